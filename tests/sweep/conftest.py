"""What several modules of real sweeps share."""

import functools

import jax
import pytest


@pytest.fixture(scope="module")
def sweeps_here(settings_of_jax, tmp_path_factory):
    """Sweeps that this module runs in its own process measure and trace the same things once.

    Where programs are compiled quickly, which no worker does, they are kept for this module alone.
    """
    from gpcjax.sweep import executables, worker

    with pytest.MonkeyPatch.context() as patch:
        measured = functools.cache(worker.baseline)
        patch.setattr(worker, "baseline", lambda env, name, kept: measured(env, name))
        if jax.config.values["jax_disable_most_optimizations"]:
            folder = tmp_path_factory.mktemp("programs")
            patch.setattr(worker, "programs_folder", lambda: folder)
            patch.setattr(executables, "_IN_A_HURRY", "jax_disable_jit")
        yield
