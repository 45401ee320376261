"""Runs that are under way, on the host: from these a pool goes on to the same bits (`Pool.snapshot`, `Pool.resume`).

Packed they are named arrays and a card of JSON values, for a checkpoint. Most of a lane is room for points that it does
not have. So of each array only a box is kept, beyond which there is nothing but zeros, or an identity matrix (the
factor of points that are not there): exact, whatever the learner keeps, and as it says itself what was left out,
nothing needs to be known of the learner to read it.
"""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from gpcjax.engine.lanes import Lane

FORMAT = 2
"""Of what `pack` gives."""

Arrays = dict[str, np.ndarray]
Card = dict[str, Any]


class NotResumed(Exception):
    """A run cannot go on from where it was, and is to be begun anew; the message says why."""


@dataclass(frozen=True)
class Snapshot:
    """A run between two chunks."""

    name: Any
    """The caller's own, as in its `Start`."""
    lane: Lane
    """On the host, without a lanes axis (numpy): all of a run of a compiled task."""
    capacities: tuple[int, int]
    """For how many points of each policy and of each human model the lane has room."""
    executed: Float[np.ndarray, "steps action"] | None = None
    """Of a task on the host, the actions of the present episode so far, between the bounds of the task.

    With the seed of the episode, which follows from the lane's, they rebuild the simulation. Whether they do, the last
    observation and the return so far tell, which are in the lane.
    """


def pack(snapshots: Sequence[Snapshot]) -> tuple[Arrays, Card]:
    """The snapshots of one pool as named arrays, those of the same shape in one, and a card of JSON values.

    Names are not in it: `unpack` takes them in the same order.
    """
    arrays, groups = Arrays(), list[Card]()
    order = sorted(range(len(snapshots)), key=lambda index: snapshots[index].capacities)
    for capacities, members in itertools.groupby(order, key=lambda index: snapshots[index].capacities):
        runs, prefix, leaves = list(members), f"{len(groups)}", Card()
        for name, values in _stacked([snapshots[index].lane for index in runs]):
            box, leaves[name] = _cut(values)
            if box.size:  # a checkpoint takes no array without entries
                arrays[f"{prefix}{name}"] = box
        executed = [snapshots[index].executed for index in runs]
        steps = [None if actions is None else len(actions) for actions in executed]
        if any(steps):
            arrays[f"{prefix}.executed"] = np.concatenate([each for each in executed if each is not None])
        groups.append({"capacities": list(capacities), "runs": runs, "leaves": leaves, "steps": steps})
    return arrays, {"format": FORMAT, "groups": groups}


def unpack(
    arrays: Mapping[str, np.ndarray],
    card: Mapping[str, Any],
    names: Sequence[Any],
    shapes: Callable[[tuple[int, int]], Lane],
) -> list[Snapshot]:
    """The snapshots that were packed.

    Args:
        arrays, card: from `pack`.
        names: of the runs, in the order in which they were packed.
        shapes: those of the pool that is to go on with them (`Pool.shapes`).

    Raises:
        NotResumed: it is of another format, of a pool of other structure, or not what `pack` gave.
    """
    if card.get("format") != FORMAT:
        raise NotResumed(f"snapshots of format {str(card.get('format'))[:20]}: this version reads {FORMAT}")
    found: dict[int, Snapshot] = {}
    try:
        for index, group in enumerate(card["groups"]):
            found |= _unpacked(arrays, f"{index}", group, names, shapes)
        if sorted(found) != list(range(len(names))):
            raise NotResumed(f"snapshots of {len(found)} runs: {len(names)} are named")
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise NotResumed(f"snapshots whose card and arrays do not fit ({type(error).__name__})") from None
    return [found[index] for index in range(len(names))]


def _unpacked(
    arrays: Mapping[str, np.ndarray],
    prefix: str,
    group: Mapping[str, Any],
    names: Sequence[Any],
    shapes: Callable[[tuple[int, int]], Lane],
) -> dict[int, Snapshot]:
    """The snapshots of one group, by their places in the order of names."""
    policy, human = group["capacities"]
    expected = shapes((policy, human))
    wanted, structure = jax.tree_util.tree_flatten_with_path(expected)
    if [_name(path) for path, _ in wanted] != list(group["leaves"]):
        raise NotResumed("snapshots of lanes of another structure")
    stacked = [
        _filled(arrays.get(f"{prefix}{name}"), told, (len(group["runs"]), *leaf.shape), leaf.dtype)
        for (name, told), (_, leaf) in zip(group["leaves"].items(), wanted, strict=True)
    ]
    executed, first, found = arrays.get(f"{prefix}.executed"), 0, dict[int, Snapshot]()
    for row, (run, steps) in enumerate(zip(group["runs"], group["steps"], strict=True)):
        lane, actions = structure.unflatten([leaf[row] for leaf in stacked]), None
        if steps is not None:
            if executed is None:
                executed = np.zeros((0, lane.action.shape[0]))
            actions, first = executed[first : first + steps], first + steps
        found[run] = Snapshot(names[run], lane, (policy, human), actions)
    return found


def fitted(lane: Lane, shapes: Lane) -> Lane:
    """The lane in the structure of `shapes`.

    Raises:
        NotResumed: its arrays have other names, shapes or types.
    """
    given, wanted = (jax.tree_util.tree_leaves_with_path(tree) for tree in (lane, shapes))

    def forms(leaves: Iterable[tuple[Any, Any]]) -> list[tuple[Any, ...]]:
        return [(_name(path), tuple(leaf.shape), np.dtype(leaf.dtype)) for path, leaf in leaves]

    odd = sorted(set(forms(given)) ^ set(forms(wanted)), key=str)
    if odd:
        raise NotResumed(f"a snapshot of a lane of another structure ({odd[0][0].lstrip('.')})")
    return jax.tree.unflatten(jax.tree.structure(shapes), [leaf for _, leaf in given])


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path)


def _stacked(lanes: Sequence[Lane]) -> Iterable[tuple[str, np.ndarray]]:
    """Each array of lanes of one shape, with an axis of runs before its own."""
    names = [_name(path) for path, _ in jax.tree_util.tree_leaves_with_path(lanes[0])]
    for name, leaves in zip(names, zip(*map(jax.tree.leaves, lanes), strict=True), strict=True):
        yield name, np.stack(leaves)


def _cut(values: np.ndarray) -> tuple[np.ndarray, Card]:
    """The box beyond which there are but zeros, or ones on a diagonal; and which of both."""
    square = values.ndim > 2 and values.shape[-1] == values.shape[-2] > 1
    whole = values.shape[1:]
    if values.itemsize > 8:  # there are no whole numbers of so many bytes to compare
        return values, {"box": list(whole), "identity": False}
    choices = []
    for identity in (False, True) if square else (False,):
        # By their bits: minus zero is kept, and so is any NaN.
        odd = _bits(values) != _bits(_nothing(whole, values.dtype, identity))[None]
        box = tuple(_extent(odd, axis) for axis in range(1, values.ndim))
        choices.append((int(np.prod(box)), identity, box))
    _, identity, box = min(choices)
    return values[(slice(None), *map(slice, box))], {"box": list(box), "identity": identity}


def _filled(
    box: np.ndarray | None, told: Mapping[str, Any], shape: tuple[int, ...], dtype: np.dtype
) -> np.ndarray:
    """What `_cut` was given."""
    size = (shape[0], *told["box"])
    if box is None and 0 in size:
        box = np.zeros(size, dtype)
    if box is None or box.shape != size or box.dtype != dtype or len(size) != len(shape):
        raise ValueError("an array that is not what the card says")
    values = np.repeat(_nothing(shape[1:], np.dtype(dtype), told["identity"])[None], shape[0], 0)
    values[tuple(map(slice, size))] = box
    return values


def _nothing(shape: tuple[int, ...], dtype: np.dtype, identity: bool) -> np.ndarray:
    """Zeros, or identity matrices along the last two axes."""
    return np.zeros(shape, dtype) + np.eye(*shape[-2:], dtype=dtype) if identity else np.zeros(shape, dtype)


def _bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values).view(f"u{values.itemsize}")


def _extent(odd: np.ndarray, axis: int) -> int:
    """Up to where along an axis there is anything."""
    along = np.flatnonzero(odd.any(tuple(other for other in range(odd.ndim) if other != axis)))
    return int(along[-1]) + 1 if along.size else 0
