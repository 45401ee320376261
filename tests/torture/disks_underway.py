"""Real sweeps, whose disk becomes full or read-only, or whose folder goes, while their workers compute.

    python -m tests.torture.disks_underway [--cases 20] [--seed 0]

The moment is drawn, from the start of Python to the report; workers write checkpoints all the while. Right is: one line
and a status, no worker is left, and once the disk is well again the same command ends with the rows of a sweep that was
never disturbed, and with all that it kept, to the bit. `tests.torture.disks` has exact moments, without workers.
"""

import argparse
import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from tests.sweep.processes import alive, workers_of
from tests.torture.disk import Disk, count, in_private, obey_permissions
from tests.torture.kills import PATIENCE, ROOT, content_of, same

SWEEP = (
    "sweep --env cartpole --algo gpc --oracle lqr --rate 0.2 --seeds 6 --episodes 30 --keep states --keep-at 20 "
    "--jobs 2 --max-capacity 64 --on-full replace-nearest --checkpoint 0.2 --out"
)


def torture(cases: int, seed: int) -> Iterator[tuple[str, str | None, str]]:
    """What happened in each case, what became of it (None: it was not right), and why."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        disk = Disk(Path(folder, "disk"), "64m")
        stack.callback(disk.close)
        out, faults = disk.path / "out", list(disk.faults)
        _run(out)  # compiles
        shutil.rmtree(out)
        began = time.monotonic()
        status, said = _run(out)
        usual = time.monotonic() - began
        if status:
            raise RuntimeError(said)
        expected = content_of(out)
        for number in range(cases):
            random = np.random.default_rng([seed, number])
            fault, wait = faults[number % len(faults)], float(random.uniform(0.05, 0.95)) * usual
            what = f"{fault} after {wait:.2f} of {usual:.2f} s"
            shutil.rmtree(out, ignore_errors=True)
            try:
                yield what, _judged(disk, out, fault, wait, random, expected), ""
            except Exception:
                yield what, None, traceback.format_exc()


def _judged(
    disk: Disk, out: Path, fault: str, wait: float, random: np.random.Generator, expected: list[pd.DataFrame]
) -> str:
    """What becomes of a sweep with a fault, in a word.

    Raises:
        AssertionError: it was not right.
    """
    try:
        status, said = _run(out, lambda: disk.faults[fault](out, int(random.choice([0, 20_000]))), wait)
    finally:
        if out.exists():
            disk.mend(fault, out)
    errors = [line for line in said.splitlines() if line.startswith("gpcjax: error: ")]
    allowed = (0, 1) if fault in ("full", "read-only") else (0, 1, 2)  # 2 is a mistake of the person's
    assert status in allowed, f"it ended with {status}: {said}"
    assert len(errors) == (status != 0), said
    assert "Traceback" not in said, said
    again, later = _run(out)
    assert again == 0, f"after {said}: it ended with {again}: {later}"
    assert all(map(same, content_of(out), expected)), f"after {said}: it came to other rows, {later}"
    left = [path.name for path in out.rglob(".*") if time.time() - path.stat().st_mtime > 3600]
    assert not left, left
    return f"goes on after {status}" if status else "to its end"


def _run(out: Path, strike=None, wait: float = 0.0) -> tuple[int, str]:
    """The status of the sweep and what it said; something strikes after so many seconds."""
    with tempfile.TemporaryFile("w+") as said:
        running = subprocess.Popen(
            [sys.executable, "-m", "gpcjax", *SWEEP.split(), str(out)],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,
            preexec_fn=obey_permissions,
        )
        workers: list[int] = []
        try:
            if strike is not None:
                until = time.monotonic() + wait
                while running.poll() is None and (time.monotonic() < until or not out.exists()):
                    workers = workers_of(running.pid) or workers
                    time.sleep(0.01)
                strike()
            status = running.wait(PATIENCE)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(running.pid, signal.SIGKILL)
        assert not any(map(alive, workers)), "a worker is left"
        said.seek(0)
        return status, said.read()


def main() -> int:
    """Says how many cases became what, and prints those that were not right."""
    parser = argparse.ArgumentParser(description="Spoil disks under real sweeps.")
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    in_private("tests.torture.disks_underway")
    return count("spoiled disks of real sweeps", torture(arguments.cases, arguments.seed))


if __name__ == "__main__":
    sys.exit(main())
