"""The settings of jax under which gpcjax computes: imported first by every base module that computes.

float64 is switched on for the whole process (DESIGN: float32 is not enough here). A person may switch it off again at
any time, or ask jax for something else that suits code of their own and breaks or changes ours: an error for any NaN
(COACH's `Info` has NaN where it has no such value), no implicit conversions, products in bfloat16, no compilation. So
what is public runs `under_own_settings`, which hold in this thread until it returns.
"""

import functools
import os
import types
import warnings
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jax._src import config
from jax.core import Tracer


def _is_off(variable: str) -> bool:
    """Whether this variable of the environment says no, as jax reads such ones."""
    return os.environ.get(variable, "").lower() in ("0", "f", "false", "n", "no", "off")


if _is_off("JAX_ENABLE_X64"):
    warnings.warn(
        "JAX_ENABLE_X64 is off, but gpcjax needs float64: it is switched on for all of this process",
        stacklevel=2,
    )
jax.config.update("jax_enable_x64", True)
if _is_off("JAX_CPU_ENABLE_ASYNC_DISPATCH"):  # jax has this setting, and does not look for its variable
    with suppress(AttributeError):
        jax.config.update("jax_cpu_enable_async_dispatch", False)

P = ParamSpec("P")
R = TypeVar("R")

_OWN = (
    (jax.enable_x64, True),
    (jax.debug_nans, False),
    (jax.debug_infs, False),
    (jax.numpy_dtype_promotion, "standard"),
    (jax.default_matmul_precision, None),
    (jax.threefry_partitionable, True),  # what a random key gives
    (jax.transfer_guard_host_to_device, "allow"),
    (jax.transfer_guard_device_to_device, "allow"),
    (jax.transfer_guard_device_to_host, "allow"),
    *(
        (
            getattr(config, name),
            "ignore",
        )  # checks of new kinds of errors know no custom derivatives, no references
        for name in (
            "error_checking_behavior_nan",
            "error_checking_behavior_divide",
            "error_checking_behavior_oob",
        )
        if hasattr(config, name)
    ),
)
"""What is left out changes no number and breaks nothing here, and may be meant for a person's own policy or task."""


def seeded_key(seed: int = 0) -> jax.Array:
    """`jax.random.key(seed)` of a seed below 2**32, whatever jax's own settings of random keys are."""
    return jax.random.wrap_key_data(jnp.array([0, seed], jnp.uint32), impl="threefry2x32")


def under_own_settings(function: Callable[P, R]) -> Callable[P, R]:
    """`function` with our settings of jax, whatever those of the caller are; theirs hold again when it returns.

    A few microseconds where they agree, as they do in most processes. What a person's own `jit` does with results (an
    error for NaN) is theirs.

    Raises:
        ValueError: float64 is off and a jit, vmap or grad of the caller's own is around: it would have rounded the
            arguments, and would finish our part of its program without float64.
    """

    @functools.wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        differ = [(state, ours) for state, ours in _OWN if state.value != ours and state.value is not None]
        compiles = not jax.config.jax_disable_jit  # pyright: ignore[reportAttributeAccessIssue]
        if compiles and not differ:
            return function(*args, **kwargs)
        if not jax.enable_x64.value and any(
            isinstance(leaf, Tracer) for leaf in jax.tree.leaves((args, kwargs))
        ):
            raise ValueError(
                "jax_enable_x64 is off where gpcjax is called inside jit, vmap or grad: "
                'switch it on around them, jax.config.update("jax_enable_x64", True)'
            )
        with ExitStack() as stack:
            if not compiles:
                stack.enter_context(jax.disable_jit(False))
            for state, ours in differ:
                stack.enter_context(state(ours))
            return function(*args, **kwargs)

    return run


def set_public_methods_under_own_settings(cls: type[Any]) -> None:
    """The same for each public method that a class defines, with its call and its constructor."""
    for name, method in tuple(vars(cls).items()):
        public = not name.startswith("_") or name in ("__call__", "__init__")
        abstract = getattr(method, "__isabstractmethod__", False)
        if public and not abstract and isinstance(method, types.FunctionType):
            setattr(cls, name, under_own_settings(method))
