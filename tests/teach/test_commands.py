"""`gpcjax teach` and `gpcjax replay`, up to where a lesson would begin: one line for each mistake."""

import builtins
import contextlib
import json
import re
import signal
import sys
from types import SimpleNamespace

import pytest

from gpcjax import cli
from gpcjax.registry import find
from gpcjax.teach.course import COURSE, Course
from gpcjax.teach.lesson import Lesson
from gpcjax.teach.protocol import Command
from gpcjax.teach.server import bound
from gpcjax.teach.standing import Options, Standing
from gpcjax.teach.teller import Teller
from gpcjax.teach.telling import described_learner


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    """An empty folder, and no lesson: whatever gets as far as one fails."""
    monkeypatch.chdir(tmp_path)

    def lesson(*words):
        raise AssertionError("a lesson would begin")

    monkeypatch.setattr("gpcjax.teach.run.Lesson", lesson)
    monkeypatch.setattr("gpcjax.teach.run.compute_here", lambda: None)
    return tmp_path


@pytest.fixture
def taught(here):
    """A folder where pendulum is taught."""
    (here / "mine").mkdir()
    Course("pendulum", "gpc").write(here / "mine")
    return here / "mine"


def fails(capsys, *words):
    """The one line that `gpcjax WORDS` complains with."""
    assert cli.main(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "Traceback" not in err, err
    return err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "--env"),
        (("--out", "new"), "--env"),
        (("--env", "pendulm"), "pendulum"),
        (("--env", ""), "--env"),
        (("--env", "pendulum", "--algo", "gpc,coach"), "one value"),
        (("--env", "pendulum", "--algo", "nobody"), "nobody"),
        (("--env", "pendulum", "--port", "65536"), "--port"),
        (("--env", "pendulum", "--port", "-1"), "--port"),
        (("--env", "pendulum", "--port", "http"), "--port"),
        (("--env", "pendulum", "--port", "80.5"), "--port"),
        (("--env", "pendulum", "--speed", "0"), "--speed"),
        (("--env", "pendulum", "--speed", "nan"), "--speed"),
        (("--env", "pendulum", "--speed", "1e9"), "--speed"),
        (("--env", "pendulum", "--repeat", "-1"), "--repeat"),
        (("--env", "pendulum", "--repeat", "inf"), "--repeat"),
        (("--env", "pendulum", "--seed", "-1"), "--seed"),
        (("--env", "pendulum", "--from", "nowhere"), "--from"),
        (("--env", "pendulum", "--from", ""), "--from"),
        (("--env", "pendulum", "--oracle", "nobody"), "--oracle"),
        (("--env", "pendulum", "--credit", "0.1,0.2"), "one value"),
        (("--env", "pendulum", "--nonsense", "1"), "--nonsense"),
        (("--env", "pendulum", "--host", "no such host", "--out", "o"), "--host"),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, tuple) else "",
)
def test_a_mistake_is_said_in_one_line(capsys, words, said):
    assert said in fails(capsys, "teach", *words)


def test_an_oracle_is_checked_for_a_lesson_that_goes_on_too(capsys, tmp_path):
    Course("pendulum", "gpc").write(tmp_path)
    assert "--oracle 'nobody': give" in fails(capsys, "teach", "--out", str(tmp_path), "--oracle", "nobody")


def test_a_port_in_use(capsys, here):
    with contextlib.closing(bound("127.0.0.1", 0, 1)) as taken:
        number = str(taken.getsockname()[1])
        assert f"--port {number}" in fails(
            capsys, "teach", "--env", "pendulum", "--out", "o", "--port", number
        )
    assert not (here / "o").exists()  # nothing was begun in it


def test_a_folder_of_something_else(capsys, here):
    (here / "other").mkdir()
    (here / "other" / "thesis.tex").write_text("years of work")
    assert "something else" in fails(capsys, "teach", "--env", "pendulum", "--out", "other")
    assert [path.name for path in (here / "other").iterdir()] == ["thesis.tex"]


def test_a_folder_that_is_a_file(capsys, here):
    (here / "file").write_text("")
    for out in ("file", "file/below"):
        assert "file" in fails(capsys, "teach", "--env", "pendulum", "--out", out)


def test_another_task_than_the_folders(capsys, taught):
    assert "give a new folder" in fails(capsys, "teach", "--env", "mountaincar", "--out", str(taught))


@pytest.mark.parametrize(
    "content",
    ["", "{", "[]", "null", "1", "[" * 5000, "\udcff", "{}", '{"format": 2}',
     '{"format": 1, "env": 3, "algo": "gpc", "settings": {}, "seed": 0}',
     '{"format": 1, "env": "pendulum", "algo": "gpc", "settings": {}, "seed": "0"}',
     '{"format": 1, "env": "pendulum", "algo": "gpc", "settings": {"nonsense": 1}, "seed": 0}',
     '{"format": 1, "env": "pendulum", "algo": "gpc", "settings": {"c": "x"}, "seed": 0}',
     '{"format": 1, "env": "pendulum", "algo": "gpc", "settings": {"c": NaN}, "seed": 0}',
     '{"format": 1, "env": "pendulum", "algo": "gpc", "settings": {"c": [1]}, "seed": 0}',
     '{"format": 1, "env": "pendulum", "algo": "gpc", "settings": {}, "seed": -1}',
     '{"format": 1, "env": "gone", "algo": "gpc", "settings": {}, "seed": 0}',
     '{"format": 1, "env": "pendulum", "algo": "gone", "settings": {}, "seed": 0}'],
)  # fmt: skip
@pytest.mark.parametrize("command", ["teach", "replay"])
def test_a_damaged_or_foreign_folder(capsys, taught, command, content):
    (taught / COURSE).write_text(content, errors="surrogateescape")
    words = ["--out", str(taught)] if command == "teach" else [str(taught)]
    assert "no flag" not in fails(capsys, command, *words)


def test_a_course_is_read_as_it_was_written(here):
    course = Course("pendulum", "gpc", (("credit", 0.3),), 7)
    course.write(here)
    assert Course.read(here) == course and json.loads((here / COURSE).read_text())["format"] == 1


@pytest.mark.parametrize("out", ["nowhere", ".", "file"])
def test_a_replay_of_nothing(capsys, here, out):
    (here / "file").write_text("")
    assert "gpcjax teach" in fails(capsys, "replay", out)


def test_ctrl_c_is_how_it_ends(capsys, here, monkeypatch):
    """That is no failure, and what was taught is kept."""

    def interrupted(serving):
        serving._socket.close()
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("gpcjax.teach.run.Lesson", Lesson)
    monkeypatch.setattr("gpcjax.teach.server.Serving.run", interrupted)
    monkeypatch.setattr(sys, "setswitchinterval", lambda seconds: None)
    assert cli.main(["teach", "--env", "pendulum", "--out", "mine", "--port", "0"]) == 0
    first, last = capsys.readouterr().out.splitlines()
    assert re.fullmatch(
        r"open http://127.0.0.1:\d+/ in a browser; Ctrl-C ends the lesson, mine keeps it", first
    )
    assert last == "kept in mine: gpcjax teach --out mine goes on with it"


def test_without_the_extra(capsys, monkeypatch):
    load = builtins.__import__

    def without(name, *rest):
        if name.split(".")[0] in ("uvicorn", "starlette"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return load(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.delitem(sys.modules, "gpcjax.teach.server", raising=False)
    monkeypatch.delattr("gpcjax.teach.server", raising=False)
    assert "pip install 'gpcjax[teach]'" in fails(capsys, "teach", "--env", "pendulum")


def test_a_page_has_no_module_loaded(here, monkeypatch):
    """The page's messages may name a learner that is offered, never MODULE:CLASS of its own."""
    (here / "planted.py").write_text("raise SystemExit('loaded')")
    monkeypatch.syspath_prepend(here)
    told = []
    lesson = Lesson(here, None, None, Options(), told.append)
    learner = SimpleNamespace(largest_sigma=lambda: 0.0, obs_size=3, action_size=1)
    taught = SimpleNamespace(
        course=Course("pendulum", "gpc"), session=SimpleNamespace(learner=learner, room=1)
    )
    lesson._taught, lesson._teller = taught, Teller(taught, Standing(1.0), Options(), told.append)
    lesson._obey(Command("learner", {"name": "planted:Learner", "settings": {}}))
    assert [message["type"] for message in told] == ["problem"] and "planted" not in sys.modules


@pytest.mark.parametrize(
    ("name", "sent", "settings", "variants"),
    [
        (
            "gpc",
            {"static_rate": 0.3},
            {"static_rate": 0.3, "credit": 0.2, "noise": 1e-3},
            {"sparsify": False},
        ),
        ("gpc", {}, {"credit": 0.2, "noise": 1e-3}, {"sparsify": False}),
        ("gpc-ns", {"constant_rate": 0.3}, {"constant_rate": 0.3, "credit": 0.2}, {}),
    ],
)
def test_begun_anew_the_same_learner_keeps_what_no_page_shows(
    here, monkeypatch, name, sent, settings, variants
):
    """What the page shows and does not send is as usual again."""
    course = Course(
        "pendulum",
        "gpc",
        (("static_rate", 0.5), ("noise", 1e-3), ("credit", 0.2)),
        variants=(("sparsify", False),),
    )
    lesson, begun = Lesson(here, None, None, Options(), print), []
    lesson._taught, lesson._teller = SimpleNamespace(course=course), SimpleNamespace(learners=lambda: [name])
    monkeypatch.setattr(Lesson, "_anew", lambda lesson, *given: begun.append(given))
    lesson._obey(Command("learner", {"name": name, "settings": sent}))
    ((made, origin),) = begun
    assert (dict(made.settings), dict(made.variants), origin) == (settings, variants, None)


def test_the_page_is_told_of_settings_of_a_learner_of_ones_own():
    told = described_learner("tests.teach.drifting:Turned", find("task", "pendulum"), {})
    assert [(each["name"], each["value"]) for each in told["settings"]] == [("reach", 1.0)]
