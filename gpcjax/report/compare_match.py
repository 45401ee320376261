"""Which runs of two run folders belong together: groups of the same settings, then runs of the same seed."""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.allowed import shown, suggestion
from gpcjax.errors import UserError
from gpcjax.registry import Kind, built_in, find
from gpcjax.report.groups import Group, Study, gather, unique
from gpcjax.sweep import points
from gpcjax.sweep.boxes import usual
from gpcjax.sweep.counted import read_counted
from gpcjax.sweep.machine import kind_of
from gpcjax.sweep.options import concerns
from gpcjax.sweep.requested import chosen_of
from gpcjax.sweep.runfolder import check_report
from gpcjax.sweep.scales import SCALES
from gpcjax.sweep.source import Source
from gpcjax.sweep.spec import ORACLE, SweepSpec

PRESET = "preset"
"""Value of a setting that a specification leaves to the learner or the teacher, where that is not known here."""

OWN = ("oracle", "error", "algo")
"""Settings that a group has beside its point."""

_LENGTHS = ("seeds", "episodes")
"""Of a specification; they say how much was run, and not what."""

_LATER: Mapping[str, Any] = {"teacher": ORACLE, "rate_schedule": [], "start": None} | {
    key: [] for key in SCALES
}
"""What a specification means that does not name them: they came with later versions."""

Value = str | float | bool | tuple[Any, ...] | Source | None
"""Of a setting in a group; None where it changes nothing."""


@dataclass(frozen=True, eq=False)
class Folder:
    """A run folder that was read, as all of a comparison sees it.

    `values` holds what the specification gives each setting (one or several), `lengths` its seeds and episodes,
    `kinds` the kind of each machine that computed rows ("" for one that an old manifest does not tell), `machines`
    what the manifest says of them.
    """

    name: str
    path: Path
    study: Study
    values: Mapping[str, tuple[Value, ...]]
    lengths: Mapping[str, int]
    hash: str
    versions: Mapping[str, str]
    machines: tuple[Mapping[str, Any], ...]
    _concerned: dict[tuple[str, str], bool] = field(default_factory=dict, init=False, repr=False)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Each kind of machine once."""
        return unique(kind_of(machine) for machine in self.machines)

    def setting(self, group: Group, name: str) -> Value:
        """What a setting is in one of the groups here."""
        if name in OWN:
            return getattr(group, name)
        key = group.algo, name
        if key not in self._concerned:  # asked for each group and setting, many times
            self._concerned[key] = _is_concerned(group.algo, self, name)
        if not self._concerned[key]:
            return None
        if name in self.study.varying:
            return group.point.get(name)
        if name not in self.values:
            return self._usual(group.algo, name)
        values = self.values[name]
        return values[0] if len(values) == 1 else None

    def _usual(self, algo: str, name: str) -> Value:
        """The value of a setting that nobody gave here, where it is known without anybody's own module."""
        (teacher,), env = self.values["teacher"], self.study.env
        named: dict[Kind, Value] = {"learner": algo, "teacher": teacher, "task": env}
        if not all(each in built_in(kind) for kind, each in named.items()):
            return PRESET
        value = usual(env, algo, str(teacher), name)
        return PRESET if value is None else value

    @cached_property
    def varied(self) -> frozenset[tuple[str, str]]:
        """Each learner with the settings that vary here and concern it."""
        return frozenset((group.algo, name) for group in self.study.groups for name, _ in group.point.values)

    def settings(self, group: Group, names: Iterable[str]) -> dict[str, Value]:
        """Those of these names."""
        return {name: self.setting(group, name) for name in names}


@dataclass(frozen=True, eq=False)
class Pair:
    """Two groups that are compared, over as many episodes as both have."""

    first: Folder
    second: Folder
    one: Group
    other: Group


@dataclass(frozen=True, eq=False)
class Match:
    """What two folders have in common.

    `across` names the settings in which groups may differ that are paired all the same, `told` whether somebody asked
    for that; `differing` those of which the specifications give other values; `alone` the groups of each folder that
    have no partner.
    """

    first: Folder
    second: Folder
    pairs: tuple[Pair, ...]
    across: tuple[str, ...]
    told: bool
    differing: tuple[str, ...]
    alone: tuple[tuple[Group, ...], tuple[Group, ...]]


def opened(path: Path, name: str, say: Callable[[str], None], spec: SweepSpec | None = None) -> Folder:
    """Read a run folder: all that a comparison takes from a store and its manifest.

    What is damaged or foreign in the store is left out; `say` gets a line for it. With a `spec`, which the folder was
    asked for, the folder is read as if it held that alone.

    Raises:
        UserError: it is no run folder, holds no episodes yet, or none that is whole.
    """
    check_report(path)
    episodes, manifest = read_counted(path, say)
    if spec is not None and episodes is not None:
        episodes, manifest = chosen_of(episodes, manifest, spec)
    if episodes is None or not len(episodes.seeds):
        raise UserError(f"{path}: it holds no episodes of its sweep, let it run further")
    specification = {**manifest["specification"]}
    for each, meant in _LATER.items():
        specification.setdefault(each, meant)
    if specification["start"] is not None:
        specification["start"] = Source(**specification["start"])
    lengths = {each: specification.pop(each) for each in _LENGTHS if each in specification}
    given = points.given(specification)
    specification.pop("hyperparameters", None)
    specification.pop(points.POINTS, None)
    several = {each for each in ("algo", "error", "oracle", "delta", "rate", *given)}
    values = {
        each: tuple(value) if each in several and isinstance(value, list) else (_frozen(value),)
        for each, value in {**specification, **given}.items()
    }
    machines = (manifest["machine"], *manifest.get("further_machines", ()))
    study = gather(episodes, manifest)
    return Folder(name, path, study, values, lengths, manifest["hash"], manifest["versions"], machines)


def names_of(folders: Iterable[Folder]) -> tuple[str, ...]:
    """Every setting that tells groups of these folders apart, in the order of their specifications."""
    return tuple(name for name in unique(name for each in folders for name in each.values) if name != "env")


def match(first: Folder, second: Folder, by: Sequence[str] = ()) -> Match:
    """Pair the groups of two folders: those of the same settings, then what is left, across the settings `by`.

    Without `by`, groups are matched across the one setting in which the specifications differ, where there is just one
    and it has one value in each.
    """
    names = names_of((first, second))
    differing = tuple(name for name in names if not _same_values(first, second, name))
    told = bool(by)
    across = tuple(by)
    if not told and len(differing) == 1 and all(_alone(each, differing[0]) for each in (first, second)):
        across = differing
    ours = [(group, first.settings(group, names)) for group in first.study.groups]
    theirs = [(group, second.settings(group, names)) for group in second.study.groups]
    partners = {tuple(settings.items()): group for group, settings in theirs}
    found = [(group, partners.get(tuple(settings.items()))) for group, settings in ours]
    together = [(one, other) for one, other in found if other is not None]
    taken = {id(group) for pair in together for group in pair}
    if across:
        left = [[each for each in side if id(each[0]) not in taken] for side in (ours, theirs)]
        together += [
            (one, other)
            for (one, mine), (other, its) in itertools.product(*left)
            if _agree(mine, its, across)
        ]
        taken = {id(group) for pair in together for group in pair}
    episodes = min(first.study.episodes, second.study.episodes)
    order = {id(group): place for place, group in enumerate(first.study.groups)}
    together.sort(key=lambda pair: order[id(pair[0])])
    pairs = tuple(Pair(first, second, cut(one, episodes), cut(other, episodes)) for one, other in together)
    sides = (first.study.groups, second.study.groups)
    alone = tuple(tuple(group for group in side if id(group) not in taken) for side in sides)
    return Match(first, second, pairs, across, told, differing, (alone[0], alone[1]))


def cut(group: Group, episodes: int) -> Group:
    """The group as if its runs had ended after so many episodes."""
    return replace(group, returns=group.returns[:, :episodes], corrections=group.corrections[:, :episodes])


def of_seeds(group: Group, seeds: np.ndarray) -> Group:
    """The group with the runs of these seeds alone."""
    chosen = np.isin(group.seeds, seeds)
    return replace(
        group,
        seeds=group.seeds[chosen],
        returns=group.returns[chosen],
        corrections=group.corrections[chosen],
    )


def checked_by(by: str | Sequence[str] | None, folders: Sequence[Folder]) -> tuple[str, ...]:
    """The names in `by` (a comma list or several texts), each a setting in which the folders differ.

    Raises:
        UserError: one is no setting of these folders, is given twice, or is the same in all of them.
    """
    if by is None:
        return ()
    words = by.split(",") if isinstance(by, str) else list(by)
    names, known = [str(word).strip().replace("-", "_") for word in words], names_of(folders)
    couples = list(itertools.combinations(folders, 2))
    differ = [name for name in known if not all(_same_values(*couple, name) for couple in couples)]
    give = f"give {', '.join(differ)}" if differ else "leave it out, the folders differ in no setting"
    for word, name in zip(words, names, strict=True):
        if name not in known:
            raise UserError(f"by {shown(word)}: no setting of these folders{suggestion(name, known)}: {give}")
        if names.count(name) > 1:
            raise UserError(f"by {shown(word)} is given twice: give it once")
        if name not in differ:
            raise UserError(f"by {shown(word)}: the folders have the same values of it, {give}")
    return tuple(names)


def _agree(mine: Mapping[str, Value], its: Mapping[str, Value], across: Sequence[str]) -> bool:
    """Whether all but the settings `across` are the same, as far as they concern both."""
    return all(
        name in across or mine[name] == its[name] or mine[name] is None or its[name] is None for name in mine
    )


def _is_concerned(algo: str, folder: Folder, name: str) -> bool:
    """Whether a setting changes anything for a learner: as its store tells, or its description.

    Another's learner is not asked: its module would run for it.
    """
    if name in folder.study.varying:
        return (algo, name) in folder.varied
    (teacher,) = folder.values["teacher"]
    if algo not in built_in("learner") or teacher not in built_in("teacher"):
        return True
    return concerns(name, find("learner", algo), find("teacher", str(teacher)))


def _same_values(first: Folder, second: Folder, name: str) -> bool:
    return set(first.values.get(name, (PRESET,))) == set(second.values.get(name, (PRESET,)))


def _alone(folder: Folder, name: str) -> bool:
    return len(folder.values.get(name, (PRESET,))) == 1


def _frozen(value: Any) -> Value:
    """A value of JSON that can be a key; a table, which no setting of today is, as its text."""
    if isinstance(value, list):
        return tuple(map(_frozen, value))
    return str(value) if isinstance(value, dict) else value
