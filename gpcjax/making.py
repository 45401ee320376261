"""Makes what a person's own module has: its class or function is called, and what it gives is looked at."""

import inspect
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from gpcjax.allowed import shown
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
