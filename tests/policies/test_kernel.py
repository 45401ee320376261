"""The policy of a Gaussian process in a block of lanes: only the parts that any of them uses, the same bits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.policies.kernel import PART, KernelController

LANES, ACTIONS, SIZE = 8, 2, 3


def controller(room, used, smoothness=2.5, seed=0):
    """One whose lane i has `used[i]` points."""
    random = np.random.default_rng(seed)
    weights = random.normal(size=(ACTIONS, room, LANES))
    weights[:, np.arange(room)[:, None] >= np.asarray(used)] = 0.0
    return KernelController(
        points=jnp.asarray(random.normal(size=(ACTIONS, room, SIZE, LANES))),
        weights=jnp.asarray(weights),
        scale=jnp.asarray(random.uniform(0.5, 2.0, size=(ACTIONS, SIZE, LANES))),
        smoothness=smoothness,
    )


@jax.jit
def acted(controller, lanes, obs):
    return controller.in_use(lanes)(obs)


@jax.jit
def walked(controller, lanes, obs):
    """Several steps, as in a loop of the engine."""
    act = controller.in_use(lanes)
    return jax.lax.fori_loop(0, 5, lambda _, at: at + 0.1 * act(at)[:1], obs)


EVERY = jnp.ones(LANES, bool)
OBS = jnp.asarray(np.random.default_rng(1).normal(size=(SIZE, LANES)))


@pytest.mark.parametrize("room", [1, 48, PART, PART + 1, 192, 4 * PART + 1, 1024])
def test_it_is_the_sum_over_all_points(room):
    for most in {1, min(room, PART), room}:
        used = np.linspace(1, most, LANES).astype(int)
        policy = controller(room, used)
        np.testing.assert_allclose(acted(policy, EVERY, OBS), policy(OBS), rtol=0, atol=1e-12 * room)


@pytest.mark.usefixtures("compiled_as_shipped")
@pytest.mark.parametrize("program", [acted, walked])
@pytest.mark.parametrize("smoothness", [2.5, float("inf")])
def test_the_bits_of_a_lane_do_not_depend_on_what_others_have_learned(program, smoothness):
    room = 192
    alone = controller(room, [20, 60] + [1] * (LANES - 2), smoothness)
    for most in (PART, PART + 1, 2 * PART, 2 * PART + 1, room):
        beside = controller(room, [20, 60] + [most] * (LANES - 2), smoothness)
        assert np.array_equal(program(beside, EVERY, OBS)[:, :2], program(alone, EVERY, OBS)[:, :2])


def test_what_lanes_have_learned_that_are_not_meant_is_not_looked_at():
    policy = controller(192, [20] * (LANES - 1) + [192])
    lanes = EVERY.at[-1].set(False)
    got = acted(policy, lanes, OBS)
    assert np.array_equal(got[:, :-1], acted(policy, EVERY, OBS)[:, :-1])
    assert not np.array_equal(got[:, -1], acted(policy, EVERY, OBS)[:, -1])


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e-308, -1e-308])
@pytest.mark.parametrize("place", [PART, 2 * PART - 1, 191])
def test_no_weight_is_left_out(value, place):
    policy = controller(192, [1] * LANES)
    weights = policy.weights.at[1, place, 3].set(value)
    policy = KernelController(policy.points.at[1, place].set(0.0), weights, policy.scale, 2.5)
    without = controller(192, [1] * LANES)
    got, all_of_it = acted(policy, EVERY, OBS), policy(OBS)
    np.testing.assert_allclose(got, all_of_it, atol=1e-13)
    if abs(value) > 1 or np.isnan(value):
        assert not np.array_equal(got, acted(without, EVERY, OBS), equal_nan=True)


def test_somebodys_own_that_acts_otherwise_does_so_in_a_block():
    class Shifted(KernelController):
        def __call__(self, obs):
            return super().__call__(obs) + 1.0

    policy = controller(192, [20] * LANES)
    own = Shifted(policy.points, policy.weights, policy.scale, policy.smoothness)
    np.testing.assert_allclose(own.in_use(EVERY)(OBS), policy(OBS) + 1.0, rtol=1e-12)
