"""A module of a person's that remembers, for policies that use it."""

import jax.numpy as jnp

last = None
asked = 0


def smooth(obs):
    """A filter whose last value is the module's."""
    global last, asked
    asked += 1
    last = obs if last is None else 0.9 * last + 0.1 * obs
    return last


class Filter:
    """The same with a value that all of a class have in common."""

    value = jnp.zeros(2)

    @classmethod
    def smooth(cls, obs):
        """A filter whose last value is the class's."""
        cls.value = 0.9 * cls.value + 0.1 * obs
        return cls.value


class Inner:
    """A class within a class."""

    Filter = Filter


def by_name(obs):
    """It changes the class by its name."""
    Filter.value = 0.9 * Filter.value + 0.1 * obs
    return Filter.value
