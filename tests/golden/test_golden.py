"""A sample of `python -m tests.golden check`."""

import pandas as pd
import pytest

from tests.golden import CASES, ROWS, check, incomparable


def test_every_case_is_kept():
    tables = {f"{case}-{table}" for case in CASES for table in ("episodes", "corrections")}
    assert {path.stem for path in ROWS.glob("*.parquet")} == tables


@pytest.mark.parametrize("case", ["cartpole", "pendulum", "lander"])
def test_every_learner_is_kept_on_every_task(case):
    rows = pd.read_parquet(ROWS / f"{case}-episodes.parquet")
    assert rows["algo"].unique().tolist() == ["gpc", "gpc-ns", "coach"]


@pytest.mark.slow
@pytest.mark.parametrize(("case", "fewer"), [("full", {"algo": "gpc", "seeds": 2}), ("schedule", {})])
def test_rows_keep_their_bits(tmp_path, case, fewer):
    """As those of `swept` do, in tests/sweep/test_sweeps.py, of which `full` has another teacher and capacity."""
    different = list(check(case, tmp_path, jobs=1, **fewer))
    if other := incomparable(tmp_path / case):
        pytest.skip(f"the kept rows were made with another {other}")
    assert not different
