from pathlib import Path

import pytest

from gpcjax.report.groups import gather
from gpcjax.report.summary import Summary, summarise
from tests.report import synthetic


@pytest.fixture(scope="session")
def cartpole() -> Summary:
    """Three algorithms, three error rates, twelve seeds."""
    frame = synthetic.episodes()
    return summarise(gather(frame, synthetic.manifest(frame)))


@pytest.fixture(scope="session")
def grid() -> Summary:
    """Two length-scales for GPC and GPC-NS beside COACH."""
    points = synthetic.length_scale_grid()
    frame = synthetic.episodes(points=points, errors=(0.0, 0.2), seeds=6, length=12)
    return summarise(gather(frame, synthetic.manifest(frame, varying=list(points["gpc"][0]))))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path
