"""A real browser: the page teaches, looked at and pressed as a person would, and no more than a person could see."""

import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from gpcjax import cli
from gpcjax.recording import RECORD
from gpcjax.sweep.reading import read_episodes
from gpcjax.teach.course import POLICY
from gpcjax.teach.server import Serving
from tests.teach.writing import WritesHere, garbage_stays  # noqa: F401

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian: apt install chromium)")

TEACHER = (Path(__file__).parent / "teacher.js").read_text()
GPCJAX = Path(__file__).parents[2]
PHASE = "document.documentElement.dataset.phase"


class InThread:
    """`gpcjax teach` in a thread, but for Ctrl-C: most of a process is what it imports."""

    def __init__(self, folder, env):
        self.folder, self._status, made = folder, [], queue.SimpleQueue()
        words = ["teach", "--env", env, "--algo", "coach", "--out", str(folder), "--port", "0"]
        words += ["--speed", "0.25"]  # nobody holds the pole: it takes a while to fall

        class Known(Serving):
            def __init__(self, *words):
                super().__init__(*words)
                made.put(self)

        def teach():
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("gpcjax.teach.run.compute_here", lambda: None)
                patch.setattr("gpcjax.teach.server.Serving", Known)
                patch.setattr("gpcjax.teach.teller.Clerk", WritesHere)
                self._status.append(cli.main(words))

        self._thread = threading.Thread(target=teach, daemon=True)
        self._thread.start()
        self._serving = made.get(timeout=60)
        self.address = self._serving.address

    def end(self):
        self._serving._server.should_exit = True
        self._thread.join(120)
        assert self._status == [0]


class Server:
    """`gpcjax teach` in a process of its own."""

    def __init__(self, folder, env):
        words = [sys.executable, "-m", "gpcjax", "teach", "--env", env, "--out", str(folder), "--port", "0"]
        self.folder = folder
        self._process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=GPCJAX, env=os.environ
        )
        self.address = self._process.stdout.readline().split()[1]

    def end(self):
        self._process.send_signal(signal.SIGINT)
        said, _ = self._process.communicate(timeout=120)
        assert self._process.returncode == 0, said
        return said


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def lesson(tmp_path_factory, garbage_stays):  # noqa: F811
    """One that is taught on from test to test: what it compiles takes longer than they do."""
    before = sys.getswitchinterval()
    server = InThread(tmp_path_factory.mktemp("lesson") / "cartpole", "cartpole")
    yield server
    server.end()
    assert b'"advise"' in (server.folder / RECORD).read_bytes() and (server.folder / POLICY).is_dir()
    sys.setswitchinterval(before)


@pytest.fixture
def opened(browser, tmp_path):
    """Opens the page of a task, or of a server, ready to begin; what a page complains of fails the test."""
    servers, complaints = [], []

    def open_(env, **options):
        server = env
        if isinstance(env, str):
            server = Server(tmp_path / env, env)
            servers.append(server)
        page = browser.new_page(**options)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(server.address)
        _until(lambda: page.evaluate(PHASE) in ("waiting", "paused"), 240)
        return page, server

    yield open_
    for context in browser.contexts:
        context.close()
    for server in servers:
        if server._process.poll() is None:
            server.end()
    assert complaints == []


def _until(true, seconds, pause=0.02):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it did not come"
        time.sleep(pause)


def _shown(page, name):
    return float(page.evaluate(f"document.documentElement.dataset.{name} || 0"))


def _settled(page, name):
    """What is shown, once nothing more comes that was on its way."""
    shown = [_shown(page, name)]
    _until(lambda: shown.append(_shown(page, name)) or (len(shown) > 5 and len({*shown[-5:]}) == 1), 60, 0.1)
    return shown[-1]


def _taught(server):
    """The returns of its rows, once it has ended."""
    server.end()
    replayed = subprocess.run(
        [sys.executable, "-m", "gpcjax", "replay", str(server.folder)],
        capture_output=True,
        text=True,
        cwd=GPCJAX,
        check=False,
    )
    assert replayed.returncode == 0 and "the same to the bit" in replayed.stdout, replayed.stderr
    return read_episodes(server.folder)["return"].to_numpy()


@pytest.mark.slow
def test_a_cart_pole_is_taught_to_stand(opened):
    """By who looks at the page alone, to the full 2,500 steps."""
    page, server = opened("cartpole")
    page.keyboard.press("Space")
    page.evaluate(TEACHER, "cartpole")
    stood = lambda: _shown(page, "step") >= 2400  # noqa: E731
    _until(stood, 400)
    _until(lambda: not stood(), 60)
    page.close()
    assert 2500.0 in _taught(server)


@pytest.mark.slow
def test_a_pendulum_is_taught_to_swing_up(opened):
    page, server = opened("pendulum")
    page.keyboard.press("Space")
    page.evaluate(TEACHER, "pendulum")
    _until(lambda: _shown(page, "episode") >= 5, 240)
    page.close()
    assert (_taught(server) >= -200.0).any()


def test_keys_alone(opened, lesson):
    """What a press does is seen at once; every control has its key; a reload goes on where it was."""
    page, _ = opened(lesson, viewport={"width": 375, "height": 812})
    assert page.evaluate("document.documentElement.scrollWidth") <= 375
    page.keyboard.press("ArrowRight")
    _until(lambda: _shown(page, "corrections") == 1, 60)
    assert re.search(r"Push right here: .* → ", page.inner_text("body"))
    page.keyboard.press("Space")
    _until(lambda: page.evaluate(PHASE) == "paused", 60)
    before = _shown(page, "step")
    page.keyboard.press(".")
    _until(lambda: _shown(page, "step") > before, 60)
    page.keyboard.press("u")
    _until(lambda: _shown(page, "corrections") == 0, 60)
    page.keyboard.press("a")
    _until(lambda: _shown(page, "corrections") == 1, 60)
    there = _shown(page, "step")
    assert there <= before + 2  # the last step before the rest may be shown a moment later
    page.keyboard.press("l")
    _until(lambda: page.evaluate(PHASE) == "run", 60)
    page.keyboard.press("l")
    _until(lambda: page.evaluate(PHASE) == "paused", 60)
    _until(lambda: _shown(page, "step") == there, 60)  # what is taught is where it was
    page.reload()
    _until(lambda: page.evaluate(PHASE) in ("waiting", "paused"), 60)
    _until(lambda: (_shown(page, "step"), _shown(page, "corrections")) == (there, 1), 60)
    page.close()


@pytest.mark.slow
def test_two_tabs(opened, browser):
    """The second is told, and may take over; the first is told then."""
    page, server = opened("cartpole")
    page.keyboard.press("Space")
    second = browser.new_page()
    second.goto(server.address)
    _until(lambda: second.evaluate(PHASE) == "taken", 60)
    second.click("#card-button")
    _until(lambda: second.evaluate(PHASE) in ("waiting", "paused"), 60)
    _until(lambda: page.evaluate(PHASE) == "taken", 60)
    second.close()


GAMEPAD = """() => {
  const buttons = Array.from({length: 16}, () => ({pressed: false}));
  window.pad = {index: 0, connected: true, axes: [0, 0], buttons};
  navigator.getGamepads = () => [window.pad];
  dispatchEvent(new Event("gamepadconnected"));
}"""


def test_fingers_and_a_gamepad(opened, lesson):
    """On a telephone: a tap is one advice, a held button repeats it; so do stick and cross, and B takes it back."""
    phone = {"viewport": {"width": 375, "height": 740}, "has_touch": True, "is_mobile": True}
    page, _ = opened(lesson, **phone)
    before = _settled(page, "corrections")
    assert page.evaluate("document.documentElement.scrollWidth") <= 375
    heights = page.evaluate("[...document.querySelectorAll('.pad')].map((pad) => pad.offsetHeight)")
    assert len(heights) == 2 and min(heights) >= 44  # a finger's
    page.tap(".pad-more")
    _until(lambda: _shown(page, "corrections") == before + 1, 60)
    touch = page.context.new_cdp_session(page)
    box = page.locator(".pad-less").bounding_box()
    point = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
    touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [point]})
    _until(lambda: _shown(page, "corrections") >= before + 4, 60)
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    _until(lambda: page.evaluate("document.querySelectorAll('.pad.lit').length") == 0, 60)
    page.evaluate(GAMEPAD)
    stick, cross = (
        ("axes[0] = 1", "axes[0] = 0"),
        ("buttons[14].pressed = true", "buttons[14].pressed = false"),
    )
    for hold, leave in (stick, cross):
        more = _shown(page, "corrections") + 2
        page.evaluate(f"window.pad.{hold}")
        _until(lambda more=more: _shown(page, "corrections") >= more, 60)
        page.evaluate(f"window.pad.{leave}")

    def paused():
        """By the button, which goes on instead where an episode has just ended: then it is pressed again."""
        for pressed in ("false", "true"):
            page.evaluate(f"window.pad.buttons[0].pressed = {pressed}")
            time.sleep(0.3)
        return page.evaluate(PHASE) == "paused"

    _until(paused, 60)
    before = _settled(page, "corrections")
    page.evaluate("window.pad.buttons[1].pressed = true")
    _until(lambda: _shown(page, "corrections") == before - 1, 60)
    page.evaluate("window.pad.connected = false")
    page.close()
