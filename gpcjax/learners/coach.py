"""COACH, the baseline: linear policies on normalised radial basis functions, Alg. 1 of the thesis.

| thesis | here |
|---|---|
| theta, psi | `COACHState.policy`, `COACHState.human` |
| phi | `features` |
| beta (Table A.1 prints it as alpha) | `beta` |
| e | `magnitude` |
| c_c | `constant` |
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from gpcjax.learners.base import Info, Learner, Status
from gpcjax.learners.calls import check_kept
from gpcjax.policies.grid import Grid, GridController


class COACHState(eqx.Module):
    """Weights of both models, one grid for each action dimension (leading axis)."""

    policy: Float[Array, "action *grid"]
    human: Float[Array, "action *grid"]


class COACH(Learner):
    """COACH of Celemin and Ruiz-del-Solar.

    Fields:
        grid: centres of the radial basis functions.
        beta: (action_size,), learning rate of the human model.
        magnitude: (action_size,), e, the assumed error of the action.
        constant: (action_size,), c_c, added to |H(s)|.
    """

    grid: Grid
    beta: Float[Array, " action"]
    magnitude: Float[Array, " action"]
    constant: Float[Array, " action"]

    joint: ClassVar[bool] = False

    def controller(self, state: COACHState) -> GridController:
        """The policy of `state`."""
        check_kept(state)
        return GridController(weights=state.policy, grid=self.grid)

    def init(self, key: PRNGKeyArray | None = None) -> COACHState:
        """The idle policy: its action is 0 everywhere. Nothing is drawn."""
        shape = (self.action_size, *self.grid.counts)
        return COACHState(policy=jnp.zeros(shape), human=jnp.zeros(shape))

    def _write(self, states, place, change):
        return jax.tree.map(lambda leaf, value: leaf.at[place].set(value), states, change)

    def _correct(self, states, place, obs, action, advice):
        state, dimension = jax.tree.map(lambda leaf: leaf[place], states), place[-1]
        beta, magnitude, constant = (
            jnp.take(values, dimension) for values in (self.beta, self.magnitude, self.constant)
        )
        features = self.grid.features(obs)
        given = advice != 0

        estimate = (state.human * features).sum()  # line 7, before the update of psi
        alpha = jnp.abs(estimate) + constant  # line 10
        rate = alpha * magnitude * (features * features).sum()
        # A part of an advice, where credit goes to several steps, is a step of that part towards all of it.
        human_step = beta * jnp.abs(advice) * (jnp.sign(advice) - estimate)  # line 8
        policy_step = alpha * advice * magnitude  # line 11
        policy, human = state.policy + policy_step * features, state.human + human_step * features
        finite = jnp.isfinite(rate) & jnp.isfinite(action)
        finite &= jnp.isfinite(policy).all() & jnp.isfinite(human).all()
        learns = given & finite
        state = COACHState(
            policy=jnp.where(learns, policy, state.policy), human=jnp.where(learns, human, state.human)
        )
        none = jnp.zeros((), bool)
        info = Info(
            rate=jnp.where(learns, rate * jnp.abs(advice), 0.0),
            sigma_policy=jnp.array(jnp.nan),
            sigma_human=jnp.array(jnp.nan),
            appended=none,
            replaced=none,
            full=none,
            status=jnp.where(finite | ~given, Status.OK, Status.NON_FINITE).astype(jnp.int32),
        )
        return state, info
