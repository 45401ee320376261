"""A run folder that grows: more seeds, errors, learners or grid points asked of it later. Loads no jax.

A folder that was asked more than once lists in its manifest all that it was `asked` for; `specification` is then their
union, each list with all values, and `varying` what has several there. What is there to run is what was asked: not
every combination of the union.

What had one value in an earlier request has no column in the parts that were written then. Its value was the one that
was given, or the learner's usual one: the manifest keeps it as `filled`, so that nobody has to know the learners to
read the rows.
"""

import dataclasses
import functools
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.sweep.boxes import Box, box_of, given_settings, is_within, uncovered, values_in
from gpcjax.sweep.labels import LABELS, labels_of
from gpcjax.sweep.layout import GIVE_NEW, GROWN, UNSEALED
from gpcjax.sweep.options import concerns
from gpcjax.sweep.plan import canonical, hash_of, varying
from gpcjax.sweep.points import POINTS
from gpcjax.sweep.seeds import MOST
from gpcjax.sweep.source import Source
from gpcjax.sweep.spec import SweepSpec, as_dict, from_dict

LISTS = ("algo", "oracle", "error", "delta", "rate")
"""What may get more values, beside `seeds`, `hyperparameters` and `points`."""

Filled = Mapping[str, Mapping[str, float | None]]
"""Setting -> learner -> the value of its cells; None where it does not concern the learner."""


def requests(manifest: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Each specification that was asked of the folder, the first one first: `hash`, `specification`, `filled`."""
    alone = {"hash": manifest["hash"], "specification": manifest["specification"], "filled": {}}
    return manifest.get("asked") or [alone]


def hashes(manifest: Mapping[str, Any]) -> dict[str, Filled]:
    """The specifications whose parts are rows of this folder: what their missing columns hold, by their hash."""
    return {each["hash"]: each["filled"] for each in requests(manifest)}


def algos_of(manifest: Mapping[str, Any], hash_: str) -> frozenset[str]:
    """The learners that a request has asked for; none of one that is not of this folder."""
    return frozenset(
        algo for each in requests(manifest) if each["hash"] == hash_ for algo in each["specification"]["algo"]
    )


def filled_in_order(manifest: Mapping[str, Any], order: Iterable[str]) -> Filled:
    """What missing columns hold of each learner that anybody has asked for: by the first request that has.

    As long as a setting does not vary, all requests for a learner have the same value of it. So any will do that a part
    was written after: first those in `order`, then the others from the first one on.
    """
    known, found = hashes(manifest), dict[str, dict[str, float | None]]()
    for hash_ in dict.fromkeys([*(each for each in order if each in known), *known]):
        for name, by_learner in known[hash_].items():
            found[name] = dict(by_learner) | found.get(name, {})
    return found


def filled_since(then: Mapping[str, Any], now: Mapping[str, Any]) -> Filled:
    """The settings that have begun to vary from one manifest of a folder to a later one: what they were before."""
    filled = filled_in_order(now, hashes(then))
    return {name: filled.get(name, {}) for name in now["varying"] if name not in then["varying"]}


def contradictions(held: Mapping[str, Any], asked: Mapping[str, Any]) -> list[str]:
    """What of a specification cannot be added to the one that a folder holds, as "episodes 30, not 40"."""
    grow = (*LISTS, "seeds", "hyperparameters", POINTS)
    fixed = [name for name in {**asked, **held} if name not in grow]
    return [
        f"{name} {_shown(held.get(name))}, not {_shown(asked.get(name))}"
        for name in fixed
        if canonical(held.get(name)) != canonical(asked.get(name))
    ]


def covering(manifest: Mapping[str, Any], spec: SweepSpec) -> str | None:
    """The hash of a request that asked for all of `spec` already; None if there is none.

    Where several have done so together, the hash of the last of those that asked for some of it.
    """
    if (hash_ := _covered_by_one(manifest, spec)) is not None:
        return hash_
    wanted = as_dict(spec)
    held = {
        each["hash"]: _held(each["specification"])
        for each in requests(manifest)
        if not contradictions(each["specification"], wanted)
    }
    names = tuple(dict.fromkeys(name for one in (*held.values(), spec) for name in given_settings(one)))
    boxes = [_box(one, names) for one in held.values()]
    if len(boxes) < 2 or uncovered(spec, boxes):
        return None
    whole = uncovered(spec, [])
    by_hash = zip(reversed(held), reversed(boxes), strict=True)
    return next(hash_ for hash_, box in by_hash if uncovered(spec, [box]) < whole)


def _covered_by_one(manifest: Mapping[str, Any], spec: SweepSpec) -> str | None:
    wanted = as_dict(spec)
    for each in requests(manifest):
        held = _held(each["specification"])
        if contradictions(each["specification"], wanted):
            continue
        names = tuple(dict.fromkeys([*given_settings(held), *given_settings(spec)]))
        box = _box(held, names)
        # Points are not every combination, so they are looked at one by one.
        if is_within(spec, box) if held.points or spec.points else box_of(spec, names).within(box):
            return each["hash"]
    return None


def grown(manifest: Mapping[str, Any], spec: SweepSpec) -> dict[str, Any]:
    """The manifest of a folder that is asked for `spec` too: one that contradicts nothing, and is not covered.

    Raises:
        UserError: a setting has several values now, and what it was before is no number; or too many seeds.
    """
    specs = [_held(each["specification"]) for each in requests(manifest)]
    union = _united([from_dict(manifest["specification"]), spec])
    names = varying(union)
    # What varies is what did before, most often: then only the last of the requests is new.
    known = requests(manifest) if "asked" in manifest and names == manifest["varying"] else []
    asked = [
        *known,
        *(
            {"hash": hash_of(as_dict(one)), "specification": as_dict(one), "filled": _filled(one, names)}
            for one in (*specs, spec)[len(known) :]
        ),
    ]
    held = [_box(one, tuple(names)) for one in specs]
    new = uncovered(spec, held)
    return {
        **manifest,
        **({"unsealed": True} if manifest["format"] == UNSEALED else {}),
        "format": GROWN,
        "hash": hash_of(as_dict(union)),
        "specification": as_dict(union),
        **labels_of(spec, manifest.get(LABELS)),
        "varying": names,
        "asked": asked,
        "cells": manifest["cells"] + new,
        "complete": False,
    }


def check(out: Path, manifest: Mapping[str, Any], spec: SweepSpec) -> None:
    """Refuse a specification that a folder cannot be asked for.

    Raises:
        UserError: it contradicts what the folder holds, or its rows could not be told from those that are there.
    """
    if covering(manifest, spec) is not None:
        return
    differences = contradictions(manifest["specification"], as_dict(spec))
    if differences:
        more = f" and {len(differences) - 3} more" if len(differences) > 3 else ""
        raise UserError(
            f"{out}: it holds another specification ({', '.join(differences[:3])}{more}): a folder grows by seeds, "
            f"learners, oracles, errors and hyperparameters alone, {GIVE_NEW}"
        )
    _united([from_dict(manifest["specification"]), spec])


def _held(specification: Mapping[str, Any]) -> SweepSpec:
    """A specification of a manifest, which is looked at with each request that comes."""
    return _read(json.dumps(specification))


@functools.lru_cache(maxsize=4096)
def _read(text: str) -> SweepSpec:
    return from_dict(json.loads(text))


@functools.lru_cache(maxsize=8192)
def _box(spec: SweepSpec, names: tuple[str, ...]) -> Box:
    return box_of(spec, names)


def _united(specs: Sequence[SweepSpec]) -> SweepSpec:
    """One specification with all the values of several that differ in nothing else, points among them."""

    def all_of(each: Iterable[Iterable[Any]]) -> tuple[Any, ...]:
        return tuple(dict.fromkeys(value for values in each for value in values if value is not None))

    names = dict.fromkeys(name for spec in specs for name in given_settings(spec))
    for name in names:
        _refuse_unknown(name, specs)
    seeds = functools.reduce(lambda one, other: one | other, (spec.seeds for spec in specs))
    if len(seeds) > MOST:
        raise UserError(f"{len(seeds):,} seeds in all: a folder has {MOST:,} at most, give a new one (--out)")
    return dataclasses.replace(
        specs[0],
        **{name: all_of(getattr(spec, name) for spec in specs) for name in LISTS},
        seeds=seeds,
        hyperparameters={
            name: all_of(values_in(spec, algo, name) for spec in specs for algo in spec.algo)
            for name in names
        },
        points=(),
    )


def _refuse_unknown(name: str, specs: Sequence[SweepSpec]) -> None:
    """Refuse to tell cells apart by a setting whose value nobody knows where it was not given."""
    for spec in specs:
        teacher = find("teacher", spec.teacher)
        for algo in spec.algo:
            concerned = concerns(name, find("learner", algo), teacher)
            if concerned and name not in given_settings(spec) and None in values_in(spec, algo, name):
                raise UserError(
                    f"{name} was not given to {algo} in one of the two: what it is then is no number that its rows "
                    "could be told apart by, give a new folder (--out)"
                )


def _filled(spec: SweepSpec, names: Iterable[str]) -> dict[str, dict[str, float | None]]:
    """The settings of `names` that have one value in a specification."""
    each = {name: {algo: values_in(spec, algo, name) for algo in spec.algo} for name in names}
    return {
        name: {algo: values[0] for algo, values in by_learner.items()}
        for name, by_learner in each.items()
        if all(len(values) == 1 for values in by_learner.values())
    }


def _shown(value: object) -> str:
    if isinstance(value, Mapping):
        value = Source(**value).label
    return "as usual" if value is None or value == [] else shown(value)
