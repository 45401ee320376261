"""Every test runs with all checks on: shapes and types at run time, random keys used once, no silent broadcasting."""

import ctypes
import gc
import os
import signal
import warnings

import hypothesis
import jax
import pytest
import threadpoolctl
from jaxtyping import install_import_hook

import tests.typechecker  # noqa: F401  (the hook finds it by name)

install_import_hook("gpcjax", "tests.typechecker.check")

# A shell's background job ignores Ctrl-C, and nohup a lost connection; so would all that the tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# The types of this extension warn while it is loaded, which crashes the process where warnings are errors.
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import Box2D  # noqa: F401

# Matrices of tests are small: a second thread of BLAS waits more than it computes.
threadpoolctl.threadpool_limits(1, "blas")

jax.config.update("jax_debug_key_reuse", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

# The same examples in every run: what is covered is no matter of luck.
hypothesis.settings.register_profile("gpcjax", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("gpcjax")


LONGEST = (
    "test_extending.py",
    "sweep/test_sweeps.py",
    "engine/test_rollout.py",
    "reproduce/test_real.py",
    "test_settings.py",
    "sweep/test_lander.py",
    "reproduce/test_illustrations.py",
    "engine/test_pool.py",
    "engine/test_host_pool.py",
    "learners/test_gpc.py",
    "learners/test_parity.py",
    "gp/test_factor.py",
    "reproduce/test_run.py",
    "test_readme.py",
)
"""Modules that begin first: one that came last would keep one process at work while the others have nothing to do."""


def pytest_collection_modifyitems(items):
    places = {f"tests/{name}": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.nodeid.partition("::")[0], len(LONGEST)))


@pytest.fixture(scope="session", autouse=True)
def compiled_programs(tmp_path_factory):
    """What is compiled is kept for this run of the tests, and none of an earlier one is used.

    By the workers of real sweeps, and by the tests themselves: most modules need the same small programs.
    """
    shared = tmp_path_factory.getbasetemp()
    shared = str((shared.parent if "PYTEST_XDIST_WORKER" in os.environ else shared) / "xla")
    jax.config.update("jax_compilation_cache_dir", shared)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAX_COMPILATION_CACHE_DIR", shared)
        yield


@pytest.fixture(scope="module", autouse=True)
def compiled_programs_are_freed():
    """After each module: they hold gigabytes otherwise, and no module uses another's."""
    yield
    jax.clear_caches()
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc alone has it
    if trim is not None:
        trim(0)
