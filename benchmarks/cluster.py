"""What sweeps on several machines cost: a block of cells on its way, the driver's time and memory, two hosts of a core.

    python -m benchmarks.cluster [driver] [block] [hosts]

| Part     | What is measured                                                                                     |
|----------|------------------------------------------------------------------------------------------------------|
| `driver` | the driver alone, which is fed recorded rows as they come from Ray: seconds a cell, memory           |
| `block`  | a real Ray whose workers answer at once with recorded rows: seconds of a block of cells, all of it   |
| `hosts`  | two hosts of one core each (as tests/cluster has them) against two processes: seconds of one sweep   |

The first two are what `benchmarks/simulator.py` reckons with.
"""

import argparse
import json
import os
import pickle
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.sweep.executors import Desk, Ray, crew
from gpcjax.sweep.executors.base import ASKS, Message
from gpcjax.sweep.executors.remote import place, together
from gpcjax.sweep.plan import Cell
from gpcjax.sweep.rows import CellRows
from gpcjax.sweep.run import run
from gpcjax.sweep.sharing import BATCH
from gpcjax.sweep.spec import SweepSpec, spec_of

EPISODES, CORRECTIONS = 30, 60
"""Of a recorded run: those of the cart-pole in the thesis."""

SWEEP = ["--env", "pendulum", "--algo", "gpc-ns", "--checkpoint", "0"]
"""One program."""


def recorded(cell: Cell) -> CellRows:
    """Rows as large as those of a real run, with other numbers in each."""
    numbers = np.random.default_rng(cell.seed)
    names = "returns rate_sum chance_sum".split()
    counts = "length corrections asked policy_points human_points clipped full".split()
    episodes = {name: numbers.random(EPISODES) for name in names}
    episodes |= {name: numbers.integers(0, 1000, EPISODES).astype(np.int32) for name in counts}
    moments = numbers.integers(0, EPISODES, (CORRECTIONS, 3)).astype(np.int32)
    corrections = {
        "moments": moments,
        "values": numbers.random((CORRECTIONS, 3)),
        "outcome": numbers.random((CORRECTIONS, 3)) < 0.5,
    }
    return CellRows(cell, np.arange(1, EPISODES + 1), ["ok"] * EPISODES, episodes, corrections)


class Answering:
    """A worker that has recorded rows for every cell at once."""

    def hear(self, answer: Message | None) -> list[Message]:
        """What it says to an answer."""
        match answer:
            case ("program", *_):
                return [("next",)]
            case ("cells", [_, *_] as cells, *_):
                return [*together([("rows", recorded(cell)) for cell in cells], ()), ("next",)]
            case ("baseline", _, name):
                return [("baseline", name, {"mean": 0.0, "std": 1.0, "n": 100}), ("ready",)]
        return [("ready",)]


class Fed:
    """An executor without machines: so many workers answer in turn; what the driver does with it is timed alone."""

    def __init__(self, jobs: int):
        self.jobs = jobs
        self.seconds, self.blocks = 0.0, 0

    def run(self, desk: Desk) -> None:
        """Until each has been told to stop."""
        worker, answers = Answering(), dict[int, Message | None].fromkeys(range(desk.workers))
        while answers:
            for number, answer in list(answers.items()):
                said = pickle.dumps(worker.hear(answer), protocol=5)
                began = time.process_time()
                reply = None
                for message in pickle.loads(said):
                    told = desk.answer(number, message)
                    reply = told if message[0] in ASKS else reply
                pickle.dumps(reply, protocol=5)
                self.seconds += time.process_time() - began
                self.blocks += 1
                answers[number] = reply
                if reply == ("stop",):
                    del answers[number]


class _Echo:
    """An actor that answers so."""

    def begin(self, parcel: Any, patience: float) -> Any:
        return place()

    def hear(self, answer: bytes | None) -> bytes:
        told = None if answer is None else pickle.loads(answer)[0]
        return pickle.dumps(Answering().hear(told), protocol=5)

    def close(self) -> None:
        """There is nothing to close."""


def _spec(cells: int) -> SweepSpec:
    return spec_of(env="cartpole", algo="coach", error=[0, 0.1, 0.2, 0.3], seeds=cells // 4, oracle="lqr")


def _memory() -> float:
    """MiB that this process has now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def driver(cells: int, jobs: int) -> dict[str, float]:
    """The driver, fed with the rows of so many cells of so many workers."""
    fed, before = Fed(jobs), _memory()
    with tempfile.TemporaryDirectory() as folder:
        run(_spec(cells), Path(folder), jobs, fed)
        size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10 - before
    return {
        "cells": cells,
        "workers": jobs,
        "ms_per_cell": round(1e3 * fed.seconds / cells, 3),
        "ms_per_block": round(1e3 * fed.seconds / fed.blocks, 3),
        "cells_per_block": round(cells / fed.blocks, 1),
        "peak_mib": round(grown),
        "bytes_per_cell_on_disk": round(size / cells),
    }


def block(cells: int) -> dict[str, float]:
    """A real Ray with one worker: a block on its way, where nothing is computed; its start is left out.

    In seconds of the clock, in which the worker makes up rows and their tables, and of the driver's processor: these
    are what a call costs, and what `driver` finds for the block's cells.
    """

    def seconds(cells: int) -> np.ndarray:
        executor = Ray(jobs=1)
        executor._connect()
        began = time.monotonic(), time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            run(_spec(cells), Path(folder), 1, executor)
        return np.array((time.monotonic() - began[0], time.process_time() - began[1]))

    actor, crew.Actor = crew.Actor, _Echo  # pyright: ignore[reportAttributeAccessIssue]
    try:
        few, many = seconds(cells // 8), seconds(cells)
    finally:
        crew.Actor = actor  # pyright: ignore[reportAttributeAccessIssue]
    each = (many - few) / (cells - cells // 8) * BATCH
    return {
        "cells": cells,
        "start_s": round(few[0] - each[0] * (cells // 8) / BATCH, 1),
        "ms_per_block": round(1e3 * each[0], 1),
        "driver_ms_per_block": round(1e3 * each[1], 1),
    }


def two_hosts(seeds: int) -> dict[str, float]:
    """One sweep in two processes, then on two hosts of one core each: seconds of each."""
    from tests.cluster.hosts import hosts

    found: dict[str, float] = {"seeds": seeds}
    root = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as folder:

        def once(words: list[str], start: Any, name: str) -> float:
            command = [
                "-m",
                "gpcjax",
                "sweep",
                *SWEEP,
                "--seeds",
                str(seeds),
                *words,
                "--out",
                f"{folder}/{name}",
                "--json",
            ]
            process = start(command)
            events = [json.loads(line) for line in process.communicate()[0].splitlines()]
            assert process.returncode == 0
            return next(event["elapsed_s"] for event in events if event["event"] == "end")

        def seconds(words: list[str], start: Any, name: str) -> float:
            once(words, start, f"{name}-first")  # which fills the cache of compiled programs
            return once(words, start, name)

        environment = {**os.environ, "PYTHONPATH": str(root)}
        found["processes_s"] = seconds(
            ["--jobs", "2"],
            lambda words: subprocess.Popen([sys.executable, *words], env=environment, stdout=subprocess.PIPE),
            "processes",
        )
        with hosts() as (first, _):
            found["hosts_s"] = seconds(
                ["--engine", "ray", "--address", "auto"],
                lambda words: first.python(*words, stdout=subprocess.PIPE),
                "hosts",
            )
    found["efficiency"] = round(found["processes_s"] / found["hosts_s"], 3)
    return found


def main() -> None:
    """Measures the parts that are named, or all, a line of JSON each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", choices=["driver", "block", "hosts", []], default=[])
    parser.add_argument("--seeds", default="64,320,960", help="runs of `hosts` (default: %(default)s)")
    arguments = parser.parse_args()
    parts = arguments.parts or ["driver", "block", "hosts"]
    if "driver" in parts:
        for cells, jobs in ((20_000, 10), (80_000, 10), (80_000, 1000)):
            # In a process of its own: memory that another one has left would be used again.
            code = f"import json, benchmarks.cluster as c; print(json.dumps(c.driver({cells}, {jobs})))"
            print(
                subprocess.run(
                    [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=True
                ).stdout.strip()
            )
    if "block" in parts:
        print(json.dumps(block(8_000)))
    if "hosts" in parts:
        for seeds in arguments.seeds.split(","):
            print(json.dumps(two_hosts(int(seeds))), flush=True)


if __name__ == "__main__":
    main()
