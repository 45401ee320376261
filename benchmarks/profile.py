"""Where the time of a step and of a correction goes, against what the machine can do.

A block of GPC on cart-pole is taken from the middle of its work, and each part of a round is run on it by itself, many
times in one compiled loop that feeds on its own results. `make bench` ends with it, in the environment of a sweep's
worker; by itself: `python -c 'from gpcjax.sweep.executors import run_alone; run_alone("benchmarks.profile")'`.
The machine's limits are measured in the same run: the rate of a matrix product, and of copying large arrays.
"""

import contextlib
import dataclasses
import itertools
import os
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from rich.console import Console
from rich.table import Table

from benchmarks.cases import ERRORS, Case
from gpcjax.engine import asking, correcting
from gpcjax.engine.lanes import Lane
from gpcjax.engine.pool import Pool, Tier
from gpcjax.engine.rollout import Loop
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.sweep.build import start_of
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of

REPEATED = 200
"""Runs of a part in one compiled loop."""
CHUNKS = 5
"""After so many chunks the block is taken."""


def taken(algo: str, tier: Tier) -> tuple[Loop, Lane]:
    """A block of `tier` in the middle of its work, and its loop."""
    case = Case(algo, "cartpole", episodes=10)
    cells = plan(
        spec_of(env=case.env, algo=algo, oracle="lqr", error=ERRORS, seeds=64, episodes=case.episodes)
    )
    cells = sorted(cells, key=lambda cell: cell.seed)
    pool = Pool(
        env=make_env(case.env),
        expert=make_expert(case.env, "lqr"),
        episodes=case.episodes,
        template=start_of(cells[0]),
        tiers=(tier, dataclasses.replace(tier, policy_capacity=2048, human_capacity=2048)),
    )
    starts, looks = map(start_of, cells), itertools.count()

    class Enough(Exception):
        pass

    def look() -> None:
        if next(looks) >= CHUNKS:
            raise Enough

    with contextlib.suppress(Enough):
        pool.run(lambda: next(starts, None), lambda finished: None, look)
    block = pool._blocks[0]
    assert isinstance(block._loop, Loop)
    return block._loop, block.lanes


def seconds(part: Callable[[Any], Any], carry: Any) -> float:
    """Of one run of `part`, whose result is its next argument; the memory is used over again, as in a sweep."""
    run = jax.jit(
        lambda carry: lax.fori_loop(0, REPEATED, lambda _, carry: part(carry), carry), donate_argnums=0
    )
    carry = jax.block_until_ready(run(jax.tree.map(jnp.copy, carry)))
    times: list[float] = []
    for _ in range(5):
        began = time.perf_counter()
        carry = jax.block_until_ready(run(carry))
        times.append(time.perf_counter() - began)
    return median(times) / REPEATED


def parts(loop: Loop, block: Lane) -> dict[str, float]:
    """Seconds of the parts of a round, for all lanes of the block."""
    replace = dataclasses.replace

    def act(obs: Any) -> Any:
        return obs + 1e-9 * block.controller(obs)

    def task(env: Any) -> Any:
        return jax.vmap(loop.env.step, in_axes=-1, out_axes=-1)(env, 0.1 * env.obs[:1])

    def steps(block: Lane) -> Lane:
        return replace(loop._step(block), waiting=jnp.zeros_like(block.waiting))

    def coins(block: Lane) -> Lane:
        window, start = loop._windows(block)
        return replace(
            block, window=window, env=replace(block.env, time=start + 1 + (window & 1).astype(jnp.int32))
        )

    def ask(block: Lane) -> Lane:
        asked, advice = asking.ask(
            replace(block, waiting=jnp.ones_like(block.waiting)), loop.expert, loop.grows
        )
        env = replace(block.env, time=block.env.time + 1 + (advice[0] > 2).astype(jnp.int32))
        return replace(block, env=env, action=asked.action + 1e-12 * advice)

    return {
        "policies, one step": seconds(act, block.env.obs),
        "cart-poles, one step": seconds(task, block.env),
        f"{loop.stride} steps, with coins and counts": seconds(steps, block),
        "drawing 32 coins": seconds(coins, block),
        "asking the teacher": seconds(ask, block),
        "a round, corrections and all": seconds(loop.round, block),
    }


def correction(loop: Loop, block: Lane) -> float:
    """Seconds of one correction, the lanes taking turns."""
    lanes = block.phase.shape[0]

    def correct(carry: tuple[Any, Lane]) -> tuple[Any, Lane]:
        index, block = carry
        advice = jnp.where(jnp.arange(lanes) == index % lanes, 1.0, 0.0)[None]
        corrected = correcting.correct(block, advice)
        # A dictionary that is nearly full stays so: the work is the same, and its room is never exceeded.
        policy, human = corrected.state.policy, corrected.state.human
        limit = lambda posterior: dataclasses.replace(  # noqa: E731
            posterior, count=jnp.minimum(posterior.count, posterior.points.shape[-2] - 2)
        )
        state = dataclasses.replace(corrected.state, policy=limit(policy), human=limit(human))
        return index + 1, dataclasses.replace(
            corrected, state=state, phase=jnp.zeros_like(block.phase), status=jnp.zeros_like(block.status)
        )

    return seconds(correct, (jnp.zeros((), jnp.int32), block))


def limits() -> tuple[float, float]:
    """Floating-point operations, and bytes copied (read and written), per second, of this core."""
    matrix = np.random.default_rng(0).normal(size=(1024, 1024))
    source, target = np.ones(1 << 25), np.empty(1 << 25)

    def timed(work: Callable[[], Any]) -> float:
        times: list[float] = []
        for _ in range(5):
            began = time.perf_counter()
            work()
            times.append(time.perf_counter() - began)
        return median(times)

    product, copy = timed(lambda: matrix @ matrix), timed(lambda: np.copyto(target, source))
    return 2 * 1024**3 / product, 2 * source.nbytes / copy


def main() -> None:
    """Measures and prints."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    console = Console(width=120)
    flops, bandwidth = limits()
    console.print(
        f"this core: {flops / 1e9:.0f} Gflop/s (product of two matrices), {bandwidth / 1e9:.1f} GB/s copied"
    )
    tier = Tier(48, 64, 32)
    loop, block = taken("gpc", tier)
    measured = parts(loop, block)
    points = tier.policy_capacity * tier.lanes
    drawn = Table(
        title=f"{tier.lanes} lanes of GPC, room for {tier.policy_capacity} points",
        title_justify="left",
        box=None,
    )
    drawn.add_column("part")
    drawn.add_column("us", justify="right")
    for name, value in measured.items():
        drawn.add_row(name, f"{1e6 * value:.2f}")
    console.print(drawn)
    rate = points / measured["policies, one step"]
    console.print(f"policies: {rate / 1e6:.0f} M points/s, {rate * 40 / 1e9:.0f} GB/s from the caches")
    drawn = Table(title="one correction", title_justify="left", box=None)
    for name in ("learner", "room P, H", "us"):
        drawn.add_column(name, justify="left" if name == "learner" else "right")
    for algo in ("gpc", "gpc-ns"):
        for policy, human, lanes in ((48, 64, 32), (96, 128, 16), (128, 256, 16), (256, 512, 16)):
            cost = correction(*taken(algo, Tier(policy, human, lanes)))
            drawn.add_row(algo, f"{policy}, {human}", f"{1e6 * cost:.1f}")
    console.print(drawn)


if __name__ == "__main__":
    main()
