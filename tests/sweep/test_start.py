"""Sweeps whose runs begin with what was learned elsewhere."""

import dataclasses
import json
from pathlib import Path

import jax
import numpy as np
import pyarrow.parquet as pq
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.sweep import sealing
from gpcjax.sweep.checkpoints import cell_as_json, cell_of
from gpcjax.sweep.growth import contradictions
from gpcjax.sweep.kept import kept_rows
from gpcjax.sweep.layout import tell
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.plan import hash_of, plan, program_of
from gpcjax.sweep.source import Source
from gpcjax.sweep.sources import Contents, State, contents_of
from gpcjax.sweep.spec import as_dict, from_dict, spec_of
from gpcjax.sweep.startable import check_start
from gpcjax.sweep.store import Store
from tests.sweep.folders import begun
from tests.sweep.pretended import rows

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


def test_coach_on_another_grid_and_what_is_too_large_are_refused_before_anything_runs(tmp_path):
    sizes = {"obs_size": 4, "action_size": 1}
    coach = gpcjax.make_learner("coach", **sizes, lower=[-1] * 4, upper=[1] * 4, counts=[4, 4, 4, 4])
    gpcjax.save_learner(tmp_path / "coach", coach, coach.init())
    with pytest.raises(UserError, match=r"on another grid \(lower -1, -1, -1, -1\) than that of cartpole"):
        check_start(spec_of(env="cartpole", algo="coach", seeds=1, start=tmp_path / "coach"))
    learner = gpcjax.make_learner("gpc", "cartpole", sparsify=False)
    # Three points in both dictionaries, as so many corrections leave them.
    state = jax.tree.map(
        lambda leaf: leaf + 3 if np.issubdtype(leaf.dtype, np.integer) else leaf, learner.init()
    )
    assert [int(each.count[0]) for each in (state.policy, state.human)] == [3, 3]
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
