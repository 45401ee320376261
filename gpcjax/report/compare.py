"""Run folders compared with each other, run by run of the same seed: read, pair, count; draw and write on demand."""

import itertools
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from gpcjax.allowed import checked_path
from gpcjax.errors import UserError
from gpcjax.report import compare_page, html, words
from gpcjax.report.compare_match import Folder, Match, Pair, checked_by, match, names_of, opened
from gpcjax.report.compare_notes import differing
from gpcjax.report.compare_numbers import Difference, Profile, differences, profiles
from gpcjax.report.figures import compare_figure, style
from gpcjax.report.figures.painted import painted
from gpcjax.report.files import write_files
from gpcjax.report.groups import unique
from gpcjax.report.statistics import Interval
from gpcjax.sweep.beginning import begun
from gpcjax.sweep.layout import tell
from gpcjax.sweep.plan import hash_of
from gpcjax.sweep.source import Source

RUNS = Path("runs")
LONGEST = 120
"""Letters of the name of a folder that is made of others' names."""

_MEND = "make room and give the right to write, or give another --out"


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """What `gpcjax.compare` found.

    | Attribute           | What                                                                   |
    |---------------------|------------------------------------------------------------------------|
    | `differences_table` | a row for each statistic of each pair of groups: comparison.csv        |
    | `profiles_table`    | a row for each value, statistic and group: profiles.csv                |
    | `alone_table`       | a row for each group without a partner: alone.csv                      |
    | `notes`             | what the folders differ in and how they are matched, a sentence each   |
    """

    env: str
    folders: tuple[Folder, ...]
    matches: tuple[Match, ...]
    differences: tuple[Difference, ...]

    @cached_property
    def families(self) -> tuple[tuple[Profile, ...], ...]:
        """The profiles of groups that belong together, by statistic."""
        return profiles(self.matches)

    @property
    def notes(self) -> list[str]:
        """Sentences."""
        return [*compare_page.warnings(self), *compare_page.remarks(self)]

    @property
    def differences_table(self) -> pd.DataFrame:
        """Tidy: an estimate `x` with its interval in `x_lower` and `x_upper`.

        | column | what |
        |---|---|
        | env, first, second | the task; names of the folders |
        | oracle, error, algo, ... | settings; NAME_first and NAME_second where groups are matched across one |
        | statistic | area or final_return |
        | pairs, equal | runs with the same seed; those of them whose returns are the same to the bit |
        | difference | mean of first minus second, in units of the return |
        | excludes_zero, p, p_holm, survives | whether beyond zero; Student's p, after Holm; both |
        | better | chance that a run of the first is better than a run of the second, whatever their seeds |
        | better_paired | than the run of the same seed |
        """
        pairs = [each.pair for each in self.differences]
        shown = unique(("oracle", *compare_page.settings_shown(pairs)))
        crossed = {name for name in shown if any(len(set(_both(pair, name))) > 1 for pair in pairs)}
        return pd.DataFrame([_columns(self.env, each, shown, crossed) for each in self.differences])

    @property
    def profiles_table(self) -> pd.DataFrame:
        """`above` is the part of `runs` whose score is above `value`; groups of one `family` belong together."""
        names = [name for name in names_of(self.folders) if name in _settings_of_profiles(self)]
        frames = [
            pd.DataFrame({
                "env": self.env,
                "family": place // 2,
                "folder": each.member.folder.name,
                **_cells(each.member.folder.settings(each.member.group, names)),
                "statistic": each.statistic,
                "runs": each.runs,
                "value": each.values,
                "above": each.above.mean,
                "above_lower": each.above.lower,
                "above_upper": each.above.upper,
            })
            for place, family in enumerate(self.families)
            for each in family
        ]  # fmt: skip
        return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame()

    @property
    def alone_table(self) -> pd.DataFrame:
        """Groups that are in `folder` and have no partner in `missing_in`, with the number of their runs."""
        names = names_of(self.folders)
        rows = [
            {
                "env": self.env,
                "folder": folder.name,
                "missing_in": other.name,
                **_cells(folder.settings(group, names)),
                "runs": group.runs,
            }
            for each in self.matches
            for folder, other, groups in (
                (each.first, each.second, each.alone[0]),
                (each.second, each.first, each.alone[1]),
            )
            for group in groups
        ]
        return pd.DataFrame(rows, columns=["env", "folder", "missing_in", *names, "runs"])

    def __repr__(self) -> str:
        names = words.listed([folder.name for folder in self.folders])
        return f"<comparison of {names}: {self.env}, {len(self.differences)} differences>"

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        from gpcjax.report.inline import comparison_inline

        return comparison_inline(self)

    def save(self, out: Any) -> tuple[Path, ...]:
        """Write the tables, the figure and the page into the folder `out`, made if need be; gives their paths.

        Raises:
            UserError: something cannot be written there.
        """
        folder = checked_path("out", out)
        with begun(folder, ()):
            drawing = compare_figure.drawn(self)
            (image,) = painted([drawing.figure])
            page = compare_page.document(self, [style.pictured(drawing, svg=image.svg)])
            files: dict[str, str | bytes] = {
                "comparison.csv": self.differences_table.to_csv(index=False),
                "profiles.csv": self.profiles_table.to_csv(index=False),
                "alone.csv": self.alone_table.to_csv(index=False),
                **{f"comparison.{kind}": content for kind, content in image.files.items()},
                "comparison.html": html.render(page),
            }
            return write_files(folder, files, _MEND)


def compare(*folders: Any, by: str | Sequence[str] | None = None) -> Comparison:
    """Compare run folders of one task with each other: every two of them, run by run of the same seed.

    Groups of runs are matched that have the same learner, oracle, error and settings. Where two specifications differ
    in one setting alone, with one value in each, they are matched across it. What is damaged or foreign in a folder is
    left out, with a line on stderr.

    Args:
        folders: two run folders or more, of this or an earlier version of gpcjax.
        by: names of settings in which groups may differ that have no partner of the same settings.

    Returns:
        The differences with their intervals as tables (`differences_table`, in the units of a return), what the folders
        differ in (`notes`), and `save(out)`, which writes tables, figures and a page.

    Raises:
        ValueError: fewer than two folders, one that is none or is given twice, tasks that differ, settings of `by`
            that none of them varies, no group in common, no seed in common.
    """
    paths = [checked_path("folder", each) for each in folders]
    names = folder_names(paths)
    return compared([opened(path, name, tell) for path, name in zip(paths, names, strict=True)], by)


def compared(folders: Sequence[Folder], by: str | Sequence[str] | None = None) -> Comparison:
    """Compare what was read of run folders, as `compare` does.

    Raises:
        UserError: tasks that differ, settings of `by` that none of them varies, no group in common, no seed in common.
    """
    read = tuple(folders)
    names = [folder.name for folder in read]
    task, *others = unique(folder.study.env for folder in read)
    if others:
        told = ", ".join(f"{folder.study.env} in {folder.name}" for folder in read)
        raise UserError(f"the tasks differ ({told}): give folders of one task")
    across = checked_by(by, read)
    matches = tuple(match(one, other, across) for one, other in itertools.combinations(read, 2))
    if not any(each.pairs for each in matches):
        raise UserError(_nothing_common(read, matches))
    found = differences(pair for each in matches for pair in each.pairs)
    if not any(each.pairs for each in found):
        raise UserError(f"{' and '.join(names)} have no seed in common: give folders that share seeds")
    return Comparison(task, read, matches, found)


def folder_names(paths: Sequence[Path]) -> list[str]:
    """What each folder is called: its name, with as many of the folders above it as tell it from the others.

    Raises:
        UserError: fewer than two, or one is given twice.
    """
    if len(paths) < 2:
        raise UserError("a comparison needs two run folders or more: give them one after the other")
    whole = [Path(os.path.realpath(path)) for path in paths]
    for path, real in zip(paths, whole, strict=True):
        if whole.count(real) > 1:
            raise UserError(f"{path} is given twice: give it once")
    return [_name(real, whole) for real in whole]


def usual_out(names: Sequence[str]) -> Path:
    """Where a comparison of folders with these names goes if nobody says: `runs/compare-A-B`."""
    name = "-".join(["compare", *(re.sub(r"[^A-Za-z0-9_.-]+", "-", each).strip("-") for each in names)])
    if len(name) > LONGEST:
        name = (
            f"compare-{len(names)}-folders-{hash_of({'folders': {each: i for i, each in enumerate(names)}})}"
        )
    return RUNS / name


def _name(path: Path, among: Sequence[Path]) -> str:
    parts = path.parts
    for count in range(1, len(parts)):
        if sum(other.parts[-count:] == parts[-count:] for other in among) == 1:
            return "/".join(parts[-count:])
    return str(path)


def _nothing_common(folders: Sequence[Folder], matches: Sequence[Match]) -> str:
    names = words.listed([folder.name for folder in folders])
    settings = unique(name for each in matches for name in each.differing)
    how = (
        f"give --by {','.join(settings)} to match across what differs" if settings else "let them run further"
    )
    told = f" (their s{differing(folders)[0][1:].removesuffix('.')})" if settings else ""
    return f"{names} have no group of runs with the same settings{told}: {how}"


def _both(pair: Pair, name: str) -> tuple[Any, Any]:
    return pair.first.setting(pair.one, name), pair.second.setting(pair.other, name)


def _cells(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings as fields of a table: a series, which is one value, as its text, and so is a folder to begin with."""

    def cell(value: Any) -> Any:
        if isinstance(value, Source):
            return value.label
        return " ".join(f"{each:g}" for each in value) if isinstance(value, tuple) else value

    return {name: cell(value) for name, value in settings.items()}


def _settings_of_profiles(comparison: Comparison) -> set[str]:
    return {"oracle", *compare_page.settings_shown([each.pair for each in comparison.differences])}


def _columns(env: str, each: Difference, shown: Sequence[str], crossed: set[str]) -> dict[str, Any]:
    settings: dict[str, Any] = {}
    for name in shown:
        one, other = _both(each.pair, name)
        settings |= {f"{name}_first": one, f"{name}_second": other} if name in crossed else {name: one}
    settings = _cells(settings)
    return {
        "env": env,
        "first": each.pair.first.name,
        "second": each.pair.second.name,
        **settings,
        "statistic": each.statistic,
        "pairs": each.pairs,
        "equal": each.equal,
        **_bounds("difference", each.difference),
        "excludes_zero": each.difference.excludes_zero,
        "p": each.p,
        "p_holm": each.p_holm,
        "survives": each.survives,
        **_bounds("better", each.better),
        **_bounds("better_paired", each.better_paired),
    }


def _bounds(name: str, interval: Interval) -> dict[str, float]:
    return {name: interval.estimate, f"{name}_lower": interval.lower, f"{name}_upper": interval.upper}
