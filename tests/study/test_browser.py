"""A real browser and a real hall: from the link to the code, past a server that is killed, blind all the way."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.study.example import study_with, written
from tests.study.test_server import Running

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian: apt install chromium)")

GPCJAX = Path(__file__).parents[2]
BALANCING = {
    'title = "Small"': 'title = "Balancing"',
    "participants = 4": "participants = 2",
    '"pendulum", "cartpole"': '"cartpole"',
    "round_trip = 500": "frame_rate = 1",
    "attempts = 2": "attempts = 9",
    '[[learners]]\nalgo = "coach"\n': "",
    "Done.": "All is saved.",
    'link = "https://example.org/back?who={code}"': "",
}


class Server:
    """`gpcjax study` in a process of its own."""

    def __init__(self, out, spec=None, port=0):
        self.out = out
        words = [sys.executable, "-m", "gpcjax", "study", *([str(spec)] if spec else [])]
        words += ["--out", str(out), "--port", str(port), "--places", "8"]
        self.process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=GPCJAX, env=os.environ
        )
        said = []
        while not (said and said[-1].startswith("experimenter:")):
            said.append(self.process.stdout.readline())
            assert said[-1], f"it ended: {said}"
        self.address, self.experimenter = (line.split()[1] for line in said[-2:])
        self.port = int(re.search(r":([0-9]+)/", self.address)[1])

    def end(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        said, _ = self.process.communicate(timeout=120)
        return said


@pytest.fixture
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def until(true, seconds=60):
    end = time.monotonic() + seconds
    while not (found := true()):
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.02)
    return found


def measuring_soon(route):
    """What a page measures of its machine takes two seconds."""
    text = route.fetch().text()
    for usual, soon in (("FRAMES_FOR = 1500", "FRAMES_FOR = 100"), ("PING_APART = 80", "PING_APART = 1")):
        assert usual in text
        text = text.replace(usual, soon)
    route.fulfill(body=text, content_type="text/javascript")


def test_every_page(browser, tmp_path):
    """With a hall that only listens: what is shown and pressed, on a phone, from the link to the code."""
    running, complaints = Running(*study_with(tmp_path, '"pendulum", "cartpole"', '"cartpole"')), []
    page = browser.new_page(viewport={"width": 375, "height": 740})
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text))
    page.route("**/measuring.js", measuring_soon)
    page.goto(f"{running.origin}/?survey_code=s1")
    root = page.evaluate_handle("document.documentElement")

    def at(kind):
        until(lambda: root.evaluate("each => each.dataset.step") == kind)
        assert root.evaluate("each => each.scrollWidth") <= 375

    def begins():
        page.locator("#card-button").click()
        until(lambda: root.evaluate("each => each.dataset.phase") == "teaching")

    at("consent")
    page.get_by_role("button", name="I agree").click()
    at("check")
    page.get_by_role("button", name="Begin").click()
    at("instructions")
    page.get_by_role("button", name="trial").click()
    at("trial")
    until(lambda: "Press each key once" in page.inner_text("#card"))
    begins()
    page.keyboard.press("ArrowLeft")
    until(
        lambda: (
            "push right (1 more)" in page.inner_text("#needed") and "left" not in page.inner_text("#needed")
        )
    )
    page.keyboard.press("d")
    at("run")
    for letter in "AB":
        for phase in ("practice", "this one counts"):
            until(lambda: f"learner {letter}, {phase}" in page.inner_text("#card"))  # noqa: B023
            begins()
            seat = running.seat()
            page.keyboard.down("ArrowRight")
            until(lambda: len(seat.presses) >= 2)  # noqa: B023
            page.keyboard.up("ArrowRight")
            page.keyboard.press("Space")
            until(lambda: "Paused" in page.inner_text("#card"))
            seat.over()
            until(lambda: seat.left)  # noqa: B023
        at("questions")
        page.get_by_role("button", name="Send").click()
        until(lambda: "Please answer" in page.inner_text("#sheet"))
        page.locator("input[value='6']").check(force=True)
        page.get_by_role("button", name="Send").click()
    until(lambda: page.locator("textarea").count())
    page.fill("textarea", "<script>alert(1)</script>")
    page.get_by_role("button", name="Send").click()
    at("ended")
    until(lambda: "C0FFEE" in page.inner_text("#sheet"))
    assert page.locator("#sheet a").get_attribute("href") == "https://example.org/back?who=s1"
    page.close()
    running.end()
    assert complaints == []


@pytest.mark.slow
@pytest.mark.parametrize("killed", [False, True])
def test_from_the_link_to_the_code(browser, tmp_path, killed):
    spec, out = tmp_path / "study.toml", tmp_path / "out"
    spec.write_text(written(BALANCING))
    server, said, complaints = Server(out, spec), [], []
    try:
        page = browser.new_page(viewport={"width": 375, "height": 740})
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("websocket", lambda socket: socket.on("framereceived", lambda text: said.append(text)))
        page.goto(f"{server.address}?PROLIFIC_PID=5f3a&STUDY_ID=x")
        root = page.evaluate_handle("document.documentElement")
        at = lambda kind: until(lambda: root.evaluate("each => each.dataset.step") == kind)  # noqa: E731
        narrow = lambda: root.evaluate("each => each.scrollWidth") <= 375  # noqa: E731

        def begins():
            """Presses what the card offers, until the task runs."""
            while root.evaluate("each => each.dataset.phase") != "teaching":
                page.locator("#card-button:visible").click(timeout=60_000)
                time.sleep(0.2)

        at("consent")
        page.get_by_text("I agree").click()
        at("check")
        assert narrow()
        page.get_by_text("Begin the check").click()
        at("instructions")
        page.get_by_text("Go to a short trial").click()
        at("trial")
        begins()
        while root.evaluate("each => each.dataset.step") == "trial":
            page.keyboard.press("ArrowLeft")
            page.keyboard.press("d")
            time.sleep(0.1)
        at("run")
        assert narrow()
        begins()
        page.keyboard.press("ArrowRight")
        until(lambda: "0.00 →" in page.inner_text("#said"))

        if killed:
            server.process.kill()
            server.process.communicate()
            until(lambda: page.locator("#banner:visible").count())
            server = Server(out, port=server.port)
        look = browser.new_page()
        look.goto(server.experimenter)
        assert "token" not in look.url
        until(lambda: page.locator("#banner").is_hidden())
        row = until(lambda: look.locator("tbody tr").first.inner_text())
        assert "5f3a" in row and "active" in row

        for _ in range(60):  # two runs of two episodes, each paused or begun as often as the page offers it
            kind = root.evaluate("each => each.dataset.step")
            if kind != "run":
                break
            begins_or_over = page.locator("#card-button:visible")
            if begins_or_over.count():
                begins_or_over.click(timeout=5000, no_wait_after=True)
            page.keyboard.press("ArrowLeft")
            time.sleep(0.5)
        at("questions")
        page.locator("input[value='6']").check(force=True)
        page.get_by_text("Send and go on").click()
        until(lambda: page.locator("textarea").count())
        page.fill("textarea", "<script>alert(1)</script>")
        page.get_by_text("Send and go on").click()
        at("ended")
        assert "C0FFEE" in page.inner_text("main:visible") and narrow()
        until(lambda: "complete" in look.locator("tbody tr").first.inner_text())
    finally:
        server.end()
    assert complaints == []
    heard = "".join(text if isinstance(text, str) else "" for text in said).lower()
    assert "frame" in heard and not any(word in heard for word in ("gpc", "coach", "sigma_human", '"rate'))
    kept = json.loads((out / "participants/p0001/participant.json").read_bytes())
    assert [each["value"] for each in kept["answers"]] == [6, "<script>alert(1)</script>"]
    for name in ("01-dummy-A-cartpole", "02-recorded-A-cartpole")[: 1 + killed]:
        folder = out / "participants/p0001/runs" / name
        done = subprocess.run(
            [sys.executable, "-m", "gpcjax", "replay", str(folder)],
            capture_output=True,
            text=True,
            cwd=GPCJAX,
        )
        assert done.returncode == 0 and "the same to the bit" in done.stdout, done.stderr
