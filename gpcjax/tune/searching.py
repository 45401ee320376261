"""The search itself: batches of points run as cells of one sweep, scored, and told to whoever asks for the next."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from gpcjax.report.groups import gather
from gpcjax.sweep.counted import read_counted
from gpcjax.sweep.executors import Executor
from gpcjax.sweep.layout import tell
from gpcjax.sweep.requested import chosen_of
from gpcjax.sweep.run import run
from gpcjax.sweep.spec import SweepSpec
from gpcjax.sweep.telling import Watcher
from gpcjax.tune import halving, ranking
from gpcjax.tune.halving import Rung
from gpcjax.tune.objectives import Objective, by_point, key_of, point_scores
from gpcjax.tune.trials import Trial, Trials

SEARCH = "search"
"""The run folder of the search: all points that came to the last rung."""


@dataclasses.dataclass(frozen=True)
class Adaptive:
    """How points are chosen and looked at, one batch after another."""

    objectives: tuple[Objective, ...]
    rungs: tuple[Rung, ...]
    trials: int
    batch: int
    eta: float


def search(
    base: SweepSpec,
    out: Path,
    trials: Trials,
    how: Adaptive,
    executor: Executor,
    watcher: Callable[..., Watcher] | None = None,
    say: Callable[[str], None] = tell,
) -> None:
    """Asks for points until there are `how.trials`, and runs them: rows go to `OUT/search` and `OUT/rung-N`.

    Args:
        base: the specification of a run, with all seeds and episodes of the last rung.
        out: the folder of the search.
        trials: who says where to look, and is told.
        how: in which batches and rungs.
        executor: runs the cells of one rung after those of another; it should keep its workers.
        watcher: shows the progress of a rung.
        say: takes a line for the person.
    """
    larger = [objective.larger for objective in how.objectives]
    while batch := trials.next_batch(how.batch, how.trials):
        ended: list[tuple[Trial, tuple[float, ...], int, bool]] = []
        say(f"trials {batch[0].number} to {batch[-1].number} of {how.trials}{_best(trials, how)}")
        for index, rung in enumerate(how.rungs):
            last = index == len(how.rungs) - 1
            folder = out / (SEARCH if last else f"rung-{index + 1}")
            scores = _run(base, folder, batch, rung, how.objectives, executor, watcher)
            order = ranking.ranked([scores[trial.number] for trial in batch], larger)
            on = set(order if last else halving.go_on(order, how.eta))
            for place, trial in enumerate(batch):
                if last or place not in on:
                    ended.append((trial, scores[trial.number], index, last))
            batch = [trial for place, trial in enumerate(batch) if place in on]
        for each in ended:  # all of a batch at once: a kill in between finds the same batch again
            trials.tell(*each)


def _run(
    base: SweepSpec,
    folder: Path,
    batch: Sequence[Trial],
    rung: Rung,
    objectives: Sequence[Objective],
    executor: Executor,
    watcher: Callable[..., Watcher] | None,
) -> dict[int, tuple[float, ...]]:
    """The scores of trials on a rung, by their numbers."""
    spec = dataclasses.replace(
        base,
        seeds=halving.first(base.seeds, rung.seeds),
        episodes=rung.episodes,
        points=tuple(dict.fromkeys(tuple(trial.point.items()) for trial in batch)),
    )
    folder.mkdir(parents=True, exist_ok=True)
    run(spec, folder, executor.jobs, executor, watcher=watcher, say=lambda line: None)
    return scores_in(
        folder, spec, [trial.point for trial in batch], [trial.number for trial in batch], objectives
    )


def scores_in(
    folder: Path,
    spec: SweepSpec,
    points: Sequence[Mapping[str, float]],
    numbers: Sequence[int],
    objectives: Sequence[Objective],
) -> dict[int, tuple[float, ...]]:
    """What the rows of a run folder say of the points of `spec`, by the numbers given; nan for one without rows.

    Those of earlier points are read, and no more: there are ever more of them.
    """
    none = (float("nan"),) * len(objectives)
    episodes, manifest = read_counted(folder, lambda line: None)
    if episodes is not None:
        episodes, manifest = chosen_of(episodes, manifest, spec)
    if episodes is None or not len(episodes.seeds):
        return dict.fromkeys(numbers, none)
    study = gather(episodes, manifest)
    groups = by_point(study, list(points[0]))
    found = {}
    for number, point in zip(numbers, points, strict=True):
        mine = groups.get(key_of(point, study))
        found[number] = none if mine is None else point_scores(mine, study, objectives)
    return found


def _best(trials: Trials, how: Adaptive) -> str:
    scores = [trial.scores for trial in trials.told() if trial.whole]
    if not scores:
        return ""
    larger = [objective.larger for objective in how.objectives]
    if len(larger) > 1:
        return f", {len(ranking.front(scores, larger))} on the front so far"
    return f", best {how.objectives[0].name} so far {scores[ranking.ranked(scores, larger)[0]][0]:.4g}"
