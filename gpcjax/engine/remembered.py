"""What a person's function refers to and can change: looked at before a call and after it, and put back.

A function that jax traces runs once, for all steps of a program. What it changes then, a counter, a filter's last
value, numbers still to be drawn, would be changed once, and hold what jax traces with. What somebody else changes
meanwhile, such as a loop that teaches in another thread, is not touched.
"""

from typing import Any

from gpcjax.engine.held import same
from gpcjax.engine.referred import Referred


class Remembered:
    """All that a function refers to, as it was when this was made, and as a call left it (`look_again`)."""

    def __init__(self, function: Any):
        found = Referred(function)
        self._names, self._contents, self._writes = found.names, found.contents, found.writes
        self.uses_up, self.tracers = found.uses_up, found.tracers

    def look_again(self) -> None:
        """What there is now is what a call has left."""
        for held in (*self._names, *self._contents):
            held.after = held.read()

    @property
    def is_changed(self) -> bool:
        """Whether the call has changed anything, as far as it can be told from what others did meanwhile."""
        return any(any(held.changed(self._writes).values()) for held in self._names) or any(
            not same(held.before, held.after) for held in self._contents
        )

    @property
    def is_disturbed(self) -> bool:
        """Whether somebody else has changed something, during the call or until now."""
        return any(not all(held.changed(self._writes).values()) for held in self._names) or any(
            not same(held.after, held.read()) for held in (*self._names, *self._contents)
        )

    def put_back(self) -> None:
        """Makes what the call has changed what it was, if it still is what the call has left."""
        for held in (*self._names, *self._contents):
            held.put_back(self._writes)
