"""Whether the time left that a sweep tells is right: sweeps of many kinds, each against how long it took in the end.

    python -m benchmarks.progress [--only NAME;...] [--longer] [--jobs 2] [--write]

Each sweep runs as it is typed, with `--json`, in processes of its own. Of its lines those count that come after the
first tenth of its time; the miss of a line is the difference between the time that it told and the time that was left,
as a share of the latter. In the last tenth of a sweep the share is of that tenth: nobody waits for the share of a
second. `--longer` runs the same with so many times as many seeds as take a minute: those whose end somebody waits for.
`--write` puts the table where it belongs in `benchmarks/README.md`; all lines go to
`benchmarks/results/progress.json`.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from gpcjax.sweep.environment import CACHE

ROOT = Path(__file__).parents[1]
README = ROOT / "benchmarks" / "README.md"
RESULTS = ROOT / "benchmarks" / "results" / "progress.json"
MARKS = "<!-- progress: begin -->\n", "<!-- progress: end -->"
FIRST = 0.1
"""Part of a sweep in which it need not know yet."""
GOAL = 0.25


@dataclass(frozen=True)
class Kind:
    """A sweep, and what of it is compiled before it begins."""

    name: str
    words: str
    cold: bool = False
    """Nothing is: programs go to an empty folder. Otherwise all are, by an earlier call with 64 seeds."""

    def longer(self) -> "Kind":
        """With so many times as many seeds as take a minute; nothing for the default sweep, of which there are two."""
        words = self.words.split()
        if "--seeds" not in words:
            return self
        at = words.index("--seeds") + 1
        words[at] = str(int(words[at]) * LONGER[self.name])
        return replace(self, name=f"{self.name} x {LONGER[self.name]}", words=" ".join(words))


KINDS = (
    Kind("default, cold", "sweep --env cartpole --error 0,0.1,0.2", cold=True),
    Kind("default, four times as many", "sweep --env cartpole --error 0,0.1,0.2 --seeds 400"),
    Kind("pendulum", "sweep --env pendulum --error 0,0.1,0.2 --seeds 100"),
    Kind("many cheap runs", "sweep --env cartpole --algo coach --error 0,0.2 --seeds 4000"),
    Kind("one process, cold", "sweep --env pendulum --algo gpc-ns --seeds 80 --jobs 1", cold=True),
    Kind("a grid", "grid --env mountaincar --algo gpc,gpc-ns --human-length-scale 0.05,0.1,0.2 --seeds 80"),
    Kind(
        "large dictionaries", "sweep --env cartpole --algo gpc --no-sparsify --seeds 600 --max-capacity 512"
    ),
    Kind(
        "states are kept",
        "sweep --env pendulum --algo gpc --error 0,0.2 --seeds 300 --keep states --keep-at 10",
    ),
    Kind(
        "a learner of one's own",
        "sweep --env cartpole --algo drifting:Linear,coach --error 0,0.2 --seeds 2000",
    ),
    Kind("D-COACH", "sweep --env pendulum --algo d-coach --seeds 60"),
    Kind("lander, COACH", "sweep --env lunarlander --algo coach --seeds 40 --episodes 100"),
    Kind("lander, GPC and COACH", "sweep --env lunarlander --algo gpc,coach --seeds 16 --episodes 30"),
)

LONGER = {
    "default, four times as many": 3,
    "pendulum": 6,
    "many cheap runs": 4,
    "one process, cold": 15,
    "a grid": 8,
    "large dictionaries": 12,
    "states are kept": 8,
    "a learner of one's own": 6,
    "D-COACH": 3,
    "lander, COACH": 4,
    "lander, GPC and COACH": 12,
}
"""How many times as many seeds take a minute or two."""


def lines_of(kind: Kind, folder: Path, jobs: int) -> list[dict[str, Any]]:
    """What a sweep of this kind says, in a new folder.

    Raises:
        RuntimeError: it failed.
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "foreign")))}
    if kind.cold:
        environment[CACHE] = str(folder / "cache")
    words = kind.words.split()
    words += [] if "--jobs" in words else ["--jobs", str(jobs)]
    if not kind.cold:
        _run([*without_seeds(words), "--seeds", "7000-7063", "--out", str(folder / "before")], environment)
    told = _run([*words, "--out", str(folder / "out")], environment)
    return [json.loads(line) for line in told.splitlines() if '"left_s"' in line]


def without_seeds(words: Sequence[str]) -> list[str]:
    """A command without its `--seeds`, which can be given only once."""
    at = words.index("--seeds") if "--seeds" in words else len(words)
    return [*words[:at], *words[at + 2 :]]


def _run(words: Sequence[str], environment: dict[str, str]) -> str:
    command = [sys.executable, "-m", "gpcjax", *words, "--json"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)}: {done.stderr[-2000:]}")
    return done.stdout


@dataclass(frozen=True)
class Misses:
    """How wrong the lines of a sweep were."""

    seconds: float
    """That it took."""
    first: float
    """Of the first line after the first tenth, with its sign: above 0 where too much was told."""
    median: float
    largest: float
    within: float
    """Part of the lines that are within `GOAL`."""


def misses_of(lines: Sequence[dict[str, Any]]) -> Misses:
    """Compares what was told with what was left."""
    whole = lines[-1]["elapsed_s"]
    shares = [
        (line["left_s"] - (whole - line["elapsed_s"])) / max(whole - line["elapsed_s"], FIRST * whole)
        for line in lines[:-1]
        if line["elapsed_s"] >= FIRST * whole
    ]
    sizes = [abs(each) for each in shares]
    within = sum(each <= GOAL for each in sizes) / len(sizes)
    return Misses(whole, shares[0], median(sizes), max(sizes), within)


def table_of(found: dict[str, Misses]) -> str:
    """As Markdown."""
    rows = [
        "| sweep | took | miss after the first tenth | median | largest | within 25% |",
        "|---|---|---|---|---|---|",
    ]
    rows += [
        f"| {name} | {each.seconds:.0f} s | {each.first:+.0%} | {each.median:.0%} | {each.largest:.0%} "
        f"| {each.within:.0%} |"
        for name, each in found.items()
    ]
    return "\n".join(rows)


def main() -> None:
    """Measures, and prints a line for each sweep, and at the end the table of all that were measured so far."""
    parser = argparse.ArgumentParser(description="Compare the time left that sweeps tell with what was left.")
    parser.add_argument("--only", default="", help="names of sweeps, separated by semicolons")
    parser.add_argument("--longer", action="store_true", help="with so many seeds as take a minute")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    wanted = [name.strip() for name in arguments.only.split(";") if name.strip()]
    kept = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for kind in KINDS:
        if wanted and kind.name not in wanted:
            continue
        if arguments.longer and kind == kind.longer():
            continue
        kind = kind.longer() if arguments.longer else kind
        began = time.monotonic()
        with tempfile.TemporaryDirectory() as scratch:
            kept[kind.name] = lines_of(kind, Path(scratch), arguments.jobs)
        RESULTS.parent.mkdir(exist_ok=True)
        RESULTS.write_text(json.dumps(kept))
        print(f"{kind.name}: {misses_of(kept[kind.name])} ({time.monotonic() - began:.0f} s)", flush=True)
    names = [kind.name for kind in KINDS] + [kind.longer().name for kind in KINDS]
    table = table_of({name: misses_of(kept[name]) for name in dict.fromkeys(names) if name in kept})
    print(table)
    if arguments.write:
        before, rest = README.read_text().split(MARKS[0])
        README.write_text(before + MARKS[0] + table + "\n" + MARKS[1] + rest.split(MARKS[1])[1])


if __name__ == "__main__":
    main()
