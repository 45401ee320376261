"""Policies in numpy do what they do in jax, and load none."""

import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.policies.base import Controller, Policy, acted
from gpcjax.policies.counterparts import controller_of, in_numpy, plain_of
from gpcjax.policies.kernel import KernelController
from gpcjax.policies.saved import load_shipped, shipped_path
from tests.policies.made import draw, made
from tests.trees import assert_same_bits

SHIPPED = sorted(path.name for path in shipped_path("").iterdir())


def assert_same_actions(policy, observations):
    """Those of numpy and of jax, one by one and before they are clipped too."""
    controller, plain = policy.controller, plain_of(policy.controller)
    assert plain is not None
    unclipped = jax.jit(lambda obs: controller(obs))
    for obs in observations:
        found = policy(obs)
        assert type(found) is np.ndarray and found.dtype == np.float64
        np.testing.assert_array_equal(found, policy(obs.tolist()))
        np.testing.assert_allclose(found, policy(jnp.asarray(obs)), rtol=0, atol=1e-12)
        with np.errstate(all="ignore"):
            np.testing.assert_allclose(plain(obs), unclipped(obs), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("cartpole", "brax-reacher") else pytest.param(name, marks=pytest.mark.slow)
        for name in SHIPPED
    ],
)
def test_each_shipped_policy(name):
    policy = load_shipped(name)
    size = policy.controller.obs_size
    scales = (0.0, 0.01, 0.1, 1.0, 1.0, 10.0, 1e3)
    assert_same_actions(policy, [scale * draw(size, seed) for seed, scale in enumerate(scales)])


@pytest.mark.parametrize("nu", [0.5, pytest.param(2.5, marks=pytest.mark.slow)])
def test_digits_go_with_the_distance_from_zero(nu):
    """What docs/policies.md tells: of a number that is large in length-scales few are left for what is near."""
    learner = gpcjax.make_learner(
        "gpc", obs_size=2, action_size=1, capacity=4, policy={"nu": nu, "length_scale": 1.0}
    )
    for far in (1e2, 1e5, 1e9, 1e12):
        state, points = learner.init(), [np.array([1.1 * far + step, 0.3 * step]) for step in range(3)]
        for advice, point in zip((1, -1, 1), points, strict=True):
            state, info = learner.correct(state, point, [0.0], [advice])
            assert int(info.status) == 0
        policy = learner.policy_of(state)
        for point in (*points, points[0] + 0.3):
            for one in (learner.act(state, point), policy(jnp.asarray(point))):
                np.testing.assert_allclose(one, policy(point), rtol=0, atol=4 * np.finfo(float).eps * far)


@pytest.mark.parametrize("plain", list(made()), ids=lambda plain: type(plain).__name__)
def test_each_kind(plain):
    policy = Policy.of(plain)
    observations = [scale * draw(3, seed) for seed, scale in enumerate((0.1, 1.0, 30.0, 1e200))]
    assert_same_actions(policy, observations)
    again = in_numpy(policy.controller)
    assert again is not None and type(again) is type(plain)
    assert (again.obs_size, again.action_size, again.lanes) == (3, 2, False)
    assert_same_bits(controller_of(again), policy.controller)


@pytest.mark.parametrize("plain", list(made()), ids=lambda plain: type(plain).__name__)
def test_what_is_no_number_stays_none_and_nobody_is_warned(plain):
    """And what is huge gives an action."""
    for worst in (np.nan, np.inf, -np.inf, 1e155, -1e200, 1.7e308):
        for obs in ([0.1, worst, 0.2], [worst, -worst, worst]):
            found, expected = Policy.of(plain)(np.array(obs)), Policy.of(plain)(jnp.asarray(obs))
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
            assert np.isnan(found).all() if np.isnan(worst) else (np.abs(found) <= 1).all()


def test_with_what_is_jaxs_it_is_jax():
    policy = load_shipped("pendulum")
    obs = jnp.asarray([0.3, 0.1, -0.5])
    for given in (obs, list(obs), (obs[0], 0.1, -0.5)):
        assert isinstance(policy(given), jax.Array)
    jaxpr = jax.make_jaxpr(policy)(obs)
    assert jaxpr.out_avals[0].shape == (1,) and len(jaxpr.jaxpr.eqns) > 3
    assert jax.make_jaxpr(lambda x: policy([x, x, x]))(0.5).jaxpr.eqns
    steps = lambda obs: jax.lax.scan(lambda obs, _: (obs + 0.1 * policy(obs), policy(obs)), obs, length=3)[1]  # noqa: E731
    np.testing.assert_allclose(jax.jit(steps)(obs)[0], policy(np.asarray(obs)), rtol=0, atol=1e-12)
    assert np.isfinite(jax.jacobian(policy)(obs)).all()


def test_numbers_that_jax_traces_are_jaxs():
    """A batch of policies: each call is one with numbers of numpy."""
    policies = [load_shipped(name) for name in ("brax-reacher", "brax-reacher")]
    batch = jax.tree.map(lambda *leaves: jnp.stack([leaves[0], 0.5 * leaves[1]]), *policies)
    assert isinstance(batch, Policy)
    obs = draw(policies[0].controller.obs_size)
    found = jax.jit(jax.vmap(lambda policy: policy(obs)))(batch)
    np.testing.assert_allclose(found[0], policies[0](obs), rtol=0, atol=1e-12)
    assert np.abs(found[1] - found[0]).max() > 1e-3


def test_a_policy_made_while_jax_traces_leaks_nothing():
    policy = load_shipped("cartpole")
    inside = jax.jit(lambda obs: policy(obs))(jnp.zeros(4))
    np.testing.assert_allclose(inside, policy(np.zeros(4)), rtol=0, atol=1e-12)
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(policy))
    np.testing.assert_array_equal(jax.jit(lambda obs: policy(obs))(jnp.zeros(4)), inside)


class Halved(Controller):
    obs_size = action_size = 2

    def __call__(self, obs):
        return 0.5 * obs


def test_a_controller_of_ones_own_is_jax():
    policy = Policy(Halved())
    assert isinstance(policy([1.0, -4.0]), jax.Array)
    np.testing.assert_array_equal(policy(np.array([1.0, -4.0])), [0.5, -1.0])


class Doubled(KernelController):
    def __call__(self, obs):
        return 2.0 * super().__call__(obs)


def test_one_made_of_a_built_in_kind_acts_as_it_says():
    inner, obs = load_shipped("cartpole").controller, np.array([0.0, 0.0, 0.01, 0.0])
    arrays = {name: getattr(inner, name) for name in ("points", "weights", "scale", "smoothness")}
    found, single = Policy(Doubled(**arrays))(obs), Policy(inner)(obs)
    assert 0 < abs(single[0]) < 0.4
    np.testing.assert_allclose(found, 2.0 * single, rtol=1e-12)


@pytest.mark.parametrize(
    "given", [[0.0] * 2, [[0.0] * 3], "abc", [1j] * 3, [True] * 3, None, [None] * 3], ids=repr
)
def test_refusals_are_those_of_jax(given):
    policy = load_shipped("pendulum")
    with pytest.raises(ValueError, match=r"^obs .*this policy takes") as plain:
        policy(given)
    with pytest.raises(ValueError, match=r"^obs ") as compiled:
        acted(policy.controller, given)
    assert str(plain.value) == str(compiled.value)


FRESH = """
import sys
import gpcjax
policy = gpcjax.load_policy({path!r})
action = policy([0.1, 0.0, 0.02, 0.0])
found = {{"jax", "jaxlib", "equinox", "orbax"}} & set(sys.modules)
assert not found, found
import importlib.util
assert importlib.util.find_spec("jax") and "jax" not in sys.modules
import jax.numpy as jnp
import jax
obs = jnp.array([0.1, 0.0, 0.02, 0.0])
assert obs.dtype == float and jax.__spec__.loader is jax.__loader__
for found in (policy(obs), jax.jit(policy)(obs), jax.jit(lambda policy, obs: policy(obs))(policy, obs)):
    assert isinstance(found, jax.Array) and abs(found - action).max() < 1e-12
print(len(jax.tree.leaves(policy)), len([each for each in sys.meta_path if "policies" in type(each).__module__]))
"""


@pytest.mark.parametrize("first", ["jax.numpy", pytest.param("equinox", marks=pytest.mark.slow)])
def test_a_fresh_process_acts_without_jax_and_finds_it_ready_when_it_comes(first):
    code = FRESH.replace("import jax.numpy as jnp", f"import {first}; import jax.numpy as jnp")
    code = code.format(path=str(shipped_path("cartpole")))
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(gpcjax.__file__).parents[1]
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "3 0\n", "")
