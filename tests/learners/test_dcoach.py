"""D-COACH: against numpy, its buffer, what it draws, and what of it is refused and kept."""

import dataclasses
import pickle
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.learners.base import Moment, Status
from gpcjax.learners.factory import make_learner
from gpcjax.policies.network import SquashedNetwork
from tests.trees import assert_close, assert_same_bits

SCALING = (1.0, 0.5, 2.0)
SMALL = {"obs_size": 3, "action_size": 2, "buffer_size": 4, "batch_size": 5, "width": 6, "learning_rate": 0.2}


def small(**options):
    return make_learner("d-coach", **(SMALL | {"scaling": SCALING, "magnitude": (0.8, 0.4)} | options))


class ByNumpy:
    """The same equations in numpy, with the initial weights and the minibatches of the learner."""

    def __init__(self, state):
        self.weights = [np.array(layer.weight) for layer in state.layers]
        self.biases = [np.array(layer.bias) for layer in state.layers]
        self.buffer = []

    def activations(self, obs):
        units = [obs * np.array(SCALING)]
        for w, b in zip(self.weights, self.biases, strict=True):
            units.append(np.tanh(w @ units[-1] + b))
        return units

    def descend(self, pairs):
        """A step on half the squared error, of the mean over pairs and dimensions; the loss before it."""
        loss, steps = (
            0.0,
            [[np.zeros_like(w), np.zeros_like(b)] for w, b in zip(self.weights, self.biases, strict=True)],
        )
        for obs, target in pairs:
            units = self.activations(obs)
            share = 1.0 / (len(pairs) * len(target))
            loss += 0.5 * share * ((units[-1] - target) ** 2).sum()
            error = share * (units[-1] - target)
            for layer in reversed(range(3)):
                error = error * (1.0 - units[layer + 1] ** 2)
                steps[layer][0] += np.outer(error, units[layer])
                steps[layer][1] += error
                error = self.weights[layer].T @ error
        for layer, (w, b) in enumerate(steps):
            self.weights[layer] -= 0.2 * w
            self.biases[layer] -= 0.2 * b
        return loss

    def learn(self, obs, action, advice, drawn):
        pair = (obs, np.clip(action + np.array([0.8, 0.4]) * advice, -1.0, 1.0))
        before = self.activations(obs)[-1]
        self.descend([pair])
        if len(self.buffer) < 4:
            self.buffer.append(pair)
        else:
            self.buffer[self.count % 4] = pair
        self.loss = self.descend([self.buffer[place] for place in drawn])
        return np.abs(self.activations(obs)[-1] - before)


@pytest.fixture(scope="module")
def learner():
    return small()


@pytest.fixture(scope="module")
def compiled(learner):
    """Its methods, compiled once for all tests."""
    return SimpleNamespace(**{name: jax.jit(getattr(learner, name)) for name in ("init", "learn", "idle")})


@pytest.fixture(scope="module")
def taught(learner, compiled):
    """A state with one correction."""
    state = compiled.init(jax.random.key(7))
    return learner.correct(state, [0.1, 0.2, 0.3], [0.9, -0.25], [1, 0])[0]


def moment(obs, action):
    return Moment(obs=jnp.asarray(obs), action=jnp.asarray(action), episode=jnp.int32(0), step=jnp.int32(0))


@jax.jit
def minibatch(count, most):
    """Places in the buffer, drawn with the key of so many corrections."""
    return jax.random.randint(jax.random.fold_in(jax.random.key(count), count), (5,), 0, most)


def test_it_is_what_numpy_makes_of_the_equations(learner, compiled):
    """Beyond the buffer's size: the oldest pair gives way to the newest."""
    state, rng = compiled.init(jax.random.key(7)), np.random.default_rng(0)
    reference = ByNumpy(state)
    for count in range(8):
        obs, action = rng.normal(size=3), rng.uniform(-1, 1, size=2)
        advice = [(1.0, -1.0), (0.0, 1.0), (-1.0, 0.0)][count % 3]
        drawn = minibatch(count, min(count + 1, 4))
        reference.count = count
        rate = reference.learn(obs, action, np.array(advice), np.asarray(drawn))
        state, info = compiled.learn(state, moment(obs, action), jnp.array(advice), jax.random.key(count))
        np.testing.assert_allclose(info.rate, rate, atol=1e-12)
        assert_close([[layer.weight, layer.bias] for layer in state.layers],
                     [list(pair) for pair in zip(reference.weights, reference.biases, strict=True)], 1e-12)  # fmt: skip
        np.testing.assert_allclose(state.loss, reference.loss, atol=1e-12)
        np.testing.assert_allclose(learner.act(state, obs), reference.activations(obs)[-1], atol=1e-12)
    assert {place: tuple(row) for place, row in enumerate(np.asarray(state.obs))} == {
        place: tuple(pair[0]) for place, pair in enumerate(reference.buffer)
    }
    assert learner.measure(state)["buffer_points"] == 4


def test_a_dimension_without_advice_keeps_what_was_executed_as_its_target(taught):
    np.testing.assert_allclose(taught.targets[0], [1.0, -0.25])


def test_it_goes_on_without_advice_once_there_is_something_in_its_buffer(learner, compiled, taught):
    empty = compiled.init(jax.random.key(7))
    assert_same_bits(compiled.idle(empty, jax.random.key(1)), empty)
    after = compiled.idle(taught, jax.random.key(1))
    assert after.count == 1 and (after.layers[0].weight != taught.layers[0].weight).any()
    assert learner.idle_every == 10 and small(replay_every=0).idle_every == 0


def test_seeds_begin_with_other_networks(compiled):
    first, second = (compiled.init(jax.random.key(seed)) for seed in (1, 2))
    for one, other in zip(first.layers, second.layers, strict=True):
        assert (one.weight != other.weight).all() and not one.bias.any()
    assert_same_bits(compiled.init(jax.random.key(1)), first)


def test_minibatches_differ_by_key_and_by_the_number_of_corrections(compiled, taught):
    """`correct` has one key for all corrections: a buffer of which the same part is always drawn teaches only that."""
    rng = np.random.default_rng(3)
    full = dataclasses.replace(taught, obs=jnp.asarray(rng.normal(size=(4, 3))), count=jnp.int32(4))
    losses = [float(compiled.idle(full, jax.random.key(key)).loss) for key in (0, 0, 1, 2)]
    assert losses[0] == losses[1] and len({*losses}) == 3
    advised = moment(np.ones(3), np.zeros(2)), jnp.array([1.0, -1.0]), jax.random.key(0)
    later = (dataclasses.replace(full, count=jnp.int32(count)) for count in (4, 8, 12))
    assert len({float(compiled.learn(state, *advised)[0].loss) for state in later}) == 3


@pytest.mark.slow
def test_learning_is_pure_and_the_same_in_lanes(learner, compiled):
    states = [compiled.init(jax.random.key(seed)) for seed in range(3)]
    block = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)
    kept = jax.tree.map(np.array, block)
    obs = jnp.asarray(np.random.default_rng(5).normal(size=(3, 3)))
    keys, advice = jax.vmap(jax.random.key)(jnp.arange(3)), jnp.array([1.0, -1.0])
    learn = jax.vmap(lambda state, obs, key: learner.learn(state, moment(obs, np.zeros(2)), advice, key))
    together, _ = jax.jit(learn)(block, obs, keys)
    assert_same_bits(block, kept)
    for lane, state in enumerate(states):
        alone, _ = compiled.learn(state, moment(obs[lane], np.zeros(2)), advice, jax.random.key(lane))
        assert_close(alone, jax.tree.map(lambda leaf, lane=lane: leaf[lane], together), 1e-13)


def test_what_is_no_number_is_not_learned(learner, taught):
    after, info = learner.correct(taught, [np.nan, 0.0, 0.0], [0.0, 0.0], [1, -1])
    assert info.status == Status.NON_FINITE and not info.rate.any()
    assert_same_bits(after, taught)


def test_the_policy_is_the_network_alone_and_is_kept(learner, taught, tmp_path):
    controller = learner.controller(taught)
    assert isinstance(controller, SquashedNetwork)
    assert sum(leaf.size for leaf in jax.tree.leaves(controller)) == 6 * 3 + 6 + 6 * 6 + 6 + 2 * 6 + 2
    gpcjax.save_policy(tmp_path / "policy", learner, taught, teacher="Ada")
    assert_same_bits(gpcjax.load_policy(tmp_path / "policy").controller, controller)
    for thing in (learner, taught, controller):
        assert_same_bits(pickle.loads(pickle.dumps(thing)), thing)


def test_a_state_is_kept_and_goes_on_to_the_bit(learner, taught, tmp_path):
    gpcjax.save_learner(tmp_path / "saved", learner, taught)
    loaded, again = gpcjax.load_learner(tmp_path / "saved")
    assert_same_bits((loaded, again), (learner, taught))
    assert loaded.replay_every == learner.replay_every
    given = [0.3, -0.1, 0.2], [0.0, 0.0], [0, 1]
    assert_same_bits(loaded.correct(again, *given), learner.correct(taught, *given))


def test_observations_are_scaled_by_what_a_task_says_of_them():
    np.testing.assert_allclose(make_learner("d-coach", "cartpole").scaling, [1.0, 1.0, 1 / 0.13, 1 / 0.4])
    np.testing.assert_allclose(make_learner("d-coach", "lunarlander").scaling, np.ones(8))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"learning_rate": 0.0}, "learning_rate 0.0: give a number above 0"),
        ({"magnitude": (1.0, -1.0)}, "magnitude"),
        ({"magnitude": (1.0, 1.0, 1.0)}, "magnitude"),
        ({"buffer_size": 0}, "buffer_size 0: give a whole number from 1"),
        ({"batch_size": 2.5}, "batch_size 2.5: give a whole number"),
        ({"replay_every": -1}, "replay_every -1: give a whole number from 0"),
        ({"width": 0}, "width 0"),
        ({"scaling": (1.0, 1.0)}, "scaling"),
        ({"momentum": 0.9}, "'momentum' is not an option of this learner"),
    ],
)
def test_what_makes_no_learner_is_refused(options, message):
    with pytest.raises(UserError, match=message):
        small(**options)
