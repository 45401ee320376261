"""Sweeps on 10 to 10,000 machines that nobody has: a discrete-event simulation with costs that were measured.

    python -m benchmarks.simulator [--cells 1000000] [--seconds 1.0]

What is simulated is what `gpcjax.sweep.executors.ray` does. A machine of one core starts, compiles, and takes blocks of
cells; it says what it has computed when it asks for more, or after its patience. The driver is one server: every call
waits for its turn, and takes time for itself and for each cell in it, the writing of the store included. Machines
differ in speed, and some are much slower: a sweep ends with its last cell.

| Cost           | s       | from                                                                                  |
|----------------|---------|---------------------------------------------------------------------------------------|
| `CALL`         | 0.0015  | `benchmarks.cluster block`: what a block takes of the driver beside its cells (1.1 ms)  |
| `CELL`         | 0.00012 | `benchmarks.cluster driver`: unpickling, the desk and Parquet, for one cell             |
| `TABLES`       | 0.00035 | the same where the driver makes the tables of rows, as it did before                    |
| `LOOK`         | 2e-8    | what one report of progress took for each worker, as long as all were summed up         |
| `START`        | 6.0     | an actor and its process, until jax is there                                           |
| `COMPILE`      | 11.0    | gpc-ns, the slowest of the thesis's learners (`gpcjax.sweep.costs`)                    |
"""

import argparse
import heapq
from dataclasses import dataclass

import numpy as np

CALL, CELL, TABLES, LOOK = 1.5e-3, 1.2e-4, 3.5e-4, 2e-8
START, COMPILE = 6.0, 11.0
SPREAD = 0.1
"""Of the speeds of machines: standard deviation of the logarithm."""
SLOW, HOW_SLOW = 0.02, 3.0
"""The part of the machines that are slow, and how much longer they take."""
BATCH = 16
"""`gpcjax.sweep.sharing.BATCH`"""


@dataclass(frozen=True)
class Way:
    """How workers and driver speak."""

    name: str
    reports: float = 100.0
    """Fetches a second of all workers together, beside their questions (`CALLS_PER_SECOND`)."""
    each: bool = False
    """Whether each worker is heard twice a second instead, however many there are."""
    summed: bool = False
    """Whether each report goes through all workers, as it did before their sums were kept up."""
    batch: int = BATCH
    cell: float = CELL
    call: float = CALL

    def load(self, machines: int) -> float:
        """The part of the driver's time that reports of progress take."""
        rate = 2.0 * machines if self.each else min(self.reports, 2.0 * machines)
        return rate * (self.call + (LOOK * machines if self.summed else 0.0))


NOW = Way("as it is")
WAYS = (
    Way("each report summed over all workers, two a second of each", each=True, summed=True),
    Way("two reports a second of each worker", each=True),
    Way("a call for every cell", batch=1),
    Way("tables of rows made by the driver", cell=TABLES),
    NOW,
    Way("calls at half their cost", call=CALL / 2),
)


@dataclass(frozen=True)
class Outcome:
    """What became of a sweep."""

    wall: float
    """Seconds."""
    efficiency: float
    """Work done over what all machines could have done in that time, each at its own speed."""
    busy: float
    """The part of the time in which the driver worked."""


def simulate(machines: int, cells: int, seconds: float, way: Way = NOW, seed: int = 0) -> Outcome:
    """One sweep of so many cells of one program, each of so many seconds on a usual machine."""
    numbers = np.random.default_rng(seed)
    slower = np.exp(SPREAD * numbers.standard_normal(machines))
    slower[numbers.random(machines) < SLOW] *= HOW_SLOW
    free = 1.0 - way.load(machines)
    if free <= 0.02:  # reports alone are more than the driver can hear
        return Outcome(float("inf"), 0.0, 1.0)
    left, driver, worked, last = cells, 0.0, 0.0, 0.0
    # When each machine asks, and how many cells it hands in then.
    events = [(START + COMPILE * slow, number, 0) for number, slow in enumerate(slower)]
    heapq.heapify(events)
    while events:
        now, number, done = heapq.heappop(events)
        service = (way.call + way.cell * done) / free
        driver = max(driver, now) + service
        worked += service * free
        if done:
            last = driver
        share = min(left, max(1, min(way.batch, left // (4 * machines))))
        if share:
            left -= share
            took = share * seconds * slower[number]
            heapq.heappush(events, (driver + took, number, share))
    able = float((1.0 / slower).sum())
    return Outcome(last, cells * seconds / (last * able), worked / last + way.load(machines))


def linear_until(cells_per_machine: int, seconds: float, way: Way = NOW) -> int:
    """The number of machines up to which nine tenths of them are used, in steps of a quarter."""
    machines = 8
    while (
        machines < 1 << 17
        and simulate(machines, cells_per_machine * machines, seconds, way).efficiency >= 0.9
    ):
        machines = machines * 5 // 4
    return machines


def table(cells: int, seconds: float) -> str:
    """Wall time and efficiency, Markdown."""
    lines = ["| machines | wall time | efficiency | driver busy |", "|---|---|---|---|"]
    for machines in (10, 100, 1_000, 10_000):
        found = simulate(machines, cells, seconds)
        lines.append(f"| {machines:,} | {_time(found.wall)} | {found.efficiency:.2f} | {found.busy:.0%} |")
    return "\n".join(lines)


def ways(cells: int, seconds: float) -> str:
    """Efficiency of each way to speak, Markdown."""
    lines = ["| | 100 | 1,000 | 3,000 | 10,000 |", "|---|---|---|---|---|"]
    for way in WAYS:
        found = [simulate(machines, cells, seconds, way) for machines in (100, 1_000, 3_000, 10_000)]
        lines.append(f"| {way.name} | " + " | ".join(f"{each.efficiency:.2f}" for each in found) + " |")
    return "\n".join(lines)


def _time(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes // 60}:{minutes % 60:02} h" if minutes >= 100 else f"{seconds / 60:.1f} min"


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=2.0, help="of a cell")
    given = parser.parse_args()
    print(f"{given.cells:,} cells of {given.seconds:g} s\n\n{table(given.cells, given.seconds)}\n")
    print(ways(given.cells, given.seconds))


if __name__ == "__main__":
    main()
