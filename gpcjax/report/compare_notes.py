"""What two run folders that are compared differ in, and what of them is not compared: a sentence each."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gpcjax.report import words
from gpcjax.report.compare_match import OWN, PRESET, Folder, Match, Value, names_of
from gpcjax.report.compare_numbers import Difference
from gpcjax.report.groups import Baseline, Group, unique
from gpcjax.sweep.machine import differences as of_machines
from gpcjax.sweep.source import Source

MOST_VALUES = 6
"""Values of a setting that a sentence lists."""

MOST_GROUPS = 6
"""Groups that a sentence lists; all of them are in alone.csv."""


def several_things(folders: Sequence[Folder], matches: Sequence[Match]) -> list[str]:
    """Where runs that are compared differ in more than one thing, what these are.

    Groups that only one folder has are no such thing: they are compared with nothing.
    """
    things = [_name(name) for name in unique(name for each in matches for name in crossed(each))]
    things += ["the versions"] if _versions(folders) else []
    things += ["the kind of machine"] if len(_kinds(folders) - {""}) > 1 else []
    if len(things) < 2:
        return []
    return [
        f"What is compared differs in {len(things)} things ({words.listed(things)}): any of them may be behind a "
        "difference."
    ]


def differing(folders: Sequence[Folder]) -> list[str]:
    """Specifications, versions, machines and baselines that differ, a line for each kind; what is the same, in one."""
    settings = [f"{_name(name)} ({shown})" for name, shown in _settings(folders)]
    lengths = [f"{name} ({shown})" for name, shown in _lengths(folders)]
    lines = []
    if settings or lengths:
        lines.append(f"Specifications differ in {words.listed(settings + lengths)}.")
    if versions := _versions(folders):
        lines.append(f"Versions differ: {', '.join(versions)}.")
    lines += _machines(folders)
    lines += _baselines(folders)
    if not settings and not versions and not _machines(folders):
        lines.append("They have the same settings, versions and kind of machine.")
    return lines


def matched(matches: Iterable[Match]) -> list[str]:
    """What groups are matched across, and over how many episodes where that is not all of them."""
    lines = []
    for each in matches:
        first, second = each.first, each.second
        if names := crossed(each):
            why = "as asked" if each.told else "the one setting in which they differ"
            across = words.listed([_name(name) for name in names])
            lines.append(f"{first.name} and {second.name} are matched across {across}, {why}.")
        if first.study.episodes != second.study.episodes:
            shorter = min(first.study.episodes, second.study.episodes)
            lines.append(f"{first.name} and {second.name} are compared over their first {shorter} episodes.")
    return lines


def uncounted(folders: Iterable[Folder]) -> list[str]:
    """Runs that stopped, and runs that are in no number."""
    lines = []
    for folder in folders:
        groups = folder.study.groups
        stopped = sum(len(group.stopped) for group in groups)
        lost = sum(len(group.uncounted) for group in groups)
        unfinished = sum(len(group.unfinished) for group in groups)
        parts = []
        if stopped - lost:
            parts.append(
                f"{_runs(stopped - lost)} stopped and count as a robot that does nothing from then on"
            )
        if lost:
            parts.append(
                f"{_runs(lost)} stopped and count nowhere, as it does not tell the idle policy's return"
            )
        if unfinished:
            parts.append(f"{_runs(unfinished)} not finished, in no number")
        if folder.study.cut:
            parts.append(f"{words.cut_short(folder.study.cut)}, in no number")
        if folder.study.cut_runs:
            parts.append(f"{_runs(folder.study.cut_runs)} without any other episode")
        if parts:
            lines.append(f"{folder.name}: {'; '.join(parts)}.")
    return lines


def alone(matches: Iterable[Match]) -> list[str]:
    """Groups without a partner, a line for each folder with one that it is compared with."""
    lines = []
    for each in matches:
        sides = ((each.first, each.second, each.alone[0]), (each.second, each.first, each.alone[1]))
        for folder, other, groups in sides:
            if groups:
                named = [group_name(folder, group) for group in groups[:MOST_GROUPS]]
                rest = len(groups) - len(named)
                more = f"; and {rest} more, see alone.csv" if rest else ""
                lines.append(f"In {folder.name} and not in {other.name}: {'; '.join(named)}{more}.")
    return lines


def of_pairs(differences: Iterable[Difference]) -> list[str]:
    """How many pairs of runs are equal, and which groups have no seed in common."""
    areas = [each for each in differences if each.statistic == "area"]
    lines = []
    for first, second in unique((each.pair.first, each.pair.second) for each in areas):
        ours = [each for each in areas if (each.pair.first, each.pair.second) == (first, second)]
        pairs, equal = sum(each.pairs for each in ours), sum(each.equal for each in ours)
        if equal:
            same = f"All {pairs}" if equal == pairs else f"{equal} of {pairs}"
            lines.append(
                f"{same} pairs of runs of {first.name} and {second.name} have the same return in every "
                "episode, to the bit."
            )
        without = [group_name(first, each.pair.one) for each in ours if not each.pairs]
        if without:
            lines.append(f"{first.name} and {second.name} have no seed in common in {'; '.join(without)}.")
    return lines


def crossed(match: Match) -> tuple[str, ...]:
    """The settings in which groups differ that are paired."""
    return tuple(
        name
        for name in match.across
        if any(
            match.first.setting(each.one, name) != match.second.setting(each.other, name)
            for each in match.pairs
        )
    )


def group_name(folder: Folder, group: Group) -> str:
    """A group in words: learner, error, what varies in its folder."""
    point = words.point(group)
    oracle = f", oracle {group.oracle}" if len(folder.values.get("oracle", ())) > 1 else ""
    return f"{words.algorithm(group.algo)}, {words.percent(group.error)} error{oracle}{', ' + point if point else ''}"


def shown(name: str, value: Value) -> str:
    """The value of a setting, as tables and sentences have it."""
    if value is None:
        return words.ABSENT
    if isinstance(value, bool):
        return "on" if value else "off"
    if name == "error":
        return words.percent(float(str(value)))
    if name == "algo":
        return words.algorithm(str(value))
    if isinstance(value, tuple) and len(value) > 8:
        return f"{len(value)} values from {value[0]:g} to {value[-1]:g}"
    if isinstance(value, tuple):
        return " ".join(f"{each:g}" for each in value) or "none"
    if isinstance(value, Source):
        return value.label
    return f"{value:g}" if isinstance(value, int | float) else value


def _name(name: str) -> str:
    """A setting in a sentence: with its symbol, if it has one."""
    symbol = words.plain_symbol(name)
    return name if name in OWN or symbol == name else f"{name} {symbol}"


def _settings(folders: Sequence[Folder]) -> list[tuple[str, str]]:
    """Each setting that the specifications give other values, with these."""
    found = []
    for name in names_of(folders):
        values = [folder.values.get(name, (PRESET,)) for folder in folders]
        if len({frozenset(each) for each in values}) > 1:
            texts = [_several([shown(name, value) for value in each]) for each in values]
            found.append((name, _each(folders, texts)))
    return found


def _lengths(folders: Sequence[Folder]) -> list[tuple[str, str]]:
    names = unique(name for folder in folders for name in folder.lengths)
    every = [(name, [str(folder.lengths.get(name, words.ABSENT)) for folder in folders]) for name in names]
    return [(name, _each(folders, texts)) for name, texts in every if len(set(texts)) > 1]


def _versions(folders: Sequence[Folder]) -> list[str]:
    names = unique(name for folder in folders for name in folder.versions)
    every = [(name, [folder.versions.get(name, "none") for folder in folders]) for name in names]
    return [f"{name} {_each(folders, texts)}" for name, texts in every if len(set(texts)) > 1]


def _machines(folders: Sequence[Folder]) -> list[str]:
    """One line, if all rows were not made on one kind of machine, as far as that is known."""
    kinds = _kinds(folders)
    if len(kinds) == 1 and "" not in kinds:
        return []
    silent = [folder.name for folder in folders if "" in folder.kinds]
    if silent:
        tell = (
            "does not tell its own (an old store)" if len(silent) == 1 else "do not tell theirs (old stores)"
        )
        return [f"Kinds of machine may differ: {words.listed(silent)} {tell}."]
    every = [machine for folder in folders for machine in folder.machines]
    entries = unique(
        name for one, other in itertools.combinations(every, 2) for name in of_machines(one, other)
    )
    return [
        f"Kinds of machine differ ({', '.join(name.replace('_', ' ') for name in entries)}): the same run may round "
        "otherwise there, so statistics are compared here, not bits."
    ]


def _baselines(folders: Sequence[Folder]) -> list[str]:
    """Idle and oracles whose mean return is not the same: the task or the oracle is another one."""
    oracles = unique(name for folder in folders for name in folder.study.oracles)
    every: Mapping[str, list[Baseline]] = {
        "the idle policy": [folder.study.idle for folder in folders],
        **{f"oracle {name}": [folder.study.oracle(name) for folder in folders] for name in oracles},
    }
    found = []
    for who, numbers in every.items():
        texts = [f"{each.mean:.6g}" if each.n else words.ABSENT for each in numbers]
        if len({*texts} - {words.ABSENT}) > 1:  # last bits are a matter of the machine
            found.append(f"{who} ({_each(folders, texts)})")
    return [f"The mean return differs of {words.listed(found)}."] if found else []


def _kinds(folders: Iterable[Folder]) -> set[str]:
    return {kind for folder in folders for kind in folder.kinds}


def _each(folders: Sequence[Folder], texts: Sequence[Any]) -> str:
    """`1 in A, 2 in B`; folders that say the same together."""
    by_text: dict[str, list[str]] = {}
    for folder, text in zip(folders, texts, strict=True):
        by_text.setdefault(text, []).append(folder.name)
    return "; ".join(f"{text} in {words.listed(names)}" for text, names in by_text.items())


def _several(texts: Sequence[str]) -> str:
    rest = len(texts) - MOST_VALUES
    return ", ".join(texts[:MOST_VALUES]) + (f" and {rest} more" if rest > 0 else "")


def _runs(number: int) -> str:
    return f"{number} run{'' if number == 1 else 's'}"
