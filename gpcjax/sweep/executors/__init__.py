"""How the workers of a sweep run: in processes, in this one, on the machines of a Ray; `base` and `desk` are common.

Loads no jax, and no Ray.
"""

from gpcjax.errors import UserError
from gpcjax.sweep.executors.base import Executor, Orders, Totals
from gpcjax.sweep.executors.desk import Desk
from gpcjax.sweep.executors.inprocess import InProcess
from gpcjax.sweep.executors.office import Errands, Office
from gpcjax.sweep.executors.processes import Processes
from gpcjax.sweep.executors.ray import Ray
from gpcjax.sweep.executors.starting import run_alone
from gpcjax.sweep.options import ENGINES


def executor_of(
    engine: str | None, address: str | None, jobs: int | None, source: str = "address"
) -> Executor | None:
    """What an engine's name stands for; None for processes of this machine.

    Raises:
        UserError: there is no such engine or it is not installed, or an address without one that takes it; `source`
            is where the address stood.
    """
    if engine not in (None, *ENGINES):
        raise UserError(f"engine {engine!r}: give {' or '.join(ENGINES)}")
    if engine == "ray":
        return Ray(address, jobs)
    if address is not None:
        raise UserError(f"{source} {address}: without engine ray it changes nothing, give --engine ray too")
    return None


__all__ = [
    "Desk",
    "Errands",
    "Executor",
    "InProcess",
    "Office",
    "Orders",
    "Processes",
    "Ray",
    "Totals",
    "executor_of",
    "run_alone",
]
