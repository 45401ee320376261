"""How the workers of a sweep are run: what is common (`base`), in processes, in this process, on the machines of a Ray.

Loads no jax, and no Ray.
"""

from gpcjax.sweep.executors.base import Desk, Executor, Orders, Totals
from gpcjax.sweep.executors.inprocess import InProcess
from gpcjax.sweep.executors.processes import Processes
from gpcjax.sweep.executors.ray import Ray
from gpcjax.sweep.executors.starting import run_alone

__all__ = ["Desk", "Executor", "InProcess", "Orders", "Processes", "Ray", "Totals", "run_alone"]
