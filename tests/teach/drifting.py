"""A task that takes no time: a cart on a slope, a teacher who pushes it back, and a learner of one's own."""

import jax
import jax.numpy as jnp

import gpcjax


class Drift(gpcjax.Env):
    obs_size, action_size, max_steps, time_step = 2, 1, 12, 0.01

    def reset(self, key):
        return self.begin(jax.random.uniform(key, (2,), minval=-0.5, maxval=0.5))

    def step(self, state, action):
        place, velocity = state.physics
        velocity += 0.1 * (place + 2.0 * jnp.clip(action[0], -1.0, 1.0))
        return self.advance(state, jnp.stack([place + 0.1 * velocity, velocity]), reward=1.0 - place**2)

    def render(self, state):
        return jnp.broadcast_to(jnp.clip(state.physics[0], 0.0, 1.0), (4, 6, 3))


class Far(Drift):
    """The same, and further away at each step: soon beyond what policies take."""

    def step(self, state, action):
        return self.advance(state, state.physics * 1e25, reward=1.0)


def expert(obs):
    return -jnp.clip(obs[:1] + 0.6 * obs[1:], -1.0, 1.0)


class Linear(gpcjax.Learner):
    """A linear policy, moved along the observation by each advice."""

    def init(self, key=None):
        return jnp.zeros((self.action_size, self.obs_size))

    def propose(self, state, obs):
        return state @ obs

    def learn(self, state, moment, advice, key):
        change = 0.5 * jnp.outer(advice, moment.obs)
        return state + change, gpcjax.Info.of(rate=jnp.abs(change @ moment.obs))


class Turned(Linear):
    """The same with a number, which is a setting, and a word, which is none."""

    reach: float = 1.0
    way: str = "forth"

    def propose(self, state, obs):
        return self.reach * state @ obs * (1.0 if self.way == "forth" else -1.0)


class Growing(Turned):
    """The same, and it keeps what it saw, with room that grows."""

    def init(self, key=None):
        return {"weights": super().init(), "seen": jnp.zeros((4, self.obs_size))}

    def propose(self, state, obs):
        return super().propose(state["weights"], obs)

    def learn(self, state, moment, advice, key):
        weights, info = super().learn(state["weights"], moment, advice, key)
        return {"weights": weights, "seen": jnp.roll(state["seen"], 1, 0).at[0].set(moment.obs)}, info

    def grow(self, state):
        return {**state, "seen": jnp.concatenate([state["seen"], jnp.zeros_like(state["seen"])])}
