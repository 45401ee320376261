"""How much of a core a worker has, on a machine that others use too. Loads no jax."""

MOST = 20.0
"""How much of a core's time is believed to be others': more is a worker that waits for something else."""

FADES = 0.97
"""Of what workers said of their cores, with each further word."""

_ENOUGH = 1.0
"""Seconds of what workers said, to go by that."""


USUAL_START = 1.3
"""Seconds of a core in which a worker imports what it needs, on the machine that `costs` were seen on."""


class Crowd:
    """What is known of it so far: by what workers had of a core since they began."""

    def __init__(self) -> None:
        self._seconds = self._processor = 0.0
        self._starts: list[float] = []

    def begin(self, seconds: float, processor: float) -> None:
        """Notes what a worker took until it was there, of all seconds and of a core's."""
        self._starts.append(processor)
        self.take(seconds, processor)

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

    @property
    def machine(self) -> float:
        """How many times as long as in `costs` a core of this machine takes, by the imports of its workers."""
        return sum(self._starts) / len(self._starts) / USUAL_START if self._starts else 1.0
