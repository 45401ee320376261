"""Hyperparameters by marginal likelihood (thesis 2.4.2) of what the runs of a folder had learned.

Policies and human models are fitted apart, each by one set of numbers for all runs: that is what a sweep can be given.
What is fitted to each run alone tells how much such numbers differ from run to run. In ARD a length-scale l_i of each
input becomes the settings of a learner as l = (l_1 ... l_d)^(1/d), and w_i = l / l_i.
"""

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float

from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.gp.likelihood import Dictionaries, Optima, fit_dictionaries, log_likelihood
from gpcjax.registry import find
from gpcjax.report.document import Kind, Sheet
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.kept import PACKED
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.options import concerns
from gpcjax.sweep.rows import IDENTITY
from gpcjax.sweep.runfolder import check_report
from gpcjax.sweep.seeds import LARGEST_SEED, Seeds
from gpcjax.sweep.spec import SweepSpec, from_dict
from gpcjax.tune.dictionaries import MODELS, Held, Model, chosen_runs, held_by
from gpcjax.tune.flags import TAKEN
from gpcjax.tune.toml import text_of

BEST = "best.toml"
FURTHER = 100
"""Seeds of a sweep whose seeds nobody gives."""

DIGITS = 4
"""Of a number that is taken: the likelihood does not tell more."""


@dataclass(frozen=True)
class Fit:
    """What was fitted of one model.

    | Field      | Meaning                                                                            |
    |------------|------------------------------------------------------------------------------------|
    | `model`    | which                                                                              |
    | `held`     | what it was fitted to                                                              |
    | `shared`   | of all runs                                                                        |
    | `each`     | of each run that has two points or more; None if there is none                       |
    | `as_taught` | log likelihood with the numbers that it was taught with; it may be no number         |
    """

    model: Model
    held: Held
    shared: Optima
    each: Optima | None
    as_taught: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of its numbers."""
        lengths = (f"length-scale: {name}" for name in self.held.inputs)
        return ("variance", *lengths, "noise")

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Numbers that ended at a bound: the data do not tell them, but that they are so large, or so small."""
        return tuple(name for name, at in zip(self.names, self.shared.at_bound[0], strict=True) if at)


@dataclass(frozen=True)
class Fitted:
    """What marginal likelihood makes of a folder.

    | Field      | Meaning                                                                   |
    |------------|---------------------------------------------------------------------------|
    | `settings` | that a sweep takes (`gpcjax.run_sweep(**settings)`), in place of what it had |
    | `usual`    | the sweep of the folder, with other seeds                                 |
    | `spec`     | the sweep of the folder with them, and with other seeds                    |
    | `best`     | the file that has it                                                      |
    | `fits`     | of each model                                                             |
    """

    settings: Mapping[str, Any]
    usual: SweepSpec
    spec: SweepSpec
    best: Path
    fits: tuple[Fit, ...]
    comments: tuple[str, ...] = ()
    """What the file begins with."""

    @property
    def sheet(self) -> Sheet:
        """A row for each number: as it was taught, fitted to all, and quartiles of what each run has."""
        rows, breaks = [], set()
        for fit in self.fits:
            rows += _rows(fit)
            breaks.add(len(rows) - 1)
        columns = ("model", "number", "taught", "fitted", "of runs", "at bound")
        words: dict[str, Kind] = {"model": "word", "number": "word", "at bound": "word"}
        return Sheet("marginal likelihood", columns, tuple(rows), frozenset(breaks), kinds=words)


def by_likelihood(
    folder: Path,
    out: Path,
    *,
    algo: str | None = None,
    where: Mapping[str, Any] | None = None,
    models: Collection[Model] = MODELS,
    take: Collection[str] = TAKEN[:1],
    ard: bool = True,
    starts: int = 4,
    points: int = 256,
    seeds: Seeds | None = None,
    random: int = 0,
) -> Fitted:
    """Fits the kernels of a learner to what its runs in `folder` had learned, and writes `out`/best.toml.

    Args:
        folder: a run folder with kept states (`--keep states`); of each run the last one counts.
        out: where the file goes; it is made if need be.
        algo: gpc or gpc-ns; may be left out if the folder has runs of one learner.
        where: columns of the runs, and the value that is wanted of each.
        models: which are fitted: "policy", "human".
        take: what of it becomes settings, of `TAKEN`; by default length-scales alone, as variances and noises are
            learning rates too (3.5), and with those that explain best GPC learns badly (docs/tuning.md).
        ard: a length-scale for each input, or one for all, beside the factors that the runs had.
        starts: from how many sets of numbers the likelihood is climbed.
        points: how many points of a dictionary count; of a larger one as many at random.
        seeds: of the sweep in best.toml; by default 100 that nobody had there.
        random: draws these points.

    Raises:
        UserError: the folder has no such states, or runs of several settings that the file could not tell apart; seeds
            that were fitted on; or data that cannot be explained.
    """
    check_report(folder)
    for name, given, known in (("models", models, MODELS), ("take", take, TAKEN)):
        if not given or not set(given) <= set(known):
            raise UserError(f"{name} {shown(list(given))}: give {', '.join(known)}, one or several")
    runs = chosen_runs(folder, algo, where or {})
    base = _narrowed(folder, runs, seeds)
    task = find("task", base.env)
    held = {model: held_by(folder, runs, model, task, ard, points, random) for model in MODELS}
    fits = [_fit(folder, model, held[model], starts) for model in MODELS if model in models]
    settings = _settings(fits, take, ard)
    if "human" not in models:
        settings |= _unchanged(held["human"], settings)
    spec = _with(folder, base, settings)
    fitted = Fitted(settings, base, spec, out / BEST, tuple(fits))
    fitted = dataclasses.replace(fitted, comments=tuple(_comments(folder, runs, fitted)))
    out.mkdir(parents=True, exist_ok=True)
    write_atomic(fitted.best, text_of(spec, fitted.comments))
    return fitted


def _fit(folder: Path, model: Model, held: Held, starts: int) -> Fit:
    """Raises UserError."""
    enough = held.data.counts.sum(1) >= 2
    some = Dictionaries(*(leaf[enough] for leaf in held.data))
    try:
        shared = fit_dictionaries(held.data, held.smoothness, held.bounds, held.starts(starts))
        each = None
        if enough.any():
            begin = np.vstack([shared.numbers, held.starts(1)])
            each = fit_dictionaries(some, held.smoothness, held.bounds, begin, shared=False)
    except ValueError as error:
        raise UserError(f"{folder}: the {model} model cannot be fitted ({error})") from None
    return Fit(model, held, shared, each, _total(held.taught, held))


def _total(numbers: Float[np.ndarray, " numbers"], held: Held) -> float:
    """The log likelihood of all runs with these numbers."""
    one = jax.jit(log_likelihood, static_argnums=1)
    points, targets = (leaf.reshape(-1, *leaf.shape[2:]) for leaf in (held.data.points, held.data.targets))
    active = held.data.active.reshape(targets.shape)
    return sum(
        float(one(numbers, held.smoothness, *each)) for each in zip(points, targets, active, strict=True)
    )


def _settings(fits: Collection[Fit], take: Collection[str], ard: bool) -> dict[str, Any]:
    """What is taken, as a sweep has it."""
    settings: dict[str, Any] = {}
    for fit in fits:
        numbers, prefix = fit.shared.numbers[0], "human_" if fit.model == "human" else ""
        if "variance" in take:
            settings[f"{fit.model}_variance"] = _rounded(numbers[0])
        if "length_scale" in take:
            lengths = numbers[1:-1]
            middle = float(np.exp(np.log(lengths).mean()))
            settings[f"{fit.model}_length_scale"] = _rounded(middle)
            if ard:
                settings[f"{prefix}scaling"] = [_rounded(middle / length) for length in lengths]
        if "noise" in take:
            settings[f"{prefix}noise"] = _rounded(numbers[-1])
    return settings


def _unchanged(human: Held, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What the human model had and would take over from the policy, were it not given."""
    kept: dict[str, Any] = {}
    if "scaling" in settings:
        kept["human_scaling"] = [float(factor) for factor in human.scaling]
    if "noise" in settings:
        kept["human_noise"] = float(human.taught[-1])
    return kept


def _rounded(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")


def _narrowed(folder: Path, runs: pd.DataFrame, seeds: Seeds | None) -> SweepSpec:
    """The specification of these runs, with other seeds. Raises UserError."""
    spec = from_dict(read_manifest(folder)["specification"])
    taken = [int(seed) for seed in runs["seed"] if seeds is not None and int(seed) in seeds]
    if taken:
        raise UserError(f"seeds: {taken[0]} was fitted on, give others to judge by")
    if seeds is None:
        first = spec.seeds.spans[-1][1] + 1
        if first + FURTHER > LARGEST_SEED:
            raise UserError(f"{folder}: there are no seeds beyond its own, give some (seeds)")
        seeds = Seeds(((first, first + FURTHER - 1),))
    algo, teacher = str(runs["algo"].iloc[0]), find("teacher", spec.teacher)
    learner = find("learner", algo)
    several = {name: tuple(dict.fromkeys(runs[name].dropna())) for name in runs.columns if name not in PACKED}
    named = [name for name in several if name not in (*IDENTITY, "episode", "return", "delta", "rate")]
    numbers = {**spec.hyperparameters, **{name: several[name] for name in named}}
    return dataclasses.replace(
        spec,
        algo=(algo,),
        seeds=seeds,
        points=(),
        hyperparameters={
            name: values for name, values in numbers.items() if values and concerns(name, learner, teacher)
        },
        **{name: several[name] for name in ("oracle", "error", "delta", "rate") if name in several},
    )


def _with(folder: Path, base: SweepSpec, settings: Mapping[str, Any]) -> SweepSpec:
    """The specification with other settings. Raises UserError where one has several values left."""
    scales = {name: tuple(value) for name, value in settings.items() if isinstance(value, list)}
    numbers = {name: (value,) for name, value in settings.items() if name not in scales}
    spec = dataclasses.replace(base, hyperparameters={**base.hyperparameters, **numbers}, **scales)
    several = next((name for name, values in spec.hyperparameters.items() if len(values) > 1), None)
    if several is not None:
        values = ", ".join(f"{value:g}" for value in spec.hyperparameters[several])
        raise UserError(
            f"{folder}: its runs have several {several} ({values}), give one (--where {several}=V)"
        )
    return spec


def _rows(fit: Fit) -> list[tuple[str, ...]]:
    each = fit.each.numbers if fit.each is not None else np.empty((0, len(fit.names)))
    columns = zip(
        fit.names, fit.held.taught, fit.shared.numbers[0], fit.shared.at_bound[0], each.T, strict=True
    )
    rows = []
    for name, taught, fitted, at_bound, of_runs in columns:
        quartiles = (
            ", ".join(f"{value:.3g}" for value in np.quantile(of_runs, (0.25, 0.75))) if len(each) else ""
        )
        bound = "yes" if at_bound else ""
        rows.append((fit.model, name, f"{taught:.4g}", f"{fitted:.4g}", f"[{quartiles}]", bound))
    told = f"{fit.as_taught:.1f}", f"{fit.shared.log_likelihood[0]:.1f}"
    alone = f"{fit.each.log_likelihood.sum():.1f}" if fit.each is not None else ""
    return [*rows, (fit.model, "log likelihood (nats)", *told, alone, "")]


def _comments(folder: Path, runs: pd.DataFrame, fitted: Fitted) -> list[str]:
    """What the file begins with."""
    sheet = fitted.sheet
    table = [sheet.columns, *sheet.rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
    points = ", ".join(f"{fit.held.data.counts.sum():,} of its {fit.model} models" for fit in fitted.fits)
    return [
        f"Kernels of {runs['algo'].iloc[0]} by marginal likelihood of what {len(runs)} runs in {folder} had learned,",
        f"points: {points}. Its seeds are others than theirs.",
        "In brackets the quartiles of what fits each run alone; its likelihood is their sum.",
        *lines,
    ]
