"""Disks that become full or read-only, and folders that go, under a running command; and commands that are killed.

    python -m tests.torture.disks [--cases 400] [--seed 0] [--command sweep]

Each case is a command of `COMMANDS` in a process of its own, on a small disk (`tests.torture.disk`). Workers are
pretended (no jax), all else is real. Just before it opens, renames or removes a file there for the n-th time something
of `FAULTS` happens, or it is killed. Right is: one line and a status; no row is lost that was there, none is there that
is no row of the sweep; and once the disk is well again, the same command ends with the same bits and leaves nothing
behind.
"""

import argparse
import contextlib
import os
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from gpcjax.errors import UserError
from gpcjax.sweep import going
from gpcjax.sweep import run as run_module
from gpcjax.sweep.layout import EPISODES, MANIFEST
from gpcjax.sweep.reading import read, read_kept
from tests.sweep.pretended import Pretended
from tests.torture.disk import Disk, count, in_private, obey_permissions
from tests.torture.folders import OTHER, assert_same, finished
from tests.torture.shards import sharded

KILLED = "killed"
EVENTS = ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir")
SWEEP = (
    "sweep --env cartpole --algo gpc,coach --oracle lqr --error 0.1 --delta 0,0.05 --seeds 2 --episodes 3 --jobs 1 "
    "--keep states --out"
)
REPORT = ("summary.csv", "differences.csv", "report.html")
COMPARISON = ("comparison.csv", "profiles.csv", "alone.csv", "comparison.html")


@dataclass(frozen=True)
class Command:
    """One that writes into `OUT`, a folder on the disk."""

    words: str
    begins_with: str = ""
    """What lies in OUT before, a folder of `Sources`."""
    written: tuple[str, ...] = REPORT
    """Files that are the same whenever it gets to its end."""
    rows: bool = True
    """Whether OUT is a run folder."""


COMMANDS = {
    "sweep": Command(f"{SWEEP} OUT"),
    "report": Command("report OUT", begins_with="whole"),
    "merge": Command("merge --out OUT SOURCES/sharded"),
    "compare": Command(
        "compare --out OUT SOURCES/whole SOURCES/other --by sparsify", written=COMPARISON, rows=False
    ),
}


def torture(
    cases: int, seed: int, commands: tuple[str, ...] = tuple(COMMANDS)
) -> Iterator[tuple[str, str | None, str]]:
    """What happened in each case, what became of it (None: it was not right), and why."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        scratch = Path(folder)
        sources = scratch / "sources"
        _spare_drawing(finished(sources / "whole"), scratch / "drawn")
        finished(sources / "other", OTHER)
        sharded(sources / "sharded")
        disk = Disk(scratch / "disk")
        stack.callback(disk.close)
        if not disk.mounted:
            print("no disk can be mounted here: none becomes full or read-only", flush=True)
        whole = {name: _Whole(disk, sources, name, scratch) for name in commands[:cases]}
        faults = (*disk.faults, KILLED)
        for number in range(cases):
            random = np.random.default_rng([seed, number])
            # Each with each: there are not as many of one as of the other.
            name, fault = commands[number % len(commands)], faults[number % len(faults)]
            moment = 1 + int(random.integers(whole[name].events))
            left = int(random.choice([0, 0, 4096, 20_000]))
            what = f"{name}: {fault} at {moment} of {whole[name].events}"
            try:
                yield what, whole[name].judged(fault, moment, left), ""
            except Exception:
                yield what, None, traceback.format_exc()


class _Whole:
    """A command that gets to its end, to compare others with."""

    def __init__(self, disk: Disk, sources: Path, name: str, scratch: Path):
        self._disk, self._sources, self._command = disk, sources, COMMANDS[name]
        self._out, self._told, self._copy = disk.path / "out", scratch / "told", scratch / "copy"
        words = self._command.words.replace("OUT", str(self._out)).replace("SOURCES", str(sources))
        self._words = words.split()
        self._begin()
        status, said, self.events = self._run()
        if status:
            raise RuntimeError(f"{name} ended with {status}: {said}")
        self._content = self._contents()

    def judged(self, fault: str, moment: int, left: int) -> str:
        """What becomes of it with a fault, in a word.

        Raises:
            AssertionError: it was not right.
        """
        self._begin()
        try:
            status, said, _ = self._run(fault, moment, left)
        finally:
            self._disk.mend(fault, self._out)
        _assert_said(status, said, fault)
        if self._command.rows and self._copy.exists() and fault != "removed":
            self._assert_kept()
        if not self._out.exists() and self._command.begins_with:
            return "gone"
        for path in self._disk.path.rglob(".*.tmp"):  # it may be somebody's who still writes, until it is old
            os.utime(path, (0, 0))
        again, later, _ = self._run()
        assert again == 0, f"it ended with {again}: {later}"
        assert not [line for line in later.splitlines() if "damaged" in line or "twice" in line], later
        self._assert_same()
        return "to its end" if status == 0 else "goes on"

    def _begin(self) -> None:
        for path in (self._out, self._copy):
            shutil.rmtree(path, ignore_errors=True)
        if self._command.begins_with:
            shutil.copytree(self._sources / self._command.begins_with, self._out)
        else:
            self._out.mkdir()

    def _run(self, fault: str = "", moment: int = 0, left: int = 0) -> tuple[int, str, int]:
        """The status of the command, what it said, and how many events there were."""
        with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as counted:
            child = os.fork()
            if child == 0:
                os.dup2(said.fileno(), 2)
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
                self._be_command(fault, moment, left, counted.fileno())
            status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            for file in (said, counted):
                file.seek(0)
            return status, said.read(), int(counted.read() or 0)

    def _be_command(self, fault: str, moment: int, left: int, counted: int) -> None:
        """In a process that ends with it."""
        status = 70
        try:
            sys.stderr = os.fdopen(2, "w", closefd=False)
            obey_permissions()
            count = _listen(self._disk.path, moment, lambda: self._strike(fault, left))
            run_module.Processes = Pretended(kept=True)
            going.FLUSH_SECONDS = -1.0
            from gpcjax import cli

            status = cli.main(self._words)
            os.write(counted, str(count()).encode())
        except BaseException:
            traceback.print_exc()
        finally:
            with contextlib.suppress(OSError):
                sys.stderr.flush()
            os._exit(status)

    def _strike(self, fault: str, left: int) -> None:
        if fault == KILLED:
            os.kill(os.getpid(), signal.SIGKILL)
        with contextlib.suppress(OSError, shutil.Error):  # what is being written may go while it is copied
            shutil.copytree(self._out, self._copy)
        self._disk.faults[fault](self._out, left)

    def _assert_kept(self) -> None:
        """All rows that were there are still there, and no others."""
        frames = []
        for folder in (self._copy, self._out):
            if not (folder / MANIFEST).exists() or not any((folder / EPISODES).glob("*.parquet")):
                frames.append(pd.DataFrame(columns=["episode"]))
                continue
            frames.append(read(folder, _refuse).episodes)
        before, after = frames
        keys = [name for name in ("algo", "delta", "seed", "episode") if name in after]
        assert len(before) <= len(after), "rows are lost"
        if len(after):
            whole = self._content["episodes"]
            some = whole.merge(after[keys], on=keys)[list(whole)]
            pd.testing.assert_frame_equal(after, some, check_exact=True, check_dtype=False)
        if len(before):
            assert len(after.merge(before[keys], on=keys)) == len(before), "rows are lost"

    def _contents(self) -> dict[str, pd.DataFrame | bytes]:
        found: dict[str, pd.DataFrame | bytes] = {
            name: (self._out / name).read_bytes() for name in self._command.written if name.endswith(".csv")
        }
        if self._command.rows:
            rows = read(self._out, _refuse)
            assert rows.manifest["complete"]
            found |= {"episodes": rows.episodes, "corrections": rows.corrections}
            found["kept"] = read_kept(self._out, _refuse)
        return found

    def _assert_same(self) -> None:
        for name, content in self._contents().items():
            expected = self._content[name]
            if isinstance(content, bytes) or isinstance(expected, bytes):
                assert content == expected, f"{name} is another"
            else:
                assert_same(content, expected)
        assert all((self._out / name).exists() for name in self._command.written)
        left = [path.name for path in self._out.rglob(".*")]
        assert not left, f"left behind: {left}"


def _spare_drawing(whole: Path, scratch: Path) -> None:
    """Loads and draws once what each process would: they would take most of the time. Pictures are of nothing."""
    from gpcjax.report import compare, terminal  # noqa: F401
    from gpcjax.report.figures import curves, grids, style
    from gpcjax.report.run import draw

    style.image = lambda figure, kind, dpi=200: b"<svg>" + 10_000 * b" " + b"</svg>"
    for module, name in (
        (curves, "learning_curves"),
        (curves, "learning_rates"),
        (grids, "final_returns"),
    ):
        setattr(module, name, _made_once(getattr(module, name)))
    draw(shutil.copytree(whole, scratch))


def _made_once(make: Callable[..., object]) -> Callable[..., object]:
    """What gives the same at each call, whatever it is given."""
    made: list[object] = []

    def once(*given: object) -> object:
        if not made:
            made.append(make(*given))
        return made[0]

    return once


def _listen(below: Path, moment: int, strike: Callable[[], None]) -> Callable[[], int]:
    """Calls `strike` before the moment-th of `EVENTS` below a folder; gives what tells how many there were."""
    count, busy, prefix = 0, False, str(below)

    def hear(event: str, arguments: tuple) -> None:
        nonlocal count, busy
        if event not in EVENTS or busy:
            return
        if any(
            isinstance(each, str | os.PathLike) and os.fspath(each).startswith(prefix) for each in arguments
        ):
            count += 1
            if count == moment:
                busy = True
                strike()
                busy = False

    sys.addaudithook(hear)
    return lambda: count


def _assert_said(status: int, said: str, fault: str) -> None:
    """One line of error, or none."""
    lines = said.splitlines()
    errors = [line for line in lines if line.startswith("gpcjax: error: ")]
    if fault == KILLED and status == -signal.SIGKILL:
        return
    allowed = (0, 1) if fault in ("full", "read-only") else (0, 1, 2)  # 2 is a mistake of the person's
    assert status in allowed, f"it ended with {status}: {said}"
    assert len(errors) == (status != 0), said
    assert "Traceback" not in said, said


def _refuse(line: str) -> None:
    raise UserError(line)


def main() -> int:
    """Says how many cases became what, and prints those that were not right."""
    parser = argparse.ArgumentParser(description="Spoil disks under running commands.")
    parser.add_argument("--cases", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--command", choices=tuple(COMMANDS), help="this one alone")
    arguments = parser.parse_args()
    in_private("tests.torture.disks")
    chosen = tuple(COMMANDS) if arguments.command is None else (arguments.command,)
    return count("spoiled disks", torture(arguments.cases, arguments.seed, chosen))


if __name__ == "__main__":
    sys.exit(main())
