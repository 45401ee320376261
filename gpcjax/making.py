"""Makes what a person's own module has: its class or function is called, and what it gives is looked at."""

import dataclasses
import inspect
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

from gpcjax.allowed import shown
from gpcjax.describe import Setting
from gpcjax.errors import ForeignError, UserError

T = TypeVar("T")


class Maker(Generic[T]):
    """Makes a task, a learner or a teacher of a person's own. Its signature is that of what it calls."""

    def __init__(self, source: str, found: Callable[..., Any], accepted: Callable[[Any], T]):
        """`source` begins the messages; `accepted` gives what was made in our shape, or raises UserError.

        Raises:
            UserError: Python cannot tell which arguments it takes.
        """
        self._source, self._found, self._accepted = source, found, accepted
        try:
            self.__signature__ = inspect.signature(found)
        except ValueError:
            raise UserError(
                f"{source}: Python cannot tell the arguments of {shown(found)}, give a class or function"
            ) from None

    @property
    def module(self) -> str:
        """Where what it calls comes from; "" where Python does not say."""
        return getattr(self._found, "__module__", None) or ""

    def __call__(self, **values: Any) -> T:
        """One more, of these settings.

        Raises:
            UserError: it refuses them, or is nothing that can be taught, learn or teach.
            ForeignError: it fails.
        """
        try:
            made = self._found(**values)
        except UserError:
            raise
        except Exception as error:
            raise ForeignError(f"{self._source}: it cannot be made", error) from None
        return self._accepted(made)


NEARBY = 1 + 2**-10
"""A value that is this many times another one is allowed wherever that one is, but at a bound."""


def told_apart(make: Callable[..., Any], settings: Sequence[Setting], **given: Any) -> tuple[Setting, ...]:
    """The settings, each compiled in whose value is part of the structure of what is made, and not of its arrays alone.

    A static field is such a part, and so is what a shape follows from: what is made with another value says so. Where
    it can be made with none, the value may be a part.

    Args:
        make: makes a learner or a teacher from the values `given`, and of these settings.
    """

    def form(**values: Any) -> Any:
        import jax

        made = make(**given, **values)
        return jax.tree.structure(made), [getattr(leaf, "shape", ()) for leaf in jax.tree.leaves(made)]

    def is_part(setting: Setting) -> bool:
        value = setting.default or 0.0
        for other in (value * NEARBY, value / NEARBY) if value else (1 - 1 / NEARBY, 1 / NEARBY - 1):
            try:
                return form(**{setting.name: other}) != usual
            except UserError:
                continue
        return True

    try:
        usual = form()
    except UserError:
        usual = None
    return tuple(
        dataclasses.replace(each, compiled="value") if each.compiled == "no" and is_part(each) else each
        for each in settings
    )
