"""What several modules of real sweeps share."""

import functools

import pytest


@pytest.fixture(scope="module")
def baselines_once():
    """What runs are compared with is measured once for this module: each sweep that runs here would trace it anew."""
    from gpcjax.sweep import worker

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "baseline", functools.cache(worker.baseline))
        yield
