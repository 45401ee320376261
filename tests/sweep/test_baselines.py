"""What an idle policy and an expert come to: measured once, and remembered until something changes."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gpcjax.engine.evaluate import evaluate
from gpcjax.sweep import worker
from gpcjax.sweep.executables import Executables


@pytest.fixture
def measured(monkeypatch):
    """The baselines that are computed, as a list; of starts that nobody looks at."""
    computed = []

    def evaluate(env, *rest):
        computed.append(env.name)
        return SimpleNamespace(returns=np.arange(5.0))

    monkeypatch.setattr(worker, "BASELINE_STARTS", 5)
    monkeypatch.setattr(worker, "evaluate", evaluate)
    return computed


def test_the_second_sweep_measures_nothing_and_has_the_same_numbers(tmp_path, measured, monkeypatch):
    monkeypatch.setattr(
        worker, "evaluate", lambda env, *rest: measured.append(env.name) or evaluate(env, *rest)
    )
    first = {name: worker.baseline("cartpole", name, Executables(tmp_path)) for name in ("idle", "lqr")}
    again = {name: worker.baseline("cartpole", name, Executables(tmp_path)) for name in ("idle", "lqr")}
    assert again == first and first["idle"] != first["lqr"] and len(measured) == 2
    assert first["lqr"] == worker.baseline("cartpole", "lqr") and first["lqr"]["n"] == 5


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"mean": "1"}', "null"])
def test_what_is_no_number_is_measured_again(tmp_path, measured, content):
    first = worker.baseline("pendulum", "idle", Executables(tmp_path))
    (path,) = tmp_path.glob("*.json")
    path.write_text(content)
    assert worker.baseline("pendulum", "idle", Executables(tmp_path)) == first and len(measured) == 2
    assert json.loads(path.read_text()) == first


def test_whatever_it_depends_on_changes_it(tmp_path, measured, monkeypatch):
    kept = Executables(tmp_path)
    worker.baseline("pendulum", "idle", kept)
    monkeypatch.setattr(worker, "BASELINE_STARTS", 6)
    assert worker.baseline("pendulum", "idle", kept)["n"] == 6
    worker.baseline("cartpole", "idle", kept)
    assert len(measured) == 3


def test_nothing_is_remembered_of_somebody_elses_code_and_of_the_host(tmp_path, measured, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "foreign")
    for _ in range(2):
        worker.baseline("drifting:Drift", "idle", Executables(tmp_path))
    assert len(measured) == 2 and not list(tmp_path.iterdir())
    assert worker._key_of(worker.make_env("lunarlander"), "idle") is None
