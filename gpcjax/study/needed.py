"""Which keys somebody still has to press to pass a trial of keys. Standard library only."""

from collections.abc import Mapping
from typing import Any

from gpcjax.teach.protocol import Press


class Needed:
    """The presses that are left, of less and of more in each dimension of the action; none before `begin`."""

    def __init__(self) -> None:
        self._left: dict[tuple[int, int], int] = {}

    def begin(self, task: Mapping[str, Any], presses: int) -> None:
        """Asks for so many presses of each key of a task as pages are told of it, unless that was done before."""
        if not self._left:
            self._left = {(dim, h): presses for dim in range(len(task["actions"])) for h in (-1, 1)}

    def counts(self, press: Press) -> bool:
        """Counts a key, not its repetitions while it is held; False where it was not needed."""
        key = press.dim, press.h
        if press.held or self._left.get(key, 0) == 0:
            return False
        self._left[key] -= 1
        return True

    @property
    def passed(self) -> bool:
        """Whether each was pressed often enough."""
        return bool(self._left) and not any(self._left.values())

    def message(self) -> dict[str, Any] | None:
        """For the page; None where nothing was asked for."""
        keys = [{"dim": dim, "h": h, "left": left} for (dim, h), left in self._left.items()]
        return {"type": "needed", "keys": keys} if keys else None
