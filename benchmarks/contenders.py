"""Who is measured: each contender teaches one case, counts the steps it took, and asserts that they are real.

Run as `python -m benchmarks.contenders NAME CASE` with the case as JSON: it prepares itself, says so with one line of
JSON, and answers each further line that it reads, the changes of a repetition as JSON, with one line: a `Measurement`.
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

from benchmarks.cases import ERRORS, EXPERT, Case

NAIVE_STEPS = 1000
"""Of each lane of the naive one: all episodes would take it hours."""


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


Contender = Callable[..., Measurement]
"""Called with `repetition`, and for gpcjax with what else is to change: `lanes` or `rate`."""


def peer(name: str, case: Case) -> Contender:
    """One of `benchmarks.peers`, a few lanes for each error rate, each through as many episodes as gpcjax's."""
    from benchmarks.peers import numpy_loop, sklearn_loop

    options: dict[str, Any] = {"human_every_step": True} if name == "sklearn" else {}
    run = numpy_loop.run if name == "numpy" else sklearn_loop.run
    seeds = 4 if name == "numpy" and case.name == "usual" else 1

    def measure(repetition: int) -> Measurement:
        results = [
            run(
                case.algo,
                case.env,
                steps=sys.maxsize,
                episodes=case.episodes,
                seed=seeds * repetition + seed,
                error=error,
                rate=case.rate,
                delta=case.delta,
                active_gain=case.active_gain,
                **options,
            )
            for error in ERRORS
            for seed in range(seeds)
        ]
        assert all(len(result.returns) == case.episodes for result in results)
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


def gpcjax(case: Case) -> Contender:
    """The pool of `gpcjax sweep`: some seeds for each error rate, every one through all its episodes."""
    import numpy as np

    from gpcjax.engine.pool import Finished, Start
    from gpcjax.learners.base import Status
    from gpcjax.sweep.build import start_of
    from gpcjax.sweep.plan import plan
    from gpcjax.sweep.spec import spec_of

    def cells(lanes: int, rate: float) -> list[Any]:
        """Errors take turns, so that few lanes have some of each."""
        teaching = {
            "rate": rate,
            "delta": case.delta,
            "error": ERRORS,
            "seeds": math.ceil(lanes / len(ERRORS)),
        }
        learning: dict[str, Any] = {"active_gain": case.active_gain} if case.active_gain else {}
        if case.capacity:
            learning |= {"max_capacity": case.capacity, "on_full": "drop"}
        names = {"env": case.env, "algo": case.algo, "oracle": EXPERT[case.env], "episodes": case.episodes}
        planned = plan(spec_of(**names, **teaching, **learning))
        return sorted(planned, key=lambda cell: (cell.seed, cell.error))[:lanes]

    pool = _pool(cells(1, case.rate)[0], case.capacity)

    def measure(repetition: int = 0, lanes: int | None = None, rate: float | None = None) -> Measurement:
        chosen = cells(lanes or case.lanes * len(ERRORS), case.rate if rate is None else rate)
        began, compiled, steps = time.perf_counter(), pool.counters.compile_seconds, pool.counters.env_steps
        starts, finished = iter(chosen), list[Finished]()

        def next_start() -> Start | None:
            cell = next(starts, None)
            return None if cell is None else start_of(cell)

        pool.run(next_start, finished.append)
        compile_seconds = pool.counters.compile_seconds - compiled
        seconds = time.perf_counter() - began - compile_seconds
        rows = [run.lane.rows for run in finished]
        assert len(finished) == len(chosen)
        assert all(run.lane.status == Status.OK and run.lane.episode == case.episodes for run in finished)
        assert all(np.isfinite(row.returns).all() and (row.length > 0).all() for row in rows)
        taken = pool.counters.env_steps - steps
        assert taken == sum(int(row.length.sum()) for row in rows)
        return Measurement(
            env_steps=taken,
            seconds=seconds,
            lanes=len(chosen),
            corrections=sum(int(row.corrections.sum()) for row in rows),
            policy_points=_spread([int(row.policy_points[-1]) for row in rows]),
            human_points=_spread([int(row.human_points[-1]) for row in rows]),
            compile_seconds=compile_seconds,
        )

    return measure


def _pool(cell: Any, capacity: int | None) -> Any:
    """The pool of a sweep; or one block of a fixed capacity."""
    from gpcjax.engine.pool import Pool, Tier
    from gpcjax.envs.registry import make_env, make_expert
    from gpcjax.sweep.build import make_pool, start_of

    if capacity is None:
        return make_pool(cell, learned=False)  # as in a sweep that keeps nothing
    return Pool(
        env=make_env(cell.env),
        expert=make_expert(cell.env, cell.oracle),
        episodes=cell.episodes,
        template=start_of(cell),
        tiers=(Tier(capacity, capacity, lanes=32 if capacity <= 128 else 8),),
    )


def naive(case: Case) -> Contender:
    """The obvious way in jax: `vmap` over a step with a `cond`, at one capacity of 256."""
    from benchmarks.peers import naive_vmap

    run = naive_vmap.make(
        case.algo, case.env, ERRORS, NAIVE_STEPS, rate=case.rate, delta=case.delta, expert=EXPERT[case.env]
    )

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
    name, case = sys.argv[1], Case(**json.loads(sys.argv[2]))
    measure = (
        {"gpcjax": gpcjax, "naive": naive}[name](case) if name in ("gpcjax", "naive") else peer(name, case)
    )
    warm = measure(repetition=0) if name in ("gpcjax", "naive") else None
    print(json.dumps({"warm": asdict(warm) if warm else None}), flush=True)
    for line in sys.stdin:
        measured = measure(**json.loads(line))
        print(json.dumps({**asdict(measured), "peak_mib": peak_mebibytes()}), flush=True)


if __name__ == "__main__":
    main()
