"""A learner and its state on disk: teaching goes on to the bit as if nothing had been between."""

import json
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.learners.factory import make_learner
from gpcjax.learners.packed import compact, pack_learner, unpack_learner
from gpcjax.policies.saved import Unfit, pack_controller, unpack_policy
from tests.trees import assert_same_bits

COACH = {"lower": (-1, -1), "upper": (1, 1), "counts": (2, 3)}
GO_ON = """
import sys, numpy as np, gpcjax
learner, state = gpcjax.load_learner(sys.argv[1])
rng = np.random.default_rng(1)
for _ in range(4):
    state, _ = learner.correct(state, rng.normal(size=2), np.zeros(2), rng.choice([-1, 1], size=2))
gpcjax.save_learner(sys.argv[2], learner, state)
"""


def teach(learner, state, seed, corrections):
    rng = np.random.default_rng(seed)
    for _ in range(corrections):
        state, _ = learner.correct(state, rng.normal(size=2), np.zeros(2), rng.choice([-1, 1], size=2))
    return state


def begun(learner):
    """An untaught state, with room for more than the learner begins with."""
    return learner.resize(learner.init(), 40, 200)


def learner_of(algo):
    if algo == "d-coach":
        return make_learner(
            algo, obs_size=2, action_size=2, width=4, buffer_size=8, batch_size=2, learning_rate=0.1
        )
    options = COACH if algo == "coach" else {"capacity": 8, "static_rate": 0.1, "policy": {"nu": 2.5}}
    return make_learner(algo, obs_size=2, action_size=2, **options)


@pytest.mark.parametrize("algo", ["gpc", pytest.param("gpc-ns", marks=pytest.mark.slow), "coach"])
def test_what_is_saved_goes_on_to_the_bit(tmp_path, algo):
    """Also from a state that has grown."""
    learner = learner_of(algo)
    state = teach(learner, begun(learner), 0, 5)
    gpcjax.save_learner(tmp_path / "saved", learner, state, teacher="Ada", score=np.float32(0.5))
    loaded, again = gpcjax.load_learner(tmp_path / "saved")
    assert_same_bits((loaded, again), (learner, state))
    assert_same_bits(teach(loaded, again, 1, 4), teach(learner, state, 1, 4))


@pytest.mark.parametrize(
    "algo", ["gpc", *(pytest.param(algo, marks=pytest.mark.slow) for algo in ("gpc-ns", "d-coach")), "coach"]
)
def test_what_is_packed_has_no_room_to_spare_and_goes_on_to_the_bit(algo):
    """As of a run: on the host, with room for more, and more points of one model and action than of the other."""
    learner = learner_of(algo)
    state = begun(learner)
    for advice in ([1, 1], [1, 0], [-1, 0]):
        state = teach(learner, state, 0, 1)
        state, _ = learner.correct(state, np.ones(2), np.zeros(2), advice)
    # Beyond its points a matrix may hold minus zeros, which `compact` cuts off.
    state = jax.tree.map(lambda leaf: leaf + 0, state)
    on_host = jax.tree.map(np.asarray, (learner, state))
    card, arrays = pack_learner(on_host[0], compact(*on_host))
    if algo.startswith("gpc"):
        most = state.policy.count.max(), state.human.count.max()
        assert (card["capacities"]["policy"], card["capacities"]["human"]) == most
        assert sum(array.nbytes for array in arrays.values()) < 20_000
    loaded, again = unpack_learner(json.loads(json.dumps(card)), arrays)
    assert_same_bits(loaded, learner)
    assert_same_bits(loaded.resize(again, 40, 200), state)
    assert_same_bits(teach(loaded, loaded.resize(again, 40, 200), 1, 4), teach(learner, state, 1, 4))
    policy = unpack_policy(*pack_controller(jax.tree.map(np.asarray, learner.controller(state))))
    for obs in np.random.default_rng(2).normal(size=(3, 2)):
        np.testing.assert_allclose(policy(obs), learner.act(state, obs), rtol=0, atol=1e-14)


@pytest.mark.parametrize("rates", [{"static_rate": 0.1}, {}], ids=["static", "adaptive"])
def test_a_static_rate_is_kept_where_it_was_given_and_else_there_is_nothing_of_it(tmp_path, rates):
    """As in 0.2.0, whose learners had no such number at all."""
    learner = make_learner("gpc", obs_size=2, action_size=2, capacity=8, **rates)
    state = teach(learner, learner.init(), 0, 2)
    gpcjax.save_learner(tmp_path / "saved", learner, state)
    card, arrays = pack_learner(learner, state)
    kept = {name: value for name, value in arrays.items() if "static_rate" in name}
    assert card["static"] == bool(rates) and kept == ({"learner.static_rate": 0.1} if rates else {})
    for loaded in (gpcjax.load_learner(tmp_path / "saved"), unpack_learner(card, arrays)):
        assert_same_bits(loaded, (learner, state))
    odd = (
        {name: value for name, value in arrays.items() if name not in kept}
        if rates
        else {**arrays, "learner.static_rate": np.array(0.1)}
    )
    with pytest.raises(UserError, match=r"learner.static_rate is not what the card says"):
        unpack_learner(card, odd)


def test_what_was_not_packed_is_refused():
    learner = learner_of("gpc")
    state = teach(learner, begun(learner), 0, 3)
    card, arrays = pack_learner(learner, state)
    for changed in ({"kind": "kernel"}, {"format": 3}, {"algo": "gpc-n"}):
        with pytest.raises(UserError, match=r"^cell 7: this is not a learner's card"):
            unpack_learner({**card, **changed}, arrays, "cell 7")
    with pytest.raises(UserError, match=r"damaged \(learner.policy.noise is not what the card says\)"):
        unpack_learner(card, {key: value for key, value in arrays.items() if key != "learner.policy.noise"})
    card, arrays = pack_controller(learner.controller(state))
    for changed in ({"kind": "learner"}, {"format": 3}, {"obs_size": 3}):
        with pytest.raises(Unfit):
            unpack_policy({**card, **changed}, arrays)


@pytest.mark.slow
def test_in_a_fresh_process_too(tmp_path, compiled_as_shipped):
    learner = learner_of("gpc-ns")
    state = teach(learner, learner.init(), 0, 3)
    gpcjax.save_learner(tmp_path / "saved", learner, state)
    root = Path(gpcjax.__file__).parents[1]
    command = [sys.executable, "-c", GO_ON, str(tmp_path / "saved"), str(tmp_path / "later")]
    subprocess.run(command, check=True, cwd=root)
    assert_same_bits(gpcjax.load_learner(tmp_path / "later"), (learner, teach(learner, state, 1, 4)))


def test_what_cannot_be_saved(tmp_path):
    learner = learner_of("gpc")
    state = learner.init()
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), state)
    broken = jax.tree.map(lambda leaf: leaf * np.nan if leaf.dtype == float else leaf, state)
    for given, message in (
        ((3, state), "learner 3: give a learner"),
        ((learner, 3), "state 3: give a state"),
        ((learner, batch), "cannot be saved: give a learner"),
        ((learner, learner_of("coach").init()), "give a state of this learner"),
        ((learner, broken), "is not finite"),
    ):
        with pytest.raises(ValueError, match=message):
            gpcjax.save_learner(tmp_path / "saved", *given)
    with pytest.raises(ValueError, match="a value of the card is no JSON value"):
        gpcjax.save_learner(tmp_path / "saved", learner, state, score=float("inf"))
    assert not list(tmp_path.iterdir())


def test_policies_and_learners_are_told_apart(tmp_path):
    learner = learner_of("coach")
    gpcjax.save_learner(tmp_path / "learner", learner, learner.init())
    gpcjax.save_policy(tmp_path / "policy", learner, learner.init())
    with pytest.raises(ValueError, match=r"policy/card.json: this is not a learner's card"):
        gpcjax.load_learner(tmp_path / "policy")
    with pytest.raises(ValueError, match=r"learner/card.json: this is not a policy's card"):
        gpcjax.load_policy(tmp_path / "learner")


@pytest.mark.parametrize("algo", [pytest.param("gpc", marks=pytest.mark.slow), "coach"])
def test_advice_that_is_none_is_not_learned_under_jit(algo):
    """There its value is not known when it is checked: the status tells, and no dimension is changed."""
    learner = learner_of(algo)
    state = learner.init()
    correct = jax.jit(learner.correct)
    for advice in ([0.5, 1.0], [1.0, 2.0], [np.nan, 0.0], [-1.0, np.inf]):
        after, info = correct(state, jnp.ones(2), jnp.zeros(2), jnp.array(advice))
        assert info.status == 3 and not info.rate.any()
        assert_same_bits(after, state)
        with pytest.raises(ValueError, match="each entry must be -1, 0 or 1"):
            learner.correct(state, np.ones(2), np.zeros(2), advice)
    assert correct(state, jnp.ones(2), jnp.zeros(2), jnp.array([1.0, -1.0]))[1].status == 0


@pytest.mark.parametrize("algo", [pytest.param("gpc", marks=pytest.mark.slow), "coach"])
def test_an_action_that_was_never_executed_is_not_learned(algo):
    """What is executed is clipped: a loop that gives what it proposed is told so."""
    learner = learner_of(algo)
    state, advice = learner.init(), jnp.array([1.0, 0.0])
    traced = jax.jit(learner.correct), jax.jit(lambda *given: learner.correct(*given, [1, 0]))
    for action in ([1.001, 0.0], [0.0, -3.0], [1e200, 0.0], [np.nan, 2.0]):
        for call in (traced[0](state, jnp.ones(2), jnp.array(action), advice),
                     traced[1](state, jnp.ones(2), jnp.array(action))):  # fmt: skip
            assert call[1].status == 3 and not call[1].rate.any()
            assert_same_bits(call[0], state)
        with pytest.raises(UserError, match=r"action \[.*\]: each entry must be from -1 to 1, as it"):
            learner.correct(state, np.ones(2), action, advice)
    for action in ([1.0, -1.0], np.float32([1.0, -1.0]), [1, -1]):
        assert learner.correct(state, np.ones(2), action, advice)[1].status == 0
    assert traced[0](state, jnp.ones(2), jnp.array([1.0, -1.0]), advice)[1].status == 0
    for action in ([np.inf, 0.0], [np.nan, 0.0]):
        assert learner.correct(state, np.ones(2), action, advice)[1].status == 2
        assert traced[0](state, jnp.ones(2), jnp.array(action), advice)[1].status == 2


@pytest.mark.parametrize(
    "obs", [[1j, 0], ["1", "2"], [None, 0], [True, False], b"ab", "ab", None, [[1], [2, 3]]], ids=str
)
def test_only_real_numbers_are_observations(obs):
    learner = learner_of("coach")
    state, policy = learner.init(), learner.policy_of(learner.init())
    for call in (
        policy,
        lambda obs: learner.act(state, obs),
        lambda obs: learner.correct(state, obs, [0, 0], [1, 1]),
    ):
        with pytest.raises(ValueError, match=r"obs .*: this (learner|policy) takes 2 real numbers"):
            call(obs)


def test_a_policy_without_a_file():
    """It takes lists, says which length it takes, and works in jit and vmap."""
    learner = learner_of("gpc")
    state = teach(learner, begun(learner), 0, 4)
    policy = learner.policy_of(state)
    for obs in np.random.default_rng(2).normal(size=(3, 2)):
        np.testing.assert_allclose(policy(obs.tolist()), learner.act(state, obs), atol=1e-15)
        np.testing.assert_allclose(jax.jit(jax.vmap(policy))(obs[None])[0], policy(obs), atol=1e-15)
    for wrong in ([1.0], np.zeros((2, 1)), jnp.zeros(3), 1.0):
        with pytest.raises(ValueError, match=r"obs has shape \(.*\), this policy takes \(2,\)"):
            policy(wrong)
