"""What people wait for: whole commands, as they are typed, from nothing compiled and from all compiled.

    python -m benchmarks.waiting [--repetitions 3] [--against CHECKOUT] [--only NAME,...] [--write]

Each command is a process with its workers; its time is that of the clock, its work the processor time of all of them,
its memory the largest sum of theirs. Repetitions interleave, and with `--against` so do two checkouts, so that what
else the machine does strikes both alike: then ratios tell, more than seconds do. `--write` puts the table where it
belongs in `benchmarks/README.md`; all measurements go to `benchmarks/results/waiting.json`.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from gpcjax.sweep.environment import CACHE, worker_environment
from gpcjax.sweep.manifest import read_manifest

ROOT = Path(__file__).parents[1]
README = ROOT / "benchmarks" / "README.md"
MARKS = "<!-- waiting: begin -->\n", "<!-- waiting: end -->"
SWEEP = "--env cartpole --error 0,0.1,0.2"
SMALL = "--env cartpole --seeds 4 --episodes 3"
LOOK_SECONDS = 0.1

Measurement = dict[str, Any]


@dataclass(frozen=True)
class Command:
    """One of the things that people type."""

    name: str
    words: str
    text: str
    cold: bool = False
    """Nothing is compiled before."""
    again: bool = False
    """In a folder that holds it already."""


COMMANDS = (
    Command("default, cold", f"sweep {SWEEP}", "the default sweep, nothing compiled before", cold=True),
    Command("default, other seeds", f"sweep {SWEEP} --seeds 100-199", "the same with other seeds"),
    Command("default, other episodes", f"sweep {SWEEP} --episodes 25", "the same with other EPISODES"),
    Command("default, again", f"sweep {SWEEP}", "the same once more: nothing is missing", again=True),
    Command("small, cold", f"sweep {SMALL}", "SEEDS=4 EPISODES=3, nothing compiled before", cold=True),
    Command("small", f"sweep {SMALL} --error 0.1", "the same with another ERR"),
)


class Checkout:
    """A state of the project, with what it has compiled and swept so far."""

    def __init__(self, root: Path, scratch: Path):
        self._root, self._scratch = root, scratch
        self._warm, self._whole = scratch / "cache", scratch / "whole"
        self._runs = 0

    def measure(self, command: Command) -> Measurement:
        """Runs a command, and what has to be there before."""
        if command.cold:
            shutil.rmtree(self._scratch / "cold", ignore_errors=True)
            cache = self._scratch / "cold"
        else:
            cache = self._warm
            if not self._whole.exists():  # compiles all that the others want
                self._run(f"sweep {SWEEP}", self._whole, cache)
        self._runs += 1
        out = self._whole if command.again else self._scratch / f"run{self._runs}"
        measured = self._run(command.words, out, cache)
        manifest = read_manifest(out)
        if not command.again:
            measured["compile_s"] = manifest["compile_time_s"]
            measured["env_steps"] = manifest["env_steps"]
        if command.cold:
            measured |= self._compiled(cache)
        return measured

    def _run(self, words: str, out: Path, cache: Path) -> Measurement:
        cache.mkdir(exist_ok=True)
        environment = {**os.environ, CACHE: str(cache), "PYTHONPATH": str(self._root)}
        command = [sys.executable, "-m", "gpcjax", *words.split(), "--out", str(out)]
        began, most = time.monotonic(), 0.0
        before = os.times()
        process = subprocess.Popen(
            command, cwd=self._root, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        while process.poll() is None:
            most = max(most, sum(map(_mebibytes, _family(process.pid))))
            time.sleep(LOOK_SECONDS)
        if process.returncode:
            raise RuntimeError(f"{words}: it ended with {process.returncode}")
        after = os.times()
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        return {"wall_s": time.monotonic() - began, "cpu_s": cpu, "mib": most}

    def _compiled(self, cache: Path) -> Measurement:
        """How many programs were compiled, and of how many kernels, loops and calls they are, where they are kept."""
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.waiting", "--count", str(cache)],
            cwd=ROOT,
            env=worker_environment() | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
        )
        return json.loads(done.stdout) if done.returncode == 0 else {}


def counted(cache: Path) -> Measurement:
    """Programs below a folder, and the operations in them that are compiled as one each."""
    from gpcjax.sweep.executables import Executables

    operation = re.compile(r" (?:fusion|dot|custom-call|while|conditional|call|reduce|sort|scatter)\(")
    texts = []
    for path in cache.glob("programs-*/*.program"):
        program: Any = Executables(path.parent)._read(path.stem)
        texts.append("" if program is None else program.as_text())
    return {"programs": len(texts), "kernels": sum(len(operation.findall(text)) for text in texts)}


def measured(
    commands: Sequence[Command] = COMMANDS, repetitions: int = 3, against: Path | None = None
) -> dict[str, list[list[Measurement]]]:
    """What was measured of each command, by name: of this checkout, then of the other one; they take turns."""
    roots = [ROOT, *([against.resolve()] if against else [])]
    record: dict[str, list[list[Measurement]]] = {each.name: [[] for _ in roots] for each in commands}
    with tempfile.TemporaryDirectory() as scratch:
        checkouts = []
        for number, root in enumerate(roots):
            Path(scratch, str(number)).mkdir()
            checkouts.append(Checkout(root, Path(scratch, str(number))))
        for _ in range(repetitions):
            for command in commands:
                for number, checkout in enumerate(checkouts):
                    measurement = checkout.measure(command)
                    record[command.name][number].append(measurement)
                    print(f"{command.name} [{number}]: {measurement}", file=sys.stderr, flush=True)
    return record


def table(record: dict[str, list[list[Measurement]]]) -> str:
    """The medians as Markdown; of two checkouts also the ratios, second to first, within a repetition."""
    two = any(len(each) > 1 for each in record.values())
    head = ["command", "wall s", "processor s", "compile s", "programs", "kernels", "MiB"]
    head += ["wall, before/now", "processor, before/now"] if two else []
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    texts = {command.name: command.text for command in COMMANDS}
    for name, checkouts in record.items():
        now = checkouts[0]
        cells = [texts[name], *(_median(now, key, 1) for key in ("wall_s", "cpu_s", "compile_s"))]
        cells += [_median(now, "programs", 0), _median(now, "kernels", 0), _median(now, "mib", 0)]
        if two:
            pairs = list(zip(now, checkouts[1], strict=False))
            for key in ("wall_s", "cpu_s"):
                cells.append(f"{median(other[key] / one[key] for one, other in pairs):.2f}" if pairs else "")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _median(measurements: list[Measurement], key: str, decimals: int) -> str:
    values = [each[key] for each in measurements if key in each]
    return f"{median(values):.{decimals}f}" if values else ""


def _family(process: int) -> Iterator[int]:
    """A process and those that it started, and so on."""
    yield process
    with suppress(OSError):
        for task in os.listdir(f"/proc/{process}/task"):
            for child in Path(f"/proc/{process}/task/{task}/children").read_text().split():
                yield from _family(int(child))


def _mebibytes(process: int) -> float:
    """Of memory, what several processes share counted in parts."""
    with suppress(OSError):
        found = re.search(r"^Pss: +(\d+) kB", Path(f"/proc/{process}/smaps_rollup").read_text(), re.MULTILINE)
        return int(found[1]) / 1024 if found else 0.0
    return 0.0


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--against", type=Path, help="another checkout, measured beside this one")
    parser.add_argument("--only", default=",".join(each.name.replace(", ", "-") for each in COMMANDS))
    parser.add_argument("--write", action="store_true", help="into benchmarks/README.md")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--count", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.count is not None:
        print(json.dumps(counted(arguments.count)))
        return
    commands = [each for each in COMMANDS if each.name.replace(", ", "-") in arguments.only.split(",")]
    record = measured(commands, arguments.repetitions, arguments.against)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "waiting.json").write_text(json.dumps(record, indent=1) + "\n")
    written = table(record)
    print(written)
    if arguments.write:
        text = README.read_text()
        before, after = text.split(MARKS[0])[0], text.split(MARKS[1])[1]
        README.write_text(before + MARKS[0] + written + MARKS[1] + after)


if __name__ == "__main__":
    main()
