"""The table that grows in a terminal while a sweep runs: a line for each group, with its curve so far. Loads no jax."""

import numpy as np
from jaxtyping import Float
from rich import box
from rich.table import Table

from gpcjax.registry import find
from gpcjax.sweep.sofar import Group, Range, SoFar

BARS = "\u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588"
PLAIN_BARS = "_.-:=+*#"
"""Where an encoding has no blocks."""

WIDTH = 30
"""Characters of a curve; of more episodes each stands for several."""


def table(sofar: SoFar, most: int, encoding: str | None = "utf-8") -> Table:
    """At most so many groups, those with a curve first in their order; a caption says how many are left out."""
    bars = BARS if _takes(encoding, BARS) else PLAIN_BARS
    groups, within = sofar.groups, sofar.range
    shown = groups if len(groups) <= most else sorted(groups, key=lambda group: not group.curve.size)[:most]
    left_out = len(groups) - len(shown)
    made = Table(
        box=box.SIMPLE_HEAD if _takes(encoding, "\u2500") else box.ASCII2,
        caption=f"and {left_out} groups more" if left_out else None,
        caption_justify="left",
    )
    for name in sofar.names:
        made.add_column(name, justify="left" if name in ("algo", "oracle") else "right")
    made.add_column("return by episode, so far")
    made.add_column("final return", justify="right")
    made.add_column("runs", justify="right")
    for group in shown:
        made.add_row(
            *map(_value, sofar.names, group.label),
            "" if within is None else curve(group.curve, within, bars),
            f"{group.final:.4g}" if group.curve.size else "",
            _runs(group),
        )
    return made


def curve(returns: Float[np.ndarray, "episodes"], within: Range, bars: str = BARS) -> str:
    """Returns as a line of bars, the lowest for the low end of the range."""
    if not returns.size:
        return ""
    parts = np.array_split(returns, min(len(returns), WIDTH))
    heights = np.array([part.mean() for part in parts]) - within.low
    extent = within.high - within.low
    places = np.clip(heights / extent * len(bars), 0, len(bars) - 1) if extent > 0 else np.zeros(len(parts))
    return "".join(bars[int(place)] for place in places)


def _runs(group: Group) -> str:
    stopped = f" ({group.stopped} stopped)" if group.stopped else ""
    return f"{group.finished}/{group.runs}{stopped}"


def _value(name: str, value: object) -> str:
    if name == "algo":
        return find("learner", str(value)).title
    if name == "error" and isinstance(value, float):
        return f"{100 * value:.6g}%"
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _takes(encoding: str | None, text: str) -> bool:
    try:
        text.encode(encoding or "ascii")
    except (LookupError, UnicodeEncodeError):
        return False
    return True
