"""Proximal policy optimisation (Schulman et al., 2017), for the experts that no learner of ours has made.

A batch of lanes acts for some steps, each step's advantage is estimated (GAE), and the network is moved by a few epochs
of clipped policy gradients; all of it in one compiled loop.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jax import lax
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from gpcjax.elementary import tanh
from gpcjax.envs.base import Env, State
from gpcjax.policies.network import NetworkController

Layers = list[tuple[Array, Array]]


@dataclasses.dataclass(frozen=True)
class Training:
    """What a training depends on, beside its task and its key.

    | Field            | Meaning                                                                     |
    |------------------|-----------------------------------------------------------------------------|
    | `scale`          | what each observation is multiplied by                                      |
    | `reward_scale`   | what a reward is multiplied by                                              |
    | `discount`       | gamma, of a step                                                            |
    | `trace`          | lambda of the advantage's estimate                                          |
    | `updates`        | times that the lanes act and the network is moved                           |
    | `lanes`          | episodes that run side by side                                              |
    | `unroll`         | steps of each lane between two updates                                      |
    | `epochs`         | passes over these steps                                                     |
    | `minibatches`    | parts of each pass                                                          |
    | `clip`           | how far the ratio of probabilities may move                                 |
    | `learning_rate`  | of Adam, falling linearly to zero                                           |
    | `deviation`      | standard deviation of the actions tried, at the beginning                   |
    | `hidden`         | units of each layer, of the policy and of the value                         |
    """

    scale: tuple[float, ...]
    reward_scale: float
    discount: float
    updates: int
    trace: float = 0.95
    lanes: int = 64
    unroll: int = 64
    epochs: int = 6
    minibatches: int = 8
    clip: float = 0.2
    learning_rate: float = 1e-3
    deviation: float = 0.6
    hidden: tuple[int, ...] = (32, 32)

    @property
    def steps(self) -> int:
        """Steps of the task, in all."""
        return self.updates * self.lanes * self.unroll


class Parameters(NamedTuple):
    """What is learned."""

    policy: Layers
    value: Layers
    log_deviation: Float[Array, " action"]


class Step(NamedTuple):
    """One step of every lane; each field (unroll, lanes, ...)."""

    obs: Array
    action: Array
    """As drawn: before the task clips it."""
    log_density: Array
    reward: Array
    terminated: Array
    done: Array
    next_obs: Array


def train(
    env: Env, training: Training, key: PRNGKeyArray
) -> tuple[NetworkController, Float[Array, " updates"]]:
    """A network that masters `env`, and the mean reward of a step in each update. Consumes `key`."""
    parameters, rewards = _train(env, training, key)
    weights, biases = zip(*parameters.policy, strict=True)
    first = weights[0] * jnp.asarray(training.scale)[None]
    return NetworkController(weights=(first, *weights[1:]), biases=biases), rewards


@functools.partial(jax.jit, static_argnums=1)
def _train(env: Env, training: Training, key: PRNGKeyArray) -> tuple[Parameters, Array]:
    key_start, key_age, key_policy, key_value, key_updates = jax.random.split(key, 5)
    parameters = Parameters(
        _layers(key_policy, (env.obs_size, *training.hidden, env.action_size), 0.01),
        _layers(key_value, (env.obs_size, *training.hidden, 1), 1.0),
        jnp.full(env.action_size, jnp.log(training.deviation)),
    )
    moves = training.updates * training.epochs * training.minibatches
    optimiser = optax.chain(
        optax.clip_by_global_norm(0.5),
        optax.adam(optax.linear_schedule(training.learning_rate, 0.0, moves), eps=1e-5),
    )

    def update(carry: PyTree, key: PRNGKeyArray) -> tuple[PyTree, Array]:
        parameters, memory, state = carry
        key_act, key_shuffle = jax.random.split(key)
        state, steps = _act(env, training, parameters, state, key_act)
        advantage, target = _advantages(training, parameters, steps)
        batch = (steps.obs, steps.action, steps.log_density, advantage, target)
        batch = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), batch)

        def epoch(carry: PyTree, key: PRNGKeyArray) -> tuple[PyTree, None]:
            order = jax.random.permutation(key, training.lanes * training.unroll)
            parts = jax.tree.map(
                lambda leaf: leaf[order].reshape(training.minibatches, -1, *leaf.shape[1:]), batch
            )
            return lax.scan(move, carry, parts)[0], None

        def move(carry: PyTree, part: PyTree) -> tuple[PyTree, None]:
            parameters, memory = carry
            gradient = jax.grad(_loss)(parameters, training, part)
            change, memory = optimiser.update(gradient, memory)
            return (optax.apply_updates(parameters, change), memory), None

        (parameters, memory), _ = lax.scan(
            epoch, (parameters, memory), jax.random.split(key_shuffle, training.epochs)
        )
        return (parameters, memory, state), steps.reward.mean()

    state = jax.vmap(env.reset)(jax.random.split(key_start, training.lanes))
    # Lanes end their first episodes at different times, so that every batch has steps from all of an episode.
    age = jax.random.randint(key_age, (training.lanes,), 0, env.max_steps, jnp.int32)
    state = eqx.tree_at(lambda state: state.time, state, age)
    carry = (parameters, optimiser.init(parameters), state)
    (parameters, _, _), rewards = lax.scan(update, carry, jax.random.split(key_updates, training.updates))
    return parameters, rewards


def _act(
    env: Env, training: Training, parameters: Parameters, state: State, key: PRNGKeyArray
) -> tuple[State, Step]:
    """Some steps of every lane; those whose episode ends begin another one."""

    def step(state: State, key: PRNGKeyArray) -> tuple[State, Step]:
        key_noise, key_start = jax.random.split(key)
        obs = state.obs
        mean = _forward(parameters.policy, obs * jnp.asarray(training.scale)[None])
        noise = jax.random.normal(key_noise, mean.shape)
        action = mean + jnp.exp(parameters.log_deviation)[None] * noise
        after = jax.vmap(env.step)(state, action)
        record = Step(
            obs,
            action,
            _log_density(parameters, mean, action),
            after.reward,
            after.terminated,
            after.done,
            after.obs,
        )
        fresh = jax.vmap(env.reset)(jax.random.split(key_start, training.lanes))
        state = jax.tree.map(
            lambda new, old: jnp.where(after.done.reshape(-1, *[1] * (new.ndim - 1)), new, old), fresh, after
        )
        return state, record

    return lax.scan(step, state, jax.random.split(key, training.unroll))


def _advantages(training: Training, parameters: Parameters, steps: Step) -> tuple[Array, Array]:
    """GAE, and what the value should have been. An episode that was cut off is worth what would have followed."""
    scale = jnp.asarray(training.scale)[None, None]
    value = _forward(parameters.value, steps.obs * scale)[..., 0]
    following = _forward(parameters.value, steps.next_obs * scale)[..., 0]
    following = jnp.where(steps.terminated, 0.0, following)
    surprise = training.reward_scale * steps.reward + training.discount * following - value

    def back(carry: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        surprise, done = step
        carry = surprise + training.discount * training.trace * jnp.where(done, 0.0, carry)
        return carry, carry

    advantage = lax.scan(back, jnp.zeros(training.lanes), (surprise, steps.done), reverse=True)[1]
    return advantage, advantage + value


def _loss(parameters: Parameters, training: Training, part: tuple[Array, ...]) -> Array:
    obs, action, log_density, advantage, target = part
    obs = obs * jnp.asarray(training.scale)[None]
    ratio = jnp.exp(_log_density(parameters, _forward(parameters.policy, obs), action) - log_density)
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    clipped = jnp.clip(ratio, 1.0 - training.clip, 1.0 + training.clip)
    gain = jnp.minimum(ratio * advantage, clipped * advantage).mean()
    error = 0.5 * ((_forward(parameters.value, obs)[..., 0] - target) ** 2).mean()
    return error - gain


def _log_density(parameters: Parameters, mean: Array, action: Array) -> Array:
    """Of a normal distribution, up to a constant."""
    unit = (action - mean) * jnp.exp(-parameters.log_deviation)[None]
    return (-0.5 * unit * unit - parameters.log_deviation[None]).sum(-1)


def _layers(key: PRNGKeyArray, sizes: Sequence[int], last: float) -> Layers:
    """Orthogonal weights, of gain sqrt(2) or (those of the last layer) `last`."""
    gains = [2.0**0.5] * (len(sizes) - 2) + [last]
    keys = jax.random.split(key, len(gains))
    return [
        (gain * jax.nn.initializers.orthogonal()(key, (outputs, inputs)), jnp.zeros(outputs))
        for key, gain, inputs, outputs in zip(keys, gains, sizes[:-1], sizes[1:], strict=True)
    ]


def _forward(layers: Layers, units: Float[Array, "*batch inputs"]) -> Float[Array, "*batch outputs"]:
    *hidden, last = layers
    for layer in hidden:
        units = tanh(_affine(layer, units))
    return _affine(last, units)


def _affine(
    layer: tuple[Array, Array], units: Float[Array, "*batch inputs"]
) -> Float[Array, "*batch outputs"]:
    weights, biases = layer
    product = units @ weights.T
    return product + jnp.broadcast_to(biases, product.shape)
