"""A stranger's module: a task, two experts, a learner and a teacher, none of which gpcjax knows."""

import equinox as eqx
import jax
import jax.numpy as jnp

import gpcjax


class Drift(gpcjax.Env):
    """A point on a line that runs away from zero: push it back."""

    obs_size = 2
    action_size = 1
    max_steps = 40
    speed: jax.Array = eqx.field(default=0.05, converter=gpcjax.parameter)

    def reset(self, key):
        return self.begin(jnp.stack([jax.random.uniform(key, minval=-0.5, maxval=0.5), 0.0]))

    def step(self, state, action):
        place = state.obs[0] * (1 + self.speed) + 0.1 * jnp.clip(action[0], -1.0, 1.0)
        obs = jnp.stack([place, place - state.obs[0]])
        return self.advance(state, obs, reward=-jnp.abs(place), terminated=jnp.abs(place) > 1.0)


def expert(obs):
    """Pushes back in proportion."""
    return jnp.clip(-3.0 * obs[:1], -1.0, 1.0)


DRIFT = gpcjax.TaskSpec(
    name="drifting:DRIFT",
    make=Drift,
    experts={"own": "drifting:expert"},
    label="Drifting",
    unit="metres, negative",
    actions=("push",),
    sizes=(2, 1),
    presets={"coach": {"lower": -1.0, "upper": 1.0, "counts": (5, 5)}},
)


SMALL = gpcjax.TaskSpec(name="drifting:SMALL", make=Drift, max_capacity=256)
"""Without an expert, and with a bound of its own."""


class Homeward(gpcjax.Teacher):
    """Knows without an expert that it is to go back."""

    def may_advise(self, coins, largest_sigma, step):
        return coins < 0.3

    def advise(self, coins, moment):
        return jnp.where(coins < 0.3, -jnp.sign(moment.obs[:1]), 0.0)


HOMEWARD = gpcjax.TeacherSpec(name="drifting:HOMEWARD", make=Homeward, needs_expert=False)


class Linear(gpcjax.Learner):
    """A linear policy, moved along the observation by each advice."""

    step_size: jax.Array = eqx.field(default=0.5, converter=gpcjax.parameter)

    def init(self, key=None):
        return jnp.zeros((self.action_size, self.obs_size))

    def propose(self, state, obs):
        return state @ obs

    def learn(self, state, moment, advice, key):
        change = self.step_size * jnp.outer(advice, moment.obs)
        return state + change, gpcjax.Info.of(rate=jnp.abs(change @ moment.obs))

    def measure(self, state):
        return {"weight": jnp.abs(state).max()}


LINEAR = gpcjax.LearnerSpec(name="linear", make=Linear, label="A line")


class Drawing(Linear):
    """Keeps a random key, which is no array of numbers."""

    def init(self, key=None):
        return {"weights": super().init(), "key": jax.random.key(0)}


class Loud(gpcjax.Teacher):
    """Says more than "more"."""

    loudness: jax.Array = eqx.field(default=2.0, converter=gpcjax.parameter)

    def may_advise(self, coins, largest_sigma, step):
        return coins < 0.5

    def advise(self, coins, moment):
        return jnp.broadcast_to(self.loudness, coins.shape)
