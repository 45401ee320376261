"""The sweep from its specification to a complete store, with workers that are only pretended; see test_sweeps."""

import contextlib
import json
import signal
import time

import pytest

from gpcjax.errors import UserError
from gpcjax.sweep import run as run_module
from gpcjax.sweep.executors import Totals
from gpcjax.sweep.plan import plan
from gpcjax.sweep.run import run, sweep
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store, read_episodes
from tests.sweep.test_store import rows

SETTINGS = {
    "env": "cartpole",
    "algo": "coach",
    "error": [0, 0.1],
    "seeds": 2,
    "episodes": 3,
    "oracle": ["lqr"],
}
SPEC = spec_of(**SETTINGS)
BASELINE = {"mean": 20.0, "std": 1.0, "n": 100}


class Pretended:
    """In place of `Executors`: hands in rows of all cells, or of some and then fails."""

    def __init__(self, fails_after=None, error=KeyboardInterrupt):
        self.fails_after, self.error, self.calls = fails_after, error, []

    def __call__(self, cells, baselines, jobs, on_rows, on_baseline, on_progress):
        cells, baselines = list(cells), list(baselines)
        self.calls.append((cells, baselines, jobs))
        self.work = lambda: self._work(cells, baselines, on_rows, on_baseline, on_progress)
        return self

    def run(self):
        self.work()

    def _work(self, cells, baselines, on_rows, on_baseline, on_progress):
        for _, name in baselines:
            on_baseline(name, BASELINE)
        for index, cell in enumerate(cells):
            if index == self.fails_after:
                raise self.error
            on_rows(rows(cell))
            on_progress(Totals(env_steps=10 * (index + 1), episodes=3 * (index + 1), compile_seconds=2.0))


@pytest.fixture
def pretend(monkeypatch):
    def make(*arguments, **options):
        pretended = Pretended(*arguments, **options)
        monkeypatch.setattr(run_module, "Executors", pretended)
        return pretended

    return make


def manifest(out):
    return json.loads((out / "manifest.json").read_text())


def test_a_whole_sweep(tmp_path, pretend):
    pretended = pretend()
    assert sweep(tmp_path / "deep" / "out", jobs=3, **SETTINGS) == tmp_path / "deep" / "out"
    out = tmp_path / "deep" / "out"
    assert pretended.calls == [(plan(SPEC), [("cartpole", "idle"), ("cartpole", "lqr")], 3)]
    assert len(read_episodes(out)) == 12
    written = manifest(out)
    assert written["complete"] and written["cells"] == 4 and written["jobs"] == 3 and written["format"] == 2
    assert written["baselines"] == {"idle": BASELINE, "oracles": {"lqr": BASELINE}}
    assert written["specification"]["error"] == [0, 0.1] and written["varying"] == []
    assert written["env_steps"] == 40 and written["compile_time_s"] == 2.0
    assert written["env_steps_per_s"] == pytest.approx(40 / written["wall_time_s"])
    assert {"jax", "jaxlib", "numpy", "gpcjax", "python"} <= written["versions"].keys()
    assert written["machine"]["cores"] >= 1 and written["machine"]["platform"]


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
    monkeypatch.setattr(run_module, "FLUSH_SECONDS", -1.0)
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
    monkeypatch.setattr(run_module, "FLUSH_SECONDS", 0.01)
    pretended = pretend()
    seen = []

    def work(cells, baselines, on_rows, on_baseline, on_progress):
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
    (tmp_path / "manifest.json").write_text(json.dumps(written))
    pretended = pretend()
    sweep(tmp_path, **SETTINGS)
    assert pretended.calls == [([], [("cartpole", "lqr")], 1)]
    assert manifest(tmp_path)["complete"] and manifest(tmp_path)["baselines"]["oracles"] == {"lqr": BASELINE}


def test_a_part_that_was_lost_is_run_again(tmp_path, pretend, monkeypatch):
    monkeypatch.setattr(run_module, "FLUSH_SECONDS", -1.0)
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
    def older(self, tmp_path, pretend):
        """A run folder that an older jax has begun."""

        def make(fails_after):
            pretend(fails_after)
            with contextlib.suppress(KeyboardInterrupt):
                sweep(tmp_path, **SETTINGS)
            written = manifest(tmp_path)
            written["versions"]["jax"] = "0.4.1"
            (tmp_path / "manifest.json").write_text(json.dumps(written))
            return pretend()

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


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"env": "cartpol"}, "env 'cartpol'"),
        ({"error": 1.5}, "error 1.5"),
        ({"seeds": 0}, "seeds 0"),
        ({"oracle": "energy"}, "oracle .*'energy'.*: give gpc or gpc-2 or gpc-3 or lqr for cartpole"),
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
    with pytest.raises(ValueError, match=r"it holds another specification \(seeds\)"):
        sweep(tmp_path, **(SETTINGS | {"seeds": 3}))


def test_the_default_folder(tmp_path, pretend, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pretend()
    out = sweep(**SETTINGS)
    assert out.parent.name == "runs" and out.name.startswith("cartpole-") and (out / "manifest.json").exists()
