"""D-COACH: corrective advice to a neural network (Perez-Dattari et al. 2018, arXiv 1810.00466).

A correction makes a target of the action that was executed, y = clip(a + e h, -1, 1). The network is moved towards it
by one step of gradient descent at once, and the pair (s, y) goes into a buffer whose oldest pair it replaces; then, and
every few steps of an episode whether there was advice or not, by one step for a minibatch of the buffer.

| paper | here |
|---|---|
| pi | `DCoachState.layers`: tanh units in two layers of equal width, and a tanh output, as in the authors' program |
| e | `magnitude` |
| b, the steps between two minibatches | `replay_every` |

A dimension without advice keeps its executed action as its target (y = a + e 0), as published. So the pair says that
it shall stay what it was there, which for a network with shared layers is what "untouched" can mean: without that
target, an advice for the other dimension would move it.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from gpcjax._x64 import seeded_key
from gpcjax.allowed import POSITIVE, Numbers, checked, checked_series
from gpcjax.elementary import tanh
from gpcjax.learners.base import Info, Learner, Moment
from gpcjax.learners.calls import check_kept
from gpcjax.learners.descriptions import D_COACH
from gpcjax.policies.network import NetworkController, SquashedNetwork

Layers = tuple[eqx.nn.Linear, ...]


class DCoachState(eqx.Module):
    """A network, and the newest corrections."""

    layers: Layers
    """Each gives W x + b; the first takes scaled observations."""
    obs: Float[Array, "buffer obs"]
    """Where each correction of the buffer was given; zeros where there is none yet."""
    targets: Float[Array, "buffer action"]
    """y there."""
    count: Int[Array, ""]
    """Corrections so far; the next one takes the place `count` modulo the size of the buffer."""
    loss: Float[Array, ""]
    """Of the newest minibatch, before its step; 0 before there was one."""


class DCoach(Learner):
    """D-COACH.

    Fields:
        learning_rate: of gradient descent.
        magnitude: (action_size,), e, the assumed error of the action.
        scaling: (obs_size,), what observations are multiplied by, so that they are about one in size.
        buffer_size: corrections that are kept.
        batch_size: of a minibatch, drawn with replacement.
        replay_every: steps of an episode between two minibatches without advice; 0 is never.
        width: units of each hidden layer.
    """

    learning_rate: Float[Array, ""]
    magnitude: Float[Array, " action"]
    scaling: Float[Array, " obs"]
    buffer_size: int = eqx.field(static=True)
    batch_size: int = eqx.field(static=True)
    replay_every: int = eqx.field(static=True)
    width: int = eqx.field(static=True)

    @property
    def idle_every(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]  (a setting here)
        """Steps between two calls of `idle`."""
        return self.replay_every

    def init(self, key: PRNGKeyArray | None = None) -> DCoachState:
        """A network of random weights (Glorot and Bengio 2010) without offsets, and an empty buffer."""
        sizes = (self.obs_size, self.width, self.width, self.action_size)
        keys = jax.random.split(seeded_key() if key is None else key, len(sizes) - 1)
        layers = tuple(_layer(*pair) for pair in zip(sizes[:-1], sizes[1:], keys, strict=True))
        return DCoachState(
            layers=layers,
            obs=jnp.zeros((self.buffer_size, self.obs_size)),
            targets=jnp.zeros((self.buffer_size, self.action_size)),
            count=jnp.zeros((), jnp.int32),
            loss=jnp.zeros(()),
        )

    def controller(self, state: DCoachState) -> SquashedNetwork:
        """The network of `state` alone, the scaling of observations in its first layer."""
        check_kept(state)
        first, *others = (layer.weight for layer in state.layers)
        biases = tuple(_offset(layer) for layer in state.layers)
        return SquashedNetwork(NetworkController((first * self.scaling[None], *others), biases))

    def learn(
        self, state: DCoachState, moment: Moment, advice: Float[Array, " action"], key: PRNGKeyArray
    ) -> tuple[DCoachState, Info]:
        """A step for this correction, and one for a minibatch of the buffer that holds it.

        `key` and how many corrections there were draw it: `correct` has one key for all of them. `Info.rate` is how far
        the two steps moved the action at this observation.
        """
        obs, target = moment.obs[None], jnp.clip(moment.action + self.magnitude * advice, -1.0, 1.0)
        layers, _ = self._descended(state.layers, obs, target[None])
        place = state.count % self.buffer_size
        new = self._replayed(
            DCoachState(
                layers=layers,
                obs=state.obs.at[place].set(moment.obs),
                targets=state.targets.at[place].set(target),
                count=state.count + 1,
                loss=state.loss,
            ),
            jax.random.fold_in(key, state.count),
        )
        before, after = (_actions(each, obs * self.scaling[None])[0] for each in (state.layers, new.layers))
        return new, Info.of(rate=jnp.abs(after - before))

    def idle(self, state: DCoachState, key: PRNGKeyArray) -> DCoachState:
        """A step for a minibatch of the buffer, if there is anything in it."""
        check_kept(state)
        new = self._replayed(state, key)
        return jax.tree.map(lambda now, old: jnp.where(state.count > 0, now, old), new, state)

    def measure(self, state: DCoachState) -> dict[str, Float[Array, ""]]:
        """How full the buffer is, and the loss of the newest minibatch."""
        check_kept(state)
        return {"buffer_points": self._filled(state).astype(float), "replay_loss": state.loss}

    def _filled(self, state: DCoachState) -> Int[Array, ""]:
        """Corrections in the buffer."""
        return jnp.minimum(state.count, self.buffer_size)

    def _replayed(self, state: DCoachState, key: PRNGKeyArray) -> DCoachState:
        drawn = jax.random.randint(key, (self.batch_size,), 0, jnp.maximum(self._filled(state), 1))
        layers, loss = self._descended(state.layers, state.obs[drawn], state.targets[drawn])
        return dataclasses.replace(state, layers=layers, loss=loss)

    def _descended(
        self, layers: Layers, obs: Float[Array, "batch obs"], targets: Float[Array, "batch action"]
    ) -> tuple[Layers, Float[Array, ""]]:
        """The network after a step of gradient descent on half the mean squared error, and that before it."""
        import optax  # what takes a sixteenth of a worker's start is for those who need it

        loss, slope = eqx.filter_value_and_grad(_loss)(layers, obs * self.scaling[None], targets)
        optimiser = optax.sgd(self.learning_rate)  # without momentum: it has nothing to keep in the state
        kept = optimiser.init(layers)  # pyright: ignore[reportArgumentType]  (any pytree of arrays will do)
        updates, _ = optimiser.update(slope, kept)
        return eqx.apply_updates(layers, updates), loss


def _layer(inputs: int, outputs: int, key: PRNGKeyArray) -> eqx.nn.Linear:
    weights_key, unused = jax.random.split(key)
    layer = eqx.nn.Linear(inputs, outputs, dtype=float, key=unused)
    weights = jax.nn.initializers.glorot_uniform(in_axis=1, out_axis=0)(weights_key, (outputs, inputs), float)
    return eqx.tree_at(lambda each: (each.weight, each.bias), layer, (weights, jnp.zeros(outputs)))


def _offset(layer: eqx.nn.Linear) -> Float[Array, " outputs"]:
    assert layer.bias is not None
    return layer.bias


def _actions(layers: Layers, scaled: Float[Array, "batch obs"]) -> Float[Array, "batch action"]:
    units = scaled
    for layer in layers:
        units = tanh(jax.vmap(layer)(units))
    return units


def _loss(
    layers: Layers, scaled: Float[Array, "batch obs"], targets: Float[Array, "batch action"]
) -> Float[Array, ""]:
    return 0.5 * jnp.mean((_actions(layers, scaled) - targets) ** 2)


_ALLOWED = {setting.name: setting.allowed for setting in D_COACH.settings}


def make_dcoach(*, obs_size: int, action_size: int, scaling: Any = 1.0, **settings: Any) -> DCoach:
    """D-COACH: see `gpcjax.make_learner`."""
    given = dict(D_COACH.defaults) | settings
    magnitude = _ALLOWED["magnitude"]
    assert isinstance(magnitude, Numbers)
    whole = {
        name: checked(name, given[name], int, _ALLOWED[name])
        for name in ("buffer_size", "batch_size", "replay_every", "width")
    }
    rate = checked("learning_rate", given["learning_rate"], float, _ALLOWED["learning_rate"])
    return DCoach(
        learning_rate=jnp.asarray(rate, float),
        magnitude=jnp.asarray(checked_series("magnitude", given["magnitude"], action_size, magnitude), float),
        scaling=jnp.asarray(checked_series("scaling", scaling, obs_size, POSITIVE), float),
        obs_size=obs_size,
        action_size=action_size,
        **whole,
    )
