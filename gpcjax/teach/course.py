"""What is taught in a folder, and what the folder holds. Loads no jax.

OUT/course.json      task, learner, settings, seed; with what and where it was begun
OUT/session.jsonl    the recording: every event as it happens (`gpcjax.recording`)
OUT/start/           the saved learner that it began with, if it was opened from one
OUT/saves/NAME/      what was saved, for `Session.load`
OUT/policy/          the policy so far: an oracle for sweeps, for `load_policy`
OUT/manifest.json, episodes/, corrections/    its rows, as those of a sweep
"""

import dataclasses
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gpcjax.allowed import suggestion
from gpcjax.describe import TaskSpec
from gpcjax.errors import UserError
from gpcjax.recording import RECORD
from gpcjax.registry import find
from gpcjax.sweep.atomic import write_atomic
from gpcjax.sweep.given import Given, Unchecked
from gpcjax.sweep.options import OF_CREDIT, OPTIONS, TUNING, accept
from gpcjax.sweep.plan import Cell, plan
from gpcjax.sweep.scales import SCALES
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import SweepSpec, make_spec
from gpcjax.sweep.versions import versions

FORMAT, WITH_VARIANTS = 1, 2
"""Of `course.json`: versions that know no variants must not teach the learner without."""

COURSE, START, SAVES, POLICY = "course.json", "start", "saves", "policy"

VARIANTS = (*SCALES, "sparsify")
"""What a learner may be given beside its settings, which are numbers."""

DICTIONARY = 1024
"""Points for which there is room, from the start: compiling for a larger one while a person teaches made steps wait for
half a second. A correction takes 7 ms with GPC and 24 with GPC-NS, and four times that with twice the room. A full
dictionary replaces its nearest point.
"""

__all__ = ["COURSE", "POLICY", "RECORD", "SAVES", "START", "Course", "new_folder"]


@dataclass(frozen=True)
class Course:
    """What a person teaches: a task and a learner with its settings."""

    env: str
    algo: str
    settings: tuple[tuple[str, float], ...] = ()
    """By name, those that were given: of the learner, and of credit (`gpcjax.lateness.CREDIT`)."""
    seed: int = 0
    """Of the starts, which are those of a sweep with this seed, and of what the learner draws."""
    variants: tuple[tuple[str, Any], ...] = ()
    """By name, those of `VARIANTS` that were given."""

    @classmethod
    def of(cls, given: dict[str, Given | Unchecked], seed: int = 0) -> "Course":
        """Of checked settings, as a sweep takes them, with one value each.

        Raises:
            UserError: a setting has several values, does not fit, or is none of a lesson.
        """
        if "algo" not in given and "env" in given:
            given = given | {"algo": Given((usual_learner(given["env"].value),), "--algo")}
        for name, setting in given.items():
            if isinstance(setting.value, tuple) and len(setting.value) > 1 and name not in SCALES:
                raise UserError(f"{setting.source}: one person teaches one learner at a time, give one value")
        _check_known(given)
        spec = make_spec(given | {"teacher": Given("person", "teacher")}, live=True)
        for name, values in spec.hyperparameters.items():
            if len(values) > 1:
                raise UserError(
                    f"{given[name].source}: one person teaches one learner at a time, give one value"
                )
        numbers = tuple((name, values[0]) for name, values in spec.hyperparameters.items())
        variants = tuple((name, getattr(spec, name)) for name in VARIANTS if name in given)
        return cls(spec.env, spec.algo[0], numbers, seed, variants)

    def spec(self, episodes: int) -> SweepSpec:
        """The sweep whose rows those of this course are."""
        settings: dict[str, Any] = {
            "env": self.env,
            "algo": (self.algo,),
            "teacher": "person",
            "seeds": Seeds.of([self.seed]),
            "episodes": episodes,
        }
        if find("learner", self.algo).dictionary:
            settings |= {"on_full": "replace-nearest", "max_capacity": DICTIONARY}
        settings |= dict(self.variants)
        numbers = {name: (value,) for name, value in self.settings}
        given = {name: Given(value, name) for name, value in (settings | numbers).items()}
        known: dict[str, Given | Unchecked] = {
            name: each if name in settings or name in OPTIONS else Unchecked(numbers[name][0], name, name)
            for name, each in given.items()
        }
        return make_spec(known, live=True)

    def cell(self, episodes: int) -> Cell:
        """The one run of that sweep."""
        (cell,) = plan(self.spec(episodes))
        return dataclasses.replace(cell, seed=self.seed)

    def write(self, folder: Path) -> None:
        """Says in the folder what is taught there. Raises OSError."""
        content = {
            "format": WITH_VARIANTS if self.variants else FORMAT,
            "env": self.env,
            "algo": self.algo,
            "settings": dict(self.settings),
            "seed": self.seed,
            **({"variants": dict(self.variants)} if self.variants else {}),
            "begun": datetime.now(UTC).isoformat(timespec="seconds"),
            "versions": versions(),
        }
        write_atomic(folder / COURSE, json.dumps(content, indent=2) + "\n")

    @classmethod
    def read(cls, folder: Path) -> "Course":
        """What is taught in a folder.

        Raises:
            UserError: nothing, or what says so is damaged.
        """
        path = folder / COURSE
        try:
            content = json.loads(path.read_bytes())
        except OSError as error:
            raise UserError(
                f"{path}: cannot be read ({error.strerror}), give a folder that gpcjax teach has made"
            ) from None
        except (ValueError, RecursionError):
            content = None
        match content:
            case {
                "format": 1 | 2,
                "env": str(env),
                "algo": str(algo),
                "settings": dict(settings),
                "seed": int(seed),
            } if type(seed) is int and seed >= 0:  # true is an int to Python
                variants = content.get("variants", {})
                if isinstance(variants, dict) and variants.keys() <= set(VARIANTS):
                    course = cls(env, algo, tuple(settings.items()), seed, _as_given(variants))
                    course.spec(1)  # refuses what does not fit
                    return course
        raise UserError(f"{path}: it is damaged, or of another version")


def _check_known(given: Mapping[str, Given | Unchecked]) -> None:
    """Raises UserError: there is something that a lesson has not, though a sweep may. Others' settings pass."""
    if "algo" not in given:
        return
    learner = find("learner", given["algo"].value[0])
    known = [each.name for each in (*learner.settings, *OF_CREDIT)]
    known += [name for name in VARIANTS if name in learner.options]
    passing = {"env", "algo", *known, *VARIANTS, *(each.name for each in TUNING)}
    for name, setting in given.items():
        if name not in passing:
            raise UserError(
                f"{setting.source}: what a person teaches has no such setting{suggestion(name, known)}, give "
                f"{', '.join(known)}"
            )


def _as_given(variants: dict[str, Any]) -> tuple[tuple[str, Any], ...]:
    """Variants as `Course` has them, of what JSON makes of them. Raises UserError: one is no such value."""
    return tuple((name, accept(OPTIONS[name], value, name)) for name, value in variants.items())


def seconds_of(task: TaskSpec) -> float:
    """Of a step as a person sees it: a task without a unit of time has 30 steps a second."""
    return 1 / 30 if task.time_step is None else task.time_step


def usual_learner(env: str) -> str:
    """Who learns where nobody says: GPC on a task that it has values for, elsewhere GPC-NS, which needs none."""
    task = find("task", env)
    return "gpc" if "gpc" in task.presets or task.obs_scale is not None else "gpc-ns"


def new_folder(env: str, beside: Path | None = None) -> Path:
    """A folder that does not exist yet: runs/taught-ENV-NUMBER, or the next number beside another."""
    stem = re.sub(r"[^A-Za-z0-9_.-]+", "-", f"taught-{env}")
    if beside is not None:
        stem = re.sub(r"-\d+$", "", beside.name)
    parent = Path("runs") if beside is None else beside.parent
    return next(path for number in range(1, 1_000_000) if not (path := parent / f"{stem}-{number}").exists())
