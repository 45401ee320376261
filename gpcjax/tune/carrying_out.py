"""A checked search from its beginning to its page. What was done is not done again."""

import dataclasses
import json
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from gpcjax.report import words
from gpcjax.report.compare import Comparison
from gpcjax.report.document import Picture, Sheet
from gpcjax.report.figures import compare_figure, style
from gpcjax.report.figures.painted import painted
from gpcjax.report.figures.style import Drawing
from gpcjax.report.run import draw
from gpcjax.sweep.atomic import clean, write_atomic
from gpcjax.sweep.environment import compute_here
from gpcjax.sweep.executors import Executor, Processes
from gpcjax.sweep.jsonlines import JsonLines
from gpcjax.sweep.lock import held
from gpcjax.sweep.progress import Bar
from gpcjax.sweep.run import run
from gpcjax.sweep.spec import SweepSpec
from gpcjax.sweep.telling import Watcher
from gpcjax.tune import page, toml
from gpcjax.tune.best import with_point
from gpcjax.tune.check import CHECK, checked_on, differing, is_all, of_objectives
from gpcjax.tune.command import STATE, Wishes, grid_spec
from gpcjax.tune.figure import drawn
from gpcjax.tune.found import Found, found_in
from gpcjax.tune.objectives import OBJECTIVES
from gpcjax.tune.searching import SEARCH, Adaptive, search
from gpcjax.tune.trials import Told, Trials


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a method came to: the settings, and how it tells of them."""

    usual: SweepSpec
    """Without what was found."""
    tuned: SweepSpec
    """With it."""
    origin: Sequence[str]
    """Lines for the file of the best settings."""
    lead: str
    """How it was found, in a sentence."""
    warnings: list[str]
    sheets: Callable[[int], list[Sheet]]
    """Tables of so many rows at most."""
    draw: Callable[[Comparison | None], Drawing | None]
    """Its figure."""
    files: dict[str, str]
    """Tables, by the names of their files."""
    told: dict[str, Any]
    """For programs: `best`, the settings that were found, and for points their `scores`."""
    points: pd.DataFrame | None = None
    """A row for each point that was looked at on all seeds (`Found.table`); None of a fit."""


class Result(NamedTuple):
    """A search that was carried out."""

    outcome: Outcome
    check: Comparison | None
    """With what was found and without it, on other seeds; None where both are the same."""
    said: list[str]
    """The check in sentences."""
    page: Path


def carry_out(wishes: Wishes) -> int:
    """Searches, judges on other seeds, draws, and tells of it; gives the exit status."""
    if wishes.method == "mll":  # which computes in this process
        compute_here()
    result = carried_out(wishes)
    _tell(wishes, result)
    return 0


def carried_out(wishes: Wishes) -> Result:
    """Searches, judges on other seeds, draws; what was done in the folder is not done again."""
    out = wishes.out
    with held(out), Processes(wishes.jobs) as executor:
        clean(out, lambda target: target == STATE)
        write_atomic(out / STATE, json.dumps(wishes.told, indent=2) + "\n")
        outcome = _METHODS[wishes.method](wishes, executor)
        best = dataclasses.replace(outcome.tuned, seeds=wishes.check)
        for name, text in {**outcome.files, page.BEST: toml.text_of(best, outcome.origin)}.items():
            write_atomic(out / name, text)
        comparison = checked_on(outcome.usual, outcome.tuned, wishes.check, out, executor, _watcher(wishes))
        said = page.verdict(comparison, wishes.check.words)
        if comparison is not None and wishes.method != "mll":
            said += of_objectives([OBJECTIVES[name] for name in wishes.objectives], comparison)
        commands = [shlex.join(["gpcjax", "sweep", str(out / page.BEST)])]
        if comparison is not None and is_all(comparison):
            folders = [str(out / CHECK / each.name) for each in comparison.folders]
            by = ",".join(differing(outcome.usual, outcome.tuned))
            commands.append(shlex.join(["gpcjax", "compare", *folders, "--by", by]))
        pictures = _drawn(out, outcome.draw(comparison))
        title = f"{words.algorithm(outcome.tuned.algo[0])} on {words.task(outcome.tuned.env)}, tuned"
        written = page.write(
            out,
            title,
            outcome.lead,
            outcome.sheets(page.MOST_ROWS),
            pictures,
            outcome.warnings,
            comparison,
            said,
            commands,
        )
    return Result(outcome, comparison, said, written)


def _tell(wishes: Wishes, result: Result) -> None:
    outcome, comparison = result.outcome, result.check
    if wishes.as_json:
        differences = (
            []
            if comparison is None
            else json.loads(comparison.differences_table.to_json(orient="records") or "[]")
        )
        print(json.dumps({"event": "tuned", "out": str(wishes.out), **outcome.told, "check": differences}))
        return
    from rich.console import Console

    from gpcjax.report.terminal import laid_out

    width = None if sys.stdout.isatty() else 160  # a file or pipe is no narrow terminal
    Console(width=width).print(
        laid_out(outcome.warnings, outcome.sheets(page.MOST_TERMINAL), [outcome.lead, *result.said])
    )
    files = ", ".join([page.BEST, result.page.name, *outcome.files])
    print(words.printable(f"{wishes.out}: {files}", sys.stdout.encoding))


def _drawn(out: Path, drawing: Drawing | None) -> list[Picture]:
    """The figure of a search in its folder, and for its page."""
    if drawing is None:
        return []
    (image,) = painted([drawing.figure])
    for kind, content in image.files.items():
        write_atomic(out / f"{page.FIGURE}.{kind}", content)
    return [style.pictured(drawing, svg=image.svg)]


def _watcher(wishes: Wishes) -> Callable[..., Watcher] | None:
    """Shows the progress of one sweep of many: of each nothing stays but in a terminal."""
    return JsonLines if wishes.as_json else Bar if sys.stderr.isatty() else Unseen


class Unseen:
    """A watcher that shows nothing."""

    def __init__(self, *about: Any, **more: Any):
        pass

    def __enter__(self) -> "Unseen":
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def show(self, state: object) -> None:
        """Nothing."""


def _by_trials(wishes: Wishes, executor: Executor) -> Outcome:
    objectives = tuple(OBJECTIVES[name] for name in wishes.objectives)
    startup = min(16, max(4, wishes.trials // 4))
    trials = Trials(wishes.out, wishes.space, objectives, wishes.sampler_seed, startup)
    how = Adaptive(objectives, wishes.rungs, wishes.trials, wishes.batch, wishes.eta)
    search(wishes.base, wishes.out, trials, how, executor, _watcher(wishes))
    told = tuple(trials.told())
    found = found_in(wishes.out / SEARCH, wishes.base.algo[0], wishes.space, objectives)
    lead = f"{len(told):,} trials by Optuna's tree-structured Parzen estimator, on {wishes.base.seeds.words}"
    return _of_points(wishes, found, told, lead)


def _by_grid(wishes: Wishes, executor: Executor) -> Outcome:
    folder = wishes.out / SEARCH
    folder.mkdir(parents=True, exist_ok=True)
    run(grid_spec(wishes), folder, executor.jobs, executor, watcher=_watcher(wishes))
    found = found_in(
        folder, wishes.base.algo[0], wishes.space, [OBJECTIVES[name] for name in wishes.objectives]
    )
    return _of_points(
        wishes, found, (), f"A grid of {len(found.points):,} points on {wishes.base.seeds.words}"
    )


def _of_points(wishes: Wishes, found: Found, told: tuple[Told, ...], lead: str) -> Outcome:
    draw(wishes.out / SEARCH, anew=False)
    names = ", ".join(objective.name for objective in found.objectives)
    point = ", ".join(f"{words.plain_symbol(name)} {value:.4g}" for name, value in found.best.point.items())
    lead = f"{lead}; best in {names}: {point}. {_beside(found)}; the best of many looks better than it is."

    return Outcome(
        usual=wishes.base,
        tuned=with_point(wishes.base, found.best.point),
        origin=[lead, "Its seeds had no part in the choice.", f"    gpcjax sweep {wishes.out / page.BEST}"],
        lead=lead,
        warnings=page.warnings(found),
        sheets=lambda most: [page.sheet(found, most)],
        draw=lambda comparison: drawn(found, told),
        files={page.TABLE: found.table().to_csv(index=False)},
        points=found.table(),
        told={
            "best": found.best.point,
            "scores": dict(zip(names.split(", "), found.best.scores, strict=True)),
        },
    )


def _beside(found: Found) -> str:
    """How many other points may be as good."""
    if len(found.objectives) > 1:
        front = sum(each.on_front for each in found.points)
        return (
            f"It is one of {front:,} on the front, the one with the best ranks"
            if front > 1
            else "Nothing beats it in either"
        )
    number = sum(each.tied for each in found.points) - 1
    others = (
        "1 other point is"
        if number == 1
        else f"{number:,} other points are"
        if number
        else "No other point is"
    )
    return f"{others} tied with it on the same seeds"


def _by_likelihood(wishes: Wishes, executor: Executor) -> Outcome:
    assert wishes.runs is not None
    from gpcjax.tune.likelihood import by_likelihood  # which loads jax

    fitted = by_likelihood(wishes.runs, wishes.out, where=wishes.which, take=wishes.take, seeds=wishes.check)
    bounded = [f"{fit.model} model: {', '.join(fit.at_bound)}" for fit in fitted.fits if fit.at_bound]
    warned = (
        "Numbers that ended at a bound, which the data do not tell but that they are so large, or so small: "
    )
    return Outcome(
        usual=fitted.usual,
        tuned=fitted.spec,
        origin=fitted.comments,
        lead=f"Kernels by marginal likelihood of what the runs in {wishes.runs} had learned.",
        warnings=[warned + "; ".join(bounded)] if bounded else [],
        sheets=lambda most: [fitted.sheet],
        draw=lambda comparison: None if comparison is None else compare_figure.drawn(comparison),
        files={},
        told={"best": dict(fitted.settings)},
    )


_METHODS: dict[str, Callable[[Wishes, Executor], Outcome]] = {
    "tpe": _by_trials,
    "grid": _by_grid,
    "mll": _by_likelihood,
}
