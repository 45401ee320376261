"""What several modules of real sweeps share."""

import functools

import pytest


@pytest.fixture(scope="module")
def sweeps_here(settings_of_jax, tmp_path_factory):
    """Sweeps that this module runs in its own process measure and trace the same things once.

    Programs are kept for this module alone, as they are compiled here: quickly, which no worker does.
    """
    from gpcjax.sweep import executables, worker

    folder = tmp_path_factory.mktemp("programs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "baseline", functools.cache(worker.baseline))
        patch.setattr(worker, "programs_folder", lambda: folder)
        patch.setattr(executables, "_IN_A_HURRY", "jax_disable_jit")
        yield
