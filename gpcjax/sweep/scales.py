"""The settings that are a factor for each number of an input. Loads no jax."""

from gpcjax.describe import TaskSpec
from gpcjax.errors import UserError

SCALES = ("scaling", "human_scaling")
"""They are given to learners which have them among their own `options`."""


def check_scale(name: str, factors: tuple[float, ...], source: str, task: TaskSpec) -> None:
    """Refuse another number of factors than the task's inputs have, where the task tells its sizes.

    Raises:
        UserError: there are others; `source` begins the message.
    """
    if not factors or task.sizes is None:
        return
    size, what = task.sizes[0], "one for each number of an observation"
    if name == "human_scaling":
        size, what = size + 1, f"{what} and one for the action"
    if len(factors) != size:
        raise UserError(f"{source}: of {task.name} it has {size} factors, {what}, not {len(factors)}")
