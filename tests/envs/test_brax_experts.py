"""What brax's PPO trains is what is saved; nothing is heard of what brax says when it is imported."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme import running_statistics
from brax.training.agents.ppo import networks
from flax import linen

from gpcjax import registry
from gpcjax.engine.evaluate import evaluate
from gpcjax.envs.brax_tasks import KNOWN
from gpcjax.envs.brax_training import HIDDEN, arrays_of, quiet
from gpcjax.envs.registry import make_env, make_expert, shipped
from gpcjax.errors import UserError
from gpcjax.policies.base import Policy
from gpcjax.policies.saved import load_card, load_policy, save_controller, shipped_path
from gpcjax.sweep.brax_oracles import network_of

# brax and its dependencies announce deprecations as they load and run
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")

OBS, ACTIONS = 5, 2


@pytest.fixture(scope="module")
def of_brax():
    """brax's own network, with parameters and a normaliser drawn at random, all in float64."""
    made = networks.make_ppo_networks(
        OBS,
        ACTIONS,
        preprocess_observations_fn=running_statistics.normalize,
        policy_hidden_layer_sizes=HIDDEN,
        activation=linen.tanh,
    )
    weights, biases, mean, deviation = jax.random.split(jax.random.key(0), 4)
    policy = jax.jit(made.policy_network.init)(weights)
    # flax begins with biases of zero, which would hide that one is left out.
    policy = jax.tree.map(
        lambda leaf: leaf.astype(float) + (0.3 * jax.random.normal(jax.random.clone(biases), leaf.shape)),
        policy,
    )
    normaliser = running_statistics.init_state(jnp.zeros(OBS)).replace(
        mean=jax.random.normal(mean, (OBS,)),
        std=jax.random.uniform(deviation, (OBS,), minval=0.1, maxval=3.0),
    )
    return made, normaliser, policy


def actions(made, normaliser, policy, observations):
    """brax's own inference without noise, for each observation; its key is never used."""
    act = networks.make_inference_fn(made)((normaliser, policy), deterministic=True)
    return jax.jit(jax.vmap(lambda obs: act(obs, jax.random.key(2))[0]))(observations)


by_each = jax.jit(lambda policy, observations: jax.vmap(policy)(observations))


def test_the_network_is_that_of_brax(of_brax, tmp_path):
    made, normaliser, policy = of_brax
    observations = 3.0 * jax.random.normal(jax.random.key(1), (50, OBS))
    expected = actions(made, normaliser, policy, observations)
    controller = network_of(arrays_of(normaliser, policy))
    found = by_each(Policy(controller), observations)
    assert np.abs(expected).max() > 0.9 and np.ptp(np.asarray(expected), axis=0).min() > 0.5
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    save_controller(tmp_path / "saved", controller, {})
    np.testing.assert_array_equal(by_each(load_policy(tmp_path / "saved"), observations), found)


@pytest.mark.slow
def test_float32_is_close(of_brax):
    made, normaliser, policy = jax.tree.map(
        lambda leaf: leaf.astype(jnp.float32) if isinstance(leaf, jax.Array) else leaf, of_brax
    )
    observations = jax.random.normal(jax.random.key(1), (50, OBS), jnp.float32)
    expected = actions(made, normaliser, policy, observations)
    assert expected.dtype == jnp.float32
    controller = network_of(arrays_of(normaliser, policy))
    found = by_each(Policy(controller), observations.astype(float))
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    "task",
    [pytest.param(task, marks=[pytest.mark.slow] if number else []) for number, task in enumerate(KNOWN)],
)
def test_an_expert_ships(task):
    """One for each of these, whose card says how it came about."""
    (expert, name), *others = shipped(f"brax:{task}").items()
    assert expert == "ppo" and not others
    provenance = load_card(shipped_path(name))["provenance"]
    assert provenance["env"] == f"brax:{task}" and provenance["starts"] == 100
    assert provenance["steps"] > 1_000_000 and provenance["training"]["num_envs"] == 256
    policy = load_policy(shipped_path(name))
    assert np.abs(policy(np.zeros(policy.controller.obs_size))).max() <= 1


@pytest.mark.slow
@pytest.mark.parametrize("task", KNOWN)
def test_shipped_experts_do_what_their_cards_say(task):
    env_name, few = f"brax:{task}", 8
    (expert, name), *_ = shipped(env_name).items()
    provenance = load_card(shipped_path(name))["provenance"]
    returns = np.asarray(evaluate(make_env(env_name), make_expert(env_name, expert), few).returns)
    # Five standard errors of a mean over so few starts, which a policy of the same returns misses never.
    limit = 5 * provenance["return_std"] / np.sqrt(few) + 1e-6
    assert abs(returns.mean() - provenance["return_mean"]) <= limit


def test_only_what_brax_lacks_is_unsaid(capsys):
    with quiet():
        print("Failed to import warp: No module named 'warp'")
        print("something else")
    assert capsys.readouterr().out == "something else\n"


@pytest.mark.slow
def test_nothing_is_said_where_a_task_of_brax_is_made():
    code = "from gpcjax.envs.registry import make_env; make_env('brax:inverted_pendulum')"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (ran.stdout, ran.stderr) == ("", "")


def test_no_task_of_brax():
    with pytest.raises(
        UserError, match=r"^env unknown brax environment 'pendulum'; allowed: ant, .*walker2d$"
    ):
        registry.find("task", "brax:pendulum")
