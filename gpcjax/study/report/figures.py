"""The figures of a study: those of Fig. 5.6 and B.1 to B.3 of the thesis, and the advice in each episode."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D

from gpcjax.registry import find
from gpcjax.report import words
from gpcjax.report.figures import style
from gpcjax.report.figures.curves import CUT, WINDOW, line
from gpcjax.report.figures.style import Drawing, Look
from gpcjax.report.statistics import mean_band, walking_mean
from gpcjax.study.design import Treatment
from gpcjax.study.report.numbers import Numbers, Taught, curve

MOST_PANELS = 48
"""Participants of a figure: more have their curves in episodes.parquet."""


def looks_of(treatments: Sequence[Treatment], algorithms: Mapping[Treatment, str]) -> dict[Treatment, Look]:
    """A look for each: the learner's own colour, as everywhere, where no two are of the same learner.

    Args:
        treatments: all that a figure shows.
        algorithms: what learner each of them is.
    """
    names = [algorithms[each] for each in treatments]
    if len(set(names)) == len(names):
        looks = style.looks(names)
        return {each: looks[name] for each, name in zip(treatments, names, strict=True)}
    numbered = [f"{place}" for place in range(len(treatments))]
    looks = style.looks(numbered)
    return {each: looks[name] for each, name in zip(treatments, numbered, strict=True)}


def learning_curves(
    numbers: Numbers, looks: Mapping[Treatment, Look], name_of: Mapping[Treatment, str]
) -> Drawing:
    """Return against episode over participants, a panel for each task (Fig. 5.6)."""
    return _over_participants(
        numbers, looks, name_of, "curves", "return", "Learning curves",
        "Return in each episode: mean over participants of the mean of their recorded runs",
    )  # fmt: skip


def advice(numbers: Numbers, looks: Mapping[Treatment, Look], name_of: Mapping[Treatment, str]) -> Drawing:
    """Corrections for each step against episode over participants, a panel for each task."""
    return _over_participants(
        numbers, looks, name_of, "rates", "corrections a step", "Advice in each episode",
        "Advice in each episode: corrections of all action dimensions for each step, mean over participants of the "
        "mean of their recorded runs",
    )  # fmt: skip


def _over_participants(
    numbers: Numbers,
    looks: Mapping[Treatment, Look],
    name_of: Mapping[Treatment, str],
    what: str,
    label: str,
    alternative: str,
    begins: str,
) -> Drawing:
    tasks = list(dict.fromkeys(each.task for each in numbers.taught))
    cut = False
    with style.publication():
        figure, axes = style.panels([words.task(task) for task in tasks], share=False)
        for task, axis in zip(tasks, axes, strict=True):
            longest = 1
            for each in numbers.of(task):
                curves = getattr(each, what)
                look, episode = looks[each.treatment], np.arange(1, curves.shape[1] + 1)
                with np.errstate(invalid="ignore"):
                    plain, band = mean_band(curves), mean_band(_smooth(curves))
                axis.plot(episode, plain.mean, color=look.colour, linewidth=0.8, alpha=0.35, zorder=3)
                line(axis, episode, band, look)
                longest = max(longest, curves.shape[1])
            style.count_ticks(axis, longest)
            cut |= style.follow_lines([axis], bottom=0.0 if what == "rates" else None)
            axis.set_xlabel("episode")
            axis.set_ylabel(_unit(task, label))
        style.legend(figure, _handles(numbers, looks, name_of))
    counts = sorted({len(each.by_participant) for each in numbers.taught})
    people = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    caption = (
        f"{begins} ({people} participants a line). Strong lines: walking mean of {WINDOW} episodes with its 95% "
        "interval over participants; faint lines: the mean itself. An episode that some runs did not come to is the "
        "mean of those that did."
    )
    return Drawing(figure, alternative, caption + (f" {CUT}" if cut else ""))


def participants(
    numbers: Numbers, task: str, looks: Mapping[Treatment, Look], name_of: Mapping[Treatment, str]
) -> Drawing:
    """Return against episode, a panel for each participant (Figs. B.1 to B.3)."""
    taught = numbers.of(task)
    everybody = sorted({one for each in taught for one in each.by_participant})
    shown = everybody[:MOST_PANELS]
    cut = False
    with style.publication():
        figure, axes = style.panels([f"participant {one}" for one in shown])
        longest = 1
        for one, axis in zip(shown, axes, strict=True):
            for each in taught:
                longest = max(longest, _of_participant(axis, each, one, looks[each.treatment]))
        for axis in axes:
            style.count_ticks(axis, longest)
        cut = style.follow_lines(axes)
        style.label(axes, "episode", _unit(task, "return"))
        style.legend(figure, _handles(numbers, looks, name_of, taught))
    caption = (
        f"{words.task(task)}, each participant: thin lines are recorded runs, strong ones the walking mean of {WINDOW} "
        "episodes of their mean."
    )
    if len(everybody) > len(shown):
        caption += f" These are the first {len(shown)} of {len(everybody)}; all are in episodes.parquet."
    return Drawing(
        figure,
        f"{words.task(task)}: learning curves of each participant",
        caption + (f" {CUT}" if cut else ""),
    )


def _of_participant(axis, each: Taught, one: int, look: Look) -> int:
    """Draws the runs of one participant; gives the number of episodes of the longest."""
    runs = each.by_participant.get(one, ())
    for run in runs:
        returns = curve(run, "return")
        marker = {"marker": ".", "markersize": 3} if len(returns) == 1 else {}
        axis.plot(
            np.arange(1, len(returns) + 1), returns, color=look.colour, linewidth=0.6, alpha=0.5, **marker
        )
    if not runs:
        return 1
    row = each.curves[each.participants.index(one)]
    row = row[~np.isnan(row)]
    episode = np.arange(1, len(row) + 1)
    axis.plot(episode, walking_mean(row[None], WINDOW)[0], zorder=4, **look.line(len(row)))
    return len(row)


def _smooth(curves: np.ndarray) -> np.ndarray:
    """The walking mean of each row, as far as it goes."""
    made = np.full_like(curves, np.nan)
    for row, smooth in zip(curves, made, strict=True):
        known = row[~np.isnan(row)]
        if len(known):
            smooth[: len(known)] = walking_mean(known[None], WINDOW)[0]
    return made


def _unit(task: str, label: str) -> str:
    unit = find("task", task).unit
    return f"{label} ({unit})" if label == "return" and unit else label


def _handles(
    numbers: Numbers,
    looks: Mapping[Treatment, Look],
    name_of: Mapping[Treatment, str],
    taught: Sequence[Taught] | None = None,
) -> list[Artist]:
    known = dict.fromkeys(each.treatment for each in (numbers.taught if taught is None else taught))
    return [
        Line2D([], [], label=words.drawn_algorithm(name_of[each]), **looks[each].line()) for each in known
    ]
