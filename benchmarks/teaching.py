"""How a person at a browser would feel it: `make bench-teach`, with ARGS="--env E --algo A --points N".

A server as `gpcjax teach` starts it, with nothing compiled before, and Chromium on the same machine. Keys are held, now
this, now that, until so many advices were learned; the page's marks tell when a key went down, when its answer came,
when that was drawn, and when the first step of the changed policy was there. One line of JSON at the end, for
`benchmarks/README.md`, with the machine's load of the last five minutes.

Then many at once, as in a study: `benchmarks.classroom`, with TEACHERS="1,8,64" of them (--teachers).
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page, sync_playwright

from benchmarks import classroom
from gpcjax.recording import RECORD, Recording

PHASE = "document.documentElement.dataset.phase"
MARKS = """() => {
  const marks = (kind) => performance.getEntriesByType("mark").filter((mark) => mark.name.startsWith(kind + "-"))
    .map((mark) => [Number(mark.name.slice(kind.length + 1)), mark.startTime]);
  return {press: marks("press"), advised: marks("advised"), drawn: marks("drawn"), followed: marks("followed")};
}"""
HELD_SECONDS = 1.5


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--env", default="cartpole")
    parser.add_argument("--algo", default="gpc")
    parser.add_argument("--points", type=int, default=1000, help="advices until the end")
    parser.add_argument(
        "--teachers", default=classroom.TEACHERS, help="at once, number by number; empty: none"
    )
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "taught"
        words = ["--env", arguments.env, "--algo", arguments.algo, "--out", str(folder), "--repeat", "10"]
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(Path(scratch) / "cold")}
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=arguments.chromium, args=["--no-sandbox"])
            page, began = browser.new_page(), time.monotonic()
            server = subprocess.Popen(
                [sys.executable, "-m", "gpcjax", "teach", *words],
                stdout=subprocess.PIPE,
                text=True,
                env=environment,
            )
            try:
                assert server.stdout is not None
                address = server.stdout.readline().split()[1]
                figures = measure(page, address, began, arguments.points)
            finally:
                server.send_signal(signal.SIGINT)
                server.wait()
                browser.close()
        load = os.getloadavg()[1]
        print(json.dumps({**vars(arguments), **figures, **pace(folder), "load": load}), flush=True)
    classroom.run(arguments.teachers, f"{arguments.env}/{arguments.algo}", classroom.SECONDS)


def measure(page: Page, address: str, began: float, points: int) -> dict[str, Any]:
    """Teaches until there are so many advices: seconds until page and steps came, milliseconds from the key on."""
    page.goto(address)
    there = time.monotonic() - began
    while page.evaluate(PHASE) in ("connecting", "preparing"):
        time.sleep(0.05)
    ready = time.monotonic() - began
    page.keyboard.press("Space")
    marks: dict[str, dict[int, float]] = {"press": {}, "advised": {}, "drawn": {}, "followed": {}}
    keys, corrections = ["ArrowLeft", "ArrowRight"], 0
    while corrections < points:
        page.keyboard.down(keys[0])
        time.sleep(HELD_SECONDS)
        page.keyboard.up(keys[0])
        keys.reverse()
        for kind, found in page.evaluate(MARKS).items():
            marks[kind] |= {int(number): at for number, at in found}
        corrections = int(page.evaluate("document.documentElement.dataset.corrections || 0"))
        print(f"\r{corrections} corrections", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return {
        "page_s": round(there, 2),
        "ready_s": round(ready, 2),
        "corrections": corrections,
        **{
            f"key_to_{kind}_ms": _spread(marks["press"], marks[kind])
            for kind in ("advised", "drawn", "followed")
        },
    }


def pace(folder: Path) -> dict[str, Any]:
    """Steps a second from the first advice to the last, and the longest pause, by the recording's clock."""
    _, events = Recording.read(folder / RECORD)
    advised = [event["time"] for event in events if event["event"] == "advise"]
    steps = np.array([event["time"] for event in events if event["event"] == "propose"])
    steps = steps[(steps >= advised[0]) & (steps <= advised[-1])]
    apart = np.diff(steps) * 1000
    return {
        "steps_a_second": round((len(steps) - 1) / (steps[-1] - steps[0]), 2),
        "step_ms": {"p50": _at(apart, 50), "p95": _at(apart, 95), "max": _at(apart, 100)},
    }


def _spread(before: dict[int, float], after: dict[int, float]) -> dict[str, float]:
    took = np.array([after[number] - before[number] for number in after if number in before])
    return {"n": len(took), "p50": _at(took, 50), "p95": _at(took, 95), "max": _at(took, 100)}


def _at(values: np.ndarray, percent: float) -> float:
    return round(float(np.percentile(values, percent)), 1)


if __name__ == "__main__":
    main()
