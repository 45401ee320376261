"""Every test runs with all checks on: shapes and types at run time, random keys used once, no silent broadcasting."""

import ctypes
import gc
import os
import signal
import warnings

import hypothesis
import jax
import pytest
from jaxtyping import install_import_hook

import tests.typechecker  # noqa: F401  (the hook finds it by name)

install_import_hook("gpcjax", "tests.typechecker.check")

# A shell's background job ignores Ctrl-C, and so would all that the tests start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The types of this extension warn while it is loaded, which crashes the process where warnings are errors.
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import Box2D  # noqa: F401

jax.config.update("jax_debug_key_reuse", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

# The same examples in every run: what is covered is no matter of luck.
hypothesis.settings.register_profile("gpcjax", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("gpcjax")


@pytest.fixture(scope="session", autouse=True)
def compiled_programs(tmp_path_factory):
    """What the workers of real sweeps compile is kept for this run of the tests, and none of an earlier one is used."""
    shared = tmp_path_factory.getbasetemp()
    shared = shared.parent if "PYTEST_XDIST_WORKER" in os.environ else shared
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAX_COMPILATION_CACHE_DIR", str(shared / "xla"))
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
