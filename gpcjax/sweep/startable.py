"""Whether the runs of a sweep can begin with what a folder holds, as far as that is known before they run.

Loads no jax.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.sweep.plan import Cell, plan
from gpcjax.sweep.sources import Contents, State, contents_of
from gpcjax.sweep.spec import SweepSpec


def check_start(spec: SweepSpec, place: str = "start") -> None:
    """Refuses a sweep of which a run finds nothing to begin with, as far as that can be told without computing.

    Raises:
        UserError: a run finds nothing, or several things; or what it finds is of other sizes than the task, too
            large for `max_capacity`, of COACH on another grid, or of D-COACH with another network or buffer.
    """
    if spec.start is None:
        return
    contents, sizes = contents_of(Path(spec.start.folder), place), find("task", spec.env).sizes
    told, grid = f"{place} {contents.folder}", find("task", spec.env).presets.get("coach")
    seen: set[tuple[Any, ...]] = set()
    for cell in plan(spec):
        state, network = contents.of(cell, place), _network(cell)
        key = (id(state), *network.values())
        if key in seen:
            continue
        seen.add(key)
        card = state.card
        if sizes is not None and sizes != (given := (card["obs_size"], card["action_size"])):
            raise UserError(
                f"{told}: it was learned with {given[0]} numbers of an observation and {given[1]} actions, "
                f"{spec.env} has {sizes[0]} and {sizes[1]}"
            )
        if cell.algo == "coach" and grid is not None and (other := _other_grid(contents, state, grid, place)):
            raise UserError(f"{told}: COACH learned there on another grid ({other}) than that of {spec.env}")
        if network and (other := _other_network(contents, state, network, place)):
            raise UserError(f"{told}: D-COACH learned there with {other}: give the same")
        points = max(card.get("capacities", {}).values(), default=0)
        if points > spec.max_capacity and state.place is None:  # which says how many there is room for
            points = _points(contents.arrays(state, place))
        if points > spec.max_capacity:
            raise UserError(
                f"{told}: a dictionary holds {points} points, give a --max-capacity of that at least"
            )


def _points(arrays: Mapping[str, np.ndarray]) -> int:
    """Of the largest dictionary."""
    counts = [np.max(arrays[name]) for name in ("state.policy.count", "state.human.count") if name in arrays]
    return int(max(counts, default=0))


def _other_grid(contents: Contents, state: State, grid: Mapping[str, Any], place: str) -> str:
    """What of COACH's grid there is another one, in words; nothing if it is the same."""
    arrays = contents.arrays(state, place)
    known: dict[str, Any] = {"counts": state.card.get("counts")}
    known |= {name: arrays.get(f"learner.grid.{name}") for name in ("lower", "upper")}
    for name, value in known.items():
        own = grid.get(name)
        if value is not None and own is not None and not np.all(np.equal(value, own)):
            return f"{name} {', '.join(f'{each:g}' for each in np.asarray(value).ravel())}"
    return ""


def _network(cell: Cell) -> dict[str, Any]:
    """What the shape of D-COACH's network and buffer follows from, and what its inputs mean; else nothing."""
    if cell.algo != "d-coach":
        return {}
    task = find("task", cell.env)
    settings = (
        find("learner", cell.algo).defaults | task.presets.get(cell.algo, {}) | dict(cell.hyperparameters)
    )
    scales = None if task.obs_scale is None else tuple(1.0 / scale for scale in task.obs_scale)
    return {name: settings[name] for name in ("width", "buffer_size")} | {"scaling": scales}


def _other_network(contents: Contents, state: State, network: Mapping[str, Any], place: str) -> str:
    """What of D-COACH there is another than of this network, in words; nothing if it may go on."""
    for name, own in network.items():
        known = (
            contents.arrays(state, place).get("learner.scaling")
            if name == "scaling"
            else state.card.get(name)
        )
        if known is not None and own is not None and not np.array_equal(known, own):
            given, here = (", ".join(f"{each:g}" for each in np.ravel(value)) for value in (known, own))
            return f"{name} {given}, here it is {here}"
    return ""
