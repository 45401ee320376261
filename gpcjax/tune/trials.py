"""A search's trials in Optuna's database: asked for in batches, told when they ran, the same after a kill.

Each trial has a sampler of its own, seeded by the search's seed and the trial's place: so what a trial is depends on
what was told before alone, and not on when the process was started. A batch that was not told to its end, as the
process was killed, is given again.
"""

import logging
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gpcjax.errors import Unwritten, UserError
from gpcjax.tune.objectives import Objective
from gpcjax.tune.space import Range, Space

DATABASE = "study.db"
NAME = "gpcjax"
"""Of the study in its database."""

_BATCH = "batch"
"""What Optuna keeps of a trial: which batch it belongs to."""

_NO_DISK = re.compile("disk is full|readonly|read-only|disk I/O")
"""What SQLite says of a disk that takes no more."""

STARTUP = 16
"""Trials at random, before the estimator of densities says where to go."""


class Trial(NamedTuple):
    """A point to look at, and its number in the study."""

    number: int
    point: dict[str, float]


class Told(NamedTuple):
    """A trial that was looked at."""

    number: int
    point: dict[str, float]
    scores: tuple[float, ...]
    rung: int
    """The last one that it came to, from 0."""
    whole: bool
    """Whether that was the last of all."""


class Trials:
    """The trials of one search, in the database of its folder.

    Args:
        folder: of the search.
        space: where it looks.
        objectives: what it looks for; several for a Pareto front.
        seed: of its samplers.
        startup: trials at random.

    Raises:
        UserError: the database is not one of such a search.
    """

    def __init__(
        self, folder: Path, space: Space, objectives: Sequence[Objective], seed: int, startup: int = STARTUP
    ):
        import optuna

        optuna.logging.set_verbosity(logging.WARNING)
        self._optuna, self._space, self._objectives = optuna, space, tuple(objectives)
        self._seed, self._startup = seed, startup
        self._handles: dict[int, Any] = {}
        """Optuna's trials by number."""
        self._distributions = {name: _distribution(optuna, domain) for name, domain in space.items()}
        self._path = path = folder / DATABASE
        with self._database(Exception):  # sqlalchemy has dozens of them, and what was damaged more
            storage = optuna.storages.RDBStorage(f"sqlite:///{path}", heartbeat_interval=None)
            with _quiet():
                self._study = optuna.create_study(
                    storage=storage,
                    study_name=NAME,
                    directions=["maximize" if each.larger else "minimize" for each in objectives],
                    load_if_exists=True,
                )
                if not self._study.metric_names:
                    self._study.set_metric_names([each.name for each in objectives])
            self._read()

    @contextmanager
    def _database(self, *kinds: type[Exception]) -> Iterator[None]:
        """Around what reads or writes the database: errors of these kinds, or of its own, are told in one line."""
        from sqlalchemy.exc import SQLAlchemyError

        try:
            yield
        except (self._optuna.exceptions.StorageInternalError, SQLAlchemyError, *kinds) as error:
            cause = error.__cause__ or error
            why = " ".join(str(getattr(cause, "orig", cause)).split())[:200]
            line = f"{self._path}: this database cannot be used ({why}): "
            if _NO_DISK.search(why):
                raise Unwritten(
                    f"{line}make room or make it writable, then the same command goes on"
                ) from None
            raise UserError(f"{line}move it away, or give a new --out") from None

    def told(self) -> list[Told]:
        """The trials that were looked at, in their order."""
        with self._database():
            return self._read()

    def _read(self) -> list[Told]:
        ended = [trial for trial in self._study.get_trials(deepcopy=False) if trial.state.is_finished()]
        return [
            Told(
                trial.number,
                {name: float(value) for name, value in trial.params.items()},
                tuple(map(float, trial.user_attrs["scores"])),
                int(trial.user_attrs["rung"]),
                trial.state == self._optuna.trial.TrialState.COMPLETE,
            )
            for trial in ended
            if "scores" in trial.user_attrs
        ]

    def next_batch(self, size: int, most: int) -> list[Trial]:
        """The trials of one batch: of the one that a kill has interrupted, or of a new one; none after `most` in all.

        Args:
            size: trials of a batch.
            most: trials of all batches together.
        """
        with self._database():
            return self._batch(size, most)

    def _batch(self, size: int, most: int) -> list[Trial]:
        asked = self._asked()
        interrupted = any(not trial.state.is_finished() for trial in asked)
        last = int(asked[-1].user_attrs[_BATCH]) if asked else -1
        number = last if interrupted else last + 1
        members = [trial for trial in asked if trial.user_attrs[_BATCH] == number]
        found = []
        for trial in members:
            # Optuna has no public way to a trial that another process has asked for.
            self._handles[trial.number] = self._optuna.trial.Trial(self._study, trial._trial_id)
            found.append(Trial(trial.number, _floats(trial.params)))
        before = len(asked) - len(members)
        while len(found) < min(size, most - before):
            found.append(self._ask(before + len(found), number))
        return found

    def _ask(self, index: int, batch: int) -> Trial:
        with _quiet():
            self._study.sampler = self._optuna.samplers.TPESampler(
                seed=_seed_of(self._seed, index),
                n_startup_trials=self._startup,
                multivariate=True,
                constant_liar=True,
            )
            trial = self._study.ask(self._distributions)
        trial.set_user_attr(_BATCH, batch)
        self._handles[trial.number] = trial
        return Trial(trial.number, _floats(trial.params))

    def _asked(self) -> list[Any]:
        """The trials in their order, without those that a kill has left while they were asked for: they fail."""
        found = []
        for trial in self._study.get_trials(deepcopy=False):
            if _BATCH in trial.user_attrs:
                found.append(trial)
            elif not trial.state.is_finished():
                self._study.tell(trial.number, state=self._optuna.trial.TrialState.FAIL)
        return found

    def tell(self, trial: Trial, scores: Sequence[float], rung: int, whole: bool) -> None:
        """Notes how a trial did on the last rung that it came to; nothing for one that was told.

        One that did not come to the last rung is pruned for Optuna; one whose score is no number has failed.
        """
        with self._database():
            self._tell(trial, scores, rung, whole)

    def _tell(self, trial: Trial, scores: Sequence[float], rung: int, whole: bool) -> None:
        state, handle = self._optuna.trial.TrialState, self._handles[trial.number]
        if self._study.get_trials(deepcopy=False)[trial.number].state.is_finished():
            return
        handle.set_user_attr("scores", [float(score) for score in scores])
        handle.set_user_attr("rung", rung)
        if np.isnan(scores).any():
            self._study.tell(trial.number, state=state.FAIL)
        elif whole:
            self._study.tell(trial.number, list(map(float, scores)))
        else:
            if len(scores) == 1:
                handle.report(float(scores[0]), rung)
            self._study.tell(trial.number, state=state.PRUNED)


def _distribution(optuna: Any, domain: Any) -> Any:
    if isinstance(domain, Range):
        return optuna.distributions.FloatDistribution(domain.low, domain.high, log=domain.log)
    return optuna.distributions.CategoricalDistribution(domain.values)


def _floats(point: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in point.items()}


def _seed_of(seed: int, number: int) -> int:
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


@contextmanager
def _quiet() -> Iterator[None]:
    """Optuna warns of what it calls experimental, such as the names of metrics."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
