"""What the import hook of conftest checks annotations with, and which modules of tests have them checked."""

import functools

import jaxtyping
from beartype import BeartypeConf, beartype

check = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""An int will do where a float is wanted, as for the static checker."""

CHECKED = (
    "engine/test_classroom.py",
    "engine/test_host.py",
    "engine/test_identity.py",
    "engine/test_late.py",
    "engine/test_planner.py",
    "engine/test_rollout.py",
    "engine/test_schedule.py",
    "engine/test_session.py",
    "engine/test_streams.py",
    "engine/test_together.py",
    "envs/",
    "gp/test_batches.py",
    "gp/test_factor.py",
    "gp/test_fit.py",
    "gp/test_kernels.py",
    "gp/test_regression.py",
    "learners/test_coach.py",
    "learners/test_dcoach.py",
    "learners/test_factory.py",
    "learners/test_parity.py",
    "learners/test_recipes.py",
    "learners/test_scaling.py",
    "policies/",
    "sweep/test_ppo.py",
    "teachers/",
    "test_elementary.py",
    "test_pickle.py",
    "test_streams.py",
)
"""Modules whose calls are checked; with --all those of each are. A fifth of the time of what is traced goes there, and
nearly every function that is checked is called by one of these.
"""


def check_in(name, everywhere):
    """Calls that the module of tests `name` makes are checked, or not."""
    jaxtyping.config.update("jaxtyping_disable", not (everywhere or name.startswith(CHECKED)))


_jaxtyped = jaxtyping.jaxtyped


def jaxtyped(fn=None, **options):
    """That of jaxtyping, which makes a nested function anew at each call: not where nobody checks it."""
    if fn is None:
        return functools.partial(jaxtyped, **options)
    nested = "<locals>" in getattr(fn, "__qualname__", "")
    return fn if nested and jaxtyping.config.jaxtyping_disable else _jaxtyped(fn, **options)


jaxtyping.jaxtyped = jaxtyped
