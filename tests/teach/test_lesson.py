"""A lesson with its clock, on a task that takes no time: what the page asks for, and what it is told."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import gpcjax
from gpcjax.sweep.given import Given
from gpcjax.teach.course import DICTIONARY, RECORD, Course
from gpcjax.teach.lesson import Lesson
from gpcjax.teach.protocol import Command, Press
from gpcjax.teach.standing import Options
from tests.teach.writing import WritesHere, garbage_stays  # noqa: F401

ENV = "tests.teach.drifting:Drift"
ROOT = Path(__file__).parents[2]


class Held:
    """A lesson, and all that it has told."""

    def __init__(
        self, folder, origin=None, fresh=True, env=ENV, algo="gpc-ns", oracle="tests.teach.drifting:expert"
    ):
        self.told = []
        folder.mkdir(exist_ok=True)
        course = Course.of({"env": Given(env, "env"), "algo": Given((algo,), "algo")}, 5) if fresh else None
        self.lesson = Lesson(folder, course, origin, Options(oracle=oracle), self._hear)
        self.lesson.start()
        assert self.lesson.ready.wait(300)
        assert self.lesson.failure is None

    def _hear(self, message):
        self.told.append(message)

    def ask(self, kind, press=None, **values):
        self.lesson.submit(Command(kind, values, press))

    def press(self, number, h=1, dim=0, shown=0):
        self.ask("press", Press(number, dim, h, shown, 0.0, 0.0, False))

    def messages(self, kind):
        return [each for each in list(self.told) if isinstance(each, dict) and each["type"] == kind]

    def wait(self, kind, true=lambda message: True, seconds=90):
        """The first message of this type, among those told since the last `forget`, for which this is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for message in self.messages(kind):
                if true(message):
                    return message
            time.sleep(0.01)
        raise AssertionError(f"no such {kind}: {self.messages(kind)[-3:]}, {self.messages('problem')}")

    def forget(self):
        self.told.clear()


@pytest.fixture(scope="module")
def small_dictionaries():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gpcjax.teach.beginning.DICTIONARY", 8)
        yield


@pytest.fixture(scope="module")
def held(tmp_path_factory, small_dictionaries):
    held = Held(tmp_path_factory.mktemp("lessons") / "taught-1")
    yield held
    held.lesson.close()
    assert held.lesson.failure is None


@pytest.fixture(scope="module", autouse=True)
def put_aside_and_given_back(garbage_stays):  # noqa: F811
    """What each lesson of this module does with what was loaded before."""
    yield
    begun = [number for number, what in enumerate(garbage_stays) if what == "freeze"]
    assert begun and all(garbage_stays[number - 1] == "collect" for number in begun)
    assert garbage_stays[-1] == "unfreeze" and garbage_stays.count("unfreeze") >= len(begun)


@pytest.fixture(autouse=True)
def resting(request):
    """Each test begins with a lesson that rests and says nothing."""
    if "held" in request.fixturenames:
        held = request.getfixturevalue("held")
        held.forget()
        held.ask("pause", on=True)
        held.wait("state", lambda state: state["paused"])
        held.forget()


def test_a_page_is_told_everything(held):
    held.ask("joined")
    task = held.wait("task")
    assert task["task"]["scene"] == "pictures" and len(task["task"]["observations"]) == 2
    assert task["learner"]["name"] == "gpc-ns"
    assert "coach" not in [each["name"] for each in task["learners"]]  # no grid of it is known here
    frame = held.wait("frame")
    assert len(frame["obs"]) == 2 and len(frame["action"]) == 1 and frame["prior"] > 0
    lines = held.wait("lines", lambda lines: lines["oracle"] is not None, 60)
    assert lines["oracle"] > lines["idle"]
    drawn = held.wait("map")
    assert drawn["size"] == [41, 41]
    held.ask("step")
    assert isinstance(held.wait("frame", lambda frame: frame["n"] > held.messages("frame")[0]["n"]), dict)
    end = time.monotonic() + 10
    while not any(isinstance(each, bytes) for each in list(held.told)):
        assert time.monotonic() < end, "no picture"
        time.sleep(0.01)


def test_a_press_starts_it_and_counts(held):
    held.ask("left")
    held.wait("state", lambda state: state["why"] == "connection" or state["paused"])
    held.forget()
    held.ask("pause", on=False)
    held.press(7)
    advised = held.wait("advised")
    assert advised["id"] == 7 and advised["after"] > advised["before"] and advised["status"] == "ok"
    held.wait("frame")
    held.wait("episode", lambda episode: episode["why"] == "over" and episode["steps"] == 12)


def test_at_rest_a_press_teaches_and_nothing_moves(held):
    held.press(8, h=-1)
    advised = held.wait("advised")
    assert advised["after"] < advised["before"]
    assert not held.messages("frame")
    held.ask("undo")
    undone = held.wait("undone")
    assert undone["corrections"] == advised["corrections"] - 1


def test_a_step_and_the_end_of_an_episode(held):
    held.ask("step")
    first = held.wait("frame")
    held.ask("reset")
    ended = held.wait("episode")
    assert ended["why"] == "reset" and ended["index"] == first["episode"]
    frame = held.wait("frame", lambda frame: frame["step"] == 0)
    assert frame["episode"] == first["episode"] + 1 and frame["total"] == 0.0


def test_advice_about_an_episode_that_is_over_is_none(held):
    held.ask("step")
    shown = held.wait("frame")["n"]
    held.ask("reset")
    held.wait("episode")
    held.press(9, shown=shown)
    held.press(10, dim=3)
    held.press(11)
    held.wait("advised")
    assert [each["id"] for each in held.messages("advised")] == [11]


def test_let_it_run(held):
    held.ask("run", on=True)
    held.wait("episode", lambda episode: episode["mode"] == "run")
    held.press(12)
    held.ask("run", on=False)
    held.wait("state", lambda state: state["mode"] == "teach")
    assert not held.messages("advised")


def test_speed(held):
    held.ask("speed", value=0.5)
    assert held.wait("state", lambda state: state["speed"] == 0.5)
    held.ask("speed", value=1.0)


def test_after_a_sleep_no_steps_are_made_up_for(held):
    """A laptop that slept for an hour: its clock goes on from now."""
    held.ask("pause", on=False)
    held.wait("frame")
    held.lesson._teaching._due -= 3600.0
    held.forget()
    began = time.monotonic()
    time.sleep(0.3)
    held.ask("pause", on=True)
    held.wait("state", lambda state: state["paused"])
    seconds = time.monotonic() - began
    assert len(held.messages("frame")) <= 2 + seconds / 0.01 + 0.25 / 0.01


def test_map(held, monkeypatch):
    monkeypatch.setattr("gpcjax.teach.teller.MAP_APART", 0.0)
    held.ask("map", x=1, y=0, dim=0)
    drawn = held.wait("map", lambda drawn: drawn["x"] == 1)
    assert drawn["y"] == 0
    held.ask("map", x=1, y=9, dim=0)  # there is no such number
    held.ask("map", x=0, y=1, dim=0)
    held.wait("map", lambda drawn: drawn["x"] == 0)
    assert all(drawn["y"] != 9 for drawn in held.messages("map"))


@pytest.fixture(scope="module", autouse=True)
def writes_here():
    """But for a lesson that is a process of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gpcjax.teach.teller.Clerk", WritesHere)
        yield


def test_saved_and_opened(held):
    first = held.lesson.folder
    held.press(13)
    held.wait("advised")
    held.ask("save", name="good")
    assert held.wait("saved")["saves"] == ["good"]
    held.ask("open", name="nothing")
    assert "nothing is saved" in held.wait("problem")["text"]
    held.ask("learner", name="gpc", settings={"policy_length_scale": -1.0})
    held.wait("problem", lambda problem: "policy_length_scale" in problem["text"])
    assert held.lesson.folder == first
    held.forget()
    held.ask("open", name="good")
    task = held.wait("task", seconds=120)
    assert task["corrections"] == 0 and task["points"][1] > 0
    second = held.lesson.folder
    assert second.name == "taught-2" and (second / "start").is_dir()


def test_what_was_asked_while_one_lesson_ended_is_no_matter_of_the_next(held, monkeypatch):
    held.ask("step")
    shown = held.wait("frame")["n"]
    held.ask("save", name="before")
    held.wait("saved")
    end = Lesson._end
    monkeypatch.setattr(Lesson, "_end", lambda lesson: (held.told.append({"type": "ends"}), end(lesson)))
    held.forget()
    held.ask("open", name="before")
    held.press(20)
    for kind, values in (("step", {}), ("reset", {}), ("undo", {}), ("speed", {"value": 2.0})):
        held.ask(kind, **values)
    held.ask("joined")
    held.wait("task", seconds=120)
    assert [each["type"] for each in held.told[:2]] == ["preparing", "ends"]
    held.press(21, shown=shown)  # it was under way: about what another lesson had shown
    held.ask("save", name="after")
    held.wait("saved")
    assert held.lesson._standing.paused and held.lesson._standing.speed == 1.0
    assert held.lesson._taught.present.length == 0 and held.lesson._taught.episode == 0
    held.press(22, shown=held.wait("frame")["n"])
    held.wait("advised")
    assert [each["id"] for each in held.messages("advised")] == [22]
    assert len(held.messages("task")) == 2, "the page that came is told everything"


@pytest.mark.parametrize(
    ("algo", "setting"),
    [("gpc", "constant_rate"), pytest.param("d-coach", "learning_rate", marks=pytest.mark.slow)],
)
def test_begun_anew_with_another_learner(held, algo, setting):
    first, number = held.lesson.folder.name.rsplit("-", 1)
    held.ask("learner", name=algo, settings={setting: 0.1})
    task = held.wait("task", seconds=120)
    assert task["learner"]["name"] == algo and held.lesson.folder.name == f"{first}-{int(number) + 1}"
    assert {each["name"]: each["value"] for each in task["learner"]["settings"]}[setting] == 0.1


def test_two_lessons_in_one_folder(held):
    told = []
    other = Lesson(held.lesson.folder, None, None, Options(), told.append)
    other.start()
    other.ready.wait(60)
    other.close()
    assert "in use" in str(other.failure) or "writes" in str(other.failure) or "another" in str(other.failure)


class TestFailing:
    """Code of a person's own that fails on the way: it is said, the lesson rests, and goes on."""

    @pytest.fixture
    def begun(self, tmp_path, small_dictionaries):
        begun = []

        def begin(**words):
            begun.append(Held(tmp_path / f"taught-{len(begun)}", **words))
            return begun[-1]

        yield begin
        for each in begun:
            each.lesson.close()
            assert each.lesson.failure is None

    @pytest.mark.parametrize(
        ("task", "said"),
        [pytest.param("Odd", "reward nan", marks=pytest.mark.slow), ("Broken", "a wheel came off")],
    )
    def test_a_task(self, begun, task, said, capfd):
        held = begun(env=f"tests.teach.failing:{task}")
        assert held.wait("task")["task"]["scene"] == "signals"
        assert "no paint" in held.wait("problem")["text"]
        for _ in range(2):
            held.forget()
            held.ask("pause", on=False)
            assert said in held.wait("problem")["text"]
            ended = held.wait("episode", lambda episode: episode["why"] == "problem")
            assert ended["steps"] == 4
            held.wait("state", _rests_on_a_problem)
            held.wait("frame", lambda frame, next_=ended["index"] + 1: frame["episode"] == next_)
        assert len(held.messages("problem")) == 1
        held.forget()
        held.ask("pause", on=False)
        held.wait("state", lambda state: not state["paused"])
        held.ask("run", on=True)
        assert said in held.wait("problem")["text"]
        held.wait("frame", lambda frame: frame["mode"] == "teach")
        held.wait("state", _rests_on_a_problem)
        held.press(3)
        held.wait("advised")
        if task == "Broken":
            assert 'raise RuntimeError("a wheel came off")' in capfd.readouterr().err  # where, to its author

    @pytest.mark.slow
    def test_an_episode_that_cannot_begin(self, begun, monkeypatch):
        held = begun()
        with monkeypatch.context() as patch:
            patch.setattr("gpcjax.teach.world._started", _failing)
            for ask in (("reset", {}), ("pause", {"on": False}), ("run", {"on": True}), ("undo", {})):
                held.forget()
                held.ask(ask[0], **ask[1])
                assert "reset fails (RuntimeError: no road)" in held.wait("problem")["text"]
                held.wait("state", _rests_on_a_problem)
        held.forget()
        held.ask("pause", on=False)
        held.wait("frame", lambda frame: frame["episode"] == 1 and frame["step"] > 0)

    def test_a_learner(self, begun):
        held = begun(algo="tests.teach.failing:Refusing")
        held.press(1, h=-1)
        assert "Refusing: it fails" in held.wait("problem")["text"]
        held.press(2, h=1)
        assert held.wait("advised")["corrections"] == 1

    def test_a_policy_that_comes_to_no_number(self, begun):
        """What made it so can be taken back."""
        held = begun(algo="tests.teach.failing:Diverging")
        held.press(1)
        for kind, values in (("step", {}), ("reset", {}), ("run", {"on": True})):
            held.forget()
            held.ask(kind, **values)
            assert "is no number" in held.wait("problem")["text"]
        held.ask("undo")
        held.wait("undone")
        held.forget()
        held.ask("pause", on=False)
        held.wait("frame", lambda frame: frame["episode"] == 1 and frame["step"] > 0)

    @pytest.mark.slow
    def test_an_expert(self, begun):
        held = begun(oracle="tests.teach.failing:expert")
        assert "the lines" in held.wait("problem")["text"]
        assert held.wait("task")["lines"]["oracle"] is None


def _rests_on_a_problem(state):
    return state["paused"] and state["why"] == "problem" and state["mode"] == "teach"


def _failing(*words):
    raise RuntimeError("no road")


def command(*words):
    return [sys.executable, "-m", "gpcjax", *map(str, words)]


@pytest.mark.slow
def test_killed_and_gone_on_with(tmp_path, compiled_as_shipped, monkeypatch):
    """Kill -9 of a lesson as a process: what was recorded is there, is the same to the bit, and goes on."""
    monkeypatch.setattr("gpcjax.teach.beginning.DICTIONARY", DICTIONARY)  # as there
    folder = tmp_path / "taught-1"
    script = f"""
import time
from tests.teach.test_lesson import Held
from pathlib import Path
held = Held(Path({str(folder)!r}))
held.ask("pause", on=False)
for number in range(1000):
    held.press(number, h=1 if number % 3 else -1)
    time.sleep(0.02)
"""
    process = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT)
    end = time.monotonic() + 120
    while not (folder / RECORD).exists() or (folder / RECORD).read_bytes().count(b'"advise"') < 30:
        assert time.monotonic() < end and process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    advised = (folder / RECORD).read_bytes().count(b'"advise"')
    held = Held(folder, fresh=False)
    assert held.wait("task")["corrections"] == advised
    held.ask("pause", on=False)
    held.press(1)
    held.wait("advised", lambda advised_: advised_["corrections"] == advised + 1)
    held.lesson.close()
    done = subprocess.run(command("replay", folder), cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "the same to the bit" in done.stdout, done.stderr
    assert len(gpcjax.load(folder)) >= 1
