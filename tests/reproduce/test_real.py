"""A very small reproduction that computes: from the command line to the report."""

import numpy as np
import pandas as pd
import pytest

from gpcjax import cli
from gpcjax.sweep.executors import processes
from gpcjax.sweep.reading import read_episodes
from tests.reproduce.test_run import files

SETTINGS = """
env = "pendulum"
seeds = 50
error = [0, 0.2]

[quick]
seeds = 2
episodes = 2
"""


@pytest.mark.slow
def test_two_seeds_of_two_episodes_on_the_pendulum(tmp_path, monkeypatch):
    """A second call computes nothing."""
    sweeps = tmp_path / "sweeps"
    sweeps.mkdir()
    (sweeps / "fig5_1_pendulum.toml").write_text(SETTINGS)
    words = f"reproduce --quick --only pendulum --sweeps {sweeps} --out {tmp_path / 'out'} --jobs 1".split()
    assert cli.main(words) == 0
    out = tmp_path / "out"
    frame = read_episodes(out / "fig5_1_pendulum")
    assert len(frame) == 3 * 2 * 2 * 2 and set(frame["length"]) == {200}
    claims = pd.read_csv(out / "claims.csv")
    assert set(claims["part"]) == {"pendulum"} and claims["n"].max() == 2
    order = claims[claims["claim"].str.startswith("GPC outperforms COACH")]
    table = frame.pivot_table("return", ["error", "seed"], "algo")
    expected = (table["gpc"] - table["coach"]).groupby("error").mean()
    np.testing.assert_allclose(order["estimate"], expected, rtol=1e-12)
    assert (out / "figures" / "fig5_1_returns.png").stat().st_size > 10_000
    monkeypatch.setattr(processes, "_start", None)
    before = files(out)
    assert cli.main(words) == 0
    assert files(out) == before
