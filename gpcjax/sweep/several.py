"""Several sweeps at once, each into its own run folder, by the same workers. The parent process loads no jax."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

from gpcjax.sweep import stopping
from gpcjax.sweep.beginning import begun
from gpcjax.sweep.executors import Errands, Office, Processes
from gpcjax.sweep.notebook import usual_watcher
from gpcjax.sweep.run import opened
from gpcjax.sweep.spec import SweepSpec
from gpcjax.sweep.telling import State, Watcher
from gpcjax.sweep.works import Work


def run_several(
    name: str,
    asked: Sequence[tuple[SweepSpec, Path]],
    executor: Processes,
    errands: Errands | None = None,
    watcher: Callable[..., Watcher] | None = None,
) -> None:
    """Runs what is missing of these sweeps, as if all their cells were of one: no worker waits for the end of another.

    A folder is complete as soon as its last row is there. None may hold less than is asked for: none grows.

    Args:
        name: what they are called where it is shown how far they are.
        asked: specifications, and the run folders that they go to, in the order in which workers turn to them.
        executor: runs the workers.
        errands: what workers are to do before.
        watcher: shows how far all of them are; None for the usual one.

    Raises:
        UserError: see `gpcjax.sweep.run.opened`, of any of them: then nothing has run.
        Failure: a worker failed; what was finished is kept.
    """
    joint = _Joint(name, executor.jobs, watcher or usual_watcher())
    with ExitStack() as stack:
        goings = []
        for spec, out in asked:
            stack.enter_context(begun(out))
            going = stack.enter_context(opened(spec, out, executor.jobs, grows=False, watcher=joint.part))
            goings += [] if going is None else [going]
        stack.enter_context(stopping.deferred())
        if goings:
            stack.enter_context(joint)
        for going in goings:
            stack.enter_context(going.under_way())
        office = Office(
            [going.desk for going in goings],
            executor.jobs,
            on_turn=lambda index: goings[index].begin(),
            on_over=lambda index: goings[index].finish(),
            errands=errands,
        )
        if office.workers:
            executor.run(office)


class _Joint:
    """Shows several sweeps as one."""

    def __init__(self, name: str, jobs: int, watcher: Callable[..., Watcher]):
        self._name, self._jobs, self._watcher = name, jobs, watcher
        self._parts: list[_Part] = []
        self._bar: Watcher | None = None

    def part(self, name: str, cells: int, jobs: int, works: Sequence[Work] = ()) -> "_Part":
        """What shows one of them."""
        self._parts.append(_Part(self, cells, State(works=works)))
        return self._parts[-1]

    def __enter__(self) -> "_Joint":
        cells, works = sum(part.cells for part in self._parts), self._works()
        self._bar = self._watcher(self._name, cells, self._jobs, works=works)
        self._bar.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        if self._bar is not None:
            self._bar.__exit__(*error)

    def show(self) -> None:
        """Shows where all of them are."""
        states = [part.state for part in self._parts]
        if self._bar is not None:
            self._bar.show(
                State(
                    finished=sum(state.finished for state in states),
                    steps=sum(state.steps for state in states),
                    works=self._works(),
                    compiling=any(state.compiling for state in states),
                )
            )

    def _works(self) -> tuple[Work, ...]:
        return tuple(work for part in self._parts for work in part.state.works)


class _Part:
    """What a sweep tells of itself, as one of several."""

    def __init__(self, joint: _Joint, cells: int, state: State):
        self._joint, self.cells, self.state = joint, cells, state

    def __enter__(self) -> "_Part":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def show(self, state: State) -> None:
        """Show this, with what the others have told."""
        self.state = state
        self._joint.show()
