"""Whether what gpcjax computes with is installed: the Makefile has a command checked before it sets that up."""

import importlib.util
import sys


def is_set_up() -> bool:
    """Whether jax is there, without which nothing computes."""
    return "jax" in sys.modules or importlib.util.find_spec("jax") is not None


def require_set_up() -> None:
    """Raises ModuleNotFoundError where jax is missing: whatever else is missing may come with it."""
    if not is_set_up():
        raise ModuleNotFoundError("No module named 'jax'", name="jax")
