"""Sweeps whose runs begin with what was learned elsewhere."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import gpcjax
from gpcjax import cli
from gpcjax.errors import UserError
from gpcjax.sweep import sealing, worker
from gpcjax.sweep.checkpoints import cell_as_json, cell_of
from gpcjax.sweep.executors import InProcess
from gpcjax.sweep.growth import contradictions
from gpcjax.sweep.kept import kept_rows
from gpcjax.sweep.layout import CHECKPOINTS, tell
from gpcjax.sweep.listing import commands
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.plan import hash_of, plan, program_of
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.sweep.source import Source
from gpcjax.sweep.sources import Contents, State, _group, _places, contents_of
from gpcjax.sweep.spec import as_dict, from_dict, spec_of
from gpcjax.sweep.startable import check_start
from gpcjax.sweep.store import Store
from tests.sweep.folders import begun
from tests.sweep.pretended import rows
from tests.sweep.test_underway import assert_same, killed_under_way

pytestmark = pytest.mark.usefixtures("sweeps_here")

SETTINGS = {"env": "cartpole", "algo": "coach", "oracle": "lqr", "rate": 0.2, "seeds": 2, "episodes": 2}
SOURCE = Source("/somewhere/x", "0123456789ab")


def state(algo="gpc", seed=0, oracle="lqr", error=0.0, **varying):
    card = {"algo": algo, "obs_size": 4, "action_size": 1}
    values = {"algo": algo, "seed": seed, "oracle": oracle, "error": error, **varying}
    return State(values, card)


def cell(**settings):
    (one,) = plan(spec_of(**{"env": "cartpole", "algo": "gpc", "oracle": "lqr", "seeds": [0]} | settings))
    return one


def found(states, **settings):
    return Contents(Path("/x"), states, "").of(cell(**settings)).values


def test_a_run_takes_the_state_of_its_learner_and_seed():
    states = [state(algo, seed) for algo in ("gpc", "gpc-ns", "coach") for seed in (0, 1)]
    assert found(states, seeds=[1]) == states[1].values
    assert found(states, algo="gpc-ns") == states[2].values
    assert found(states[2:], algo="gpc") == states[2].values, "its relative"
    saved = State({}, state("gpc").card)
    assert Contents(Path("/x"), [saved], "").of(cell(seeds=[7])) is saved


def test_of_several_it_takes_the_one_with_its_own_settings():
    several = [state(error=error, policy_length_scale=scale) for error in (0.0, 0.2) for scale in (0.1, 0.4)]
    got = found(several, error=0.2, policy_length_scale=0.4)
    assert (got["error"], got["policy_length_scale"]) == (0.2, 0.4)
    # What has one value there need not be the run's own: a second teacher, another setting.
    assert found([state(oracle="gpc", error=0.3, policy_length_scale=9.0)], error=0.1)["error"] == 0.3


@pytest.mark.parametrize(
    ("states", "settings", "line"),
    [
        (
            [state("coach")],
            {},
            "/x: it holds what coach learned, which means nothing to gpc: give --algo coach",
        ),
        ([state()], {"algo": "d-coach"}, "means nothing to d-coach: give --algo gpc"),
        ([state(seed=3)], {}, "nothing that gpc learned with seed 0, give --seeds among those it has (3)"),
        (
            [state(error=0.0), state(error=0.2)],
            {"error": 0.1},
            "with error 0.0, 0.2, and these runs have 0.1 error",
        ),
    ],
)
def test_what_does_not_name_one_is_refused(states, settings, line):
    with pytest.raises(UserError, match="start") as refused:
        found(states, **settings)
    assert line in str(refused.value)


def test_it_is_part_of_what_rows_depend_on_wherever_it_lies():
    plain = spec_of(env="cartpole", algo="gpc")
    begun = dataclasses.replace(plain, start=SOURCE)
    moved = dataclasses.replace(plain, start=Source("/elsewhere", SOURCE.digest))
    changed = dataclasses.replace(plain, start=Source(SOURCE.folder, "ba9876543210"))
    assert "start" not in as_dict(plain)
    assert len({hash_of(as_dict(spec)) for spec in (plain, begun, moved, changed)}) == 3
    assert hash_of(as_dict(begun)) == hash_of(as_dict(moved)) and from_dict(as_dict(begun)) == begun
    told = contradictions(as_dict(begun), as_dict(changed))
    assert told == ["start 'x (0123456789ab)', not 'x (ba9876543210)'"]
    assert contradictions(as_dict(begun), as_dict(plain)) == ["start 'x (0123456789ab)', not as usual"]
    first = plan(begun)[0]
    assert first != plan(plain)[0] and program_of(first) == program_of(plan(plain)[0])
    for each in (first, plan(plain)[0]):
        assert cell_of(json.loads(json.dumps(cell_as_json(each)))) == each


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


def test_coach_on_another_grid_and_what_is_too_large_are_refused_before_anything_runs(tmp_path):
    sizes = {"obs_size": 4, "action_size": 1}
    coach = gpcjax.make_learner("coach", **sizes, lower=[-1] * 4, upper=[1] * 4, counts=[4, 4, 4, 4])
    gpcjax.save_learner(tmp_path / "coach", coach, coach.init())
    with pytest.raises(UserError, match=r"on another grid \(lower -1, -1, -1, -1\) than that of cartpole"):
        check_start(spec_of(env="cartpole", algo="coach", seeds=1, start=tmp_path / "coach"))
    learner = gpcjax.make_learner("gpc", "cartpole", sparsify=False)
    state = learner.init()
    for place in (-0.2, 0.0, 0.2):
        state, _ = learner.correct(state, obs=[0.0, 0.0, place, 0.0], action=[0.0], advice=[1])
    gpcjax.save_learner(tmp_path / "gpc", learner, state)
    settings = {"env": "cartpole", "algo": "gpc", "seeds": 1, "start": tmp_path / "gpc"}
    check_start(spec_of(max_capacity=3, **settings))
    with pytest.raises(
        UserError, match="a dictionary holds 3 points, give a --max-capacity of that at least"
    ):
        check_start(spec_of(max_capacity=2, **settings))


def test_what_runs_take_is_found_without_going_through_all_states():
    """As often as there are runs, it was done for each: half an hour for a hundred thousand."""

    class Counted(dict):
        read = 0

        def __getitem__(self, name):
            Counted.read += 1
            return super().__getitem__(name)

    settings = {"env": "cartpole", "algo": "gpc", "oracle": "lqr", "seeds": 40, "error": [0, 0.1, 0.2, 0.3]}
    cells = plan(spec_of(**settings, policy_length_scale=[0.1, 0.2, 0.4, 0.8]))
    keys = [(each.seed, each.error, dict(each.hyperparameters)["policy_length_scale"]) for each in cells]
    states = [state(seed=seed, error=error, policy_length_scale=scale) for seed, error, scale in keys]
    contents = Contents(Path("/x"), [State(Counted(one.values), Counted(one.card)) for one in states], "")
    for one, expected in zip(cells, states, strict=True):
        assert contents.of(one).values == expected.values
    assert Counted.read < 20 * len(cells)


def test_of_what_is_kept_a_row_is_read_and_not_its_part(tmp_path, monkeypatch):
    out = begun(tmp_path, spec := spec_of(**SETTINGS | {"seeds": 9}))
    monkeypatch.setattr(sealing, "GROUP", 1)
    Store(out, read_manifest(out)).append([rows(each, kept=True) for each in plan(spec)])
    contents, read, read_group = contents_of(out, "start"), [], pq.ParquetFile.read_row_group

    def counted(self, group, columns):
        read.append("arrays" in columns)
        return read_group(self, group, columns)

    monkeypatch.setattr(pq.ParquetFile, "read_row_group", counted)
    for each in plan(spec)[::4]:
        assert contents.arrays(contents.of(each))["seed"] == each.seed
    assert sum(read) == 3 and len(read) == 3 + 9


def test_what_is_damaged_there_is_a_line_once(tmp_path, capsys):
    """And no warning of Python's, which a command would show with a line of its source."""
    out = begun(tmp_path, spec := spec_of(**SETTINGS | {"seeds": 3}))
    for each in plan(spec):
        Store(out, read_manifest(out)).append([rows(each, kept=True)])
    first = min((out / "kept").iterdir())
    first.write_bytes(first.read_bytes()[:-1])
    check_start(spec_of(**SETTINGS | {"seeds": [1, 2]}, start=out))
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"gpcjax: {out}: 1 damaged part left out")
    assert len(kept_rows(out, "state", {}, tell)) == 2
    assert capsys.readouterr().err == line + "\n"


def test_d_coach_of_other_sizes_is_refused_before_anything_runs(tmp_path):
    learner = gpcjax.make_learner("d-coach", "cartpole", width=8, buffer_size=20)
    gpcjax.save_learner(tmp_path / "saved", learner, learner.init())
    settings = {"env": "cartpole", "algo": "d-coach", "seeds": 1, "start": tmp_path / "saved"}
    check_start(spec_of(width=8, buffer_size=20, batch_size=7, learning_rate=0.1, **settings))
    for wrong, line in (
        ({"width": 16, "buffer_size": 20}, "with width 8, here it is 16: give the same$"),
        ({"width": [8, 16], "buffer_size": 20}, "with width 8, here it is 16: give the same$"),
        ({"width": 8}, "with buffer_size 20, here it is 200: give the same$"),
    ):
        with pytest.raises(UserError, match=line):
            check_start(spec_of(**settings, **wrong))
    scaled = gpcjax.make_learner("d-coach", obs_size=4, action_size=1, width=8, scaling=[1.0, 1.0, 1.0, 2.0])
    gpcjax.save_learner(tmp_path / "scaled", scaled, scaled.init())
    with pytest.raises(UserError, match=r"with scaling 1, 1, 1, 2, here it is "):
        check_start(spec_of(width=8, **settings | {"start": tmp_path / "scaled"}))


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
def test_one_that_was_killed_goes_on_to_the_same_bits(source, tmp_path, compiled_as_shipped, monkeypatch):
    monkeypatch.setattr(
        worker, "programs_folder", lambda: tmp_path / "programs"
    )  # not as the others have them
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
