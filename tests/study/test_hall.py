"""Runs of several participants on one clock, on a task that takes no time: what they are told, and what is left."""

import dataclasses
import itertools
import json
import shutil
import threading
import time

import numpy as np
import pytest

import gpcjax
from gpcjax.engine.classroom import ROOMS
from gpcjax.errors import UserError
from gpcjax.recording import RECORD, Recording
from gpcjax.study.hall import Hall, Run
from gpcjax.sweep.given import Given
from gpcjax.teach.clerk import Clerk
from gpcjax.teach.course import COURSE, POLICY, Course
from gpcjax.teach.protocol import Press
from gpcjax.teach.taught import Taught
from tests.teach.writing import WritesHere, garbage_stays  # noqa: F401

ENV = "tests.teach.drifting:Drift"
STEPS = 12
"""Of an episode of it."""

SECRETS = ("gpc", "learner", "rate", "points", "sigma_human")


def course(seed=0, algo="gpc-ns", **settings):
    given = {name: Given((value,), name) for name, value in settings.items()}
    return Course.of({"env": Given(ENV, "env"), "algo": Given((algo,), "algo"), **given}, seed)


class Page:
    """A participant's page: all that it was told, and its seat."""

    def __init__(self, hall, folder, seed=0, episodes=1000, **how):
        self.told = []
        self._new = threading.Condition()
        self.run = Run(folder, course(seed), episodes, **how)
        self.seat = hall.seat(self.run, self._hear)

    def _hear(self, message):
        with self._new:
            self.told.append(message)
            self._new.notify_all()

    def messages(self, kind):
        return [each for each in list(self.told) if each["type"] == kind]

    def wait(self, kind, true=lambda message: True, seconds=60):
        found = lambda: next((each for each in self.messages(kind) if true(each)), None)  # noqa: E731
        with self._new:
            assert self._new.wait_for(found, seconds), (kind, self.told[-3:])
            return found()

    def press(self, number, h=1, dim=0, shown=0):
        self.seat.press(Press(number, dim, h, shown, 0.0, 0.0, False))

    def goes(self):
        self.wait("ready")
        self.seat.go_on()
        self.wait("state", lambda state: not state["paused"])
        return self

    def gone(self):
        self.seat.leave()
        assert self.seat.gone.wait(60)
        return self


@pytest.fixture(scope="module")
def problems():
    return []


@pytest.fixture(scope="module")
def hall(problems, garbage_stays):  # noqa: F811
    """With room for four points at first, then for eight. What is left of a run is written by this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gpcjax.study.kind.ROOMS", ((4, 4), (8, 8)))
        patch.setattr("gpcjax.study.hall.Clerk", WritesHere)
        hall = Hall([course()], 6, problems.append)
        hall.start()
        yield hall
        hall.close()
    assert problems == [] and garbage_stays == ["collect", "freeze", "unfreeze"]


@pytest.fixture(autouse=True)
def empty(hall):
    """Each test leaves the hall empty, however it ends."""
    yield
    for seat in list(hall._seats):
        seat.leave()
        assert seat.gone.wait(60)
    assert hall.free == 6


def replayed(folder):
    """The run made again alone, with every step of its task compared."""
    return Taught.resume(folder, lambda line: None, whole=True)


def test_a_run_from_its_beginning_to_its_end(hall, tmp_path):
    page = Page(hall, tmp_path / "run", seed=5, episodes=3)
    frame = page.wait("frame")
    assert (frame["n"], frame["episode"], frame["step"], frame["sigma"], frame["prior"]) == (
        1,
        0,
        0,
        None,
        None,
    )
    assert page.wait("state") == {
        "type": "state", "mode": "teach", "paused": True, "why": "start", "speed": 1.0, "undos": 0
    }  # fmt: skip
    page.press(1)  # it rests: nobody advises
    page.goes()
    page.wait("frame", lambda frame: frame["step"] == 2)
    for number in range(2, 12):
        page.press(number, h=-1 if number % 3 else 1)
    done = page.wait("advised", lambda advised: advised["id"] == 11)
    assert done["corrections"] == 10
    first = page.messages("advised")[0]
    assert first["before"] == 0.0 and first["after"] < 0.0
    page.wait("over")
    assert [each["index"] for each in page.messages("episode")] == [0, 1, 2]
    assert {each["why"] for each in page.messages("episode")} == {"over"}
    frames = page.messages("frame")
    assert [each["n"] for each in frames] == list(range(1, 3 * STEPS + 1))
    standing = page.seat.standing
    assert (standing.episode, standing.corrections, standing.paused, standing.why) == (3, 10, True, "over")
    # All is written when it is told to be over.
    rows = gpcjax.load(page.run.folder)
    assert rows["length"].tolist() == [STEPS] * 3 and rows["corrections"].sum() == 10
    assert rows["return"].tolist() == [each["total"] for each in page.messages("episode")]
    assert np.isfinite(gpcjax.load_policy(page.run.folder / POLICY)([0.1, 0.2])).all()
    again = replayed(page.run.folder)
    assert again.tally.corrections == 10 and len(again.tally.finished) == 3
    page.gone()


def test_nothing_tells_who_learns(hall, tmp_path):
    page = Page(hall, tmp_path / "blind", cue=True).goes()
    page.press(1)
    page.wait("advised")
    page.wait("frame", lambda frame: frame["sigma"] is not None)
    assert page.messages("frame")[0]["prior"] > 0
    page.gone()
    for message in page.told:
        text = json.dumps({name: value for name, value in message.items() if name not in ("sigma", "prior")})
        assert not [word for word in SECRETS if word in text], text


def test_a_reload_is_told_all_and_changes_nothing(hall, tmp_path):
    page = Page(hall, tmp_path / "reload").goes()
    page.wait("episode")
    page.seat.pause("connection")
    page.wait("state", lambda state: state["why"] == "connection")
    page.told.clear()
    page.seat.everything()
    frame = page.wait("frame")
    assert [each["type"] for each in page.told[:3]] == ["task", "ready", "state"]
    assert len(page.told[0]["episodes"]) == 1 and frame["episode"] == 1
    assert page.messages("state")[0]["why"] == "connection"
    page.seat.go_on()
    page.wait("frame", lambda each: each["step"] == frame["step"] + 1)
    page.gone()
    replayed(page.run.folder)


def test_limits_of_time(hall, tmp_path):
    page = Page(hall, tmp_path / "time", episodes=100, seconds=0.3).goes()
    page.wait("over")
    assert [each["why"] for each in page.messages("episode")] == ["over", "over", "time"]
    assert page.messages("episode")[-1]["steps"] == 30 - 2 * STEPS
    page.gone()
    again = Page(hall, tmp_path / "time", episodes=100, seconds=0.3)
    again.wait("over")
    again.seat.go_on()
    assert again.wait("state", lambda state: state["paused"])["why"] == "over"
    again.gone()
    assert len(replayed(page.run.folder).tally.finished) == 3


def test_nothing_of_a_run_is_written_after_it_was_awaited(hall, tmp_path, monkeypatch):
    """As who is deleted asks for: what a hall writes when a run is left would make its folder anew."""
    page = Page(hall, tmp_path / "p0001" / "runs" / "1").goes()
    page.press(1)
    page.wait("advised")
    page.wait("episode")
    write, wrote = hall._clerk.write, []

    release = threading.Event()

    def held_back(kept):
        assert release.wait(60)
        write(kept)
        wrote.append(kept.folder)

    monkeypatch.setattr(hall._clerk, "write", held_back)
    page.seat.leave()
    hall.await_left(tmp_path / "p0002")
    waiting = threading.Thread(target=hall.await_left, args=(tmp_path / "p0001",))
    waiting.start()
    assert not wrote
    release.set()
    waiting.join(60)
    assert page.seat.gone.is_set() and wrote[-1] == page.seat.run.folder


def test_it_goes_on_where_it_was_left(hall, tmp_path):
    """Also within an episode, beyond the growth of a dictionary: as one that nobody interrupted."""
    folder = tmp_path / "left"
    page = Page(hall, folder, seed=9).goes()
    for number in range(1, 8):
        page.press(number, h=1 if number % 2 else -1)
        page.wait("advised", lambda advised, number=number: advised["id"] == number)
    page.wait("frame", lambda frame: (frame["episode"], frame["step"]) >= (1, 5))
    page.gone()
    left = page.seat.standing
    again = Page(hall, folder, seed=9).goes()
    first = again.wait("frame")
    assert again.messages("task")[0]["corrections"] == 7
    again.press(8)
    again.wait("advised")
    again.wait("frame", lambda frame: frame["episode"] > first["episode"] + 1)
    again.gone()
    done = replayed(folder)
    assert done.tally.corrections == 8 and done.session.points[1] > 4
    assert left.corrections == 7 or left.why == "left"
    times = [event["time"] for event in Recording.read(folder / RECORD)[1]]
    assert any(later < earlier for earlier, later in itertools.pairwise(times))  # two programs


@pytest.mark.parametrize(
    "names",
    [
        ("torn", "noted", "empty"),
        pytest.param(("ended", "begun"), marks=pytest.mark.slow),
    ],
    ids="-".join,
)
def test_a_process_that_died(hall, tmp_path, names):
    """Wherever its file ends: within a line, between an episode's last lines, before its first."""
    page = Page(hall, tmp_path / "whole", seed=3).goes()
    page.press(1)
    page.wait("episode")
    page.wait("frame", lambda frame: (frame["episode"], frame["step"]) == (1, 3))
    page.gone()
    lines = (page.run.folder / RECORD).read_bytes().splitlines(keepends=True)
    ended = next(index for index, line in enumerate(lines) if b'"end"' in line)
    kept = {
        "torn": [*lines[:-1], lines[-1][:20]],
        "ended": lines[: ended + 1],
        "noted": lines[:ended],
        "begun": lines[:1],
        "empty": [],
    }
    for name in names:
        folder = tmp_path / name
        folder.mkdir()
        shutil.copy(page.run.folder / COURSE, folder)
        (folder / RECORD).write_bytes(b"".join(kept[name]))
        again = Page(hall, folder, seed=3).goes()
        frame = again.wait("frame")
        again.wait("frame", lambda each, frame=frame: each["n"] > frame["n"] + 3)
        again.gone()
        replayed(folder)


@pytest.mark.slow
def test_several_at_once_are_the_same_alone(hall, tmp_path):
    pages = [Page(hall, tmp_path / f"{seed}", seed=seed) for seed in range(5)]
    draw = np.random.default_rng(0)
    for page in pages:
        page.goes()
    for number in range(1, 31):
        pages[int(draw.integers(5))].press(number, h=int(draw.choice([-1, 1])))
        time.sleep(0.005)
    for page in pages:
        page.wait("frame", lambda frame: frame["episode"] == 2)
        page.gone()
    totals = [replayed(page.run.folder).tally.finished[0].total for page in pages]
    assert len(set(totals)) == 5


def test_places(hall, tmp_path):
    pages = [Page(hall, tmp_path / f"{seed}", seed=seed) for seed in range(6)]
    for page in pages:
        page.wait("ready")
    with pytest.raises(UserError, match="all 6 places are taken"):
        Page(hall, tmp_path / "6")
    with pytest.raises(UserError, match="somebody is at this run"):
        Page(hall, tmp_path / "0")
    pages[0].seat.leave()
    again = Page(hall, tmp_path / "0") if pages[0].seat.gone.wait(60) else None
    again.wait("ready")
    for page in [again, *pages[1:]]:
        page.gone()
    assert hall.free == 6


def test_what_is_not_taught_here_is_refused(hall, tmp_path):
    with pytest.raises(UserError, match="is not taught here"):
        hall.seat(Run(tmp_path / "other", course(algo="gpc"), 1), print)


@pytest.mark.parametrize(
    ("does", "message"),
    [
        (lambda folder: (folder / COURSE).write_text("{}"), "damaged"),
        (lambda folder: course(seed=8).write(folder), "something else is taught there"),
        (
            lambda folder: (course().write(folder), (folder / RECORD).write_text("{}\n")),
            "no record of a session",
        ),
    ],
)
def test_a_damaged_folder_is_told(hall, tmp_path, does, message):
    does(tmp_path)
    page = Page(hall, tmp_path)
    assert message in page.wait("problem")["text"]
    assert page.seat.standing.why == "problem" and message in page.seat.standing.problem
    page.seat.go_on()
    page.press(1)
    page.gone()
    assert hall.free == 6


def test_a_full_disk_stops_one_run_until_there_is_room(hall, tmp_path, monkeypatch):
    monkeypatch.setattr("gpcjax.study.hall.FLUSH_APART", 0.1)
    page = Page(hall, tmp_path / "full").goes()
    other = Page(hall, tmp_path / "other", seed=1).goes()
    page.wait("frame", lambda frame: frame["step"] == 3)
    record, away = page.run.folder / RECORD, tmp_path / "away"
    record.rename(away)
    assert "cannot be written" in page.wait("problem")["text"]
    page.seat.go_on()
    page.wait("problem", lambda each: len(page.messages("problem")) > 1)
    at = len(other.messages("frame"))
    away.rename(record)
    page.told.clear()
    page.seat.go_on()
    page.wait("frame")
    assert len(other.messages("frame")) > at
    for each in (page, other):
        each.gone()
        replayed(each.run.folder)


@pytest.mark.slow
def test_the_process_that_writes_may_die(hall, tmp_path, monkeypatch):
    clerk = Clerk()
    monkeypatch.setattr(hall, "_clerk", clerk)
    page = Page(hall, tmp_path / "run", episodes=1).goes()
    clerk._process.kill()
    page.wait("over")
    assert len(gpcjax.load(page.run.folder)) == 1
    page.gone()
    clerk.close()


def test_a_run_whose_rewards_come_to_no_number_rests_alone(hall, tmp_path, monkeypatch):
    odd, other = Page(hall, tmp_path / "odd").goes(), Page(hall, tmp_path / "other", seed=1).goes()
    moved = Taught.moved

    def comes_to_none(taught, told):
        moved(taught, told._replace(reward=np.inf) if taught.folder.name == "odd" else told)

    monkeypatch.setattr(Taught, "moved", comes_to_none)
    assert "add up to inf" in odd.wait("problem")["text"]
    steps = len(other.messages("frame"))
    other.wait("frame", lambda frame: frame["n"] > steps + 3)
    assert odd.seat.broken and other.seat.runs


def test_garbage_and_a_page_that_fails_are_its_own_affair(hall, problems, tmp_path):
    other = Page(hall, tmp_path / "other").goes()
    page = Page(hall, tmp_path / "bad", seed=1).goes()
    for press in (Press(1, 7, 1, 0, 0.0, 0.0, False), Press(2, 0, 1, 2**40, 0.0, 0.0, True)):
        page.seat.press(press)
    page.wait("advised")

    def fails(message):
        raise RuntimeError("the page is gone")

    page.seat.say = fails
    other.wait("frame", lambda frame: frame["episode"] == 1)
    page.seat.say = lambda message: None
    other.gone()
    page.gone()
    assert problems and all("the page is gone" in each for each in problems)
    problems.clear()


@pytest.mark.slow
def test_all_of_a_study_at_once_are_the_same_alone(compiled_as_shipped, monkeypatch, tmp_path):
    """64 of four kinds, with advice at random until dictionaries have outgrown a room; each replays to the bit."""
    monkeypatch.setattr("gpcjax.study.kind.ROOMS", ROOMS[:2])
    kinds = [("cartpole", "gpc"), ("pendulum", "gpc-ns"), ("cartpole", "coach"), ("pendulum", "coach")]
    problems: list[str] = []
    courses = [Course.of({"env": Given(env, "env"), "algo": Given((algo,), "algo")}) for env, algo in kinds]
    hall = Hall(courses, 64, problems.append)
    hall.start()
    draw, pages = np.random.default_rng(0), []
    for number in range(64):
        page = Page.__new__(Page)
        page.told, page._new = [], threading.Condition()
        page.run = Run(tmp_path / f"{number}", dataclasses.replace(courses[number % 4], seed=number), 10**6)
        page.seat = hall.seat(page.run, page._hear)
        pages.append(page)
    for page in pages:
        page.goes()
    eager, ends, number = pages[:4], time.monotonic() + 200, 0
    while min(page.seat.standing.corrections for page in eager) <= 80:
        number += 1
        page = eager[number // 2 % 4] if number % 2 else pages[int(draw.integers(64))]
        page.press(number, h=int(draw.choice([-1, 1])))
        page.wait("advised", lambda advised, number=number: advised["id"] == number)
        assert time.monotonic() < ends
    for page in pages:
        page.gone()
    hall.close()
    assert problems == []
    for page in [*eager, *pages[32:36]]:
        again = replayed(page.run.folder)
        assert again.tally.corrections == page.messages("advised")[-1]["corrections"]
        assert page not in eager or page.run.course.algo == "coach" or again.session.points[1] > 64
