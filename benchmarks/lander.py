"""Lunar lander: steps a second with a learner, against the bare physics on the same cores in the same run.

    python -m benchmarks.lander [--repetitions N] [--runs N] [--episodes N] [--algo gpc,gpc:256,coach,gpc-ns,gpc-ns:256]

`gpc:256` is GPC with room for 256 points in each dictionary, of which a new one takes the nearest one's place when it
is full (`--max-capacity 256 --on-full replace-nearest`).

A contender runs once on each core at the same time, and their steps a second add up; compilation is left out.
Repetitions are interleaved, reported is the median. The physics replays episodes that the heuristic flew, on
simulations that are made as a sweep makes them; learners teach whole runs, with everything that is counted in a sweep.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time

from gpcjax.sweep.environment import worker_environment

PHYSICS = "physics"
EPISODES = 40
"""That the physics replays, again and again."""


def main() -> None:
    """Measures all contenders, or with --alone one of them in this process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--algo", default="gpc,coach,gpc-ns")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument(
        "--runs", type=int, default=32, help="of GPC and COACH on each core; a quarter of GPC-NS"
    )
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--alone", help=argparse.SUPPRESS)
    parser.add_argument("--core", type=int, default=0, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.alone:
        runs = max(8, arguments.runs // 4) if arguments.alone.startswith("gpc-ns") else arguments.runs
        first = arguments.core * runs
        print(json.dumps(measure(arguments.alone, range(first, first + runs), arguments.episodes)))
        return
    cores = sorted(os.sched_getaffinity(0))
    contenders = [PHYSICS, *arguments.algo.split(",")]
    speeds: dict[str, list[float]] = {name: [] for name in contenders}
    for repetition in range(arguments.repetitions):
        for name in contenders:
            results = _on_all_cores(name, cores, arguments)
            speeds[name].append(sum(result["steps"] / result["seconds"] for result in results))
            print(f"{repetition + 1}: {name}: {speeds[name][-1]:,.0f} steps/s", file=sys.stderr, flush=True)
    bare = statistics.median(speeds[PHYSICS])
    print(f"| contender | steps/s, {len(cores)} cores | of the bare physics |\n|---|---|---|")
    for name, values in speeds.items():
        middle = statistics.median(values)
        print(f"| {name} | {middle:,.0f} | {100 * middle / bare:.0f} % |")


def measure(name: str, seeds: range, episodes: int) -> dict[str, float]:
    """Steps and seconds of one contender in this process."""
    return _physics() if name == PHYSICS else _learner(name, seeds, episodes)


def _on_all_cores(name: str, cores: list[int], arguments: argparse.Namespace) -> list[dict[str, float]]:
    processes = []
    for index, core in enumerate(cores):
        command = ["taskset", "-c", str(core), sys.executable, "-m", "benchmarks.lander", "--alone", name]
        command += [
            f"--core={index}",
            f"--runs={arguments.runs}",
            f"--episodes={arguments.episodes}",
        ]
        processes.append(subprocess.Popen(command, env=worker_environment(), stdout=subprocess.PIPE))
    return [json.loads(process.communicate()[0]) for process in processes]


def _physics(seconds: float = 15.0) -> dict[str, float]:
    import numpy as np
    from gymnasium.envs.box2d.lunar_lander import heuristic

    from gpcjax.envs.registry import make_env

    simulation = make_env("lunarlander").simulate()
    flights = []
    for seed in range(EPISODES):
        obs, actions, over = simulation.reset(seed), [], False
        while not over:
            actions.append(np.asarray(heuristic(simulation._env, obs), np.float64))
            outcome = simulation.step(actions[-1])
            obs, over = outcome.obs, outcome.terminated or outcome.truncated
        flights.append(actions)
    steps, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        for seed, actions in enumerate(flights):
            simulation.reset(seed)
            for action in actions:
                simulation.step(action)
            steps += len(actions)
    return {"steps": steps, "seconds": time.perf_counter() - began}


def _learner(name: str, seeds: range, episodes: int) -> dict[str, float]:
    from gpcjax.sweep.build import make_pool, start_of
    from gpcjax.sweep.plan import plan
    from gpcjax.sweep.spec import spec_of

    algo, _, points = name.partition(":")
    bounded = {"max_capacity": int(points), "on_full": "replace-nearest"} if points else {}
    cells = plan(spec_of(env="lunarlander", algo=algo, seeds=seeds.stop, episodes=episodes, **bounded))
    cells = [cell for cell in cells if cell.seed in seeds]
    pool, waiting, delivered = make_pool(cells[0]), iter(cells), []
    began = time.perf_counter()
    pool.run(lambda: next((start_of(cell) for cell in waiting), None), delivered.append)
    elapsed = time.perf_counter() - began
    assert len(delivered) == len(cells) and all(run.lane.status == 0 for run in delivered)
    return {"steps": pool.counters.env_steps, "seconds": elapsed - pool.counters.compile_seconds}


if __name__ == "__main__":
    main()
