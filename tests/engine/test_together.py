"""Lanes computed all at once, as on an accelerator, learn what they learn one by one."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from gpcjax.engine.pool import Tier
from gpcjax.learners.base import Status
from gpcjax.sweep.build import make_pool, start_of
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of
from tests.engine import tasks
from tests.engine.test_rollout import RECORDED, agrees

COUNTED = ("length", "corrections", "policy_points", "human_points", "full", "asked")

CASES = {
    "gpc": {"env": "pendulum", "algo": "gpc", "active_gain": 0.5},
    "gpc late": {"env": "pendulum", "algo": "gpc", "credit": 0.1, "credit_longest": 0.2, "delay": 0.1},
    "gpc full": {
        "env": "pendulum",
        "algo": "gpc",
        "max_capacity": 16,
        "on_full": "replace-nearest",
        "delta": 0.0,
        "episodes": 1,
        "seeds": 2,
    },
    "gpc-ns": {"env": "cartpole", "algo": "gpc-ns", "error": 0.2},
    "coach": {"env": "cartpole", "algo": "coach", "error": 0.2},
    "d-coach": {"env": "pendulum", "algo": "d-coach"},
    "gpc two actions": {"env": "lunarlander", "algo": "gpc", "oracle": "heuristic"},
}
TIER = Tier(4, 8, 8)


def learned(settings):
    cells = list(plan(spec_of(**{"episodes": 2, "seeds": 3, "rate": 0.1, **settings})))
    starts, finished = iter(cells), {}

    def next_start():
        cell = next(starts, None)
        return None if cell is None else start_of(cell)

    make_pool(cells[0]).run(next_start, lambda run: finished.update({run.name.seed: run.lane}))
    return [finished[cell.seed] for cell in cells]


@pytest.fixture
def accelerated(monkeypatch):
    """From now on lanes are computed as on an accelerator."""
    return lambda: monkeypatch.setattr(
        "gpcjax.gp.batching.jax", SimpleNamespace(default_backend=lambda: "gpu")
    )


def test_small_ones_all_at_once_are_what_a_plain_loop_makes_of_each(accelerated):
    """Three runs on recorded observations, both of whose actions are advised until dictionaries are full."""
    given = tasks.learner("gpc", on_full="replace-nearest", sparsify=False)
    starts = [tasks.start(seed, given, tasks.oracle(rate=0.6, delta=0.0), seed) for seed in range(3)]
    apart = [tasks.plain(RECORDED, each, TIER, 1) for each in starts]
    accelerated()
    lanes = tasks.run(tasks.make_pool(RECORDED, starts[0], (TIER,), 1), starts)
    for each, expected in zip(starts, apart, strict=True):
        assert lanes[each.name].rows.full.sum() > 0
        agrees(lanes[each.name], expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_all_at_once_is_one_by_one(name, accelerated):
    apart = learned(CASES[name])
    accelerated()
    agree(learned(CASES[name]), apart)


def agree(together, apart):
    for one, other in zip(apart, together, strict=True):
        assert one.status == other.status == Status.OK
        assert one.rows.corrections.sum() > 3
        for column in COUNTED:
            np.testing.assert_array_equal(getattr(one.rows, column), getattr(other.rows, column), column)
        np.testing.assert_allclose(one.rows.returns, other.rows.returns, rtol=1e-7)
        np.testing.assert_array_equal(one.log.moments, other.log.moments)
        for here, there in zip(
            jax.tree.leaves(one.controller), jax.tree.leaves(other.controller), strict=True
        ):
            # Of rooms that differ, as tiers do, the part that both have. Weights are what is left of numbers many times
            # as large.
            both = tuple(map(slice, map(min, here.shape, there.shape)))
            here, there = here[both], there[both]
            np.testing.assert_allclose(here, there, rtol=1e-4, atol=1e-6 * np.abs(here).max())
