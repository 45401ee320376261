"""How much of a core a worker has, on a machine that others use too, and how fast that core is. Loads no jax."""

import time

MOST = 20.0
"""How much of a core's time is believed to be others': more is a worker that waits for something else."""

FADES = 0.97
"""Of what workers said of their cores, with each further word."""

_ENOUGH = 1.0
"""Seconds of what workers said, to go by that."""

AT_START = 1.5
"""Seconds that a second of a core takes while workers begin, on two cores that nobody else is on: the process that
starts them is at work, too, which it hardly is later."""

USUAL_START, USUAL_PIECE = 1.3, 6e-3
"""Seconds of a core in which a worker imports what it needs, and does a piece of work, on the machine that `costs` were
seen on."""


def piece_of_work() -> float:
    """Seconds of this core for what is always the same: imports take longer the first time that they are done."""
    taken: list[float] = []
    for _ in range(3):
        began, total = time.process_time(), 0
        for i in range(100_000):
            total += i * i % 7
        taken.append(time.process_time() - began)
    return min(taken)


class Crowd:
    """What is known of it so far: by what workers had of a core since they began."""

    def __init__(self) -> None:
        self._seconds = self._processor = 0.0
        self._pieces: list[float] = []

    def begin(self, seconds: float, processor: float, piece: float) -> None:
        """Notes what a worker took until it was there, of all seconds and of a core's, and for a piece of work."""
        self._pieces.append(piece)
        self.take(max(seconds / AT_START, processor), processor)

    def take(self, seconds: float, processor: float) -> None:
        """Notes that a worker had so many seconds of a core while so many passed."""
        self._seconds = FADES * self._seconds + seconds
        self._processor = FADES * self._processor + processor

    @property
    def slowness(self) -> float:
        """Seconds that a second of a core takes by now, one at least."""
        if self._seconds < _ENOUGH:
            return 1.0
        return min(max(self._seconds / max(self._processor, 1e-9), 1.0), MOST)

    def late(self, seconds: float, usual: float) -> float:
        """The same as long as no worker is there, after so many seconds: usually they take so many of a core."""
        return min(max(seconds / (AT_START * usual), self.slowness), MOST) if usual else self.slowness

    @property
    def machine(self) -> float:
        """How many times as long as in `costs` a core of this machine takes, by the pieces of work of its workers."""
        return sum(self._pieces) / len(self._pieces) / USUAL_PIECE if self._pieces else 1.0
