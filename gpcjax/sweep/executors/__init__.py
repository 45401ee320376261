"""How the workers of a sweep are run: what is common (`base`), in processes, in this process. Loads no jax."""

from gpcjax.sweep.executors.base import Desk, Executor, Orders, Totals
from gpcjax.sweep.executors.inprocess import InProcess
from gpcjax.sweep.executors.processes import Processes
from gpcjax.sweep.executors.starting import run_alone

__all__ = ["Desk", "Executor", "InProcess", "Orders", "Processes", "Totals", "run_alone"]
