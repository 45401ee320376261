"""The flags of `gpcjax tune` beside those of a sweep, in one table. Standard library only."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gpcjax.allowed import COUNT, Anything, Numbers, OneOf
from gpcjax.errors import UserError
from gpcjax.sweep.options import Option, accept, parse
from gpcjax.sweep.seeds import WORDS, Seeds
from gpcjax.sweep.spec import Given
from gpcjax.tune import halving
from gpcjax.tune.names import OBJECTIVES

METHODS = ("tpe", "grid", "mll")
TAKEN = ("length_scale", "variance", "noise")
"""What may be taken from a fit of marginal likelihood; all of it is fitted in any case."""

NOT_TAKEN = ("rate_from", "keep", "keep_at", "checkpoint", "engine", "address", "shard")
"""Settings of a sweep that a search has none of: its sweeps are its own, in processes of this machine."""

TABLE = "tune"
"""The table of a TOML file with the flags of this command."""


@dataclass(frozen=True)
class Own:
    """A flag of this command: what it takes, what it is, and what holds without it."""

    kind: type
    allowed: Any
    text: str
    metavar: str
    default: Any = None
    methods: tuple[str, ...] = METHODS
    """Those that it concerns."""

    @property
    def help(self) -> str:
        """The text, with what holds without it."""
        usual = (
            ""
            if self.default is None
            else f"; default {self.default:g}"
            if self.kind is float
            else f"; default {self.default}"
        )
        whose = f"{self.methods[0]} alone: " if len(self.methods) == 1 else ""
        return f"{whose}{self.text} ({self.allowed}{usual})"


FLAGS: dict[str, Own] = {
    "method": Own(str, OneOf(METHODS), "how", "METHOD", METHODS[0]),
    "objective": Own(
        str,
        Anything(", ".join(OBJECTIVES)),
        "what for; several for a Pareto front",
        "A,B,...",
        "area",
        ("tpe", "grid"),
    ),
    "trials": Own(int, COUNT, "how many points", "N", 100, ("tpe",)),
    "batch": Own(int, Numbers(1, 10_000, whole=True), "of these at once", "N", 16, ("tpe",)),
    "rungs": Own(
        str,
        Anything(halving.FORM),
        "successive halving, before all seeds and episodes",
        "4x10,8",
        methods=("tpe",),
    ),
    "eta": Own(float, halving.ETA, "one of so many goes on to the next rung", "ETA", 3.0, ("tpe",)),
    "sampler_seed": Own(
        int, Numbers(0, 2**31 - 1, whole=True), "of the sampler's random numbers", "SEED", 0, ("tpe",)
    ),
    "check_seeds": Own(
        Seeds,
        Anything(WORDS),
        "on which the best is judged, none of the search's; default 1000-1099",
        "SEEDS",
    ),
    "take": Own(
        str,
        Anything(", ".join(TAKEN)),
        "what of the fitted numbers become settings",
        "A,B,...",
        TAKEN[0],
        methods=("mll",),
    ),
    "runs": Own(
        str,
        Anything("the path of a run folder with kept states"),
        "whose dictionaries are fitted",
        "FOLDER",
        methods=("mll",),
    ),
}


def own_values(words: Mapping[str, str | None], table: Mapping[str, Any], prefix: str) -> dict[str, Given]:
    """The value of each of this command's flags, and where it stood; flags win.

    Args:
        words: the text of each flag that was given; of Python's settings, which have no flags, nothing.
        table: settings by their names: of a file, or of Python.
        prefix: what a message has before a name of the table.

    Raises:
        UserError: a name or a value that is not allowed, or a setting that changes nothing.
    """
    written = {str(key).replace("-", "_"): (value, f"{prefix}{key}") for key, value in table.items()}
    for name, (_, source) in written.items():
        if name not in (*FLAGS, "search"):
            raise UserError(f"{source} is no setting of a search: give {', '.join([*FLAGS, 'search'])}")
    found: dict[str, Given] = {}
    for name, flag in FLAGS.items():
        option, text = Option(name, flag.kind, flag.allowed, ""), words.get(name)
        dashed = f"--{name.replace('_', '-')}" if words else name
        if text is not None:
            found[name] = Given(parse(option, text, dashed), dashed)
        elif name in written:
            value, source = written[name]
            found[name] = Given(accept(option, value, source), source)
        else:
            found[name] = Given(flag.default, dashed)
            continue
        method = found["method"].value
        if method not in flag.methods:
            with_method = f"with {'--' if words else ''}method {method}"
            raise UserError(f"{found[name].source}: {with_method} it changes nothing, leave it out")
    return found
