"""The sweep from its specification to a complete store, with workers that are only pretended; see test_sweeps."""

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time

import pyarrow.parquet as pq
import pytest

from gpcjax.errors import UserError
from gpcjax.report import html
from gpcjax.report.content import document
from gpcjax.report.groups import gather
from gpcjax.report.summary import summarise
from gpcjax.sweep import going, machine, opening, origin
from gpcjax.sweep import run as run_module
from gpcjax.sweep.layout import FORMAT, tell
from gpcjax.sweep.lock import LOCK
from gpcjax.sweep.manifest import write_manifest
from gpcjax.sweep.opening import UNKNOWN
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import run, sweep
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store
from tests.sweep.pretended import BASELINE, Pretended, rows

SETTINGS = {
    "env": "cartpole",
    "algo": "coach",
    "error": [0, 0.1],
    "seeds": 2,
    "episodes": 3,
    "oracle": ["lqr"],
}
SPEC = spec_of(**SETTINGS)


@pytest.fixture
def pretend(monkeypatch):
    def make(*arguments, **options):
        pretended = Pretended(*arguments, **options)
        monkeypatch.setattr(run_module, "Processes", pretended)
        return pretended

    return make


def manifest(out):
    return json.loads((out / "manifest.json").read_text())


def parts(out):
    return sorted((out / "episodes").glob("*.parquet"))


def contents(out):
    return {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


def test_a_whole_sweep(tmp_path, pretend):
    pretended = pretend()
    assert sweep(tmp_path / "deep" / "out", jobs=3, **SETTINGS) == tmp_path / "deep" / "out"
    out = tmp_path / "deep" / "out"
    assert pretended.calls == [(plan(SPEC), [("cartpole", "idle"), ("cartpole", "lqr")], 3)]
    assert len(read_episodes(out)) == 12
    written = manifest(out)
    assert (
        written["complete"] and written["cells"] == 4 and written["jobs"] == 3 and written["format"] == FORMAT
    )
    assert written["baselines"] == {"idle": BASELINE, "oracles": {"lqr": BASELINE}}
    assert written["specification"]["error"] == [0, 0.1] and written["varying"] == []
    assert written["env_steps"] == 40 and written["compile_time_s"] == 2.0
    assert written["env_steps_per_s"] == pytest.approx(40 / written["wall_time_s"])
    assert {"jax", "jaxlib", "numpy", "gpcjax", "python"} <= written["versions"].keys()
    assert written["machine"] == machine.describe() and "further_machines" not in written


def test_a_second_call_runs_nothing_and_writes_nothing(tmp_path, pretend):
    pretended = pretend()
    sweep(tmp_path, **SETTINGS)
    before = {
        path: (path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.rglob("*") if path.is_file()
    }
    sweep(tmp_path, **SETTINGS)
    sweep(tmp_path, **(SETTINGS | {"error": [0.1, 0]}))
    assert len(pretended.calls) == 1
    assert before == {
        path: (path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.rglob("*") if path.is_file()
    }


def test_checkpoints_of_a_complete_sweep_go(tmp_path, pretend):
    """A kill behind the last manifest has left them; somebody's own file stays."""
    pretended = pretend()
    sweep(tmp_path, **SETTINGS)
    (tmp_path / "checkpoints" / "1795690957943205000-7-9").mkdir(parents=True)
    (tmp_path / "checkpoints" / "mine").touch()
    sweep(tmp_path, **SETTINGS)
    assert [path.name for path in (tmp_path / "checkpoints").iterdir()] == ["mine"]
    assert len(pretended.calls) == 1


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt, RuntimeError("a worker failed")], ids=["stopped", "failed"]
)
def test_what_was_finished_is_kept_and_the_rest_runs_later(tmp_path, pretend, error):
    pretend(fails_after=3, error=error)
    with pytest.raises(error if isinstance(error, type) else type(error)):
        sweep(tmp_path, **SETTINGS)
    assert len(read_episodes(tmp_path)) == 9
    first = manifest(tmp_path)
    assert not first["complete"] and first["env_steps"] == 30
    pretended = pretend()
    sweep(tmp_path, **SETTINGS)
    # The baselines are known by now, and three of the cells.
    assert pretended.calls == [(plan(SPEC)[3:], [], 1)]
    assert len(read_episodes(tmp_path)) == 12
    second = manifest(tmp_path)
    assert second["complete"] and second["env_steps"] == 40 and second["compile_time_s"] == 4.0
    assert second["wall_time_s"] > first["wall_time_s"]


def test_stopped_just_when_rows_were_written(tmp_path, pretend, monkeypatch):
    """The flush at the end must not write them again."""
    monkeypatch.setattr(going, "FLUSH_SECONDS", -1.0)
    pretend()
    append = Store.append

    def interrupted(self, some):
        append(self, some)
        if len(read_episodes(tmp_path)) == 6:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(Store, "append", interrupted)
        with pytest.raises(KeyboardInterrupt):
            sweep(tmp_path, **SETTINGS)
    assert not read_episodes(tmp_path).duplicated(["error", "seed", "episode"]).any()
    sweep(tmp_path, **SETTINGS)
    frame = read_episodes(tmp_path)
    assert len(frame) == 12 and not frame.duplicated(["error", "seed", "episode"]).any()


def test_rows_are_flushed_while_it_runs(tmp_path, pretend, monkeypatch):
    """So that a kill, which nobody can catch, costs little."""
    monkeypatch.setattr(going, "FLUSH_SECONDS", 0.01)
    pretended = pretend()
    seen = []

    def work(cells, baselines, on_rows, on_baseline, on_progress):
        for _, name in baselines:
            on_baseline(name, BASELINE)
        for cell in cells:
            time.sleep(0.02)
            on_rows(rows(cell))
            seen.append(len(read_episodes(tmp_path)))

    pretended._work = work
    sweep(tmp_path, **SETTINGS)
    assert seen == [3, 6, 9, 12]
    assert len(list((tmp_path / "episodes").iterdir())) == 4


def test_stopped_between_the_last_row_and_the_manifest(tmp_path, pretend):
    """Nothing is missing but the word that it is complete, and what is wanted besides cells."""
    pretend()
    sweep(tmp_path, **SETTINGS)
    written = manifest(tmp_path) | {"complete": False, "baselines": {"idle": BASELINE, "oracles": {}}}
    write_manifest(tmp_path, written)
    pretended = pretend()
    sweep(tmp_path, **SETTINGS)
    assert pretended.calls == [([], [("cartpole", "lqr")], 1)]
    assert manifest(tmp_path)["complete"] and manifest(tmp_path)["baselines"]["oracles"] == {"lqr": BASELINE}


def test_a_part_that_was_lost_is_run_again(tmp_path, pretend, monkeypatch):
    monkeypatch.setattr(going, "FLUSH_SECONDS", -1.0)
    pretend()
    sweep(tmp_path, **SETTINGS)
    lost = sorted((tmp_path / "episodes").iterdir())[1]
    lost.unlink()
    pretended = pretend()
    sweep(tmp_path, **SETTINGS)
    assert pretended.calls[0][0] == [plan(SPEC)[1]]
    assert len(read_episodes(tmp_path)) == 12


class TestOtherVersions:
    @pytest.fixture
    def older(self, tmp_path, pretend, monkeypatch):
        """A run folder that an older jax has begun."""

        def make(fails_after):
            pretend(fails_after)
            with monkeypatch.context() as patch, contextlib.suppress(KeyboardInterrupt):
                for module in (opening, origin):
                    patch.setattr(module, "versions", lambda: versions() | {"jax": "0.4.1"})
                sweep(tmp_path, **SETTINGS)
            return pretend()

        versions = origin.versions

        return make

    def test_an_unfinished_sweep_is_not_mixed(self, tmp_path, older):
        """Its rows would differ in the last bits."""
        pretended = older(fails_after=2)
        with pytest.raises(
            UserError, match=rf"{tmp_path}: it was begun with jax 0.4.1, this is .*: give a new folder"
        ):
            run(SPEC, tmp_path, 1)
        assert not pretended.calls and len(read_episodes(tmp_path)) == 6

    def test_a_finished_one_is_still_good(self, tmp_path, older):
        pretended = older(fails_after=None)
        run(SPEC, tmp_path, 1)
        assert not pretended.calls

    def test_a_manifest_made_anew_says_which_versions_made_the_rows(self, tmp_path, older):
        """Not those that find the parts: the rest of the rows would differ in the last bits."""
        pretended = older(fails_after=2)
        (tmp_path / "manifest.json").unlink()
        with pytest.raises(UserError, match=r"it was begun with jax 0.4.1, this is .*: give a new folder"):
            run(SPEC, tmp_path, 1)
        assert not pretended.calls and len(parts(tmp_path)) == 1

    def test_rows_of_other_versions_are_not_mixed_in(self, tmp_path, older, capsys):
        """Whoever copies them into the folder of the same sweep."""
        older(fails_after=None)
        copy = tmp_path / "here"
        pretended = older(fails_after=None)
        sweep(copy, **SETTINGS)
        for folder in ("episodes", "corrections"):
            shutil.copytree(tmp_path / folder, copy / folder, dirs_exist_ok=True)
        before = contents(copy)
        run(SPEC, copy, 1)
        assert len(pretended.calls) == 1 and len(read_episodes(copy, tell)) == 12
        assert (
            "here: not rows of this sweep, so neither read nor touched: 'episodes/part-"
            in capsys.readouterr().err
        )
        assert contents(copy) == before


class TestOtherMachines:
    """The last bits of rows depend on what the processor can."""

    def go_on_elsewhere(self, out, pretend, monkeypatch, **changes):
        pretend(fails_after=2)
        with contextlib.suppress(KeyboardInterrupt):
            sweep(out, **SETTINGS)
        here = machine.describe()
        monkeypatch.setattr(machine, "describe", lambda: here | changes)
        pretend()
        sweep(out, **SETTINGS)
        return here, manifest(out)

    def test_another_kind_is_written_down_and_told(self, tmp_path, pretend, monkeypatch, capsys):
        changes = {"vector_features": "sse", "cpu_model": "7 0"}
        here, written = self.go_on_elsewhere(tmp_path, pretend, monkeypatch, **changes)
        assert written["machine"] == here and written["further_machines"] == [here | changes]
        line = f"{tmp_path}: begun on another kind of machine (cpu_model, vector_features): last bits may"
        assert line in capsys.readouterr().err
        told = {json.loads(pq.read_schema(path).metadata[b"gpcjax"])["machine"] for path in parts(tmp_path)}
        assert told == {machine.kind_of(here), machine.kind_of(here | changes)} and len(told) == 2

    def test_another_of_the_same_kind_is_not(self, tmp_path, pretend, monkeypatch, capsys):
        """More cores and another kernel of Linux change no bit."""
        here, written = self.go_on_elsewhere(tmp_path, pretend, monkeypatch, cores=64, platform="Linux-7")
        assert written["machine"] == here and "further_machines" not in written
        assert "machine" not in capsys.readouterr().err


class TestOneWriter:
    """A second sweep of a folder says who has it, and touches nothing."""

    def test_while_a_sweep_runs_another_is_refused(self, tmp_path, pretend):
        pretended, work = pretend(), Pretended._work
        seen = []

        def meet(*arguments):
            before = contents(tmp_path)
            code = f"import gpcjax.sweep.run as run; run.sweep({str(tmp_path)!r}, **{SETTINGS!r})"
            other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
            seen.append((other.returncode, other.stderr.splitlines()[-1], contents(tmp_path) == before))
            work(pretended, *arguments)

        pretended._work = meet
        sweep(tmp_path, **SETTINGS)
        ((status, line, untouched),) = seen
        assert status == 1 and untouched
        assert re.fullmatch(
            rf"gpcjax.errors.UserError: {tmp_path}: another sweep writes there "
            rf"\(process {os.getpid()} on {re.escape(socket.gethostname())} since 20.*\): "
            r"wait until it ends, or give a new folder \(--out\)",
            line,
        )
        assert len(read_episodes(tmp_path)) == 12 and not (tmp_path / LOCK).exists()

    def test_a_sweep_reads_the_folder_again_once_it_is_its_own(self, tmp_path, pretend, monkeypatch):
        """Another has begun and ended there since it was looked at."""
        pretended = pretend()

        @contextlib.contextmanager
        def late(out):
            with monkeypatch.context() as patch:
                patch.setattr(run_module, "held", contextlib.nullcontext)
                sweep(out, **(SETTINGS | {"episodes": 4}))
            yield

        monkeypatch.setattr(run_module, "held", late)
        with pytest.raises(UserError, match=r"it holds another specification \(episodes"):
            sweep(tmp_path / "out", **SETTINGS)
        assert len(pretended.calls) == 1


class TestManifestMadeAnew:
    @pytest.fixture
    def half(self, tmp_path, pretend):
        """A sweep that was stopped, and workers for the rest."""
        pretend(fails_after=3)
        with contextlib.suppress(KeyboardInterrupt):
            sweep(tmp_path, **SETTINGS)
        return pretend()

    @pytest.mark.parametrize(
        "text", ["", "{", "[]", "null", '{"format": 3}'], ids=["empty", "cut", "list", "null", "keys"]
    )
    def test_from_parts(self, tmp_path, half, capsys, text):
        (tmp_path / "manifest.json").write_text(text)
        sweep(tmp_path, **SETTINGS)
        # What the manifest knew beside the rows is measured again.
        assert half.calls == [(plan(SPEC)[3:], [("cartpole", "idle"), ("cartpole", "lqr")], 1)]
        written = manifest(tmp_path)
        assert written["complete"] and written["recovered"] and len(read_episodes(tmp_path)) == 12
        line = f"{tmp_path / 'manifest.json'} was damaged and lies in {tmp_path / 'damaged'} now: made anew"
        assert capsys.readouterr().err.count(line) == 1
        assert (tmp_path / "damaged" / "manifest.json").read_text() == text

    def test_where_there_is_none(self, tmp_path, half, capsys):
        (tmp_path / "manifest.json").unlink()
        sweep(tmp_path, **SETTINGS)
        assert half.calls[0][0] == plan(SPEC)[3:]
        assert f"{tmp_path / 'manifest.json'} is missing: made anew" in capsys.readouterr().err

    def test_the_machine_is_this_one_where_the_parts_say_so(self, tmp_path, half):
        (tmp_path / "manifest.json").unlink()
        sweep(tmp_path, **SETTINGS)
        assert manifest(tmp_path)["machine"] == machine.describe()
        assert "further_machines" not in manifest(tmp_path)

    def test_and_unknown_where_they_say_another(self, tmp_path, half, monkeypatch):
        (tmp_path / "manifest.json").unlink()
        here = machine.describe() | {"cpu_model": "another"}
        monkeypatch.setattr(machine, "describe", lambda: here)
        sweep(tmp_path, **SETTINGS)
        written = manifest(tmp_path)
        assert written["machine"] == {"processor": UNKNOWN} and written["further_machines"] == [here]
        page = html.render(document(summarise(gather(read_episodes(tmp_path), written)), []))
        assert UNKNOWN in page and "It went on with another machine" in page

    def test_not_for_another_sweep(self, tmp_path, half):
        (tmp_path / "manifest.json").unlink()
        before = contents(tmp_path)
        with pytest.raises(UserError, match="it holds rows of another sweep and no manifest"):
            sweep(tmp_path, **(SETTINGS | {"episodes": 30}))
        assert not half.calls and contents(tmp_path) == before


def test_the_files_of_others_stay(tmp_path, pretend, capsys):
    """Beside our parts, in the run folder and anywhere below it."""
    pretend(fails_after=3)
    with contextlib.suppress(KeyboardInterrupt):
        sweep(tmp_path, **SETTINGS)
    names = [
        "notes.txt",
        "episodes/my_data.json",
        "episodes/.hidden",
        "corrections/mine.parquet",
        "episodes/deep/a",
    ]
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("mine")
    pretended = pretend()
    sweep(tmp_path, **SETTINGS)
    assert pretended.calls[0][0] == plan(SPEC)[3:] and len(read_episodes(tmp_path, tell)) == 12
    assert all((tmp_path / name).read_text() == "mine" for name in names)
    line = f"gpcjax: {tmp_path}: not rows of this sweep, so neither read nor touched: 'episodes/.hidden' and 3 more"
    assert capsys.readouterr().err.splitlines().count(line) == 2  # of the sweep and of the reading


def test_what_kills_leave_is_removed(tmp_path, pretend):
    pretend(fails_after=2)
    with contextlib.suppress(KeyboardInterrupt):
        sweep(tmp_path, **SETTINGS)
    (part,) = parts(tmp_path)
    others = tmp_path / "episodes" / ".rows.0123456789ab.tmp"
    others.write_text("another program's")
    for folder, name in ((".", "manifest.json"), ("episodes", part.name), ("corrections", part.name)):
        for number in range(3):  # of a process that no system has
            (tmp_path / folder / f".gpcjax-4999999-{number:012x}.{name}.tmp").write_text("half")
    (tmp_path / ".gpcjax.lock").write_text('{"pid": 1}')
    pretend()
    sweep(tmp_path, **SETTINGS)
    assert [path for path in tmp_path.rglob(".*")] == [others]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"env": "cartpol"}, "env 'cartpol'"),
        ({"error": 1.5}, "error 1.5"),
        ({"seeds": 0}, "seeds 0"),
        (
            {"oracle": "energy"},
            "oracle .*'energy'.*: give gpc, gpc-2, gpc-3, lqr, network, mpc, .* for cartpole",
        ),
        ({"nosie": 1}, "'nosie' is no setting .did you mean noise"),
    ],
)
def test_mistakes_are_refused_before_anything_is_written(tmp_path, pretend, settings, message):
    pretended = pretend()
    with pytest.raises(ValueError, match=message):
        sweep(tmp_path / "out", **(SETTINGS | settings))
    assert not pretended.calls and not list(tmp_path.iterdir())


def test_another_sweeps_folder_is_refused(tmp_path, pretend):
    pretend()
    sweep(tmp_path, **SETTINGS)
    with pytest.raises(ValueError, match=r"it holds another specification \(episodes"):
        sweep(tmp_path, **(SETTINGS | {"episodes": 30}))


def test_the_default_folder(tmp_path, pretend, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pretend()
    out = sweep(**SETTINGS)
    assert out.parent.name == "runs" and out.name.startswith("cartpole-") and (out / "manifest.json").exists()
