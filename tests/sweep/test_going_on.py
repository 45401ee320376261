"""Real sweeps that begin with what another one had learned."""

import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import gpcjax
from gpcjax import cli
from gpcjax.errors import UserError
from gpcjax.sweep.executors import InProcess
from gpcjax.sweep.layout import CHECKPOINTS
from gpcjax.sweep.listing import commands
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.sweep.sources import _group, _places, contents_of
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.startable import check_start
from tests.sweep.test_start import SETTINGS
from tests.sweep.test_underway import assert_same, killed_under_way


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return sweep(tmp_path_factory.mktemp("source") / "out", executor=InProcess(), keep="states", **SETTINGS)


def test_a_sweep_goes_on_from_another_one(source, tmp_path):
    out = sweep(tmp_path / "out", executor=InProcess(), keep="states", start=source, **SETTINGS)
    learned = gpcjax.load_states(source)
    assert learned["episode"].tolist() == [2, 2]
    rows = read_episodes(out)
    # A run of four episodes is no run of two and two: streams begin anew. But what was learned stands the test.
    first = rows[rows["episode"] == 1]["return"].to_numpy()
    assert (first > read_episodes(source).query("episode == 1")["return"].to_numpy()).all()
    (line,) = commands(read_manifest(out), out)
    assert f"--start {source}" in line
    # The same again is the same, from a copy too; from what has changed it is not.
    copy = shutil.copytree(source, tmp_path / "copy")
    sweep(out, executor=InProcess(), keep="states", start=copy, **SETTINGS)
    for settings, line in (
        ({}, "not as usual"),
        ({"start": out}, r"start 'out \(\w{12}\)', not 'out \(\w{12}\)'"),
    ):
        with pytest.raises(UserError, match=line):
            sweep(out, executor=InProcess(), **SETTINGS, **settings)


def test_a_saved_learner_is_where_every_run_begins(source, tmp_path):
    learner, learned = gpcjax.load_states(source, seed=1).loc[0, ["learner", "state"]]
    gpcjax.save_learner(tmp_path / "saved", learner, learned)
    silent = {**SETTINGS, "rate": 0.0, "seeds": [4, 5]}
    out = sweep(tmp_path / "out", executor=InProcess(), keep="states", start=tmp_path / "saved", **silent)
    for state in gpcjax.load_states(out)["state"]:
        np.testing.assert_array_equal(state.policy, learned.policy)
    with pytest.raises(
        UserError, match="learned with 4 numbers of an observation and 1 actions, pendulum has 3"
    ):
        check_start(spec_of(env="pendulum", algo="coach", seeds=1, start=tmp_path / "saved"))


def test_states_that_have_changed_since_are_refused(source, tmp_path):
    copy = shutil.copytree(source, tmp_path / "copy")
    contents = contents_of(copy, "start")
    (one, *_) = plan(spec_of(**SETTINGS))
    state = contents.of(one)
    assert contents.packed(state)[0] and contents.arrays(state)["state.policy"].any()
    part = copy / "kept" / state.place.part
    data, table = part.read_bytes(), pq.read_table(part)
    others = pa.array([bytes(len(each.as_py())) for each in table["arrays"]], pa.large_binary())
    pq.write_table(table.set_column(table.column_names.index("arrays"), "arrays", others), part)
    for now in (part.read_bytes(), data[: len(data) // 2], b""):
        part.write_bytes(now)
        _places.cache_clear()
        _group.cache_clear()
        with pytest.raises(UserError, match="it has changed since the sweep was asked for"):
            contents.packed(state)


@pytest.mark.slow
def test_a_learner_of_ones_own_goes_on_too(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "foreign")
    names = {"env": "drifting:Drift", "algo": "drifting:Linear", "oracle": "drifting:expert"}
    settings = {**names, "seeds": 2, "episodes": 2, "executor": InProcess(), "rate": 0.5}
    first = sweep(tmp_path / "first", keep="states", step_size=[0.2, 0.5], **settings)
    frame = gpcjax.load_states(first)
    assert len(frame) == 4 and (frame["state"].map(lambda state: np.abs(state).max()) > 0).all()
    assert [float(learner.step_size) for learner in frame["learner"]] == frame["step_size"].tolist()
    # Nobody teaches: it does what it had learned.
    silent = settings | {"rate": 0.0, "step_size": 0.5}
    second = sweep(tmp_path / "second", keep="policies", start=first, **silent)
    policies = gpcjax.load_policies(second)["policy"]
    learned = frame.loc[frame["step_size"] == 0.5, "state"]
    for policy, state in zip(policies, learned, strict=True):
        np.testing.assert_allclose(
            policy([0.1, 0.0]), np.clip(np.asarray(state) @ [0.1, 0.0], -1, 1), rtol=1e-12
        )


@pytest.mark.slow
def test_one_that_was_killed_goes_on_to_the_same_bits(source, tmp_path):
    settings = SETTINGS | {"episodes": 12, "keep": "states", "start": str(source)}
    reference = sweep(tmp_path / "reference", executor=InProcess(), checkpoint=0, **settings)
    out = killed_under_way(tmp_path, settings)
    assert list((out / CHECKPOINTS).iterdir()) and not list((out / "episodes").iterdir())
    before = read_manifest(out)["env_steps"]
    sweep(out, executor=InProcess(), checkpoint=0, **settings)
    assert_same(out, reference)
    assert 0 < read_manifest(out)["env_steps"] - before < read_episodes(out)["length"].sum()


def test_mistakes_are_a_line(source, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    words = ["sweep", "--env", "cartpole", "--algo", "coach", "--out", "out"]
    for folder, more, line in (
        ("empty", (), "nothing to begin with is there, give a run folder with kept states (--keep states)"),
        (str(source), ("--seeds", "3"), "nothing that coach learned with seed 2, give --seeds among those"),
    ):
        assert cli.main([*words, "--start", folder, *more]) == 2
        said = capsys.readouterr().err
        assert said.startswith("gpcjax: error: --start ") and line in said and said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]
