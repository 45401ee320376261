"""Every test runs with all checks on: shapes and types at run time, random keys used once, no silent broadcasting."""

import os

# One thread, as in a sweep's workers: jaxlib's batched Cholesky can wait for ever on an XLA pool of several threads, and
# OpenBLAS's threads wait for each other so long on a busy machine that one factor of 128 points takes a tenth of a second.
for name in ("NPROC", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import hypothesis
import jax
from jaxtyping import install_import_hook

import tests.typechecker  # noqa: F401  (the hook finds it by name)

install_import_hook("gpcjax", "tests.typechecker.check")

jax.config.update("jax_debug_key_reuse", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

# The same examples in every run: what is covered is no matter of luck.
hypothesis.settings.register_profile("gpcjax", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("gpcjax")
