"""What a person asks of jax for code of their own changes no number here, and breaks nothing."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.gp.fit import fit
from tests.trees import assert_same_bits

SETTINGS = {
    "jax_enable_x64": False,
    "jax_debug_nans": True,
    "jax_debug_infs": True,
    "jax_disable_jit": True,
    "jax_numpy_dtype_promotion": "strict",
    "jax_default_matmul_precision": "BF16_BF16_F32",
    "jax_default_prng_impl": "rbg",
    "jax_threefry_partitionable": False,
    "jax_transfer_guard": "disallow",
}


def make_inputs():
    """What a person gives, made under jax's usual settings: each kind of key is another stream of numbers."""
    keys = [jax.random.key(seed, impl="threefry2x32") for seed in range(3)]
    return keys, jnp.array([0.3]), jnp.zeros(1)


@pytest.fixture
def inputs():
    return make_inputs()


@pytest.fixture
def asked(request):
    """What a person asks of jax during this test."""
    before = {name: getattr(jax.config, name) for name in request.param}
    for name, value in request.param.items():
        jax.config.update(name, value)
    yield request.param
    for name, value in before.items():
        jax.config.update(name, value)


all_settings = pytest.mark.parametrize(
    "asked",
    [
        pytest.param(SETTINGS, id="all at once"),
        *(pytest.param({name: SETTINGS[name]}, id=name, marks=pytest.mark.slow) for name in SETTINGS),
    ],
    indirect=True,
)
"""Of all at once, one that is let through has the effect that it has alone."""


@pytest.fixture(scope="module")
def algos(request):
    """GPC-NS computes with the parts of GPC."""
    return ("gpc", "coach", *(("gpc-ns",) if request.config.option.both_tiers else ()))


def everything(folder, inputs, algos):
    """Of each public name and method that computes: what it gives."""
    env, pendulum = gpcjax.make_env("cartpole", max_steps=5), gpcjax.make_env("pendulum", mass=1.1)
    expert, oracle = gpcjax.make_expert("cartpole", "lqr"), gpcjax.make_oracle("cartpole", "gpc", rate=0.9)
    keys, push, none = inputs
    at = env.step(env.reset(keys[0]), push)
    yield env, pendulum, oracle.oracle, at, pendulum.step(pendulum.reset(keys[1]), push)
    yield expert(at.obs), oracle.target(at.obs), oracle.advise(keys[2], at.obs, none)
    yield gpcjax.evaluate(env, expert, 2)
    for algo in algos:
        learner = gpcjax.make_learner(algo, "cartpole", **({} if algo == "coach" else {"capacity": 16}))
        state = learner.init()
        for scale in (1.0, -2.0, 0.5):
            state, info = learner.correct(state, scale * np.ones(4), none, np.sign([scale]))
        state = learner.grow(state)
        yield learner, state, info, learner.act(state, at.obs), learner.uncertainty(state, at.obs, none)
        yield learner.controller(state)(at.obs), learner.has_room(state), learner.largest_sigma()
        gpcjax.save_policy(folder / algo, learner, state)
        yield gpcjax.load_policy(folder / algo)(at.obs)


@pytest.fixture(scope="module")
def expected(tmp_path_factory, algos):
    folder = tmp_path_factory.mktemp("as_ever")
    return [jax.tree.leaves(each) for each in everything(folder, make_inputs(), algos)]


@all_settings
def test_every_number_is_the_same(inputs, expected, algos, asked, tmp_path):
    got = [jax.tree.leaves(each) for each in everything(tmp_path, inputs, algos)]
    assert_same_bits(got, expected)
    assert {name: getattr(jax.config, name) for name in asked} == asked


@pytest.mark.slow
def test_a_fit_without_float64():
    points = np.linspace(0, 3, 8)[:, None]
    call = lambda: fit(points, np.sin(points[:, 0]), 2.5, starts=[(1.0, 1.0, 0.01)])  # noqa: E731
    before = call()
    with jax.enable_x64(False):
        assert_same_bits(call(), before)


def test_float64_off_in_one_thread_only():
    learner, results = gpcjax.make_learner("coach", "pendulum"), []

    def teach():
        with jax.enable_x64(False):
            results.append(learner.correct(learner.init(), [0.1] * 3, [0.0], [1.0]))

    thread = threading.Thread(target=teach)
    thread.start()
    thread.join()
    assert_same_bits(results[0], learner.correct(learner.init(), [0.1] * 3, [0.0], [1.0]))


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap])
def test_inside_a_program_without_float64_it_is_refused(transform, inputs):
    learner, env = gpcjax.make_learner("gpc", "cartpole", capacity=16), gpcjax.make_env("cartpole")
    state, obs = learner.init(), jnp.ones((2, 4))
    with jax.enable_x64(False), pytest.raises(ValueError, match='update\\("jax_enable_x64", True\\)'):
        transform(lambda obs: learner.act(state, obs))(obs[0] if transform is jax.jit else obs)
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64 is off"):
        jax.jit(env.reset)(inputs[0][0])


@pytest.mark.parametrize("algo", ["gpc", "gpc-ns", "coach"])
def test_a_state_that_was_cast_is_refused(algo):
    learner = gpcjax.make_learner(algo, "cartpole", **({} if algo == "coach" else {"capacity": 16}))
    cast = jax.tree.map(
        lambda leaf: leaf.astype(jnp.float32) if leaf.dtype == jnp.float64 else leaf, learner.init()
    )
    obs, one = np.zeros(4), np.ones(1)
    for call in (
        lambda: learner.act(cast, obs),
        lambda: learner.uncertainty(cast, obs, one),
        lambda: learner.correct(cast, obs, one, one),
    ):
        with pytest.raises(ValueError, match="state holds float32, where init gives float64"):
            call()
