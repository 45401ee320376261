"""Environment steps per second of gpcjax beside its peers, in one run: `make bench`.

Each contender lives in a process of its own, pinned to one core, and is compiled and warmed up before anything counts.
Then the repetitions interleave, so that what else the machine does strikes all alike; the table gives medians, and the
medians of ratios taken within a repetition. Everything is counted: acting, the task, the teacher, learning, and for
gpcjax the host's work between chunks. Compile time stands apart.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table

ONE_THREAD = {"NPROC": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
NAIVE_STEPS = 1000
LABELS = {
    "sklearn": "scikit-learn, as the public code",
    "sklearn-policy": "scikit-learn, policy alone each step",
    "numpy": "numpy, incremental",
    "naive": "jax, naive vmap(cond)",
    "gpcjax": "gpcjax, one core",
    "gpcjax-all": "gpcjax, all cores",
}


@dataclass
class Process:
    """A contender in its process."""

    process: subprocess.Popen[str]
    warm: dict[str, Any] | None

    def ask(self, repetition: int) -> None:
        """Starts a repetition."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{repetition}\n")
        self.process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        """Waits for what it measured."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"a contender ended with status {self.process.wait()}")
        return json.loads(line)


def start(name: str, algo: str, env: str, size: int, core: int) -> Process:
    """Starts a contender pinned to one core; returns when it is warm."""
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.contenders", name, algo, env, str(size)],
        env={**os.environ, **ONE_THREAD},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, {core}),
    )
    contender = Process(process, None)
    contender.warm = contender.answer()["warm"]
    return contender


def measure(algo: str, env: str, repetitions: int, lanes: int) -> dict[str, list[dict[str, Any]]]:
    """All repetitions of every contender that knows `algo`, by name."""
    cores = sorted(os.sched_getaffinity(0))
    ours = [start("gpcjax", algo, env, lanes, core) for core in cores]
    names = ["numpy"] if algo == "coach" else ["numpy", "sklearn", "sklearn-policy"]
    if (algo, env) == ("gpc", "cartpole"):
        names.append("naive")
    peers = {name: start(name, algo, env, NAIVE_STEPS, cores[0]) for name in names}
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in (*peers, "gpcjax", "gpcjax-all")}
    try:
        for repetition in range(repetitions):
            for name, contender in (*peers.items(), ("gpcjax", ours[0])):
                contender.ask(repetition)
                found[name].append({**contender.answer(), "warm": contender.warm})
            for contender in ours:
                contender.ask(repetition)
            found["gpcjax-all"].append(together([contender.answer() for contender in ours]))
    finally:
        for contender in (*peers.values(), *ours):
            contender.process.kill()
            contender.process.wait()
    return found


def together(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """One measurement of processes that ran at the same time: all their steps, the longest of their times."""
    added = {
        name: sum(part[name] for part in parts) for name in ("env_steps", "lanes", "corrections", "peak_mib")
    }
    return {**parts[0], **added, "seconds": max(part["seconds"] for part in parts)}


def speed(measurement: dict[str, Any]) -> float:
    """Environment steps per second."""
    return measurement["env_steps"] / measurement["seconds"]


def ratio(first: list[dict[str, Any]], second: list[dict[str, Any]]) -> float:
    """Median over repetitions of how many times faster the first is."""
    return median(speed(a) / speed(b) for a, b in zip(first, second, strict=True))


def table(env: str, results: dict[str, dict[str, list[dict[str, Any]]]]) -> Table:
    """Medians, and what kind of work they were measured on."""
    drawn = Table(title=f"{env}: environment steps per second, medians", title_justify="left", box=None)
    for name in (
        "algo",
        "contender",
        "steps/s",
        "times slower",
        "steps/lane",
        "corr./1000",
        "P",
        "H",
        "MiB",
        "compile s",
    ):
        drawn.add_column(name, justify="left" if name in ("algo", "contender") else "right")
    for algo, found in results.items():
        for name, measured in found.items():
            steps, lanes, corrections = (
                sum(m[key] for m in measured) for key in ("env_steps", "lanes", "corrections")
            )
            warm = measured[0].get("warm")
            drawn.add_row(
                algo,
                LABELS[name],
                f"{median(map(speed, measured)):,.0f}",
                f"{ratio(found['gpcjax'], measured):,.2f}",
                f"{steps / lanes:,.0f}",
                f"{1000 * corrections / steps:.1f}",
                *(
                    f"{measured[-1][key][0]:.0f}/{measured[-1][key][1]:.0f}"
                    for key in ("policy_points", "human_points")
                ),
                f"{max(m['peak_mib'] for m in measured):,.0f}",
                f"{warm['compile_seconds']:.1f}" if warm and warm["compile_seconds"] else "",
            )
            algo = ""
    return drawn


def main() -> None:
    """Parses, measures, prints, and writes the JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--env", default="cartpole", choices=("cartpole", "pendulum"))
    parser.add_argument("--algo", default="gpc,gpc-ns,coach", help="comma list (default: %(default)s)")
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--lanes", type=int, default=64, help="gpcjax lanes for each of four error rates")
    parser.add_argument("--quick", action="store_true", help="two repetitions, few lanes")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/throughput.json"))
    arguments = parser.parse_args()
    repetitions, lanes = (2, 16) if arguments.quick else (arguments.repetitions, arguments.lanes)
    results = {algo: measure(algo, arguments.env, repetitions, lanes) for algo in arguments.algo.split(",")}
    Console(width=140).print(table(arguments.env, results))
    for algo, found in results.items():
        Console().print(f"{algo}: all cores against one {ratio(found['gpcjax-all'], found['gpcjax']):.2f}")
    record = {
        "env": arguments.env,
        "repetitions": repetitions,
        "machine": {"platform": platform.platform(), "cores": len(os.sched_getaffinity(0))},
        "versions": {name: version(name) for name in ("jax", "jaxlib", "numpy", "scikit-learn")},
        "results": results,
    }
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(record, indent=1) + "\n")
    Console().print(f"{arguments.out}")


if __name__ == "__main__":
    main()
