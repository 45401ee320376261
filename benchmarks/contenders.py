"""Who is measured: each contender teaches on one task, counts the steps it took, and asserts that they are real.

Run as `python -m benchmarks.contenders NAME ALGO ENV SIZE` (lanes of gpcjax, steps of the naive one): it prepares
itself, says so with one line of JSON, and answers each further line it reads (a repetition's number) with one line of
JSON, a `Measurement`.
"""

import json
import math
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

RATE, DELTA = 0.05, 0.05
ERRORS = (0.0, 0.1, 0.2, 0.3)
EXPERT = {"cartpole": "lqr", "pendulum": "energy"}
EPISODES = {"cartpole": 10, "pendulum": 40}
"""Of every lane of every contender but the naive one, which would take hours: equal work, from idle to learned."""


@dataclass(frozen=True)
class Measurement:
    """One repetition: how many steps in how many seconds, and what kind of steps they were."""

    env_steps: int
    seconds: float
    lanes: int
    corrections: int
    policy_points: tuple[float, float]
    """Median and largest over lanes, at the end."""
    human_points: tuple[float, float]
    compile_seconds: float = 0.0


Contender = Callable[[int], Measurement]


def peer(name: str, algo: str, env: str) -> Contender:
    """One of `benchmarks.peers`, one lane for each error rate, each through as many episodes as gpcjax's."""
    from benchmarks.peers import numpy_loop, sklearn_loop

    options: dict[str, Any] = {"human_every_step": True} if name == "sklearn" else {}
    run = numpy_loop.run if name == "numpy" else sklearn_loop.run

    def measure(repetition: int) -> Measurement:
        results = [
            run(
                algo,
                env,
                steps=sys.maxsize,
                episodes=EPISODES[env],
                seed=repetition,
                error=error,
                rate=RATE,
                delta=DELTA,
                **options,
            )
            for error in ERRORS
        ]
        assert all(len(result.returns) == EPISODES[env] for result in results)
        assert all(math.isfinite(value) for result in results for value in result.returns)
        return Measurement(
            env_steps=sum(result.env_steps for result in results),
            seconds=sum(result.seconds for result in results),
            lanes=len(results),
            corrections=sum(result.corrections for result in results),
            policy_points=_spread([result.policy_points for result in results]),
            human_points=_spread([result.human_points for result in results]),
        )

    return measure


def gpcjax(algo: str, env: str, lanes: int) -> Contender:
    """The pool of `gpcjax sweep`: `lanes` seeds for each error rate, every one through all its episodes."""
    import numpy as np

    from gpcjax.engine.pool import Finished, Start
    from gpcjax.learners.base import Status
    from gpcjax.sweep.build import make_pool, start_of
    from gpcjax.sweep.plan import Cell, plan
    from gpcjax.sweep.spec import spec_of

    spec = spec_of(
        env=env,
        algo=algo,
        oracle=EXPERT[env],
        error=ERRORS,
        seeds=lanes,
        episodes=EPISODES[env],
        rate=RATE,
        delta=DELTA,
    )
    cells: list[Cell] = plan(spec)
    pool = make_pool(cells[0])

    def measure(_: int) -> Measurement:
        began, compiled, steps = time.perf_counter(), pool.counters.compile_seconds, pool.counters.env_steps
        starts, finished = iter(cells), list[Finished]()

        def next_start() -> Start | None:
            cell = next(starts, None)
            return None if cell is None else start_of(cell)

        pool.run(next_start, finished.append)
        compile_seconds = pool.counters.compile_seconds - compiled
        seconds = time.perf_counter() - began - compile_seconds
        rows = [run.lane.rows for run in finished]
        assert len(finished) == len(cells)
        assert all(run.lane.status == Status.OK and run.lane.episode == spec.episodes for run in finished)
        assert all(np.isfinite(row.returns).all() and (row.length > 0).all() for row in rows)
        taken = pool.counters.env_steps - steps
        assert taken == sum(int(row.length.sum()) for row in rows)
        return Measurement(
            env_steps=taken,
            seconds=seconds,
            lanes=len(cells),
            corrections=sum(int(row.corrections.sum()) for row in rows),
            policy_points=_spread([int(row.policy_points[-1]) for row in rows]),
            human_points=_spread([int(row.human_points[-1]) for row in rows]),
            compile_seconds=compile_seconds,
        )

    return measure


def naive(algo: str, env: str, steps: int) -> Contender:
    """The obvious way in jax: `vmap` over a step with a `cond`, at one capacity of 256."""
    from benchmarks.peers import naive_vmap

    run = naive_vmap.make(algo, env, ERRORS, steps, rate=RATE, delta=DELTA, expert=EXPERT[env])

    def measure(repetition: int) -> Measurement:
        began = time.perf_counter()
        result = run(repetition)
        return Measurement(
            env_steps=result.env_steps,
            seconds=time.perf_counter() - began,
            lanes=result.lanes,
            corrections=result.corrections,
            policy_points=_spread(result.policy_points),
            human_points=_spread(result.human_points),
        )

    return measure


def peak_mebibytes() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _spread(values: list[int]) -> tuple[float, float]:
    return float(median(values)), float(max(values))


def main() -> None:
    """Serves one contender."""
    name, algo, env, size = sys.argv[1:]
    if name == "gpcjax":
        measure = gpcjax(algo, env, int(size))
    elif name == "naive":
        measure = naive(algo, env, int(size))
    else:
        measure = peer(name, algo, env)
    warm = measure(0) if name in ("gpcjax", "naive") else None
    print(json.dumps({"warm": asdict(warm) if warm else None}), flush=True)
    for line in sys.stdin:
        print(json.dumps({**asdict(measure(int(line))), "peak_mib": peak_mebibytes()}), flush=True)


if __name__ == "__main__":
    main()
