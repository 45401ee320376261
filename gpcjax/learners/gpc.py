"""Gaussian Process Coach (GPC) and its normalised variant GPC-NS: Alg. 2 with SPARS (Alg. 3) of the thesis.

| thesis | here |
|---|---|
| P, N_p | `policy`, `GPCState.policy` |
| H, N_h | `human`, `GPCState.human` |
| k_p, k_h; c, l, nu | `Kernel`; `variance`, `length_scale`, `smoothness` |
| w (multiplies the inputs) | `scaling`, `human_scaling` |
| r_k, c_r, r_c | `Info.rate`, `constant_rate`, `static_rate` |
| sigma_p, sigma_h | `Info.sigma_policy`, `Info.sigma_human` |
| sigma_thres | half of the policy's prior standard deviation |
"""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from gpcjax.gp.posterior import Posterior, small
from gpcjax.gp.process import Change, GaussianProcess, Reading, nearest
from gpcjax.gp.tiles import Places
from gpcjax.learners.base import Info, Learner, Status
from gpcjax.learners.calls import check_kept
from gpcjax.policies.kernel import KernelController


class GPCState(eqx.Module):
    """One policy and one human model for each action dimension (leading axis)."""

    policy: Posterior
    human: Posterior


class GPCChange(eqx.Module):
    """What a correction changes in one action dimension of a `GPCState`.

    Vectors for GPC, however large the factors are; with normalisation all is new.
    """

    policy: Change
    human: Change


class _Consulted(eqx.Module):
    """What one model has to say of an input, before it learns from it."""

    posterior: Posterior
    """The data, without the matrix."""
    nearest: Int[Array, ""]
    """Row of the point of largest covariance with the input."""
    reading: Reading

    @property
    def sigma(self) -> Float[Array, ""]:
        """Predictive standard deviation."""
        return self.reading.deviation

    @property
    def full(self) -> Bool[Array, ""]:
        return self.posterior.count >= self.posterior.capacity


def _consult(
    process: GaussianProcess, posteriors: Posterior, place: Places, point: Float[Array, " d"]
) -> _Consulted:
    covariances = process.covariances(posteriors, place, point)
    closest = nearest(covariances)
    reading = process.read(posteriors, place, covariances, closest)
    return _Consulted(small(posteriors, place), closest, reading)


class GPC(Learner):
    """GPC, or GPC-NS where both processes normalise.

    Fields:
        policy, human: the Gaussian processes P (Matern) and H (squared exponential). P keeps weights and, to
            sparsify, replaces points; H replaces them where `on_full` is "replace-nearest".
        scaling: (obs_size,), w: what observations are multiplied by; GPC-NS has what it needs of it in its processes.
        constant_rate: c_r, added to the adaptive rate (3.5).
        static_rate: r_c, the whole rate, as in the ablation of Table 5.4; NaN where nobody gave it: then it is (3.5).
        sparsify: use SPARS (Alg. 3); otherwise every correction is appended. Static.
        on_full: one of `ON_FULL`. Static.
        policy_capacity, human_capacity: points for which `init` makes room. Static.
        human_scaling: (obs_size + 1,), what H multiplies observation and action by in GPC; None is w, and 1 for the
            action, as in the thesis.
    """

    policy: GaussianProcess
    human: GaussianProcess
    scaling: Float[Array, " obs"]
    constant_rate: Float[Array, ""]
    static_rate: Float[Array, ""]
    sparsify: bool = eqx.field(static=True)
    on_full: str = eqx.field(static=True)
    policy_capacity: int = eqx.field(static=True)
    human_capacity: int = eqx.field(static=True)
    human_scaling: Float[Array, " pair"] | None = None

    joint: ClassVar[bool] = False

    def grow(self, state: GPCState) -> GPCState:
        """The same state with twice the room."""
        return self.resize(state, 2 * state.policy.points.shape[1], 2 * state.human.points.shape[1])

    def resize(self, state: GPCState, policy_capacity: int, human_capacity: int) -> GPCState:
        """The same state with room for these many points in each policy and each human model."""
        check_kept(state)
        return _resized(self, state, policy_capacity, human_capacity)

    def controller(self, state: GPCState) -> KernelController:
        """The policy of `state`, ready for many steps."""
        check_kept(state)
        kernel = self.policy.kernel
        scale = state.policy.scale * kernel.inverse_length
        return KernelController(
            points=state.policy.points * scale[:, None],
            weights=kernel.variance * state.policy.weights,
            scale=scale,
            smoothness=kernel.smoothness,
        )

    def points(self, state: GPCState) -> tuple[Int[Array, ""], Int[Array, ""]]:
        """Points of P and of H over all action dimensions."""
        check_kept(state)
        return state.policy.count.sum(), state.human.count.sum()

    def has_room(self, state: GPCState, corrections: int = 1) -> Bool[Array, ""]:
        """Whether so many more corrections surely fit into every dictionary."""
        check_kept(state)
        policy = (state.policy.count + (corrections - 1) < state.policy.points.shape[1]).all()
        return policy & (state.human.count + (corrections - 1) < state.human.points.shape[1]).all()

    def largest_sigma(self) -> Float[Array, ""]:
        """The human model's prior deviation: data only lower it."""
        return jnp.sqrt(self.human.prior)

    @property
    def factorises(self) -> bool:
        return self.policy.normalise or self.human.normalise

    @property
    def wants_room(self) -> bool:
        return self.on_full == "error"

    @property
    def goes_on_when_full(self) -> bool:
        return self.on_full == "drop"

    def init(self, key: PRNGKeyArray | None = None) -> GPCState:
        """The idle policy: its action is 0 everywhere. Nothing is drawn."""
        return _untaught(self)

    def _like(self, state):
        policy, human = (each.points.shape[-2] for each in (state.policy, state.human))
        return dataclasses.replace(self, policy_capacity=policy, human_capacity=human).init()

    def _uncertainty(self, states, place, obs, action):
        def one(dimension: Int[Array, ""]) -> Float[Array, ""]:
            return self.human.uncertainty(states.human, (*place, dimension), _pair(obs, action[dimension]))

        # One by one: a batch would be taken apart again where the model normalises (`cholesky.one_at_a_time`).
        return lax.map(one, jnp.arange(self.action_size, dtype=jnp.int32))

    def _write(self, states, place, change):
        return GPCState(
            policy=change.policy.write(states.policy, place),
            human=change.human.write(states.human, place),
        )

    def _correct(self, states, place, obs, action, advice):
        """Alg. 2, lines 7 to 14."""
        pair = _pair(obs, action)
        policy = _consult(self.policy, states.policy, place, obs)
        human = _consult(self.human, states.human, place, pair)
        adaptive = policy.sigma + human.sigma + self.constant_rate  # (3.5)
        rate = jnp.where(jnp.isnan(self.static_rate), adaptive, self.static_rate)
        target = action + rate * advice

        given = advice != 0
        count, threshold = policy.posterior.count, 0.5 * jnp.sqrt(self.policy.kernel.variance)
        replaces = (policy.sigma < threshold) & (count > 0) if self.sparsify else jnp.array(False)
        policy_full = ~replaces & policy.full
        full = given & (policy_full | human.full)
        index, human_index = jnp.where(replaces, policy.nearest, count), human.posterior.count
        refused = full
        if self.on_full == "replace-nearest":
            refused = jnp.array(False)
            replaces = replaces | policy_full
            index = jnp.where(policy_full, policy.nearest, index)
            human_index = jnp.where(human.full, human.nearest, human_index)

        # Both models learn a correction or neither does, and nothing that is no number enters any of them.
        numbers = [obs, action, advice, policy.sigma, human.sigma]
        finite = jnp.stack([jnp.isfinite(number).all() for number in numbers]).all()
        learns = given & finite & ~refused
        change = GPCChange(
            policy=self.policy.put(states.policy, place, policy.reading, obs, target, index, learns),
            human=self.human.put(states.human, place, human.reading, pair, advice, human_index, learns),
        )
        finite &= self._sound(change, policy.posterior, human.posterior) | ~learns
        learns &= finite
        status = jnp.where(finite, jnp.where(refused, Status.FULL, Status.OK), Status.NON_FINITE)
        info = Info(
            rate=jnp.where(learns, rate * jnp.abs(advice), 0.0),
            sigma_policy=policy.sigma,
            sigma_human=human.sigma,
            appended=learns & ~replaces,
            replaced=learns & replaces,
            full=full,
            status=jnp.where(given, status, Status.OK).astype(jnp.int32),
        )
        return GPCChange(policy=change.policy.only(learns), human=change.human.only(learns)), info

    def _sound(self, change: GPCChange, policy: Posterior, human: Posterior) -> Bool[Array, ""]:
        """Whether both models would still be numbers."""
        return self.policy.sound(change.policy, policy.scale) & self.human.sound(change.human, human.scale)


def _pair(obs: Float[Array, " obs"], action: Float[Array, ""]) -> Float[Array, " pair"]:
    """Z = (s, a), the human model's input (3.2)."""
    return jnp.concatenate([obs, action[None]])


# These two are compiled as a whole, as their operations one by one take a second; inline: part of a larger program they
# are what they are without it.


@eqx.filter_jit(inline=True)  # pyright: ignore[reportCallIssue]  (what it takes beyond is for jax.jit)
def _untaught(learner: GPC) -> GPCState:
    pair = learner.human_scaling
    if pair is None:
        pair = jnp.concatenate([learner.scaling, jnp.ones(1)])  # the thesis does not scale the action in GPC
    policy = learner.policy.init(learner.policy_capacity, learner.scaling)
    human = learner.human.init(learner.human_capacity, pair)
    repeat = lambda leaf: jnp.broadcast_to(leaf, (learner.action_size, *leaf.shape))  # noqa: E731
    return GPCState(policy=jax.tree.map(repeat, policy), human=jax.tree.map(repeat, human))


@eqx.filter_jit(inline=True)  # pyright: ignore[reportCallIssue]  (what it takes beyond is for jax.jit)
def _resized(learner: GPC, state: GPCState, policy_capacity: int, human_capacity: int) -> GPCState:
    return GPCState(
        policy=jax.vmap(lambda posterior: learner.policy.grow(posterior, policy_capacity))(state.policy),
        human=jax.vmap(lambda posterior: learner.human.grow(posterior, human_capacity))(state.human),
    )
