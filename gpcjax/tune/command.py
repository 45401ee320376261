"""What `gpcjax tune` was asked for, all of it checked before anything runs. Standard library only."""

import argparse
import dataclasses
import importlib.util
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.installed import require_set_up
from gpcjax.registry import find
from gpcjax.sweep.atomic import target_of
from gpcjax.sweep.layout import GIVE_NEW
from gpcjax.sweep.lock import LOCK
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
from gpcjax.tune.flags import FLAGS, NOT_TAKEN, TABLE, TAKEN, own_values
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
    """What a person wants by words, checked, and not against what their folder holds.

    Args:
        arguments: the words, with the flags of `FLAGS`.
        settings: those of a sweep among them.
        cores: processes at once where nobody says how many.

    Raises:
        UserError: a mistake of the person's.
    """
    path = None if arguments.toml is None else Path(arguments.toml)
    if arguments.quick and path is None:
        raise UserError("--quick takes the table [quick] of a TOML file: give the file")
    table, prefix = {} if path is None else read_table(path, TABLE), f"{path}: [{TABLE}] "
    own = own_values({name: getattr(arguments, name) for name in FLAGS}, table, prefix)
    if arguments.search:
        look = Given(space.of_words(arguments.search), "--search")
    else:
        source = f"{path}: [{TABLE}.search]" if path is not None else "--search"
        looked = table.get("search", {})
        if not isinstance(looked, dict):
            raise UserError(f"{path}: [{TABLE}] search is no table: begin one with a line [{TABLE}.search]")
        look = Given(space.of_table(looked, f"{source} "), source)
    given = {} if path is None else read_toml(path, arguments.quick, TABLE)
    return checked(own, look, {**given, **settings}, conditions(arguments.where), cores, arguments.json)


def checked(
    own: Mapping[str, Given],
    look: Given,
    given: Mapping[str, Given | Unchecked],
    which: Mapping[str, str],
    cores: int,
    as_json: bool = False,
) -> Wishes:
    """What a person wants, however they said so, checked as a whole and against what their folder holds.

    Args:
        own: the settings of a search, as `own_values` gives them.
        look: the space to look in, and where it stood; an empty one for none.
        given: the settings of a sweep.
        which: which runs are fitted, by columns and values.
        cores: processes at once where nobody says how many.
        as_json: whether a program listens.

    Raises:
        UserError: a mistake of the person's.
    """
    wishes = _wishes(own, look, given, which, cores, as_json)
    _refuse_another(wishes)
    if wishes.method == "tpe" and importlib.util.find_spec("optuna") is None:
        require_set_up()
        raise UserError(f"{own['method'].source} tpe needs Optuna: pip install 'gpcjax[tune]'")
    return wishes


def _wishes(
    own: Mapping[str, Given],
    look: Given,
    given: Mapping[str, Given | Unchecked],
    which: Mapping[str, str],
    cores: int,
    as_json: bool,
) -> Wishes:
    value = {name: each.value for name, each in own.items()}
    searched, method, with_method = (
        look.value,
        value["method"],
        f"with {own['method'].source} {own['method'].value}",
    )
    for name in NOT_TAKEN:
        if name in given:
            raise UserError(f"{given[name].source}: a search has none, leave it out")
    if method == "mll":
        if searched:
            raise UserError(f"{look.source}: {with_method} all is fitted that can be, leave it out")
        base = _base_of_runs(given, own["runs"], with_method)
        which = {**which, **({"algo": given["algo"].value[0]} if "algo" in given else {})}
    else:
        if not searched:
            raise UserError(f"no search: give {look.source} {space.FORM}, once for each setting")
        if which:
            raise UserError("--where: it says which runs of --method mll, leave it out")
        base = _base(given, method, look)
        if "seeds" not in given:
            base = dataclasses.replace(base, seeds=Seeds(((0, SEEDS - 1),)))
    check = (
        own["check_seeds"]
        if value["check_seeds"] is not None
        else own["check_seeds"]._replace(value=HELD_OUT)
    )
    _refuse_common(base.seeds, check)
    out = Path(os.path.expanduser(given["out"].value)) if "out" in given else None
    wishes = Wishes(
        method=method,
        base=base,
        space=searched,
        objectives=names_of(*own["objective"]),
        trials=value["trials"],
        batch=value["batch"],
        rungs=halving.rungs_of(value["rungs"], base.seeds, base.episodes, own["rungs"].source),
        eta=value["eta"],
        sampler_seed=value["sampler_seed"],
        check=check.value,
        runs=None if value["runs"] is None else Path(os.path.expanduser(value["runs"])),
        take=names_of(*own["take"], known=TAKEN),
        which=dict(which),
        out=Path(),
        jobs=given["jobs"].value if "jobs" in given else cores,
        as_json=as_json,
    )
    usual = Path("runs", f"tune-{base.env.replace(':', '-').replace('/', '-')}-{hash_of(wishes.told)}")
    return wishes._replace(out=usual if out is None else out)


def _base(given: Mapping[str, Given | Unchecked], method: str, look: Given) -> SweepSpec:
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
    make_spec(known | {"points": Unchecked(space.corners(look.value), look.source, look.source)})
    if method == "grid":
        space.grid_of(look.value)
    base = make_spec(known)
    several = [name for name, values in base.hyperparameters.items() if len(values) > 1]
    if several:
        raise UserError(
            f"{known[several[0]].source}: give one value, or {look.source} {several[0]}=A,B for the list to be searched"
        )
    if find("teacher", base.teacher).live:
        raise UserError(f"teacher {base.teacher}: a search needs one that advises by itself")
    return base


def _base_of_runs(given: Mapping[str, Given | Unchecked], runs: Given, with_method: str) -> SweepSpec:
    """The specification of a folder whose runs are fitted."""
    if runs.value is None:
        raise UserError(
            f"no runs: give {runs.source} FOLDER, a run folder with kept states (gpcjax sweep --keep states)"
        )
    for name, setting in given.items():
        if name not in ("algo", "out", "jobs"):
            raise UserError(
                f"{setting.source}: {with_method} the folder of {runs.source} says it, leave it out"
            )
    if len(given["algo"].value if "algo" in given else ("",)) > 1:
        raise UserError(f"{given['algo'].source}: give one learner, each has a best of its own")
    folder = Path(os.path.expanduser(runs.value))
    check_report(folder)
    return from_dict(read_manifest(folder)["specification"])


def _refuse_another(wishes: Wishes) -> None:
    """Refuse a folder that is another search's, or something else than what a kill leaves that has just begun one."""
    path = wishes.out / STATE
    try:
        held = json.loads(path.read_text())
    except FileNotFoundError:
        names = [path.name for path in wishes.out.iterdir()] if wishes.out.is_dir() else []
        if any(name != LOCK and target_of(name) != STATE for name in names):
            raise UserError(
                f"{wishes.out}: this is no folder of a search, and it is not empty, {GIVE_NEW}"
            ) from None
        return
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({error}), {GIVE_NEW}") from None
    if not isinstance(held, dict):
        raise UserError(f"{path}: this is not what a search has written, {GIVE_NEW}")
    other = [name for name, value in wishes.told.items() if held.get(name) != json.loads(json.dumps(value))]
    if other:
        raise UserError(
            f"{wishes.out}: it holds another search ({other[0]} {shown(held.get(other[0]))}, not "
            f"{shown(wishes.told[other[0]])}), {GIVE_NEW}"
        )


def grid_spec(wishes: Wishes) -> SweepSpec:
    """All points of a grid."""
    points = {**wishes.base.hyperparameters, **space.grid_of(wishes.space)}
    return dataclasses.replace(wishes.base, hyperparameters=points)


def _refuse_common(seeds: Seeds, check: Given) -> None:
    """Refuse seeds that would both choose and judge."""
    common = [seed for seed in seeds if seed in check.value]
    if common:
        raise UserError(
            f"{check.source} {check.value}: seed {common[0]} has a part in the search, whose choice must be judged on "
            "others: give seeds that are not among those of the search"
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
