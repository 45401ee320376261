"""What has been done for each program of a sweep, and what is still to do. Loads no jax."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from gpcjax.registry import find
from gpcjax.sweep import costs
from gpcjax.sweep.experience import COMPILED_FROM, FROM_CACHE, FROM_TEXT, LEAST_DONE, Cost
from gpcjax.sweep.paces import Paces
from gpcjax.sweep.plan import Program

AT_FIRST = 0.25
"""Seconds that a worker takes with a new program beside its compilation and its blocks."""


@dataclass
class Work:
    """The cells of one program: what has been done for them, by all workers, and what is still to do."""

    env: str
    algo: str
    cells: int
    episodes: int
    """Of each cell."""
    oracle: str = ""
    """Whose targets may cost more than a step."""
    begun: int = 0
    """Cells that were handed to workers."""
    finished: int = 0
    finished_steps: int = 0
    """Steps of the finished cells."""
    finished_episodes: int = 0
    """Episodes of the finished cells: fewer than they might have had, where runs stopped."""
    steps: int = 0
    done_episodes: int = 0
    seconds: float = 0.0
    """That workers have spent on it, compilations left out."""
    compile_seconds: float = 0.0
    kept: int = 0
    """Programs that were compiled, or found by their text, and are kept now; of all workers."""
    workers: int = 0
    """Workers that are at it now."""
    starting: int = 0
    """Those of them that have not made a step yet."""
    joined: int = 0
    """Workers that have been at it: each compiles for itself."""
    recent_steps: float = 0.0
    recent_episodes: float = 0.0
    """Of the last seconds: what an episode takes by now, where learners live longer and longer."""
    before: Cost | None = None
    """What the program took when it ran here the last time, of a core that does nothing else."""
    paces: Paces = field(default_factory=Paces)
    """How fast its workers are."""
    heard_seconds: float = 0.0
    """Between words of its workers, compilations among them."""
    processor_seconds: float = 0.0
    """That these workers had of a core meanwhile."""
    slowness: float = 1.0
    """Seconds that a second of a core takes by now: more than one where others are on it."""
    machine: float = 1.0
    """How many times as long as in `costs` a core takes here."""
    ready_in: float = 0.0
    """Seconds until the workers are there at all."""
    compiling_for: float = 0.0
    """Seconds that a worker has been at a compilation by now, tracing and all."""

    def add(self, steps: int, episodes: int, compile_seconds: float) -> None:
        """Take in what a worker has done since it was last heard."""
        self.steps += steps
        self.done_episodes += episodes
        self.compile_seconds += compile_seconds
        self.recent_steps = 0.9 * self.recent_steps + steps
        self.recent_episodes = 0.9 * self.recent_episodes + episodes

    def _steps_left(self) -> tuple[float, float]:
        """Expected steps of the runs that are under way, and of those that are not begun.

        Runs that are over are no sample of those that are not: on tasks where one falls early, the short ones come
        first. So the runs that are under way go on as they do now, and those not begun are like all the others.
        """
        if self.finished >= self.cells:
            return 0.0, 0.0
        running = max(self.begun - self.finished, 0)
        episodes = max(self.done_episodes - self.finished_episodes, 0)
        steps = max(self.steps - self.finished_steps, 0)
        recent = self.recent_steps / self.recent_episodes if self.recent_episodes > 0.5 else 0.0
        length = max(recent, steps / episodes if episodes else 0.0)
        if not length:
            length = self.steps / max(self.done_episodes, 1)
        of_running = length * max(running * self.episodes - episodes, 0)
        known = self.finished + running
        each = (self.finished_steps + steps + of_running) / known if known else 0.0
        return of_running, each * (self.cells - known)

    @property
    def usual_episode(self) -> float:
        """Seconds of an episode, as far as that is known before one was seen."""
        if not self.before:
            return costs.of_episode(self.env, self.algo, self.oracle)
        if find("task", self.env).on_host:
            return self.before.episode
        # Fewer cells leave the block emptier, and longer: the last ones take as long as a full block does.
        before, workers = self.before, self.joined or self.before.workers
        return before.episode * _emptiness(self.cells / workers) / _emptiness(before.cells / before.workers)

    @property
    def usual_compiling(self) -> float:
        """Seconds until a worker has the program, likewise."""
        return (
            self.before.compiling
            if self.before
            else costs.compiling(self.algo, costs.tiers(self.algo, self.episodes))
        )

    @property
    def joining(self) -> float:
        """Seconds until a further worker runs the program too: it reads what the first one compiled and kept."""
        if self.before:
            return self.before.compiling + AT_FIRST
        compiled = self.compile_seconds / max(self.joined - self.starting, 1)
        return FROM_CACHE * (compiled or self.usual_compiling * self.machine) + AT_FIRST

    @property
    def cell_seconds(self) -> float:
        """Seconds of a worker that a cell takes: as it was seen, or as far as that is known before."""
        if is_seen(self):
            return self.seconds / (self.done * self.cells)
        return self.episodes * self.usual_episode * (1.0 if self.before else self.machine)

    @property
    def usual_whole(self) -> float:
        """Seconds that one worker alone would usually take for it, from compiling to its last cell."""
        return self.usual_compiling + self.cells * self.episodes * self.usual_episode

    @property
    def took(self) -> Cost | None:
        """What the program took of a core; None if too little of it was done to tell."""
        if self.done < LEAST_DONE or not self.done_episodes or not self.joined:
            return None
        share = min(self.processor_seconds / self.heard_seconds, 1.0) if self.heard_seconds > 1.0 else 1.0
        compiling = share * self.compile_seconds / self.joined
        if self.kept:
            anew = share * self.compile_seconds / self.kept > COMPILED_FROM
            compiling *= FROM_CACHE if anew else FROM_TEXT
        cells = max(round(self.cells * self.done), 1)
        tiers = max(self.paces.compiled, self.before.tiers if self.before else 1)
        return Cost(share * self.seconds / self.done_episodes, compiling, cells, self.joined, tiers)

    @property
    def steps_left(self) -> float:
        """Expected steps of all that is not done."""
        return sum(self._steps_left())

    @property
    def steps_free(self) -> float:
        """Those of cells that no worker has."""
        return self._steps_left()[1]

    @property
    def done(self) -> float:
        """Share of its steps that are done, from 0 to 1; a program without steps has none."""
        return self.steps / (self.steps + self.steps_left) if self.steps else 0.0


def works_of(sizes: Mapping[Program, int], before: Mapping[Program, Cost] = {}) -> dict[Program, Work]:
    """The programs with so many cells each, in their order, with nothing done yet; and what some took `before`."""
    return {
        key: Work(key.env, key.algo, cells, key.episodes, key.oracle, before=before.get(key))
        for key, cells in sizes.items()
    }


def _emptiness(cells: float) -> float:
    """How much longer a cell takes than one of very many, where a worker has so many."""
    return 1.0 + costs.LANES / max(cells, 1.0)


def is_seen(work: Work) -> bool:
    """Whether its own speed can be told."""
    return work.done > 0.02 and work.seconds > 0.5
