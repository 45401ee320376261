"""How well a policy does: its mean return with an interval, and each episode."""

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from gpcjax.play.chosen import Player, check_sizes
from gpcjax.report import words
from gpcjax.report.document import Sheet
from gpcjax.report.statistics import Interval, mean_interval

_ACROSS = 10
"""Episodes in a row of the table."""


class Evaluation(NamedTuple):
    """Episodes of a policy, from the starts of as many seeds; nothing is learned from them."""

    player: Player
    seed: int
    """Of the first start."""
    returns: Float[np.ndarray, " episodes"]
    """NaN where a number was not finite."""
    steps: Int[np.ndarray, " episodes"]
    mean: Interval
    """With its 95% interval; none for one episode, or where a return is no number."""


def evaluated(player: Player, episodes: int, seed: int) -> Evaluation:
    """Simulates the episodes; episode i begins as the first one of a run with seed `seed` + i.

    Raises:
        UserError: a policy of other sizes than the task has.
    """
    from gpcjax.engine.evaluate import evaluate
    from gpcjax.envs.registry import make_env

    env = make_env(player.env)
    check_sizes(player, (env.obs_size, env.action_size))
    found = evaluate(env, player.act, episodes, seed)
    returns, steps = np.asarray(found.returns, np.float64), np.asarray(found.length)
    return Evaluation(player, seed, returns, steps, mean_interval(returns[:, None]))


def as_json(found: Evaluation) -> dict[str, Any]:
    """All numbers; null for what is none."""
    names = ("mean", "lower", "upper")
    return {
        "policy": found.player.who,
        "env": found.player.env,
        "seed": found.seed,
        **{name: _number(value) for name, value in zip(names, found.mean, strict=True)},
        "std": _number(float(found.returns.std(ddof=1)) if len(found.returns) > 1 else math.nan),
        "episodes": [
            {"seed": found.seed + place, "return": _number(float(value)), "steps": int(steps)}
            for place, (value, steps) in enumerate(zip(found.returns, found.steps, strict=True))
        ],
    }


def sheet(found: Evaluation) -> Sheet:
    """The return of each episode, in rows of ten seeds."""
    decimals = words.places(found.returns.tolist())
    texts = [words.number(value, decimals) for value in found.returns.tolist()]
    across = min(_ACROSS, len(texts))
    rows = [texts[first : first + across] for first in range(0, len(texts), across)]
    return Sheet(
        title="return of each episode, by the seed of its start",
        columns=("seed", *(f"+{place}" for place in range(across))),
        rows=tuple(
            (str(found.seed + across * place), *row, *[""] * (across - len(row)))
            for place, row in enumerate(rows)
        ),
    )


def facts(found: Evaluation) -> dict[str, str]:
    """What the episodes say together."""
    returns, decimals = found.returns, words.places(found.returns.tolist())
    told = {"task": words.task(found.player.env)}
    bounds = ", with its 95% interval" if np.isfinite(found.mean.lower) else ""
    told["mean return"] = f"{words.interval(found.mean, decimals)}{bounds}"
    if len(returns) > 1:
        spread = float(returns.std(ddof=1))
        told["spread"] = f"{words.number(spread, decimals)} (standard deviation)"
        ordered = [float(each) for each in (returns.min(), np.median(returns), returns.max())]
        told["lowest, median, highest"] = ", ".join(words.number(each, decimals) for each in ordered)
    told["steps"] = f"{found.steps.mean():,.1f} an episode on average, {found.steps.sum():,} in all"
    broken = np.flatnonzero(np.isnan(returns))
    if len(broken):
        first = found.seed + int(broken[0])
        told["no number"] = (
            f"{len(broken)} of {len(returns)} episodes, the first with seed {first}: an action, an observation or a "
            "reward was not finite"
        )
    return told


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
