"""What a robot's own loop waits for, call by call from Python: `python -m benchmarks.calls`.

| measured | how |
|---|---|
| a policy that only acts | fresh processes: `import gpcjax; load_policy; act` |
| the first correction, and the one after `grow` | fresh processes for GPC and GPC-NS, cold and after `warm_up` |
| `act` and `correct` with a taught learner | one process for each learner: all kinds of calls in turn, many times |

Processes have the environment of whoever starts this, as a robot's program has, and come in turn, so that what else the
machine does strikes all alike. Written are the tables and `calls.json`, with all measurements, machine and versions.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from gpcjax.policies.saved import shipped_path

ALGOS = ("gpc", "gpc-ns")

ACTS = """
import json, time
began = time.perf_counter(), time.process_time()
import gpcjax
policy = gpcjax.load_policy({path!r})
{act}
ended = time.perf_counter(), time.process_time()
print(json.dumps(dict(zip(("load and act", "load and act, processor"), (b - a for a, b in zip(began, ended))))))
"""
ACTING = {
    "in numpy": "policy([0.0, 0.0, 0.01, 0.0])",
    "in jax": "import jax.numpy as jnp; policy(jnp.array([0.0, 0.0, 0.01, 0.0])).block_until_ready()",
}
"""A program that loads a policy, and two ways to act: it loads nothing else, as this module does."""


OURS = ("-m", "benchmarks.calls")

IN_A_ROW = 25

INLINE = {"JAX_CPU_ENABLE_ASYNC_DISPATCH": "0"}
"""Programs are run by who calls them (`docs/python.md`)."""


def firsts(algo: str, warm: bool) -> dict[str, float]:
    """Seconds of what compiles when it comes first; `warm` compiles it beforehand."""
    import jax

    import gpcjax

    learner = gpcjax.make_learner(algo, "cartpole")
    seconds = Stopwatch()
    state = jax.block_until_ready(learner.init())
    seconds.lap("init")
    if warm:
        behind = learner.warm_up(state)
        seconds.lap("warm_up")
        behind.join()
        seconds.lap("its thread")
    given = np.zeros(4), [0.0], [1]
    state, _ = jax.block_until_ready(learner.correct(state, *given))
    seconds.lap("first correct")
    jax.block_until_ready(learner.act(state, given[0]))
    seconds.lap("first act")
    state, _ = jax.block_until_ready(learner.correct(learner.grow(state), *given))
    seconds.lap("grow and correct")
    return seconds.laps


def calls(algo: str, points: int, repetitions: int) -> dict[str, list[float]]:
    """Seconds of each call with a learner of so many points, until its result is there.

    Kinds come in turn, `IN_A_ROW` calls of each: a loop of one's own calls the same again and again. Before a
    correction that is given the state (donate) there is a copy of it, which is not timed.
    """
    import jax
    import jax.numpy as jnp

    import gpcjax

    learner = gpcjax.make_learner(algo, "cartpole")
    rng, state = np.random.default_rng(0), learner.init()
    while int(state.policy.count[0]) < points:
        state, _ = learner.correct(state, 3.0 * rng.normal(size=4), [0.1], [1])
    policy, spare = learner.policy_of(state), state

    kinds: dict[str, Callable[[Any], Any]] = {
        "act": lambda obs: learner.act(state, obs),
        "policy": policy,
        "correct": lambda obs: learner.correct(state, obs, [0.1], [1]),
        "correct, donate": lambda obs: learner.correct(spare, obs, [0.1], [1], donate=True),
    }
    found: dict[str, list[float]] = {name: [] for name in kinds}
    for repetition in range(-1, -(-repetitions // IN_A_ROW)):
        for name, call in kinds.items():
            for obs in 3.0 * rng.normal(size=(IN_A_ROW, 4)):
                if name == "correct, donate":
                    spare = jax.block_until_ready(jax.tree.map(jnp.copy, state))
                began = time.perf_counter()
                jax.block_until_ready(call(obs))
                if repetition >= 0:  # the first ones compile
                    found[name].append(time.perf_counter() - began)
    return found


class Stopwatch:
    """Seconds from lap to lap, by name: of the clock, and of the processor."""

    def __init__(self):
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter(), time.process_time()

    def lap(self, name: str) -> None:
        """What has passed since the last one."""
        now = time.perf_counter(), time.process_time()
        self.laps[name], self.laps[f"{name}, processor"] = (
            new - old for new, old in zip(now, self._last, strict=True)
        )
        self._last = now


def alone(*words: object, variables: Mapping[str, str] = {}) -> dict[str, Any]:
    """What Python with these words measures in a process of its own, and how long that process took."""
    began, environment = time.perf_counter(), {**os.environ, **variables}
    done = subprocess.run(
        [sys.executable, *map(str, words)], stdout=subprocess.PIPE, text=True, check=True, env=environment
    )
    return {**json.loads(done.stdout), "whole process": time.perf_counter() - began}


def table(found: dict[str, list[dict[str, Any]]]) -> Table:
    """Medians over processes, in seconds."""
    names = list(dict.fromkeys(name for each in found.values() for run in each for name in run))
    shown = [name for name in names if not name.endswith("processor")]
    drawn = Table(box=None)
    for name in ("", *shown):
        drawn.add_column(name, justify="right" if name else "left")
    for label, runs in found.items():
        cells = []
        for name in shown:
            several = [
                np.median([run[each] for run in runs if each in run] or [np.nan]) for each in _both(name)
            ]
            cells.append("" if np.isnan(several[0]) else _cell(*several))
        drawn.add_row(label, *cells)
    return drawn


def _both(name: str) -> tuple[str, str]:
    return name, f"{name}, processor"


def _cell(wall: float, processor: float) -> str:
    return f"{wall:.2f}" if np.isnan(processor) else f"{wall:.2f} ({processor:.2f})"


def table_of_calls(found: dict[str, dict[str, list[float]]]) -> Table:
    """Medians and 99th percentiles, in milliseconds."""
    drawn = Table(box=None)
    for name in ("", *next(iter(found.values()))):
        drawn.add_column(name, justify="right" if name else "left")
    for algo, kinds in found.items():
        cells = (
            f"{1e3 * np.median(all_):.3f} ({1e3 * np.quantile(all_, 0.99):.2f})" for all_ in kinds.values()
        )
        drawn.add_row(algo, *cells)
    return drawn


def main() -> None:
    """Parses, measures, prints, and writes the JSON; with a role, it is one of the processes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("role", nargs="*", help=argparse.SUPPRESS)
    parser.add_argument("--processes", type=int, default=5, help="of each kind (default: %(default)s)")
    parser.add_argument("--repetitions", type=int, default=1000, help="of each call (default: %(default)s)")
    parser.add_argument(
        "--points", type=int, default=300, help="of the taught learner (default: %(default)s)"
    )
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    arguments = parser.parse_args()
    if arguments.role:
        print(json.dumps(_measured(*arguments.role)))
        return
    console, path = Console(width=150), str(shipped_path("cartpole"))
    acting: dict[str, list[dict[str, Any]]] = {}
    first: dict[str, list[dict[str, Any]]] = {}
    for _ in range(arguments.processes):
        for name, act in ACTING.items():
            acting.setdefault(name, []).append(alone("-c", ACTS.format(path=path, act=act)))
        for algo in ALGOS:
            for role in ("cold", "warm"):
                first.setdefault(f"{algo}, {role}", []).append(alone(*OURS, role, algo))
    console.print("seconds, medians (of the processor): a policy that only acts, and what compiles")
    console.print(table(acting))
    console.print(table(first))
    called = {}
    for algo in ALGOS:
        for name, variables in ((algo, {}), (f"{algo}, inline", INLINE)):
            words = *OURS, "calls", algo, arguments.points, arguments.repetitions
            called[name] = alone(*words, variables=variables)
            del called[name]["whole process"]
    console.print(f"with {arguments.points} points: milliseconds, median (99th percentile)")
    console.print(table_of_calls(called))
    record = {
        "machine": {"platform": platform.platform(), "cores": len(os.sched_getaffinity(0))},
        "versions": {name: version(name) for name in ("jax", "jaxlib", "numpy", "tensorstore")},
        "points": arguments.points,
        "acts": acting,
        "firsts": first,
        "calls": called,
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "calls.json").write_text(json.dumps(record, indent=1) + "\n")
    console.print(f"{arguments.out}/calls.json")


def _measured(role: str, *words: str) -> dict[str, Any]:
    match role, *words:
        case (("cold" | "warm"), algo):
            return firsts(algo, role == "warm")
        case "calls", algo, points, repetitions:
            return calls(algo, int(points), int(repetitions))
    raise SystemExit(f"no such role: {role}")


if __name__ == "__main__":
    main()
