"""What `gpcjax tune` was asked for, all of it checked before anything runs. Standard library only."""

import argparse
import dataclasses
import importlib.util
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.allowed import shown, suggestion
from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.sweep.layout import GIVE_NEW
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.options import conditions
from gpcjax.sweep.plan import count, hash_of
from gpcjax.sweep.runfolder import check_report
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import (
    Given,
    SweepSpec,
    Unchecked,
    as_dict,
    from_dict,
    make_spec,
    read_toml,
)
from gpcjax.sweep.tomlfile import read_table
from gpcjax.tune import halving, space
from gpcjax.tune.flags import TABLE, TAKEN, own_values
from gpcjax.tune.halving import Rung
from gpcjax.tune.names import names_of
from gpcjax.tune.space import Space

STATE = "tune.json"
"""In the folder of a search: what it is, so that only the same one goes on there."""

SEEDS = 16
"""Of the search, where nobody gives any."""

HELD_OUT = Seeds(((1000, 1099),))
"""Seeds on which the best is judged, unless somebody says which."""


class Wishes(NamedTuple):
    """A search, checked."""

    method: str
    base: SweepSpec
    """A run, without what is searched; with the seeds of the search."""
    space: Space
    objectives: tuple[str, ...]
    trials: int
    batch: int
    rungs: tuple[Rung, ...]
    eta: float
    sampler_seed: int
    check: Seeds
    runs: Path | None
    """A folder with what runs had learned, for the method that is fitted to it."""
    take: tuple[str, ...]
    """What of the fitted numbers become settings."""
    which: dict[str, str]
    """Which of these, by columns and values."""
    out: Path
    jobs: int
    as_json: bool

    @property
    def told(self) -> dict[str, Any]:
        """What this search is, as its folder keeps it: all that its points follow from, but how many there are."""
        return {
            "method": self.method,
            "specification": as_dict(self.base),
            "search": space.as_json(self.space),
            "objectives": list(self.objectives),
            "batch": self.batch,
            "rungs": [list(rung) for rung in self.rungs],
            "eta": self.eta,
            "sampler_seed": self.sampler_seed,
            "runs": None if self.runs is None else str(self.runs),
            "take": list(self.take),
            "where": self.which,
        }


def wishes_of(arguments: argparse.Namespace, settings: Mapping[str, Given | Unchecked], cores: int) -> Wishes:
    """What a person wants, checked, and not against what their folder holds.

    Args:
        arguments: the words, with the flags of `FLAGS`.
        settings: those of a sweep among them.
        cores: processes at once where nobody says how many.

    Raises:
        UserError: a mistake of the person's.
    """
    wishes = _wishes(arguments, settings, cores)
    _refuse_another(wishes)
    if wishes.method == "tpe" and importlib.util.find_spec("optuna") is None:
        raise UserError("--method tpe needs Optuna: pip install 'gpcjax[tune]'")
    return wishes


def _wishes(arguments: argparse.Namespace, settings: Mapping[str, Given | Unchecked], cores: int) -> Wishes:
    path = None if arguments.toml is None else Path(arguments.toml)
    if arguments.quick and path is None:
        raise UserError("--quick takes the table [quick] of a TOML file: give the file")
    own = own_values(arguments, {} if path is None else read_table(path, TABLE), f"{path}: [{TABLE}] ")
    where, source = _space(arguments, path)
    given = {} if path is None else read_toml(path, arguments.quick, TABLE)
    given |= settings
    for name in ("rate_from", "keep", "keep_at"):
        if name in given:
            raise UserError(f"{given[name].source}: a search has none, leave it out")
    method, which = own["method"], conditions(arguments.where)
    if method == "mll":
        if where:
            raise UserError(f"{source}: --method mll finds all it can, leave it out")
        base = _base_of_runs(given, own["runs"])
        which |= {"algo": given["algo"].value[0]} if "algo" in given else {}
    else:
        if not where:
            raise UserError(f"no search: give --search {space.FORM}, once for each setting")
        if which:
            raise UserError("--where: it says which runs of --method mll, leave it out")
        base = _base(given, method, where, source)
        if "seeds" not in given:
            base = dataclasses.replace(base, seeds=Seeds(((0, SEEDS - 1),)))
    seeds = base.seeds
    rungs = halving.rungs_of(own["rungs"], seeds, base.episodes, own["source of rungs"])
    check = HELD_OUT if own["check_seeds"] is None else own["check_seeds"]
    _refuse_common(seeds, check, own["source of check_seeds"])
    names = names_of(own["objective"], own["source of objective"])
    out = Path(os.path.expanduser(given["out"].value)) if "out" in given else None
    wishes = Wishes(
        method=method,
        base=base,
        space=where,
        objectives=names,
        trials=own["trials"],
        batch=own["batch"],
        rungs=rungs,
        eta=own["eta"],
        sampler_seed=own["sampler_seed"],
        check=check,
        runs=None if own["runs"] is None else Path(os.path.expanduser(own["runs"])),
        take=_taken(own["take"], own["source of take"]),
        which=which,
        out=Path(),
        jobs=given["jobs"].value if "jobs" in given else cores,
        as_json=arguments.json,
    )
    usual = Path("runs", f"tune-{base.env.replace(':', '-').replace('/', '-')}-{hash_of(wishes.told)}")
    return wishes._replace(out=usual if out is None else out)


def _space(arguments: argparse.Namespace, path: Path | None) -> tuple[Space, str]:
    """Where to look, by flags or else by the file, and where that stood."""
    if arguments.search:
        return space.of_words(arguments.search), "--search"
    table = {} if path is None else read_table(path, TABLE).get("search", {})
    if not isinstance(table, dict):
        raise UserError(f"{path}: [{TABLE}] search is no table: begin one with a line [{TABLE}.search]")
    return space.of_table(table, f"{path}: [{TABLE}.search] "), f"{path}: [{TABLE}.search]"


def _base(given: Mapping[str, Given | Unchecked], method: str, where: Space, source: str) -> SweepSpec:
    """The specification of a run without what is searched, all of which is checked with it."""
    known = dict(given)
    known.setdefault("algo", Given(("gpc",), "algo"))
    algo = known["algo"].value
    if len(algo) > 1:
        raise UserError(
            f"{known['algo'].source} {','.join(algo)}: give one learner, each has a best of its own"
        )
    if "points" in known:
        raise UserError(f"{known['points'].source}: a search has points of its own, leave it out")
    if where:
        corners = {"points": Unchecked(space.corners(where), source, source)}
        make_spec(known | corners)
        if method == "grid":
            space.grid_of(where)
    base = make_spec(known)
    several = [name for name, values in base.hyperparameters.items() if len(values) > 1]
    if several:
        raise UserError(
            f"{known[several[0]].source}: give one value, or --search {several[0]}=A,B for the list to be searched"
        )
    if find("teacher", base.teacher).live:
        raise UserError(f"teacher {base.teacher}: a search needs one that advises by itself")
    return base


def _base_of_runs(given: Mapping[str, Given | Unchecked], runs: str | None) -> SweepSpec:
    """The specification of a folder whose runs are fitted."""
    if runs is None:
        raise UserError(
            "no runs: give --runs FOLDER, a run folder with kept states (gpcjax sweep --keep states)"
        )
    for name, setting in given.items():
        if name not in ("algo", "out", "jobs"):
            raise UserError(f"{setting.source}: with --method mll the folder of --runs says it, leave it out")
    if len(given["algo"].value if "algo" in given else ("",)) > 1:
        raise UserError(f"{given['algo'].source}: give one learner, each has a best of its own")
    folder = Path(os.path.expanduser(runs))
    check_report(folder)
    return from_dict(read_manifest(folder)["specification"])


def _taken(text: str, source: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(word.strip().replace("-", "_") for word in text.split(",")))
    for name in names:
        if name not in TAKEN:
            raise UserError(f"{source} {shown(name)}: give {', '.join(TAKEN)}{suggestion(name, TAKEN)}")
    return names


def _refuse_another(wishes: Wishes) -> None:
    """Refuse a folder that is another search's, or something else."""
    path = wishes.out / STATE
    try:
        held = json.loads(path.read_text())
    except FileNotFoundError:
        if wishes.out.is_dir() and any(wishes.out.iterdir()):
            raise UserError(
                f"{wishes.out}: this is no folder of a search, and it is not empty, {GIVE_NEW}"
            ) from None
        return
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({error}), {GIVE_NEW}") from None
    other = [name for name, value in wishes.told.items() if held.get(name) != json.loads(json.dumps(value))]
    if other:
        raise UserError(
            f"{wishes.out}: it holds another search ({other[0]} {shown(held.get(other[0]))}, not "
            f"{shown(wishes.told[other[0]])}), {GIVE_NEW}"
        )


def grid_spec(wishes: Wishes) -> SweepSpec:
    """All points of a grid."""
    return dataclasses.replace(
        wishes.base, hyperparameters={**wishes.base.hyperparameters, **space.grid_of(wishes.space)}
    )


def _refuse_common(seeds: Seeds, check: Seeds, source: str) -> None:
    """Refuse seeds that would both choose and judge."""
    common = [seed for seed in seeds if seed in check]
    if common:
        raise UserError(
            f"{source} {check}: seed {common[0]} has a part in the search, whose choice must be judged on others: "
            "give seeds that are not among --seeds"
        )


def said(wishes: Wishes) -> str:
    """What would be done, in a line."""
    checked = 2 * count(dataclasses.replace(wishes.base, seeds=wishes.check))
    match wishes.method:
        case "grid":
            cells, what = count(grid_spec(wishes)), "grid"
        case "tpe":
            each = count(dataclasses.replace(wishes.base, seeds=halving.first(wishes.base.seeds, 1)))
            cells, on = 0, float(wishes.trials)
            for rung in wishes.rungs:
                cells += round(on) * rung.seeds * each
                on /= wishes.eta
            what = f"{wishes.trials} trials"
        case _:
            cells, what = 0, "marginal likelihood"
    cells_of = f"{cells:,} cells of {wishes.base.env}, then {checked:,} to judge"
    return f"{what}: {cells_of}, in {wishes.jobs} processes, into {wishes.out}"
