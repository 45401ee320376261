"""A policy as a function of one observation: in numpy where its kind is known, in jax wherever jax is asked for.

It loads no jax until then: a robot's program that only acts starts in a fraction of the time.
"""

from typing import Any

from gpcjax.policies.later import jax_is_coming
from gpcjax.policies.plain import Plain
from gpcjax.policies.vectors import Vector, is_jax, vector

Controller = Any
"""A `gpcjax.policies.base.Controller`, which would load jax."""

_UNKNOWN = object()


class Policy:
    """A controller as a function of the observation, (obs_size,) -> (action_size,) in [-1, 1].

    The observation may be a list, a numpy or a jax array. Called with what is jax's, or that jax traces, it is part of
    jax: it may be used inside jit, vmap, grad and scan, and is a pytree whose leaves are those of `controller`. Called
    with anything else, the built-in kinds (Gaussian processes, grids, networks) compute in numpy and give an array of
    numpy's, the same to 1e-12 where the observation is within thousands of length-scales of zero; a controller of
    one's own compiles itself.

    Raises:
        ValueError: an observation of another shape, or one that holds no real numbers.
    """

    __slots__ = ("__weakref__", "_controller", "_plain")

    def __init__(self, controller: Controller):
        self._controller: Any = controller
        self._plain: Any = _UNKNOWN

    @classmethod
    def of(cls, plain: Plain) -> "Policy":
        """The same policy in jax is made of `plain` when it is first asked for."""
        return cls._with(None, plain)

    @classmethod
    def _with(cls, controller: Controller | None, plain: Plain | None) -> "Policy":
        jax_is_coming()
        policy = cls(controller)
        if plain is not None:
            policy._plain = plain
        return policy

    @property
    def controller(self) -> Controller:
        """The `Controller` that acts; its leaves are arrays of jax's."""
        if self._controller is None:
            from gpcjax.policies.counterparts import controller_of

            self._controller = controller_of(self._plain)
        return self._controller

    @property
    def plain(self) -> Plain | None:
        """The same in numpy; None for a controller of one's own, or one whose numbers jax traces."""
        if self._plain is _UNKNOWN:
            from gpcjax.policies.counterparts import plain_of

            self._plain = plain_of(self._controller)
        return self._plain

    def __call__(self, obs: Vector) -> Any:
        """The action at `obs`: jax's if that is, otherwise an array of numpy's where the kind is a built-in one."""
        if not is_jax(obs) and not (isinstance(obs, list | tuple) and any(map(is_jax, obs))):
            plain = self.plain
            if plain is not None:
                return plain.act(vector("obs", obs, plain.obs_size, "this policy"))
        from gpcjax.policies.base import acted

        return acted(self.controller, obs)

    def __reduce__(self) -> tuple[Any, ...]:
        plain = self._plain if isinstance(self._plain, Plain) else None
        return Policy._with, (self._controller, plain)

    def __repr__(self) -> str:
        acting = self._plain if self._controller is None else self._controller
        return f"Policy({type(acting).__name__})"
