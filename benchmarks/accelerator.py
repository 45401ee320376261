"""Lanes against throughput on whatever jax finds here, a GPU for one: `python -m benchmarks.accelerator`.

The pool of a sweep, with all its blocks as wide as asked for; every run goes through all its episodes, as in
`benchmarks.throughput`, or the case ends when its time is up. One line of JSON for each case, then a table.
"""

import argparse
import json
import time
from typing import Any

import jax
from rich.console import Console
from rich.table import Table

from benchmarks.cases import ERRORS, EXPERT, cases
from gpcjax.engine.block import Block
from gpcjax.engine.pool import Pool, Tier
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.registry import find
from gpcjax.sweep.build import start_of
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of


class TimeIsUp(Exception):
    """A case has run as long as it may."""


def measured(algo: str, env: str, width: int, seconds: float, runs: int, episodes: int) -> dict[str, Any]:
    """Steps a second with `runs` times as many runs as a block is wide, without what compiling takes."""
    case = next(case for case in cases((algo,), (env,)) if case.name == "usual")
    each = max(1, runs * width // len(ERRORS))
    names = {"env": env, "algo": algo, "oracle": EXPERT[env], "episodes": episodes}
    cells = plan(spec_of(**names, rate=case.rate, delta=case.delta, error=ERRORS, seeds=each))
    cells = sorted(cells, key=lambda cell: (cell.seed, cell.error))
    rooms = [(48, 64), (96, 128), (128, 256), (256, 512)] if find("learner", algo).dictionary else [(1, 1)]
    pool = Pool(
        env=make_env(env),
        expert=make_expert(env, EXPERT[env]),
        episodes=episodes,
        template=start_of(cells[0]),
        tiers=tuple(Tier(*room, lanes=max(8, width >> min(index, 2))) for index, room in enumerate(rooms)),
    )
    starts, finished, counters = iter(cells), [], pool.counters
    began = time.perf_counter()

    def next_start() -> Any:
        cell = next(starts, None)
        return None if cell is None else start_of(cell)

    def look() -> None:
        if time.perf_counter() - began - counters.compile_seconds > seconds:
            raise TimeIsUp

    complete, advance, advancing = True, Block.advance, 0.0

    def timed(self: Block) -> None:
        nonlocal advancing
        start, compiling = time.perf_counter(), counters.compile_seconds
        advance(self)
        advancing += time.perf_counter() - start - (counters.compile_seconds - compiling)

    Block.advance = timed
    try:
        pool.run(next_start, finished.append, look)
    except TimeIsUp:
        complete = False
    finally:
        Block.advance = advance
    took = time.perf_counter() - began - counters.compile_seconds
    return {
        "algo": algo,
        "env": env,
        "lanes": width,
        "steps_per_second": counters.env_steps / took,
        "env_steps": counters.env_steps,
        "seconds": took,
        "advancing": advancing,
        "compile_seconds": counters.compile_seconds,
        "complete": complete,
        "finished": len(finished),
        "promotions": counters.promotions,
        "chunks": counters.chunks,
        "mean_return": float(sum(run.lane.rows.returns[-1] for run in finished) / max(1, len(finished))),
    }


def main() -> None:
    """Measures what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--algos", default="gpc,gpc-ns,coach")
    parser.add_argument("--envs", default="cartpole,pendulum")
    parser.add_argument("--lanes", default="32,256,1024,4096,16384")
    parser.add_argument("--seconds", type=float, default=10.0, help="of one case, without compiling")
    parser.add_argument("--runs", type=int, default=1, help="for each lane")
    parser.add_argument("--episodes", type=int, default=30, help="of each run")
    given = parser.parse_args()
    device = jax.devices()[0]
    told = f"{device.platform} {device.device_kind}, jax {jax.__version__}"
    print(json.dumps({"device": told}), flush=True)
    table = Table("learner", "task", "lanes", "M steps/s", "compile s", title=told)
    for env in given.envs.split(","):
        for algo in given.algos.split(","):
            for width in map(int, given.lanes.split(",")):
                case = measured(algo, env, width, given.seconds, given.runs, given.episodes)
                print(json.dumps(case), flush=True)
                rate = f"{case['steps_per_second'] / 1e6:.2f}" + ("" if case["complete"] else " *")
                table.add_row(algo, env, str(width), rate, f"{case['compile_seconds']:.0f}")
    Console().print(table)


if __name__ == "__main__":
    main()
