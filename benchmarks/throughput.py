"""Environment steps per second of gpcjax beside its peers, in one run: `make bench`.

Each contender lives in a process of its own, pinned to one core, and is compiled and warmed up before anything counts.
Then the repetitions interleave, so that what else the machine does strikes all alike; the tables give medians, and the
medians of ratios taken within a repetition. Everything is counted: acting, the task, the teacher, learning, and for
gpcjax the host's work between chunks. Compile time stands apart.

Then whole commands, cold and warm (`benchmarks.waiting`). Written are the tables, `throughput.json` with all
measurements, machine and versions, and `throughput.png`; `benchmarks.calls` measures single calls from Python, and
`benchmarks.profile` tells where the time goes.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks import waiting
from benchmarks.cases import Case, cases
from gpcjax.sweep.environment import computing_environment
from gpcjax.sweep.executors import run_alone

LABELS = {
    "sklearn": "scikit-learn, as the public code",
    "sklearn-policy": "scikit-learn, policy alone each step",
    "numpy": "numpy, incremental",
    "numpy-all": "numpy, all cores",
    "naive": "jax, naive vmap(cond)",
    "gpcjax": "gpcjax, one core",
    "gpcjax-all": "gpcjax, all cores",
}
LANES = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048)
CAPACITIES = (32, 64, 128, 256, 512, 1024)
RATES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)

Measurements = list[dict[str, Any]]


@dataclass
class Process:
    """A contender in its process."""

    process: subprocess.Popen[str]
    warm: dict[str, Any] | None

    def ask(self, **changes: Any) -> None:
        """Starts a repetition."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(changes) + "\n")
        self.process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        """Waits for what it measured."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"a contender ended with status {self.process.wait()}")
        return json.loads(line)

    def end(self) -> None:
        """Ends the process."""
        self.process.kill()
        self.process.wait()


def begin(name: str, case: Case, core: int) -> Process:
    """Starts a contender pinned to one core; returns when it is warm."""
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.contenders", name, json.dumps(asdict(case))],
        env={**os.environ, **computing_environment()},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, {core}),
    )
    contender = Process(process, None)
    contender.warm = contender.answer()["warm"]
    return contender


def compare(case: Case, repetitions: int) -> dict[str, Measurements]:
    """All repetitions of every contender that knows the case, by name."""
    cores = sorted(os.sched_getaffinity(0))
    usual_cartpole = case.env == "cartpole" and case.name == "usual"
    groups: dict[str, list[Process]] = {}
    try:
        if case.algo != "coach":
            groups["sklearn"] = [begin("sklearn", case, cores[0])]
            if usual_cartpole and case.algo == "gpc":
                groups["sklearn-policy"] = [begin("sklearn-policy", case, cores[0])]
        every_numpy = [begin("numpy", case, core) for core in cores]
        groups["numpy"], groups["numpy-all"] = every_numpy[:1], every_numpy
        if usual_cartpole and case.algo == "gpc":
            groups["naive"] = [begin("naive", case, cores[0])]
        ours = [begin("gpcjax", case, core) for core in cores]
        groups["gpcjax"], groups["gpcjax-all"] = ours[:1], ours
        found: dict[str, Measurements] = {name: [] for name in groups}
        for repetition in range(repetitions):
            for name, processes in groups.items():
                for index, process in enumerate(processes):
                    process.ask(repetition=repetition + index * repetitions)
                found[name].append(together(processes))
        return found
    finally:
        for processes in groups.values():
            for process in processes:
                process.end()


def together(processes: list[Process]) -> dict[str, Any]:
    """One measurement of processes that ran at the same time: all their steps, the longest of their times."""
    parts = [process.answer() for process in processes]
    added = {
        name: sum(part[name] for part in parts) for name in ("env_steps", "lanes", "corrections", "peak_mib")
    }
    longest = max(part["seconds"] for part in parts)
    return {**parts[0], **added, "seconds": longest, "warm": processes[0].warm}


def curves(case: Case, repetitions: int) -> dict[str, dict[str, Measurements]]:
    """Of gpcjax alone: against lanes, advice rate, cores, and capacity."""
    cores = sorted(os.sched_getaffinity(0))
    found: dict[str, dict[str, Measurements]] = {"lanes": {}, "rate": {}, "cores": {}, "capacity": {}}

    def note(curve: str, point: float, processes: list[Process], **changes: Any) -> None:
        for process in processes:
            process.ask(**changes)
        found[curve].setdefault(str(point), []).append(together(processes))

    processes = [begin("gpcjax", case, core) for core in cores]
    try:
        for curve, points in (("lanes", LANES), ("rate", RATES)):
            for point in points:  # larger blocks may be compiled at their first use: once unmeasured
                processes[0].ask(**{curve: point}, **({} if curve == "lanes" else {"lanes": 128}))
                processes[0].answer()
        for _ in range(repetitions):
            for lanes in LANES:
                note("lanes", lanes, processes[:1], lanes=lanes)
            for rate in RATES:
                note("rate", rate, processes[:1], rate=rate, lanes=128)
            for count in range(1, len(cores) + 1):
                note("cores", count, processes[:count])
    finally:
        for process in processes:
            process.end()
    for capacity in CAPACITIES:
        process = begin("gpcjax", replace(case, capacity=capacity, lanes=16), cores[0])
        try:
            for _ in range(repetitions):
                note("capacity", capacity, [process])
        finally:
            process.end()
    return found


def speed(measurement: dict[str, Any]) -> float:
    """Environment steps per second."""
    return measurement["env_steps"] / measurement["seconds"]


def median_speed(measured: Measurements) -> float:
    """Median over repetitions."""
    return median(map(speed, measured))


def ratio(first: Measurements, second: Measurements) -> float:
    """Median over repetitions of how many times faster the first is."""
    return median(speed(a) / speed(b) for a, b in zip(first, second, strict=True))


def table(compared: Iterable[tuple[Case, dict[str, Measurements]]]) -> Table:
    """Medians, and what kind of work they were measured on."""
    drawn = Table(title="environment steps per second, medians", title_justify="left", box=None)
    left = ("task", "learner", "teaching", "contender")
    right = ("steps/s", "times slower", "steps/lane", "corr./1000", "P", "H", "MiB", "compile s")
    for name in (*left, *right):
        drawn.add_column(name, justify="left" if name in left else "right")
    for case, found in compared:
        labels = (case.env, case.algo, case.name)
        for name, measured in found.items():
            steps, lanes, corrections = (
                sum(m[key] for m in measured) for key in ("env_steps", "lanes", "corrections")
            )
            warm = measured[0].get("warm")
            points = (
                f"{measured[-1][key][0]:.0f}/{measured[-1][key][1]:.0f}"
                for key in ("policy_points", "human_points")
            )
            drawn.add_row(
                *labels,
                LABELS[name],
                f"{median_speed(measured):,.0f}",
                f"{ratio(found['gpcjax'], measured):,.2f}",
                f"{steps / lanes:,.0f}",
                f"{1000 * corrections / steps:.1f}",
                *points,
                f"{max(m['peak_mib'] for m in measured):,.0f}",
                f"{warm['compile_seconds']:.1f}" if warm and warm["compile_seconds"] else "",
            )
            labels = ("", "", "")
    return drawn


def main() -> None:
    """Parses, measures, prints, and writes the JSON and the figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--env", default="cartpole,pendulum", help="comma list (default: %(default)s)")
    parser.add_argument("--algo", default="gpc,gpc-ns,coach", help="comma list (default: %(default)s)")
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="usual teaching on cart-pole, twice, few lanes")
    parser.add_argument("--curves-only", action="store_true", help="no peers: the figure and the profile")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    arguments = parser.parse_args()
    chosen = cases(tuple(arguments.algo.split(",")), tuple(arguments.env.split(",")))
    repetitions, console = arguments.repetitions, Console(width=150)
    if arguments.quick:
        chosen = [
            replace(case, lanes=16) for case in chosen if (case.env, case.name) == ("cartpole", "usual")
        ]
        repetitions = 2
    compared: list[tuple[Case, dict[str, Measurements]]] = []
    record: dict[str, Any] = {
        "repetitions": repetitions,
        "machine": {"platform": platform.platform(), "cores": len(os.sched_getaffinity(0))},
        "versions": {name: version(name) for name in ("jax", "jaxlib", "numpy", "scikit-learn")},
        "compared": [],
    }
    arguments.out.mkdir(parents=True, exist_ok=True)

    name = "curves.json" if arguments.curves_only else "throughput.json"

    def write() -> None:
        (arguments.out / name).write_text(json.dumps(record, indent=1) + "\n")

    for case in [] if arguments.curves_only else chosen:
        console.print(f"{case.env}, {case.algo}, {case.name} ...")
        compared.append((case, compare(case, repetitions)))
        record["compared"].append({"case": asdict(case), "found": compared[-1][1]})
        write()
    if not arguments.curves_only:
        console.print("whole commands ...")
        small = [command for command in waiting.COMMANDS if command.name.startswith("small")]
        record["waiting"] = waiting.measured(
            small if arguments.quick else waiting.COMMANDS, min(repetitions, 3)
        )
        write()
        console.print(waiting.table(record["waiting"]))
    if compared:
        console.print(table(compared))
    for case, found in compared:
        cores = ratio(found["gpcjax-all"], found["gpcjax"])
        console.print(f"{case.env}, {case.algo}, {case.name}: all cores against one {cores:.2f}")
    if not arguments.quick:
        from benchmarks.plots import draw

        console.print("gpcjax alone: lanes, advice rate, cores, capacity ...")
        (usual,) = (case for case in cases(("gpc",), ("cartpole",)) if case.name == "usual")
        record["curves"] = {"case": asdict(usual), **curves(usual, repetitions)}
        write()
        draw(record, arguments.out / "throughput.png")
    console.print(f"{arguments.out}/{name}")
    if not arguments.quick:
        run_alone("benchmarks.calls")
        run_alone("benchmarks.profile")


if __name__ == "__main__":
    main()
