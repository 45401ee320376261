"""What of a learner or a teacher of a person's own is no number that jax could trace, kept out of its arrays.

Fields that are no static ones are leaves, and all leaves of a lane are arrays: of a whole number there, no shape and no
condition can follow, and of a text or a function there is no array. Who writes `units: int = 3` means what is compiled
in, and need not know that.
"""

import dataclasses
import functools
import types
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np

T = TypeVar("T")


def fixed(thing: T) -> T:
    """The same with whole numbers, truth values, texts and functions in static fields; itself if there are none.

    A field is made static as a whole, if there is no other number in it. Whole numbers that are alone in a list or a
    table stay arrays. The class is one of the same name, under that which `thing` has; modules in fields are treated
    alike, gpcjax's own left as they are.
    """
    if not isinstance(thing, eqx.Module) or type(thing).__module__.startswith("gpcjax."):
        return thing
    values, names = dict(vars(thing)), []
    for each in dataclasses.fields(thing):
        if each.metadata.get("static", False):
            continue
        value = values[each.name]
        leaves = jax.tree.leaves(value)
        if (
            leaves
            and not any(map(_is_traced, leaves))
            and (_is_hashable(value) or not all(map(_is_whole, leaves)))
        ):
            values[each.name] = jax.tree.map(
                lambda leaf: leaf, value
            )  # not the list itself: its owner may change it
            names.append(each.name)
        elif any(fixed(part) is not part for part in jax.tree.leaves(value, is_leaf=_is_module)):
            values[each.name] = jax.tree.map(fixed, value, is_leaf=_is_module)
    if not names and all(value is vars(thing)[name] for name, value in values.items()):
        return thing
    return _made(type(thing), tuple(names), values)


def _is_module(part: Any) -> bool:
    return isinstance(part, eqx.Module)


def _is_traced(leaf: Any) -> bool:
    """Whether it is an array, or a number that one is made of."""
    return isinstance(leaf, float | complex | np.ndarray | np.inexact | jax.Array | jax.ShapeDtypeStruct)


def _is_whole(leaf: Any) -> bool:
    """Whether it is a whole number or a truth value, of which an array can be made too."""
    return isinstance(leaf, int | np.integer | np.bool_)


def _is_hashable(value: Any) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True


def _made(kind: type[T], names: tuple[str, ...], values: dict[str, Any]) -> T:
    """An instance with these values, whose fields `names` are static. Nothing is initialised again."""
    made = object.__new__(_with_static(kind, names) if names else kind)
    for name, value in values.items():
        object.__setattr__(made, name, value)
    return made


@functools.cache
def _with_static(kind: type[Any], names: tuple[str, ...]) -> type[Any]:
    declared = {each.name: each for each in dataclasses.fields(kind)}
    how = ("default", "default_factory", "init", "repr", "kw_only")
    fields: dict[str, Any] = {}
    for name in names:
        field = declared[name]
        metadata = {**field.metadata, "static": True}
        fields[name] = dataclasses.field(metadata=metadata, **{each: getattr(field, each) for each in how})

    def reduced(self: Any) -> tuple[Any, ...]:
        return _made, (kind, names, dict(vars(self)))

    same = {name: getattr(kind, name) for name in ("__module__", "__qualname__", "__doc__")}
    annotations = {name: declared[name].type for name in names}
    body = {**same, **fields, "__annotations__": annotations, "__reduce__": reduced}
    return types.new_class(kind.__name__, (kind,), exec_body=lambda namespace: namespace.update(body))
