"""The store: parts that are whole or absent, and frames with the promised columns."""

import dataclasses
import errno
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.sweep import parts, sealing
from gpcjax.sweep import store as store_module
from gpcjax.sweep.counted import read_counted
from gpcjax.sweep.manifest import read_manifest, write_manifest
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read, read_corrections, read_episodes, read_kept
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store
from tests.sweep.folders import begun, manifest_of
from tests.sweep.pretended import rows
from tests.torture import folders as torture

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
EPISODE_NAMES = list(EPISODE_COLUMNS)
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
        for frame_of in (read_episodes, read_corrections):
            pd.testing.assert_frame_equal(frame_of(one), frame_of(other))

    def test_load(self, tmp_path):
        with pytest.raises(ValueError, match="no such folder"):
            gpcjax.load(tmp_path / "none")
        with pytest.raises(ValueError, match=r"manifest.json: cannot be read"):
            gpcjax.load(tmp_path)

    def test_corrections_of_ones_own(self, tmp_path):
        filled(tmp_path)
        pd.testing.assert_frame_equal(gpcjax.load(tmp_path), read_episodes(tmp_path))
        pd.testing.assert_frame_equal(gpcjax.load_corrections(tmp_path), read_corrections(tmp_path))
        begun(tmp_path / "new", SPEC)
        for load in (gpcjax.load, gpcjax.load_corrections):
            with pytest.raises(ValueError, match="it holds no episodes yet"):
                load(tmp_path / "new")

    @pytest.mark.parametrize("load", [gpcjax.load, gpcjax.load_corrections])
    def test_every_column_is_described(self, tmp_path, load):
        filled(tmp_path)
        described = {
            name
            for line in load.__doc__.splitlines()
            if "|" in line
            for name in re.findall(r"\w+", line.split("|")[1])
        }
        assert set(load(tmp_path).columns) <= described


class TestDamage:
    """Found by whoever reads, set aside by the sweep; `tests/torture` has more of it."""

    @pytest.fixture
    def spoiled(self, tmp_path):
        """A store with a part for each cell, the third one's corrections with a flipped bit."""
        for cell in plan(SPEC):
            filled(tmp_path, cells=[cell])
        path = sorted((tmp_path / "corrections").iterdir())[2]
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 4
        path.write_bytes(data)
        return path

    def test_a_reader_is_warned_and_gets_the_rest(self, tmp_path, spoiled):
        message = (
            rf"{tmp_path}: 1 damaged part left out, .* \(corrections/{spoiled.name}: its checksum differs\)"
        )
        with pytest.warns(UserWarning, match=message):
            frame = gpcjax.load(tmp_path)
        assert len(frame) == 7 * 3
        with pytest.warns(UserWarning, match=message):
            assert len(gpcjax.load_corrections(tmp_path)) == 7 * 2

    def test_the_sweep_sets_both_files_aside(self, tmp_path, spoiled):
        before = {
            folder: (tmp_path / folder / spoiled.name).read_bytes() for folder in ("episodes", "corrections")
        }
        said = []
        assert opened(tmp_path, say=said.append).missing(plan(SPEC)) == plan(SPEC)[2:3]
        (line,) = said
        assert line.startswith(
            f"{tmp_path}: 1 damaged part moved to {tmp_path / 'damaged'}, what is missing runs again"
        )
        for folder, content in before.items():
            assert (tmp_path / "damaged" / folder / spoiled.name).read_bytes() == content
            assert not (tmp_path / folder / spoiled.name).exists()
        filled(tmp_path, cells=plan(SPEC)[2:3])
        assert len(read_episodes(tmp_path)) == 24 and opened(tmp_path).missing(plan(SPEC)) == []

    def test_several_are_one_line(self, tmp_path, spoiled):
        for path in list((tmp_path / "episodes").iterdir())[:5]:
            path.write_bytes(b"")
        said = []
        opened(tmp_path, say=said.append).missing(plan(SPEC))
        assert len(said) == 1 and " damaged parts moved to " in said[0]

    def test_where_nothing_is_whole_reading_is_refused(self, tmp_path):
        filled(tmp_path)
        (part,) = (tmp_path / "episodes").iterdir()
        part.write_bytes(part.read_bytes()[:-1])
        with pytest.raises(ValueError, match=rf"{tmp_path}: none of its rows is whole \(episodes/part-"):
            gpcjax.load(tmp_path)

    def test_a_part_that_was_copied_is_read_once(self, tmp_path):
        """From another folder of the same sweep, where the same cells lie in other parts."""
        one, other = tmp_path / "one", tmp_path / "other"
        cells = plan(SPEC)
        filled(one, cells=cells)
        filled(other, cells=cells[2:4])
        filled(other, cells=cells[5:6])
        expected = read_episodes(one), read_corrections(one)
        for folder in ("episodes", "corrections"):
            shutil.copytree(other / folder, one / folder, dirs_exist_ok=True)
        with pytest.warns(UserWarning, match=r"3 cells are there twice, the rows of the first part count"):
            got = read(one)
        for frame, whole in zip(got, expected, strict=False):
            pd.testing.assert_frame_equal(frame, whole)

    def test_pages_have_sums_of_their_own(self, tmp_path):
        """For whoever reads a part of a part."""
        filled(tmp_path)
        (part,) = (tmp_path / "episodes").iterdir()
        column = pq.ParquetFile(part).metadata.row_group(0).column(EPISODE_NAMES.index("return"))
        data = bytearray(part.read_bytes())
        data[column.data_page_offset + column.total_compressed_size // 2] ^= 1
        with pytest.raises(OSError, match=r"(?i)crc|checksum"):
            pq.ParquetFile(pa.BufferReader(bytes(data)), page_checksum_verification=True).read()

    def test_a_file_that_may_not_be_read_is_not_damaged(self, tmp_path, monkeypatch):
        filled(tmp_path)

        def denied(path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))

        monkeypatch.setattr(Path, "read_bytes", denied)
        with pytest.raises(UserError, match=r"part-.*\.parquet: cannot be read \(Permission denied\)"):
            store_module.Store(tmp_path, manifest_of(SPEC)).missing(plan(SPEC))
        assert not (tmp_path / "damaged").exists()

    def test_a_reader_beside_a_writer_sees_whole_parts(self, tmp_path):
        """At any moment between its files, and when it sets one aside."""
        store, cells, seen = opened(tmp_path), plan(SPEC), []
        write = store_module.write_atomic

        def looked(path, data):
            seen.append((len(read_episodes(tmp_path, refuse)), len(read_corrections(tmp_path, refuse))))
            write(path, data)
            seen.append((len(read_episodes(tmp_path, refuse)), len(read_corrections(tmp_path, refuse))))

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(store_module, "write_atomic", looked)
            for cell in cells[:2]:
                store.append([rows(cell)])
        assert seen == [(0, 0), (0, 0), (0, 0), (3, 2), (3, 2), (3, 2), (3, 2), (6, 4)]


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """As an older version left it, with a cell still missing; and the rows of all."""
    folder = tmp_path_factory.mktemp("left")
    whole = folder / "whole"
    for cell in plan(SPEC):
        filled(whole, cells=[cell])
    out = torture.unsealed(folder / "old", whole)
    for name in ("episodes", "corrections"):
        max((out / name).iterdir()).unlink()
    return folder


class TestFormat2:
    """Stores without sums are read, checked as far as that goes, and continued."""

    @pytest.fixture
    def old(self, left, tmp_path):
        """A copy of both."""
        shutil.copytree(left, tmp_path, dirs_exist_ok=True)
        return tmp_path / "old", tmp_path / "whole"

    def test_it_goes_on(self, old):
        out, whole = old
        assert len(read_episodes(out)) == 7 * 3
        store = opened(out)
        (missing,) = store.missing(plan(SPEC))
        before = {path: path.read_bytes() for path in out.rglob("*.parquet")}
        store.append([rows(missing)])
        assert opened(out).missing(plan(SPEC)) == []
        for frame_of in (read_episodes, read_corrections):
            pd.testing.assert_frame_equal(frame_of(out), frame_of(whole))
        assert all(path.read_bytes() == content for path, content in before.items())

    def test_once_gone_on_its_manifest_is_checked(self, old):
        out, _ = old
        write_manifest(out, read_manifest(out))
        text = (out / "manifest.json").read_text()
        assert read_manifest(out)["format"] == 2  # the older version can read it, too
        (out / "manifest.json").write_text(text.replace('"jobs": 0', '"jobs": 1'))
        with pytest.raises(UserError, match="it is not as it was written"):
            read_manifest(out)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda frame: frame.assign(error=0.3), "it has error 0.3, which is not in the specification"),
            (lambda frame: frame.assign(seed=7), "it has seed 7, which is not in the specification"),
            (lambda frame: frame.assign(algo="gpd"), "it has algo 'gpd'"),
            (lambda frame: frame.iloc[:2], "it has a run without its last episodes"),
            (lambda frame: frame.iloc[1:], "it has a run whose episodes are not 1, 2, 3"),
            (lambda frame: pd.concat([frame, frame]), "it has a run whose episodes are not 1, 2, 3"),
            (
                lambda frame: frame.assign(status=["full", "ok", "ok"]),
                "it has a run that goes on after its end",
            ),
            (lambda frame: frame.drop(columns="chance"), "it has no column chance"),
            (lambda frame: frame.assign(length=0), "it has episodes without a step"),
        ],
    )
    def test_rows_that_cannot_be_of_the_sweep(self, old, change, message):
        out, _ = old
        path = min((out / "episodes").iterdir())
        change(pd.read_parquet(path)).to_parquet(path, index=False)
        with pytest.warns(
            UserWarning, match=rf"1 damaged part left out, .* \(episodes/{path.name}: {re.escape(message)}"
        ):
            assert len(gpcjax.load(out)) == 6 * 3

    def test_corrections_of_other_cells(self, old):
        out, _ = old
        first, second = sorted((out / "corrections").iterdir())[:2]
        first.write_bytes(second.read_bytes())
        with pytest.warns(UserWarning, match="it has corrections of cells that its episodes have not"):
            gpcjax.load(out)

    def test_a_table_of_somebody_else_is_left_alone(self, old):
        out, _ = old
        pd.DataFrame({"mine": [1]}).to_parquet(out / "episodes" / "mine.parquet")
        said = []
        store = opened(out, say=said.append)
        assert len(store.missing(plan(SPEC))) == 1 and (out / "episodes" / "mine.parquet").exists()
        assert said == [
            f"{out}: not rows of this sweep, so neither read nor touched: 'episodes/mine.parquet'"
        ]


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
        part.rename(part.with_name(f".gpcjax-4999999-0123456789ab.{part.name}.tmp"))
        (tmp_path / ".gpcjax-4999999-0123456789ab.manifest.json.tmp").write_bytes(b"half")
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
    from gpcjax.sweep.runs import rows_of

    length = np.array([5, 7, 0], np.int32)
    measured = {field.name: length for field in dataclasses.fields(EpisodeRows) if field.name != "own"}
    measured["returns"] = np.array([1.0, np.nan, 0.0])
    log = {
        "moments": np.arange(3 * LOGGED_CORRECTIONS).reshape(-1, 3),
        "values": np.ones((LOGGED_CORRECTIONS, 3)),
    }
    lane = _of(
        Lane,
        rows=_of(EpisodeRows, **measured, own={"weight": np.array([0.5, 0.25, 0.0])}),
        log=_of(CorrectionLog, count=np.int32(2), outcome=log["values"] > 0, **log),
        status=np.int32(Status.NON_FINITE),
    )
    cell = plan(SPEC)[0]
    got = rows_of(cell, lane)
    assert got.cell is cell
    assert got.episode.tolist() == [1, 2] and got.status == ["ok", "non-finite"]
    assert all(got.episodes[name].tolist() == [5, 7] for name in measured if name != "returns")
    assert got.own["weight"].tolist() == [0.5, 0.25]
    assert got.corrections["moments"].tolist() == [[0, 1, 2], [3, 4, 5]]

    # A start that is no number: an episode without a step, but a row that tells of it.
    lane.rows.length[1] = 0
    got = rows_of(cell, lane)
    assert got.episode.tolist() == [1, 2] and got.status == ["ok", "non-finite"]


def _of(kind, **fields):
    """A module with these fields alone."""
    made = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


class TestTogether:
    """Small parts become one as they come."""

    SPEC = spec_of(env="cartpole", algo="gpc", error=[0, 0.1], seeds=10, episodes=3, oracle="lqr")
    CELLS = plan(SPEC)

    @pytest.fixture(autouse=True)
    def few(self, monkeypatch):
        """Parts of parts come of few runs."""
        monkeypatch.setattr(store_module, "TOGETHER", 4)

    def one_by_one(self, out, cells=None):
        store = opened(out, self.SPEC)
        for cell in self.CELLS if cells is None else cells:
            store.append([rows(cell)])
        return store

    def test_the_rows_stay_as_they_are(self, tmp_path):
        self.one_by_one(tmp_path / "many")
        store = opened(tmp_path / "one", self.SPEC)
        store.append([rows(cell) for cell in self.CELLS])
        for read_some in (read_episodes, read_corrections):
            pd.testing.assert_frame_equal(read_some(tmp_path / "many"), read_some(tmp_path / "one"))
        for folder in ("episodes", "corrections"):
            assert len(list((tmp_path / "many" / folder).iterdir())) < 2 * store_module.TOGETHER
        assert opened(tmp_path / "many", self.SPEC).missing(self.CELLS) == []

    def test_those_of_earlier_sweeps_count_too(self, tmp_path):
        for cell in self.CELLS[: store_module.TOGETHER]:
            store = opened(tmp_path, self.SPEC)
            store.missing(self.CELLS)
            store.append([rows(cell)])
        assert len(list((tmp_path / "episodes").iterdir())) == 1

    @pytest.mark.parametrize("step", ["before", "episodes gone", "one gone"])
    def test_a_kill_in_between_costs_nothing(self, tmp_path, monkeypatch, step):
        def killed(self, names):
            for name in {"before": [], "episodes gone": names, "one gone": names[:1]}[step]:
                (tmp_path / "episodes" / name).unlink()
            raise KeyboardInterrupt

        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(Store, "_remove", killed)
            self.one_by_one(tmp_path)
        stored = self.CELLS[: store_module.TOGETHER]
        frame = read_episodes(tmp_path)
        assert len(frame) == 3 * len(stored) and not frame.duplicated(["error", "seed", "episode"]).any()
        said = []
        store = Store(tmp_path, manifest_of(self.SPEC), say=said.append)
        assert store.missing(stored) == [] and store.cells == len(stored) and not said
        for folder in ("episodes", "corrections"):
            assert len(list((tmp_path / folder).iterdir())) == 1
        pd.testing.assert_frame_equal(read_episodes(tmp_path), frame)

    @pytest.mark.parametrize(
        "left", ["all", pytest.param("the one put together before", marks=pytest.mark.slow)]
    )
    def test_a_kill_between_parts_that_were_put_together_before(self, tmp_path, monkeypatch, left):
        """What was put together before is replaced like any other part: its rows count once, and never double."""
        remove = Store._remove

        def killed(self, names):
            made = [name for name in names if sealing.replaced_by(tmp_path, name)]
            if made:
                remove(self, [] if left == "all" else [name for name in names if name not in made])
                raise KeyboardInterrupt
            remove(self, names)

        stored = []
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(Store, "_remove", killed)
            store = opened(tmp_path, self.SPEC)
            for cell in self.CELLS:
                stored.append(cell)
                store.append([rows(cell)])
        assert store_module.TOGETHER < len(stored) < len(self.CELLS)
        for read_some in (read_episodes, lambda out, say: read_counted(out, say)[0].episode):
            assert len(read_some(tmp_path, refuse)) == 3 * len(stored)
        store = opened(tmp_path, self.SPEC)
        assert store.missing(self.CELLS) == self.CELLS[len(stored) :] and store.cells == len(stored)
        assert len(list((tmp_path / "episodes").iterdir())) == 1
        for cell in self.CELLS[len(stored) :]:
            store.append([rows(cell)])
        assert len(read_episodes(tmp_path, refuse)) == 3 * len(self.CELLS)

    def test_what_is_there_twice_is_put_together_once(self, tmp_path):
        """As a merge into a folder with some of the rows leaves it."""
        store, cells = opened(tmp_path, self.SPEC), self.CELLS[: store_module.TOGETHER + 2]
        for first in range(store_module.TOGETHER):
            store.append([rows(cell, kept=True) for cell in cells[first : first + 3]])
        assert len(list((tmp_path / "episodes").iterdir())) == 1
        assert len(read_episodes(tmp_path, refuse)) == 3 * len(cells)
        assert len(read_corrections(tmp_path, refuse)) == 2 * len(cells)
        assert len(read_kept(tmp_path, refuse)) == len(cells)

    def test_what_is_put_together_has_so_many_bytes_at_most(self, tmp_path, monkeypatch):
        """All of it is in memory at once."""
        store, counts, put = opened(tmp_path, self.SPEC), [], Store._put_together
        store.append([rows(self.CELLS[0])])
        size = sum(path.stat().st_size for path in tmp_path.rglob("*.parquet"))
        monkeypatch.setattr(store_module, "LARGEST_PART", 3 * size)

        def counted(self, names, *where):
            counts.append(len(names))
            put(self, names, *where)

        monkeypatch.setattr(Store, "_put_together", counted)
        for cell in self.CELLS[1:12]:
            store.append([rows(cell)])
        assert counts and max(counts) <= 4
        assert len(read_episodes(tmp_path, refuse)) == 3 * 12

    @pytest.mark.parametrize("read_some", [read_episodes, read_counted, read_kept])
    def test_a_reader_loses_nothing_that_is_put_together_meanwhile(self, tmp_path, monkeypatch, read_some):
        """It has the names of parts that are gone when it comes to them, and not that of the new one."""
        cells = self.CELLS[: store_module.TOGETHER]
        store = opened(tmp_path, self.SPEC)
        for cell in cells[:-1]:
            store.append([rows(cell, kept=True)])
        read_one, read_parts = parts.part_of, []

        def read_slowly(out, name, *arguments):
            read_parts.append(name)
            if len(read_parts) == 3:
                store.append([rows(cells[-1], kept=True)])
            return read_one(out, name, *arguments)

        monkeypatch.setattr(parts, "part_of", read_slowly)
        got = read_some(tmp_path, refuse)
        found = got[0].seeds.tolist() if read_some is read_counted else sorted({*got["seed"]})
        assert found == [cell.seed for cell in cells]
        assert len(list((tmp_path / "episodes").iterdir())) == 1

    def test_a_damaged_whole_does_not_hide_what_it_was_made_of(self, tmp_path, monkeypatch):
        monkeypatch.setattr(Store, "_remove", lambda self, names: None)
        self.one_by_one(tmp_path, self.CELLS[: store_module.TOGETHER])
        *_, whole = sorted((tmp_path / "episodes").iterdir())
        data = bytearray(whole.read_bytes())
        data[100] ^= 1
        whole.write_bytes(data)
        with pytest.warns(UserWarning, match=r"1 damaged part left out"):
            assert len(read_episodes(tmp_path)) == 3 * store_module.TOGETHER
