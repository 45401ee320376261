"""How much of a core a worker has, on a machine that others use too. Loads no jax."""

import os
from pathlib import Path

MOST = 20.0
"""How much of a core's time is believed to be others': more is a worker that waits for something else."""

FADES = 0.97
"""Of what workers said of their cores, with each further word."""

_ENOUGH = 1.0
"""Seconds of what workers said, to go by that."""


class Crowd:
    """What is known of it so far: at first how many processes want a core, and then what workers had of one."""

    def __init__(self) -> None:
        self._seconds = self._processor = 0.0
        self._waiting: list[float] = []

    def take(self, seconds: float, processor: float) -> None:
        """Notes that a worker had so many seconds of a core while so many passed."""
        self._seconds = FADES * self._seconds + seconds
        self._processor = FADES * self._processor + processor

    @property
    def slowness(self) -> float:
        """Seconds that a second of a core takes by now, one at least; to be asked some times a second."""
        if self._seconds > _ENOUGH:
            return min(max(self._seconds / max(self._processor, 1e-9), 1.0), MOST)
        self._waiting.append(waiting())
        return sum(self._waiting) / len(self._waiting)


def waiting(file: Path = Path("/proc/loadavg")) -> float:
    """How many processes run or wait to, for each core; one at least, and where nobody knows (Linux says it)."""
    try:
        running = int(file.read_text().split()[3].partition("/")[0])
    except (OSError, ValueError, IndexError):
        return 1.0
    return max(running / (os.cpu_count() or 1), 1.0)
