"""Run folders whose runs learned what a test says, while no engine ran."""

import dataclasses
from collections.abc import Callable

from gpcjax.learners.packed import compact
from gpcjax.policies.saved import pack_controller
from gpcjax.sweep.build import pack_learned
from gpcjax.sweep.keeping import KeptRow
from gpcjax.sweep.packing import packed
from gpcjax.sweep.plan import Cell
from tests.sweep.pretended import Pretended, rows


class Learned(Pretended):
    """Hands in made-up rows, and beside them what `learn(cell)` gives: (episode, return, learner, state), each time."""

    def __init__(self, what: str, learn: Callable[[Cell], list[tuple]]):
        super().__init__()
        self._what, self._learn, self.jobs = what, learn, 1

    def _work(self, cells, baselines, on_rows, on_baseline, on_progress):
        super()._work([], baselines, on_rows, on_baseline, on_progress)
        for cell in cells:
            kept = tuple(self._row(cell, *each) for each in self._learn(cell))
            on_rows(dataclasses.replace(rows(cell), kept=kept))

    def _row(self, cell, episode, returns, learner, state) -> KeptRow:
        if self._what == "policies":
            kind, made = "policy", pack_controller(learner.controller(state))
        else:
            kind, made = "state", pack_learned(cell, learner, compact(learner, state))
        return KeptRow(episode, returns, kind, *packed(*made))
