"""How far a sweep is, in lines of JSON for programs. Loads no jax."""

import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any

from gpcjax.sweep.estimate import compiling_left, seconds_left
from gpcjax.sweep.telling import State
from gpcjax.sweep.works import Work


@dataclass
class JsonLines:
    """Tells programs how far a sweep is: a line of JSON on stdout at its beginning, each second, and at its end.

    | Key            | What                                                                     |
    |----------------|--------------------------------------------------------------------------|
    | `event`        | "begin", "progress" or "end"                                             |
    | `sweep`        | the task                                                                 |
    | `cells`        | to do                                                                    |
    | `finished`     | of these                                                                 |
    | `env_steps`    | so far                                                                   |
    | `elapsed_s`    | since the beginning                                                      |
    | `left_s`       | estimated                                                                |
    | `compile_s`    | of these, in which workers compile: the longest of them                  |
    | `compiling`    | whether a worker has been compiling for a while                          |
    | `complete`     | of "end" alone: whether all cells came, and not a failure or Ctrl-C      |
    """

    name: str
    cells: int
    jobs: int
    stream: Any = None
    clock: Callable[[], float] = time.monotonic
    works: Sequence[Work] = ()
    _state: State = field(default_factory=State)
    _began: float = 0.0
    _last: float = 0.0

    def __enter__(self) -> "JsonLines":
        self._began = self._last = self.clock()
        self._state = State(works=self.works)
        self._say("begin")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._say("end", complete=kind is None)

    def show(self, state: State) -> None:
        self._state = state
        if self.clock() - self._last >= 1.0:
            self._last = self.clock()
            self._say("progress")

    def _say(self, event: str, **further: bool) -> None:
        line = {
            "event": event,
            "sweep": self.name,
            "cells": self.cells,
            "finished": self._state.finished,
            "env_steps": self._state.steps,
            "elapsed_s": round(self.clock() - self._began, 3),
            "left_s": round(seconds_left(self._state.works, self.jobs), 3),
            "compile_s": round(compiling_left(self._state.works, self.jobs), 3),
            "compiling": self._state.compiling,
            **further,
        }
        print(json.dumps(line), file=self.stream or sys.stdout, flush=True)
