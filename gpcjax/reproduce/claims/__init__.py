"""What the thesis claims of its results, a module for each part of the report. Loads no jax."""

from collections.abc import Callable

from gpcjax.reproduce.claims.across import across
from gpcjax.reproduce.claims.active import active
from gpcjax.reproduce.claims.cartpole import cartpole
from gpcjax.reproduce.claims.illustrated import illustrated
from gpcjax.reproduce.claims.lander import lander
from gpcjax.reproduce.claims.oracles import oracles
from gpcjax.reproduce.claims.pendulum import pendulum
from gpcjax.reproduce.parts import ABLATIONS, ROWS
from gpcjax.reproduce.records import Illustrations
from gpcjax.reproduce.results import Results
from gpcjax.reproduce.verdicts import Claim, corrected

__all__ = ["claims"]


def claims(results: Results, illustrations: Illustrations | None = None) -> dict[str, list[Claim]]:
    """The claims of each part whose experiments are there, and those that the illustrations speak of.

    Holm's correction takes all tests of a part as one family.
    """
    makers: dict[str, tuple[Callable[..., list[Claim]], tuple[str, ...]]] = {
        "pendulum": (pendulum, ("pendulum",)),
        "cartpole": (cartpole, ("cartpole",)),
        "lander": (lander, ("lander",)),
        "active": (active, tuple(f"{name}_{row}" for name in ABLATIONS for row in ROWS)),
        "all": (across, ("pendulum", "cartpole", "lander")),
    }
    made = {} if illustrations is None else {"illustrations": illustrated(illustrations)}
    made |= {
        part: make(*(results[name] for name in names))
        for part, (make, names) in makers.items()
        if all(name in results for name in names)
    }
    depending = oracles(results)
    made |= {"oracles": depending} if depending else {}
    return {part: corrected(each) for part, each in made.items()}
