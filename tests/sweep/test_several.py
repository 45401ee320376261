"""Several sweeps by the same workers, each into its own folder."""

import io
import time

import pytest

from gpcjax.errors import UserError
from gpcjax.sweep.beginning import begun
from gpcjax.sweep.executors import Errands, Processes
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.progress import Bar
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import run
from gpcjax.sweep.several import run_several
from gpcjax.sweep.spec import spec_of
from tests.sweep.pretended import BASELINE, rows

EPISODES = 3


def spec(algo, **settings):
    return spec_of(env="cartpole", algo=algo, oracle="lqr", **{"episodes": EPISODES, "seeds": 4, **settings})


class Worker:
    """In place of `Processes`: one worker, which a signal or an error may end before so many cells."""

    jobs = 1

    def __init__(self, stops_after=None, error=KeyboardInterrupt, wait=0.0):
        self.cells, self.stops_after, self.error, self.wait = [], stops_after, error, wait

    def run(self, office):
        while (answer := office.answer(0, ("ready",))) != ("stop",):
            match answer:
                case ("errand", *told):
                    self.cells.append(told)
                case ("baseline", _, name):
                    office.answer(0, ("baseline", name, BASELINE))
                case ("program", *_):
                    while taken := office.answer(0, ("next",))[1]:
                        for cell in taken:
                            self._hand_in(office, cell)
                    time.sleep(self.wait)

    def _hand_in(self, office, cell):
        if len(self.cells) == self.stops_after:
            raise self.error
        self.cells.append(cell)
        office.answer(0, ("rows", rows(cell, EPISODES)))


def folders(tmp_path):
    return [(spec(algo), tmp_path / algo) for algo in ("gpc", "coach")]


def test_each_folder_is_what_a_sweep_of_its_own_makes(tmp_path):
    run_several("both", folders(tmp_path), Worker())
    for each, out in folders(tmp_path):
        with begun(folder := tmp_path / f"{out.name} alone"):
            run(each, folder, 1, Worker())
        alone = read_episodes(folder)
        assert read_episodes(out).equals(alone) and len(alone) == 4 * EPISODES
        manifest = read_manifest(out)
        assert manifest["complete"] and manifest["baselines"]["oracles"] == {"lqr": BASELINE}


def test_what_is_over_is_complete_while_others_go_on(tmp_path):
    (_, first), (_, second) = folders(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run_several("both", folders(tmp_path), Worker(stops_after=5))
    assert read_manifest(first)["complete"]
    assert not read_manifest(second)["complete"] and len(read_episodes(second)) == EPISODES
    worker = Worker()
    run_several("both", folders(tmp_path), worker)
    assert [(cell.algo, cell.seed) for cell in worker.cells] == [("coach", seed) for seed in (1, 2, 3)]
    assert read_manifest(second)["complete"]


def test_the_time_of_another_one_is_none_of_its_own(tmp_path):
    run_several("both", folders(tmp_path), Worker(wait=0.3))
    times = [read_manifest(out)["wall_time_s"] for _, out in folders(tmp_path)]
    assert max(times) >= 0.3 and sum(times) < 2 * max(times)


def test_what_cannot_run_is_said_before_anything_has(tmp_path):
    (_, first), (_, second) = folders(tmp_path)
    second.mkdir()
    (second / "thesis.tex").touch()
    worker = Worker()
    with pytest.raises(UserError, match=r"thesis\.tex"):
        run_several("both", folders(tmp_path), worker)
    assert not worker.cells and not first.exists()


def test_none_grows(tmp_path):
    run_several("one", [(spec("gpc"), tmp_path / "gpc")], Worker())
    with pytest.raises(UserError, match="another specification"):
        run_several("one", [(spec("gpc", seeds=8), tmp_path / "gpc")], Worker())


def test_nothing_to_do_is_nothing_to_show(tmp_path):
    run_several("both", folders(tmp_path), Worker())
    stream, worker = io.StringIO(), Worker()
    watcher = lambda *told, **works: Bar(*told, stream=stream, **works)  # noqa: E731
    run_several("both", folders(tmp_path), worker, watcher=watcher)
    assert not worker.cells and not stream.getvalue()
    errand = ("module:function", ("word",))
    run_several("both", folders(tmp_path), worker, Errands([errand]), watcher=watcher)
    assert worker.cells == [list(errand)] and not stream.getvalue()


def test_they_are_shown_as_one(tmp_path):
    stream = io.StringIO()
    watcher = lambda *told, **works: Bar(*told, stream=stream, **works)  # noqa: E731
    run_several("both", folders(tmp_path), Worker(), watcher=watcher)
    first, last = stream.getvalue().splitlines()
    assert first.startswith("both: 8 cells in 1 process, about ") and "compiling" in first
    assert last.startswith("both: 0/8 cells in 0:00"), "this worker tells of no progress"


@pytest.mark.slow
def test_with_processes(tmp_path):
    """Rows are those of sweeps one after the other, and a function of ours is called."""
    asked = folders(tmp_path)
    errand = ("gpcjax.sweep.atomic:write_atomic", (tmp_path / "written", "word"))
    with Processes(2) as executor:
        run_several("both", asked, executor, Errands([errand]))
        assert (tmp_path / "written").read_text() == "word"
        again = [(each, tmp_path / f"{out.name} alone") for each, out in asked]
        for each, out in again:
            with begun(out):
                run(each, out, 2, executor)
    for (_, out), (_, alone) in zip(asked, again, strict=True):
        assert read_episodes(out).equals(read_episodes(alone))
