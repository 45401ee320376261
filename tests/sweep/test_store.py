"""The store: parts that are whole or absent, and frames with the promised columns."""

import dataclasses

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import gpcjax
from gpcjax.sweep import store as store_module
from gpcjax.sweep.plan import plan
from gpcjax.sweep.runfolder import read_manifest
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import CellRows, Store, read_corrections, read_episodes
from tests.sweep.folders import begun

SPEC = spec_of(env="cartpole", algo=["gpc", "coach"], error=[0, 0.1], seeds=2, episodes=3, oracle="lqr")
EPISODE_COLUMNS = {
    "env": "str",
    "algo": "str",
    "oracle": "str",
    "error": "float64",
    "seed": "int64",
    "episode": "int32",
    "return": "float64",
    "length": "int32",
    "corrections": "int32",
    "mean_rate": "float64",
    "asked": "int32",
    "chance": "float64",
    "policy_points": "int32 or null",
    "human_points": "int32 or null",
    "clipped": "int32",
    "full": "int32",
    "status": "str",
}
CORRECTION_COLUMNS = {
    **{name: EPISODE_COLUMNS[name] for name in ("env", "algo", "oracle", "error", "seed", "episode")},
    **{
        "step": "int32",
        "action_dim": "int32",
        "rate": "float64",
        "sigma_policy": "float64",
        "sigma_human": "float64",
    },
    **{"appended": "bool", "replaced": "bool", "full": "bool"},
}


def rows(cell, episodes=3, corrections=2, status="ok") -> CellRows:
    """Numbers that tell the cell and the episode."""
    mark = 10.0 * cell.seed + 100 * cell.error
    counts = np.arange(episodes, dtype=np.int32)
    integers = {
        name: counts + i
        for i, name in enumerate(("length", "policy_points", "human_points", "clipped", "full"))
    }
    measured = {"returns": mark + counts, "corrections": counts, "rate_sum": 0.5 * counts, **integers}
    measured |= {"asked": 2 * counts, "chance_sum": 0.25 * counts}
    sigmas = [np.nan, np.nan] if cell.algo == "coach" else [0.2, 0.3]
    log = {
        "where": np.array([[0, step, 0] for step in range(corrections)], np.int32).reshape(-1, 3),
        "values": np.array([[mark, *sigmas]] * corrections).reshape(-1, 3),
        "outcome": np.array([[True, False, False]] * corrections, bool).reshape(-1, 3),
    }
    return CellRows(cell, counts + 1, ["ok"] * (episodes - 1) + [status], measured, log)


def opened(out, spec=SPEC, say=None):
    """The store of a folder, which is begun if nobody has."""
    if not (out / "manifest.json").exists():
        begun(out, spec)
    return Store(out, read_manifest(out), say=say or refuse)


def refuse(line):
    raise AssertionError(f"nothing was to be said, but: {line}")


def filled(out, spec=SPEC, cells=None):
    store = opened(out, spec)
    store.append([rows(cell) for cell in (plan(spec) if cells is None else cells)])
    return store


def kinds(frame) -> dict[str, str]:
    def kind(column):
        if pd.api.types.is_string_dtype(column.dropna()):
            return "str"
        return "int32 or null" if column.name in ("policy_points", "human_points") else str(column.dtype)

    return {name: kind(frame[name]) for name in frame.columns}


class TestReading:
    def test_what_was_written_is_read(self, tmp_path):
        filled(tmp_path)
        frame = read_episodes(tmp_path)
        assert kinds(frame) == EPISODE_COLUMNS
        assert len(frame) == 8 * 3 and frame["episode"].tolist() == [1, 2, 3] * 8
        assert frame["return"].tolist() == [
            10.0 * seed + 100 * error + episode
            for _ in ("gpc", "coach")
            for error in (0.0, 0.1)
            for seed in (0, 1)
            for episode in range(3)
        ]
        assert frame["algo"].unique().tolist() == ["gpc", "coach"]
        assert (
            set(frame["status"]) == {"ok"}
            and set(frame["env"]) == {"cartpole"}
            and set(frame["oracle"]) == {"lqr"}
        )

    def test_corrections(self, tmp_path):
        filled(tmp_path)
        frame = read_corrections(tmp_path)
        assert kinds(frame) == CORRECTION_COLUMNS
        assert len(frame) == 8 * 2 and frame["step"].tolist() == [0, 1] * 8 and set(frame["episode"]) == {1}
        assert frame["appended"].all() and not frame["replaced"].any()

    def test_what_does_not_exist_is_null(self, tmp_path):
        """No dictionary and no sigma of COACH, no rate without corrections, no chance where none was worked out."""
        filled(tmp_path)
        episodes, corrections = read_episodes(tmp_path), read_corrections(tmp_path)
        coach = episodes["algo"] == "coach"
        for name in ("policy_points", "human_points"):
            assert (episodes[name].isna() == coach).all()
        assert (episodes["mean_rate"].isna() == (episodes["corrections"] == 0)).all()
        assert set(episodes["mean_rate"].dropna()) == {0.5}
        assert (episodes["chance"].isna() == (episodes["asked"] == 0)).all()
        assert set(episodes["chance"].dropna()) == {0.125} and set(episodes["asked"]) == {0, 2, 4}
        schema = pq.read_schema(next((tmp_path / "episodes").iterdir()))
        assert all(schema.field(name).type == "int32" for name in ("policy_points", "human_points"))
        for name in ("sigma_policy", "sigma_human"):
            assert (corrections[name].isna() == (corrections["algo"] == "coach")).all()

    def test_a_cell_that_stopped_has_fewer_episodes_and_says_why(self, tmp_path):
        cell = plan(SPEC)[0]
        opened(tmp_path).append([rows(cell, episodes=2, status="full")])
        assert read_episodes(tmp_path)["status"].tolist() == ["ok", "full"]

    def test_a_cell_without_corrections(self, tmp_path):
        opened(tmp_path).append([rows(plan(SPEC)[0], corrections=0)])
        assert (
            len(read_corrections(tmp_path)) == 0
            and kinds(read_corrections(tmp_path)).keys() == CORRECTION_COLUMNS.keys()
        )
        assert len(read_episodes(tmp_path)) == 3

    def test_a_column_for_each_setting_that_varies(self, tmp_path):
        """Null where it does not concern the learner. The chance of advice is not a correction's learning rate."""
        spec = spec_of(
            env="cartpole", algo=["gpc", "coach"], seeds=1, oracle="lqr", delta=[0, 0.05], rate=[0.1, 0.2],
            beta=[10, 30], policy_length_scale=[0.1, 0.2, 0.4], constant_rate=0.05,
        )  # fmt: skip
        filled(tmp_path, spec)
        frame = read_episodes(tmp_path)
        assert list(frame.columns) == [*EPISODE_COLUMNS, "delta", "rate", "policy_length_scale", "beta"]
        gpc, coach = (frame[frame["algo"] == algo] for algo in ("gpc", "coach"))
        assert gpc["beta"].isna().all() and coach["policy_length_scale"].isna().all()
        assert sorted(gpc["policy_length_scale"].unique()) == [0.1, 0.2, 0.4] and sorted(
            coach["beta"].unique()
        ) == [10, 30]
        assert len(frame) == 3 * len(plan(spec)) and not frame.drop(columns="return").duplicated().any()
        corrections = read_corrections(tmp_path)
        assert list(corrections.columns) == [
            *CORRECTION_COLUMNS, "delta", "advice_rate", "policy_length_scale", "beta",
        ]  # fmt: skip
        assert sorted(corrections["advice_rate"].unique()) == [0.1, 0.2]

    def test_the_order_of_arrival_does_not_matter(self, tmp_path):
        cells = plan(SPEC)
        one, other = tmp_path / "one", tmp_path / "other"
        for folder, order in ((one, cells), (other, cells[::-1])):
            folder.mkdir()
            for cell in order:
                filled(folder, cells=[cell])
        for read in (read_episodes, read_corrections):
            pd.testing.assert_frame_equal(read(one), read(other))

    def test_load(self, tmp_path):
        with pytest.raises(ValueError, match="no such folder"):
            gpcjax.load(tmp_path / "none")
        with pytest.raises(ValueError, match=r"manifest.json: cannot be read"):
            gpcjax.load(tmp_path)


class TestGoingOn:
    def test_everything_is_missing_at_first(self, tmp_path):
        assert opened(tmp_path).missing(plan(SPEC)) == plan(SPEC)

    def test_what_is_stored_is_not_missing(self, tmp_path):
        cells = plan(SPEC)
        store = filled(tmp_path, cells=cells[:3])
        assert store.missing(cells) == cells[3:]
        store.append([rows(cell) for cell in cells[3:]])
        assert opened(tmp_path).missing(cells) == []

    def test_cells_that_differ_in_a_varying_setting_are_told_apart(self, tmp_path):
        spec = spec_of(
            env="cartpole", algo=["gpc", "coach"], seeds=2, oracle="lqr", delta=[0, 0.1], noise=[1e-7, 1e-6]
        )
        cells = plan(spec)
        for some in (cells[::2], cells[1::2]):
            missing = opened(tmp_path, spec).missing(cells)
            assert [cell for cell in cells if cell in some] == [cell for cell in missing if cell in some]
            filled(tmp_path, spec, some)
        assert opened(tmp_path, spec).missing(cells) == []

    def test_an_interrupted_part_is_removed(self, tmp_path):
        """Corrections without episodes, and files that never got their names."""
        cells = plan(SPEC)
        filled(tmp_path, cells=cells[:2])
        before = {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()}
        store = filled(tmp_path, cells=cells[2:4])
        part = max((tmp_path / "episodes").iterdir())
        part.rename(part.with_name(f".{part.name}.0123456789ab.tmp"))
        (tmp_path / ".manifest.json.0123456789ab.tmp").write_bytes(b"half")
        assert store.missing(cells) == cells[2:]
        assert {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()} == before

    @pytest.mark.parametrize("call", [1, 2])
    def test_a_write_that_fails_leaves_no_half_part(self, tmp_path, monkeypatch, call):
        """Before or between the two files: the cells stay missing, and can be written later."""
        cells = plan(SPEC)
        store, calls, write = filled(tmp_path, cells=cells[:2]), [], store_module.write_atomic

        def fail(path, data):
            calls.append(path)
            if len(calls) == call:
                raise OSError("no space left")
            write(path, data)

        with monkeypatch.context() as patch:
            patch.setattr(store_module, "write_atomic", fail)
            with pytest.raises(OSError, match="no space left"):
                store.append([rows(cells[2])])
        assert len(read_episodes(tmp_path)) == 6
        assert store.missing(cells) == cells[2:]
        store.append([rows(cell) for cell in cells[2:]])
        assert opened(tmp_path).missing(cells) == []
        assert len(read_episodes(tmp_path)) == 24 and len(read_corrections(tmp_path)) == 16

    def test_parts_are_never_written_over(self, tmp_path):
        for cell in plan(SPEC):
            before = {path: path.read_bytes() for path in tmp_path.rglob("*.parquet")}
            filled(tmp_path, cells=[cell])
            assert all(path.read_bytes() == content for path, content in before.items())
        assert len(list(tmp_path.rglob("*.parquet"))) == 2 * len(plan(SPEC))
        episodes, corrections = (
            {path.name for path in (tmp_path / name).iterdir()} for name in ("episodes", "corrections")
        )
        assert episodes == corrections

    def test_nothing_to_write(self, tmp_path):
        opened(tmp_path).append([])
        assert not list(tmp_path.rglob("*.parquet"))
        assert read_episodes(tmp_path).empty


def test_the_rows_of_a_lane():
    """An episode that never began has no row, and the last one carries the status; the log ends at its count."""
    from gpcjax.engine.lanes import LOGGED_CORRECTIONS, CorrectionLog, EpisodeRows, Lane
    from gpcjax.learners.base import Status
    from gpcjax.sweep.worker import rows_of

    length = np.array([5, 7, 0], np.int32)
    measured = {field.name: length for field in dataclasses.fields(EpisodeRows)}
    log = {
        "where": np.arange(3 * LOGGED_CORRECTIONS).reshape(-1, 3),
        "values": np.ones((LOGGED_CORRECTIONS, 3)),
    }
    lane = _of(
        Lane,
        rows=_of(EpisodeRows, **measured),
        log=_of(CorrectionLog, count=np.int32(2), outcome=log["values"] > 0, **log),
        status=np.int32(Status.NON_FINITE),
    )
    cell = plan(SPEC)[0]
    got = rows_of(cell, lane)
    assert got.cell is cell
    assert got.episode.tolist() == [1, 2] and got.status == ["ok", "non-finite"]
    assert all(values.tolist() == [5, 7] for values in got.episodes.values())
    assert got.corrections["where"].tolist() == [[0, 1, 2], [3, 4, 5]]


def _of(kind, **fields):
    """A module with these fields alone."""
    made = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made
