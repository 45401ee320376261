"""Tasks and learners of a person's own that fail on the way, where an episode begins on the right."""

import equinox as eqx
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np

from tests.teach.drifting import Drift, Linear


class Odd(Drift):
    """At its fifth step the reward is no number; its picture fails."""

    def reset(self, key):
        state = super().reset(key)
        return self.begin((state.physics, state.physics[0] > 0), state.obs)

    def step(self, state, action):
        place, right = state.physics
        after = super().step(eqx.tree_at(lambda state: state.physics, state, place), action)
        wrong = right & (after.time == 5)
        return self.advance(
            state, (after.physics, right), after.obs, reward=jnp.where(wrong, jnp.nan, after.reward)
        )

    def render(self, state):
        raise RuntimeError("no paint")


class Unseen(Odd):
    """At its fifth step the observation is no number."""

    def step(self, state, action):
        after = super().step(state, action)
        wrong = jnp.isnan(after.reward)
        return self.advance(state, after.physics, jnp.where(wrong, jnp.inf, after.obs), reward=1.0)


class Endless(Odd):
    """From its fourth step on the rewards are numbers, and their sum is none."""

    def step(self, state, action):
        after = super().step(state, action)
        large = after.physics[1] & (after.time > 3)
        return self.advance(state, after.physics, after.obs, reward=jnp.where(large, 1e308, 1.0))


class Broken(gymnasium.Env):
    """A simulation on the host whose fifth step fails, half done; its picture fails, too."""

    observation_space = gymnasium.spaces.Box(-10.0, 10.0, (2,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    fails_at = 5
    metadata = {"render_modes": ["rgb_array"], "render_fps": 100}  # noqa: RUF012

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.time = self.np_random.uniform(-0.5, 0.5), 0
        self.right = self.place > 0
        return self._seen(), {}

    def step(self, action):
        self.time, self.place = self.time + 1, self.place + 0.1 * float(action[0])
        if self.time == self.fails_at and self.right:
            raise RuntimeError("a wheel came off")
        return self._seen(), 1.0 - self.place**2, False, self.time == 12, {}

    def render(self):
        raise RuntimeError("no paint")

    def _seen(self):
        return np.array([self.place, self.time / 12])


class Diverging(Linear):
    """Once it has learned something, its policy comes to no number."""

    def propose(self, state, obs):
        return jnp.where((state == 0).all(), state @ obs, jnp.nan)


class Refusing(Linear):
    """Refuses, while it computes, to learn less."""

    def learn(self, state, moment, advice, key):
        def check(advice):
            if advice[0] < 0:
                raise RuntimeError("I will not")
            return advice

        advice = jax.pure_callback(check, jax.ShapeDtypeStruct(advice.shape, advice.dtype), advice)
        return super().learn(state, moment, advice, key)


class Shapeless(Linear):
    """Proposes what is no action."""

    def propose(self, state, obs):
        return jnp.zeros(7)


def expert(obs):
    """Fails once it is more than looked at."""

    def check(obs):
        raise RuntimeError("I do not know")

    return jax.pure_callback(check, jax.ShapeDtypeStruct((1,), obs.dtype), obs)
