"""What a reproduction consists of: parts that can be run alone, each a few experiments. Loads no jax, no numpy."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gpcjax.allowed import suggestion
from gpcjax.errors import UserError
from gpcjax.sweep.layout import EPISODES, MANIFEST
from gpcjax.sweep.runfolder import check_sweep
from gpcjax.sweep.spec import make_spec, read_toml

SWEEPS = Path(__file__).parent / "sweeps"
"""The TOML files of the experiments: a part of the package, so that an installed one can reproduce the thesis. In a
checkout, `sweeps` at the top is a link to them."""


@dataclass(frozen=True)
class Part:
    """Experiments in the order in which they have to run: a later one may take its rates from an earlier one."""

    title: str
    experiments: tuple[str, ...]
    """Names of TOML files, and of their run folders."""


ROWS = {
    "i": "i: active learning (AL) and adaptive learning rate (ALR)",
    "ii": "ii: AL",
    "iii": "iii: ALR",
    "iv": "iv: baseline",
}
"""Of Table 5.4, as figures call them."""


@dataclass(frozen=True)
class Ablation:
    """A variant of Table 5.4: four experiments, one for each of its rows.

    | Field           | Meaning                                                                |
    |-----------------|------------------------------------------------------------------------|
    | `name`          | what it is called as a condition of a claim                            |
    | `constant_rate` | c_r, of rows i and iii                                                 |
    | `static_rate`   | r_c, of rows ii and iv                                                 |
    | `delta`         | distance from its target within which the teacher is silent            |
    | `origin`        | where its values are from                                              |
    """

    name: str
    constant_rate: float
    static_rate: float
    delta: float
    origin: str

    @property
    def setting(self) -> str:
        """Its values in symbols."""
        return f"c_r = {self.constant_rate:g}, r_c = {self.static_rate:g}, delta = {self.delta:g}"


COMPARED_RATE = 0.04
"""r_c that the average rates reported with Table 5.4 are compared with."""

ABLATIONS = {
    "table5_4": Ablation("delta 0.05", 0.01, 0.04, 0.05, "the rates that the reported averages suggest"),
    "table5_4_fine": Ablation("delta 0.01", 0.01, 0.04, 0.01, "the same with a finer teacher"),
    "table5_4_zero": Ablation(
        "delta 0 (found by a scan)",
        0.01,
        0.04,
        0.0,
        "a teacher that is never silent, found by a scan for the reported average rates",
    ),
    "table5_4_printed": Ablation("the printed rates", 0.1, 0.4, 0.05, "as table and text print them"),
}
"""By the beginning of the names of their experiments."""

DEPENDENCE = {"oracles_cartpole": ("cart-pole", "5.1.2"), "oracles_pendulum": ("pendulum", "5.1.1")}
"""Experiments with several oracles: their tasks, and where the thesis speaks of them."""

CIRCLE = "a circle"
"""What it is where GPC is taught by what GPC has learned."""


def taught_by_gpc(oracle: str) -> bool:
    """Whether an oracle is a policy that GPC itself has learned ("gpc", "gpc-2", ...)."""
    return oracle.partition("-")[0] == "gpc"


PARTS: dict[str, Part] = {
    "illustrations": Part("Illustrations of the method (Chapters 2, 3 and 5)", ()),
    "pendulum": Part("Inverted pendulum (5.1.1)", ("fig5_1_pendulum",)),
    "cartpole": Part("Cart-pole (5.1.2)", ("fig5_4_cartpole",)),
    "active": Part(
        "Active learning and the adaptive learning rate (5.3)",
        tuple(f"{name}_{row}" for name in ABLATIONS for row in ROWS),
    ),
    "oracles": Part("Which conclusions depend on the oracle and on delta", tuple(DEPENDENCE)),
    "lander": Part("Lunar lander (5.1.3)", ("fig5_5_lunarlander", "fig5_5_lunarlander_ns")),
}
"""The slowest last. Illustrations are computed, not swept."""

CHANGES = {
    "Tasks": "gymnasium's Pendulum-v1 and LunarLander-v3 for Pendulum-v0 and LunarLander-v2, which are gone; the "
    "cart-pole with a continuous force, as the thesis describes it.",
    "Runs": "100 instead of 20 on pendulum and cart-pole, 20 where oracles are compared. On the lander 100 for GPC "
    "and COACH as in the thesis, but 20 for GPC-NS, whose factors are computed anew at each correction.",
    "Custom scaling w": "multiplies the inputs (Tables 5.1 to 5.3); as printed, to the power -2, nothing is learned.",
    "GPC-NS": "divides by the standard deviations of the inputs; with the variances of the text nothing is learned.",
    "c_h and c_p": "are variances, so that sigma_thres is half of the root of c_p.",
    "Table 5.4": "c_r = 0.01 and r_c = 0.04. The table prints c_r = 0.1, and the text r_c = 0.4, ten times what the "
    "reported average rates are compared with; these are run too. c_a, which the thesis does not name, is 1. The "
    "variant with delta = 0 was found by a scan for settings whose average rates are those that are reported.",
    "Oracles": "The thesis' oracles were taught by a person. Ours, where they are called gpc, were taught by GPC "
    "itself from a linear regulator (cart-pole) and an energy controller (pendulum, for 100 episodes with delta "
    "0.01): a circle, which every result with them has to be read with. The part on oracles repeats the comparison "
    "with experts that owe nothing to GPC. On the lander the oracle is gymnasium's heuristic, as in the thesis.",
    "Converged": "is a final return that closes 90 % of the gap from the idle policy to the oracle, on every task; "
    "the thesis does not say what it calls converged.",
    "delta": "0.05 where nothing else is said; the thesis does not name its value.",
    "Episodes": "30 on the cart-pole, 40 on the pendulum, 200 on the lander.",
}
"""Where a value of the thesis was changed, or one that it does not give was chosen."""


def check(sweeps: Path, out: Path, only: Sequence[str], quick: bool) -> int:
    """Says what is wrong before anything runs; gives the number of experiments.

    Raises:
        UserError: a file of an experiment that is missing or wrong, a run folder that holds something else, or an `out`
            that is a run folder itself.
    """
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: this is no folder, give a new one (--out)")
    if any(os.path.lexists(out / name) for name in (MANIFEST, EPISODES)):
        raise UserError(f"{out}: this is the run folder of a sweep, give a folder for all of them (--out)")
    names = [name for part in only for name in PARTS[part].experiments]
    for name in names:
        given = read_toml(sweeps / f"{name}.toml", quick)
        if given.pop("rate_from", None) is None:
            check_sweep(out / name, make_spec(given), grows=False)
    return len(names)


def folder(quick: bool) -> Path:
    """Where a reproduction goes if nobody says."""
    return Path("runs", "reproduction-quick" if quick else "reproduction")


def chosen(text: str | None) -> tuple[str, ...]:
    """The parts named in a comma list, in their own order; all without one.

    Raises:
        UserError: a part that there is not.
    """
    names = tuple(PARTS) if text is None else tuple(word.strip() for word in text.split(","))
    for name in names:
        if name not in PARTS:
            raise UserError(f"--only {name!r}: give {', '.join(PARTS)}{suggestion(name, PARTS)}")
    return tuple(part for part in PARTS if part in names)
