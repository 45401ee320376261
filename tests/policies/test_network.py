"""A network's controller: against numpy, with lanes at the end, and on disk."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.policies.network import NetworkController
from gpcjax.policies.saved import load_card, save_controller
from tests.trees import assert_same_bits

SIZES = (3, 5, 4, 2)


@pytest.fixture(scope="module")
def network():
    rng = np.random.default_rng(0)
    pairs = list(zip(SIZES[1:], SIZES[:-1], strict=True))
    return NetworkController(
        weights=tuple(jnp.asarray(rng.normal(size=pair)) for pair in pairs),
        biases=tuple(jnp.asarray(rng.normal(size=outputs)) for outputs, _ in pairs),
    )


def by_numpy(network, obs):
    units = np.asarray(obs)
    for w, b in zip(network.weights[:-1], network.biases[:-1], strict=True):
        units = np.tanh(w @ units + b)
    return network.weights[-1] @ units + network.biases[-1]


def test_it_is_a_multilayer_perceptron(network):
    act = jax.jit(network.__call__)
    for obs in np.random.default_rng(1).normal(size=(10, 3)):
        np.testing.assert_allclose(act(jnp.asarray(obs)), by_numpy(network, obs), atol=1e-13)


@pytest.mark.parametrize("lanes", [pytest.param(1, marks=pytest.mark.slow), 33])
def test_lanes_stand_at_the_end(network, lanes):
    """Those of observations alone, as an expert has them, and those of the layers too, as a learner's policy would."""
    obs = jnp.asarray(np.random.default_rng(2).normal(size=(3, lanes)))
    expected = np.stack([by_numpy(network, column) for column in np.asarray(obs).T], axis=-1)
    together = jax.jit(jax.vmap(network, in_axes=-1, out_axes=-1))(obs)
    np.testing.assert_allclose(together, expected, atol=1e-13)
    copies = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[..., None], lanes, axis=-1), network)
    each = jax.jit(lambda network, obs: network(obs))(jax.tree.map(jnp.asarray, copies), obs)
    np.testing.assert_allclose(each, expected, atol=1e-13)


def test_a_lane_has_the_same_bits_in_any_company(network):
    obs = jnp.asarray(np.random.default_rng(3).normal(size=(3, 64)))
    act = jax.jit(jax.vmap(network, in_axes=-1, out_axes=-1))
    together = np.asarray(act(obs))
    for lanes in (8, 32):
        np.testing.assert_array_equal(act(obs[:, :lanes]), together[:, :lanes])
    np.testing.assert_array_equal(act(obs[:, ::-1]), together[:, ::-1])


def test_what_is_saved_is_loaded_to_the_bit(network, tmp_path):
    save_controller(tmp_path / "mine", network, {"learner": "ppo"})
    assert_same_bits(gpcjax.load_policy(tmp_path / "mine").controller, network)
    card = load_card(tmp_path / "mine")
    assert card["kind"] == "network" and card["provenance"] == {"learner": "ppo"}
    shapes = {"weights_1": [5, 3], "weights_2": [4, 5], "weights_3": [2, 4]}
    assert card["arrays"] == shapes | {"biases_1": [5], "biases_2": [4], "biases_3": [2]}
