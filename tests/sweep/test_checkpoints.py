"""Runs that are under way: what is saved of them when, what checkpoints say of them, and which can go on. No engine."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from gpcjax.errors import UserError
from gpcjax.policies.folder import read_arrays, read_card, write_folder
from gpcjax.sweep import checkpointing, going
from gpcjax.sweep.checkpointing import Checkpointer
from gpcjax.sweep.checkpoints import HERE, KIND, runs_as_json, runs_of, survey, told
from gpcjax.sweep.executors import Orders
from gpcjax.sweep.keeping import KeptRow
from gpcjax.sweep.packing import compressed, expanded, packed
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.sweep.runs import Runs
from gpcjax.sweep.spec import spec_of
from tests.sweep.pretended import Pretended

CELLS = plan(spec_of(env="cartpole", algo="coach", error=[0.1, 0.2], seeds=4096, episodes=50, oracle="lqr"))
AGREE = told({"jax": "0"}, "machine", None)


def learned(episodes):
    """What is kept of a run, with a card as long as that of a learner of COACH."""
    card, arrays = packed({"kind": "learner", "algo": "coach", "note": "n" * 400}, {"weights": np.ones(42)})
    return [KeptRow(episode, -12.5, "state", card, arrays) for episode in range(1, episodes + 1)]


@pytest.mark.parametrize(
    "episodes", [120, pytest.param(2000, marks=pytest.mark.slow), pytest.param(0, marks=pytest.mark.slow)]
)
def test_a_card_has_room_for_all_runs_of_an_accelerator(tmp_path, episodes):
    """8,192 lanes, and 64 lanes of which each episode is kept, did not fit into the bytes that a card may have."""
    kept = [learned(episodes)] * 64 + [[]] * (len(CELLS) - 64)
    out = tmp_path / "out"
    card = {"kind": KIND, **AGREE, "runs": runs_as_json((cell, 7) for cell in CELLS)}
    arrays = {"x": np.ones(1), **checkpointing._kept_arrays(kept)}
    write_folder(out / "checkpoints" / "12345678901-1-0", card, arrays)
    places = survey(out, lambda cell: True, AGREE, str)[HERE]
    assert list(places) == CELLS and [place.index for place in places.values()] == [*range(len(CELLS))]
    card = read_card(out / "checkpoints" / "12345678901-1-0", KIND)
    assert set(runs_of(card)) == {(cell, 7) for cell in CELLS}
    arrays = read_arrays(out / "checkpoints" / "12345678901-1-0", card, KIND)
    got = checkpointing._kept_rows(arrays, len(CELLS))
    assert [[vars(row) for row in rows] for rows in got[60:70]] == [
        [vars(row) for row in rows] for rows in kept[60:70]
    ]
    assert list(arrays) == ["x"]


def test_what_is_kept_lies_in_several_arrays_where_it_is_long(monkeypatch):
    monkeypatch.setattr(checkpointing, "PIECE", 100)
    rows = [learned(1), [], [KeptRow(2, float("nan"), "policy", "{}", b"")]]
    arrays = checkpointing._kept_arrays(rows)
    assert sorted(arrays) == ["kept", "kept.0", "kept.1", "kept.2", "kept.3"]
    *same, odd = checkpointing._kept_rows(dict(arrays), 3)
    assert [[vars(row) for row in each] for each in same] == [
        [vars(row) for row in each] for each in rows[:2]
    ]
    assert np.isnan(odd[0].returns) and odd[0].arrays == b""
    for broken in ({**arrays, "kept.4": np.ones(1, np.uint8)}, {**arrays, "kept": np.ones(9, np.uint8)}):
        with pytest.raises(ValueError, match=r"kept is not what|not compressed"):
            checkpointing._kept_rows(broken, 3)
    with pytest.raises(ValueError, match="kept is not what"):
        checkpointing._kept_rows(dict(arrays), 2)
    assert checkpointing._kept_rows(checkpointing._kept_arrays([[], []]), 2) == [[], []]


def test_compressed_values():
    value = {"a": [1, 2.5, None], "b": "text" * 1000}
    data = compressed(value)
    assert len(data) < 100 and expanded(data) == value
    for broken in (b"", data[:-3], json.dumps(value).encode()):
        with pytest.raises(ValueError, match="compressed JSON"):
            expanded(broken)


def test_the_last_one_of_a_program_goes_when_its_rows_are_stored(tmp_path, monkeypatch):
    """Not when the sweep ends: each program would leave one until then."""
    monkeypatch.setattr(going, "FLUSH_SECONDS", 1e9)  # rows wait in memory
    out, seen = tmp_path / "out", []
    folder = out / "checkpoints" / "12345678901-1-0"

    class Saving(Pretended):
        def _work(self, cells, baselines, on_rows, on_baseline, on_progress):
            super()._work(cells[:2], baselines, on_rows, on_baseline, on_progress)
            folder.mkdir(parents=True)
            desk.answer(desk.workers - 1, ("over", folder.name))
            desk.answer(desk.workers - 1, ("over", "../../mine"))
            seen.append((folder.exists(), len(read_episodes(out))))
            super()._work(cells[2:], [], on_rows, on_baseline, on_progress)

        def run(self, given):
            nonlocal desk
            desk = given
            super().run(given)

    desk = None
    (tmp_path / "mine").mkdir()
    settings = {"env": "cartpole", "algo": ["coach", "gpc"], "oracle": "lqr", "seeds": 2, "episodes": 3}
    sweep(out, executor=Saving()(1), **settings)
    assert seen == [(False, 2 * 3)] and (tmp_path / "mine").exists()


def test_a_worker_says_so_once(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpointing, "_packed", lambda snapshots, kept: ({}, {"x": np.ones(1)}))
    one = Checkpointer(tmp_path, 1e-9, AGREE)
    assert one.close() is None
    pool = SimpleNamespace(snapshot=lambda: [1])
    for _ in range(2):
        one._since, one._took = 0.0, 0.0
        one.look(pool, {})
    (name,) = (path.name for path in tmp_path.iterdir())
    assert one.close() == name and one.close() is None
    assert (tmp_path / name).exists()


class Looked:
    """A pool without runs, that counts how often they were asked for."""

    count = 0

    def snapshot(self):
        self.count += 1
        return []


class TestWhereNothingCanBeWritten:
    def test_it_is_tried_again_when_it_is_time(self, tmp_path):
        class Full(Looked):
            def snapshot(self):
                super().snapshot()
                raise UserError("the disk is full")

        pool, checkpointer = Full(), Checkpointer(tmp_path / "checkpoints", 100.0, {})
        checkpointer._since -= 101
        with pytest.raises(UserError):
            checkpointer.look(pool, {})
        checkpointer.look(pool, {})
        assert pool.count == 1

    def test_a_run_folder_that_was_removed_is_not_made_anew(self, tmp_path):
        pool, out = Looked(), tmp_path / "out"
        with pytest.raises(UserError, match=f"^{out}: the folder was removed or moved while it was in use$"):
            Checkpointer(out / "checkpoints", 1e-9, {}).look(pool, {})
        assert not out.exists() and not pool.count

    def test_it_is_said_once(self, tmp_path):
        said = []
        runs = Runs(
            Looked(), Orders(checkpoints=str(tmp_path / "out" / "checkpoints"), seconds=1e-9), said.append
        )
        for _ in range(3):
            runs.save()
        assert [word for word, _ in said] == ["note"]
