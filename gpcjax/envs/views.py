"""What a description says a person sees of a task, checked once, where the task is known."""

from typing import Any, get_args

from gpcjax.allowed import FINITE, checked, plain, shown
from gpcjax.describe import Control, Key, View
from gpcjax.errors import UserError

SCENES = {"": 0, "cartpole": 4, "mountaincar": 2, "pendulum": 3}
"""What is drawn of an observation, by how many numbers that has."""

KEYS = get_args(Key)


def check_view(source: str, view: Any, sizes: tuple[int, int]) -> None:
    """Refuses a view that does not fit a task whose observation and action have these sizes.

    Raises:
        UserError: what of it does not; `source` begins the message.
    """
    if not isinstance(view, View):
        raise UserError(f"{source}: view {shown(view)}: give a gpcjax.View")
    size, dims = sizes
    observed, controls = (_listed(source, view, name) for name in ("observed", "controls"))
    if observed and len(observed) != size:
        raise UserError(
            f"{source}: its view names {len(observed)} numbers of an observation, its task has {size}: give all or none"
        )
    for each in observed:
        if not (isinstance(each, tuple | list) and len(each) == 3 and isinstance(each[0], str)):
            raise UserError(
                f"{source}: observed {shown(each)}: give a name, the lowest and the highest value"
            )
        low, high = (checked(f"{source}: observed {each[0]}", value, float, FINITE) for value in each[1:])
        if not low < high:
            raise UserError(f"{source}: observed {each[0]}: {low:g} must be below {high:g}")
    if len(controls) > dims:
        raise UserError(
            f"{source}: its view has {len(controls)} controls, an action of its task {dims} dimensions"
        )
    for each in controls:
        if not (isinstance(each, Control) and _is_key(each.less) and _is_key(each.more)):
            raise UserError(
                f"{source}: controls {shown(each)}: give gpcjax.Control(less=(KEY, WORDS), more=(KEY, WORDS)), with "
                f"{', '.join(KEYS)} as KEY"
            )
    if not isinstance(view.scene, str) or view.scene not in SCENES or SCENES[view.scene] not in (0, size):
        drawn = ", ".join(f"{name} ({numbers} numbers)" for name, numbers in SCENES.items() if name)
        raise UserError(
            f"{source}: scene {shown(view.scene)}: give none, or the one of its {size} numbers: {drawn}"
        )
    axes: list[Any] = [plain(axis) for axis in _listed(source, view, "axes")]
    if len(axes) != 2 or not all(type(axis) is int and axis >= 0 for axis in axes):
        raise UserError(f"{source}: axes {shown(view.axes)}: give the places of two numbers, from 0")
    # Those that nobody gave are of any task: of one with a single number the page shows that alone.
    if tuple(axes) != View.axes and (axes[0] == axes[1] or max(axes) >= size):
        raise UserError(
            f"{source}: axes {shown(view.axes)}: give two of the {size} numbers of an observation, from 0"
        )
    if not isinstance(view.hint, str):
        raise UserError(f"{source}: hint {shown(view.hint)}: give a sentence")


def _listed(source: str, view: View, name: str) -> list[Any]:
    value = getattr(view, name)
    if not isinstance(value, tuple | list):
        raise UserError(f"{source}: {name} {shown(value)}: give a tuple")
    return list(value)


def _is_key(pair: Any) -> bool:
    match pair:
        case (str(key), str()):
            return key in KEYS
    return False
