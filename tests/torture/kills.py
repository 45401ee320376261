"""Sweeps that are killed at random moments, again and again: do they come to the same bits?

    python -m tests.torture.kills [--kills 200] [--seed 0]

Each sweep of `SWEEPS` runs once undisturbed. Then it is begun in a new folder and killed, and begun again in the same
one and killed again, until it gets to its end; and then anew, until there were as many kills as wanted. What is killed
is drawn: the parent by SIGKILL (its workers must be gone within a second), one of its workers, or the parent by a
signal that it hears (SIGTERM, SIGHUP, SIGINT), once or twice. The moment is drawn too, from the start of Python to the
report; or it is an exact one of `tests.torture.killed_at`: within the writing of the manifest, of a part or of the
report, or while a worker compiles, with nothing kept of earlier compilations. After each kill what is there must be
rows of the undisturbed sweep; at the end all of them, with what was kept, to the bit.
"""

import argparse
import collections
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from gpcjax.errors import UserError
from gpcjax.sweep.environment import CACHE
from gpcjax.sweep.layout import EPISODES, MANIFEST
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.reading import read_corrections, read_episodes, read_kept
from tests.sweep.processes import alive, workers_of
from tests.torture.killed_at import COMPILES, MOMENTS

ROOT = Path(__file__).parents[2]
SWEEPS = {
    "compiled": "--env cartpole --algo coach,gpc --oracle lqr --rate 0.2 --seeds 40 --episodes 40 --keep policies "
    "--keep-at 10 --jobs 2 --max-capacity 128 --on-full replace-nearest",
    "host": "--env lunarlander --algo coach --seeds 6 --episodes 20 --keep states --jobs 2",
}
CHECKPOINT = "0.5"
PATIENCE = 3600.0
"""Seconds until a sweep that should end is taken to hang: a busy machine is slow."""

EXACT = 0.5
"""Part of the kills whose moment is exact."""
LATEST = 24
"""Largest count of what happens before one of these."""

OUTLIVES = 1.0
"""Seconds that a worker may live on after its parent."""
HEARD = {signal.SIGTERM: 143, signal.SIGHUP: 129, signal.SIGINT: 130}


@dataclass
class Tally:
    """What happened so far."""

    kills: collections.Counter = field(default_factory=collections.Counter)
    finished: collections.Counter = field(default_factory=collections.Counter)
    outlived: float = 0.0
    """Longest time that workers lived after their parent, in seconds."""
    wrong: list[str] = field(default_factory=list)


def torture(kills: int, seed: int, sweeps: dict[str, str] | None = None) -> Iterator[str]:
    """Kills so often, shared among the sweeps; gives a line for each sweep, and one for whatever was wrong."""
    sweeps = sweeps or SWEEPS
    for number, (name, words) in enumerate(sweeps.items()):
        wanted = kills // len(sweeps) + (number < kills % len(sweeps))
        random, tally = np.random.default_rng([seed, number]), Tally()
        with tempfile.TemporaryDirectory() as scratch:
            reference = Path(scratch, "reference")
            began = time.monotonic()
            done = subprocess.run(_command(words, reference), cwd=ROOT, capture_output=True, text=True)
            if done.returncode:
                yield f"{name}: the undisturbed sweep failed: {done.stderr[-2000:]}"
                continue
            usual, began = time.monotonic() - began, time.monotonic()
            expected = content_of(reference)
            while sum(tally.kills.values()) < wanted and not tally.wrong:
                out = Path(scratch, f"{sum(tally.finished.values())}")
                _until_it_ends(_command(words, out), out, random, usual, expected, wanted, tally)
        what = ", ".join(f"{count} {kind}" for kind, count in tally.kills.most_common())
        print(
            f"{name}: {sum(tally.kills.values())} kills ({what}), {tally.finished['same']} sweeps to the same bits, "
            f"{time.monotonic() - began:.0f} s, workers gone after {tally.outlived:.3f} s at most",
            flush=True,
        )
        yield from (f"{name}: {line}" for line in tally.wrong)


def _command(words: str, out: Path) -> list[str]:
    return [
        sys.executable,
        "-m",
        "gpcjax",
        "sweep",
        *words.split(),
        "--checkpoint",
        CHECKPOINT,
        "--out",
        str(out),
    ]


def _until_it_ends(
    command: list[str],
    out: Path,
    random: np.random.Generator,
    usual: float,
    expected: list[pd.DataFrame],
    wanted: int,
    tally: Tally,
) -> None:
    """Runs and kills one sweep until it gets to its end."""
    while not tally.wrong:
        with tempfile.TemporaryFile("w+") as said:
            moment, given, environment = "", command, dict(os.environ)
            if sum(tally.kills.values()) < wanted and random.random() < EXACT:
                moment = str(random.choice(MOMENTS))
                count = int(random.integers(1, 4 if moment in COMPILES else LATEST))
                given = [*command[:2], "tests.torture.killed_at", moment, str(count), *command[3:]]
                if moment in COMPILES:
                    environment[CACHE] = str(out.with_name(f"cache-{sum(tally.kills.values())}"))
            running = subprocess.Popen(
                given, cwd=ROOT, env=environment, stdout=said, stderr=said, start_new_session=True
            )
            kind, status = "", None
            if moment:
                kind = _wait_for(running, moment, tally)
            elif sum(tally.kills.values()) < wanted:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    running.wait(float(random.uniform(0.05, 0.9 * usual)))
                kind = _kill(running, random, tally) if running.poll() is None else ""
            try:
                status = running.wait(PATIENCE)
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(running.pid, signal.SIGKILL)
            said.seek(0)
            text = said.read()
        if kind:
            tally.kills[kind] += 1
            _judge(out, kind, status, text, expected, tally)
        elif status:
            tally.wrong.append(f"it ended with {status}: {text[-2000:]}")
        else:
            whole = all(map(same, content_of(out), expected)) and read_manifest(out)["complete"]
            tally.finished["same" if whole else "other"] += 1
            if not whole:
                tally.wrong.append("it came to other rows")
            return


def _wait_for(running: subprocess.Popen, moment: str, tally: Tally) -> str:
    """Waits until a process has killed itself, or one of its workers, or is at its end; says what."""
    workers: list[int] = []
    until = time.monotonic() + PATIENCE
    while running.poll() is None and time.monotonic() < until:
        workers = workers_of(running.pid) or workers
        time.sleep(0.01)
    if running.returncode == -signal.SIGKILL:
        _see_them_gone(workers, tally)
        return moment
    return moment if moment == "worker compiles" and running.returncode else ""


def _see_them_gone(workers: list[int], tally: Tally) -> None:
    limit = time.monotonic() + OUTLIVES
    began = time.monotonic()
    while any(map(alive, workers)):
        if time.monotonic() > limit:
            tally.wrong.append(f"a worker lives {OUTLIVES} s after its parent")
            break
        time.sleep(0.001)
    tally.outlived = max(tally.outlived, time.monotonic() - began)


def _kill(running: subprocess.Popen, random: np.random.Generator, tally: Tally) -> str:
    """Kills something of a sweep; says what."""
    workers = workers_of(running.pid)
    kind = str(random.choice(["parent", "parent", "worker", "signal", "two signals"]))
    if kind == "worker" and workers:
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(random.choice(workers)), signal.SIGKILL)
        return kind
    if kind in ("signal", "two signals"):
        number = signal.Signals(int(random.choice([int(each) for each in HEARD])))
        running.send_signal(number)
        if kind == "two signals":
            with contextlib.suppress(subprocess.TimeoutExpired):
                running.wait(float(random.uniform(0, 0.2)))
            running.send_signal(number)
        return number.name
    running.kill()
    running.wait()
    _see_them_gone(workers, tally)
    return "parent"


def _judge(
    out: Path, kind: str, status: int | None, text: str, expected: list[pd.DataFrame], tally: Tally
) -> None:
    """Whether what a kill has left is right."""
    if "Traceback" in text:
        tally.wrong.append(f"{kind}: {text[-2000:]}")
    # A signal before Python listens ends it as the system has it; a worker's end may come too late to count.
    heard = {f"{number.name}": (status_, -int(number), 0) for number, status_ in HEARD.items()}
    killed = dict.fromkeys(("parent", *MOMENTS), (-int(signal.SIGKILL),))
    allowed = {**killed, "worker": (0, 1), "worker compiles": (1,), **heard}[kind]
    if status not in allowed:
        tally.wrong.append(f"{kind}: it ended with {status}: {text[-2000:]}")
    if (out / MANIFEST).exists() and any((out / EPISODES).glob("*.parquet")):
        try:
            found = content_of(out)
        except UserError as error:
            tally.wrong.append(f"{kind}: {error}")
            return
        for frame, whole in zip(found, expected, strict=True):
            keys = [name for name in ("algo", "seed") if name in frame]
            if len(frame) and not same(
                frame, whole.merge(frame[keys].drop_duplicates(), on=keys)[list(whole)]
            ):
                tally.wrong.append(f"{kind}: what is left are not rows of the sweep")


def content_of(out: Path) -> list[pd.DataFrame]:
    """All that a folder holds, without a word about it."""
    return [
        read(out, _refuse).sort_values(order, ignore_index=True)
        if len(read(out, _refuse))
        else pd.DataFrame()
        for read, order in (
            (read_episodes, ["algo", "seed", "episode"]),
            (read_corrections, ["algo", "seed", "episode", "step", "action_dim"]),
            (read_kept, ["algo", "seed", "episode"]),
        )
    ]


def _refuse(line: str) -> None:
    raise UserError(line)


def same(got: pd.DataFrame, expected: pd.DataFrame) -> bool:
    """To the bit."""
    try:
        pd.testing.assert_frame_equal(
            got.reset_index(drop=True), expected.reset_index(drop=True), check_exact=True
        )
    except AssertionError:
        return False
    return True


def main() -> int:
    """Says what became of the sweeps, and prints what was wrong."""
    parser = argparse.ArgumentParser(
        description="Kill sweeps at random moments, and see that they come to the same."
    )
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    wrong = 0
    for line in torture(arguments.kills, arguments.seed):
        wrong += 1
        print(line, flush=True)  # at once: the rest takes an hour
    if not wrong:
        print("nothing was wrong")
    return os.EX_OK if not wrong else 1


if __name__ == "__main__":
    sys.exit(main())
