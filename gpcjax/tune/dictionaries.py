"""What the models of kept runs hold, as marginal likelihood takes it: inputs, targets, and what they were taught with.

| learner | `ard` | inputs | a length-scale is |
|---|---|---|---|
| GPC | yes | observations (and actions) as they are | l / w_i, in units of the input |
| GPC-NS | yes | the same, divided by their deviation over the dictionary | l / w_i, in deviations |
| either | no | all that reaches the kernel | l |
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float

from gpcjax.describe import TaskSpec
from gpcjax.errors import UserError
from gpcjax.gp.likelihood import Dictionaries
from gpcjax.gp.posterior import Posterior
from gpcjax.gp.process import GaussianProcess
from gpcjax.learners.gpc import GPC, GPCState
from gpcjax.sweep.kept import kept_rows, narrowed, newest
from gpcjax.sweep.layout import tell
from gpcjax.sweep.learned import learned_of

Model = Literal["policy", "human"]
MODELS: tuple[Model, ...] = ("policy", "human")

LEAST_NOISE = 1e-7
"""The thesis' noise: less leaves a matrix of near repeats singular."""

SPANS = {"variance": 1e3, "length_scale": 1e2, "noise": 10.0}
"""How far from the data's own size a number may go: above and below it; of the noise only above."""


@dataclass(frozen=True)
class Held:
    """What one model holds in some runs.

    | Field        | Meaning                                                                      |
    |--------------|------------------------------------------------------------------------------|
    | `data`       | points and targets                                                           |
    | `smoothness` | of the kernel                                                                |
    | `taught`     | variance, length-scales and noise of the first run while it was taught        |
    | `scaling`    | factors of the inputs then, beyond normalisation                             |
    | `inputs`     | their names, or "all" where one length-scale is to serve them                |
    """

    data: Dictionaries
    smoothness: float
    taught: Float[np.ndarray, " numbers"]
    scaling: Float[np.ndarray, " d"]
    inputs: tuple[str, ...]

    @property
    def bounds(self) -> Float[np.ndarray, "numbers 2"]:
        """Around the size of the data: a length-scale beyond them says that an input does not matter."""
        power, spreads = self._sizes
        middle = np.array([power, *spreads])
        factor = np.array([SPANS["variance"], *np.full(len(spreads), SPANS["length_scale"])])
        noise = LEAST_NOISE, max(SPANS["noise"] * power, 10.0 * LEAST_NOISE)
        return np.vstack([np.column_stack([middle / factor, middle * factor]), noise])

    def starts(self, count: int) -> Float[np.ndarray, "starts numbers"]:
        """Where to climb from: from what they were taught with, and around the size of the data; always the same."""
        power, spreads = self._sizes
        random = np.random.default_rng(0)
        others = [
            [
                power * np.exp(random.normal()),
                *(spreads * np.exp(random.normal(0.5, 1.0, len(spreads)))),
                power * 10.0 ** random.uniform(-4, 0),
            ]
            for _ in range(count - 1)
        ]
        return np.array([self.taught, *others])

    @property
    def _sizes(self) -> tuple[float, Float[np.ndarray, " scales"]]:
        """Mean square of the targets, and the deviation of each input, or of all, over all runs."""
        points, targets = self.data.points[self.data.active], self.data.targets[self.data.active]
        spreads = points.std(0)
        if len(self.inputs) == 1:
            spreads = np.sqrt(np.mean(spreads**2, keepdims=True))
        return max(float((targets**2).mean()), 1e-6), np.where(spreads < 1e-6, 1.0, spreads)


def chosen_runs(folder: Path, algo: str | None, where: Mapping[str, Any]) -> pd.DataFrame:
    """The last kept state of each run of one learner, as `gpcjax.sweep.kept` has it.

    Raises:
        UserError: no states are kept, there are none of this learner, or of several where none was named.
    """
    told = {name: str(value) for name, value in where.items()}
    kept = narrowed(newest(kept_rows(folder, "state", {}, tell)), told, str(folder))
    names = list(dict.fromkeys(kept["algo"]))
    if algo is None and len(names) > 1:
        raise UserError(f"{folder}: there are runs of {', '.join(names)}, give one of them (--algo)")
    wanted = kept.loc[kept["algo"] == (algo or names[0])] if names else kept
    if wanted.empty:
        raise UserError(f"{folder}: no state of such runs was kept, there are {', '.join(names) or 'none'}")
    return wanted


def held_by(
    folder: Path, runs: pd.DataFrame, model: Model, task: TaskSpec, ard: bool, most: int, random: int
) -> Held:
    """What a model holds in these runs, of `chosen_runs`.

    Args:
        folder: the run folder.
        runs: those of one learner.
        model: which of its two.
        task: the task, for names of inputs.
        ard: see above.
        most: points of a dictionary that count, drawn from larger ones by `random` and the run's seed.
        random: a number.

    Raises:
        UserError: the learner has no such model, the runs have several smoothnesses, or fewer than two points.
    """
    found = [learned_of(folder, "state", row, grown=False) for row in runs.to_dict("records")]
    learner, state = found[0]
    if not isinstance(learner, GPC):
        raise UserError(
            f"{folder}: {runs['algo'].iloc[0]} has no Gaussian process to fit, give gpc or gpc-ns"
        )
    processes: list[GaussianProcess] = [getattr(each, model) for each, _ in found]
    smoothnesses = sorted({process.kernel.smoothness for process in processes})
    if len(smoothnesses) > 1:
        raise UserError(
            f"{folder}: its runs have several policy_nu, {smoothnesses}, give --where policy_nu=V"
        )
    factors = _factors(learner, state, model)
    divided = factors if ard else np.ones_like(factors)
    data = _padded(
        [
            _dictionaries(getattr(state, model), divided, most, (random, int(seed)))
            for (_, state), seed in zip(found, runs["seed"], strict=True)
        ]
    )
    if data.counts.sum() < 2:
        raise UserError(f"{folder}: its runs hold fewer than two points, nothing can be fitted")
    kernel, noise = processes[0].kernel, processes[0].noise
    lengths = float(kernel.length_scale) / (factors if ard else np.ones(1))
    taught = np.array([float(kernel.variance), *lengths, float(noise)])
    names = _names(task, learner.obs_size, model) if ard else ("all",)
    return Held(data, smoothnesses[0], taught, factors, names)


def _factors(learner: GPC, state: GPCState, model: Model) -> Float[np.ndarray, " d"]:
    """W of a model, for each of its inputs; of GPC-NS what comes after normalisation."""
    process = getattr(learner, model)
    posterior: Posterior = getattr(state, model)
    if not process.normalise:
        return np.asarray(posterior.scale)[0]
    scaling = process.scaling
    return np.ones(posterior.points.shape[-1]) if scaling is None else np.asarray(scaling)


def _dictionaries(
    posterior: Posterior, divided: Float[np.ndarray, " d"], most: int, seeds: tuple[int, int]
) -> list[tuple[Float[np.ndarray, "n d"], Float[np.ndarray, " n"]]]:
    """Inputs and targets of a run, one pair for each action dimension; of its scale, what `divided` leaves."""
    random = np.random.default_rng(seeds)
    scales, held = np.asarray(posterior.scale) / divided[None], []
    for index, count in enumerate(map(int, posterior.count)):
        rows = np.arange(count) if count <= most else np.sort(random.choice(count, most, replace=False))
        points, targets = (np.asarray(each)[index, rows] for each in (posterior.points, posterior.targets))
        held.append((points * scales[index][None], targets))
    return held


def _padded(held: list[list[tuple[Float[np.ndarray, "n d"], Float[np.ndarray, " n"]]]]) -> Dictionaries:
    """In arrays of one capacity, a multiple of 16: that each folder has another one costs a compilation."""
    counts = np.array([[len(targets) for _, targets in run] for run in held])
    capacity = 16 * max(1, -(-int(counts.max()) // 16))
    points = np.zeros((*counts.shape, capacity, held[0][0][0].shape[1]))
    targets = np.zeros((*counts.shape, capacity))
    for (run, each), count in np.ndenumerate(counts):
        points[run, each, :count], targets[run, each, :count] = held[run][each]
    return Dictionaries(points, targets, counts)


def _names(task: TaskSpec, size: int, model: Model) -> tuple[str, ...]:
    """Of the inputs, as the task calls them."""
    observed = [name for name, *_ in task.view.observed] or [f"s{index + 1}" for index in range(size)]
    return (*observed, *(("action",) if model == "human" else ()))
