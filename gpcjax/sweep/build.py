"""Where names become objects: learners, teachers and pools for the cells of a sweep."""

import dataclasses
import functools
import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from gpcjax._x64 import under_own_settings
from gpcjax.allowed import checked
from gpcjax.describe import LearnerSpec, TeacherSpec
from gpcjax.engine.evaluate import idle
from gpcjax.engine.history import Credit
from gpcjax.engine.identity import Keeper
from gpcjax.engine.keeping import Keep
from gpcjax.engine.lanes import Start, room_for
from gpcjax.engine.pool import Pool, Tier, tiers
from gpcjax.envs.registry import NOBODY, expert_names, make_env, make_expert
from gpcjax.errors import UserError
from gpcjax.fixed import fixed
from gpcjax.gp.batching import together
from gpcjax.learners.base import Learner, State
from gpcjax.learners.descriptions import CREDIT
from gpcjax.learners.factory import sizes_of
from gpcjax.learners.packed import pack_learner
from gpcjax.learners.recipes import Recipe, pack_own
from gpcjax.registry import built_in, find, resolve
from gpcjax.sweep.keeping import Keeping
from gpcjax.sweep.options import OPTIONS
from gpcjax.sweep.plan import Cell, Program, program_of
from gpcjax.sweep.rehearsal import rehearse_learner, rehearse_task, rehearse_teacher
from gpcjax.sweep.scales import SCALES
from gpcjax.teachers.base import Teacher
from gpcjax.teachers.oracle import Advisor, synthesised

WIDE, WIDE_TOGETHER = Tier(1, 1, lanes=64), Tier(1, 1, lanes=8192)
"""The one block of learners without a dictionary: nothing of theirs grows. On a CPU, and on an accelerator."""

_OF_THE_EXPERIMENT = ("rate", "error", "delta")
"""Settings of every sweep, which a teacher is given that has them."""


def start_of(cell: Cell) -> Start:
    """The lane of a cell: its numbers, and what it begins with, on the host.

    Raises:
        UserError: what it is to begin with is gone, has changed, or cannot be carried over.
    """
    learner, teacher, credit = _parts(dataclasses.replace(cell, seed=0, start=None))
    state = None
    if cell.start is not None:
        from gpcjax.sweep.started import state_of  # which reads run folders

        state = state_of(cell, learner, [tier.capacities for tier in _tiers(program_of(cell))])
    return Start(name=cell, learner=learner, teacher=teacher, seed=cell.seed, credit=credit, state=state)


def learner_of(cell: Cell, capacity: int) -> Learner:
    """The learner of a cell, with room for so many points at first."""
    return _recipe(cell, dict(cell.hyperparameters), capacity).made()


@functools.lru_cache(maxsize=1024)
def _parts(cell: Cell) -> tuple[Learner, Teacher, Credit | None]:
    """Learner, teacher and credit of a cell, which all seeds share."""
    values = dict(cell.hyperparameters)
    seconds, longest, shape = (values.get(setting.name) for setting in CREDIT)
    credit = Credit.of(seconds, longest, shape, find("task", cell.env).seconds)
    return jax.tree.map(np.asarray, (_recipe(cell, values).made(), _teacher(cell, values), credit))


def recipe_of(cell: Cell) -> Recipe:
    """How the learner of a cell is made."""
    return _recipe(cell, dict(cell.hyperparameters))


def pack_learned(cell: Cell, learner: Learner, state: State) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What the learner of a cell has learned, as `gpcjax.learners.packed.unpack_learner` takes it."""
    if cell.algo in built_in("learner"):
        return pack_learner(learner, state)
    return pack_own(recipe_of(cell), learner, state)


def _own(spec: LearnerSpec | TeacherSpec, values: Mapping[str, float]) -> dict[str, Any]:
    """The values of its settings, of the type that it takes: another one may have the same name for whole numbers."""
    kinds = {each.name: each.kind for each in spec.settings}
    return {name: kinds[name](value) for name, value in values.items() if name in kinds}


def _recipe(cell: Cell, values: Mapping[str, float], capacity: int | None = None) -> Recipe:
    spec: LearnerSpec = find("learner", cell.algo)
    options = _own(spec, values)
    options |= {name: list(factors) for name in SCALES if (factors := getattr(cell, name))}
    if spec.dictionary:
        first = _tiers(program_of(cell))[0]
        options |= {
            "policy_capacity": capacity or first.policy_capacity,
            "human_capacity": capacity or first.human_capacity,
            "sparsify": cell.sparsify,
            "on_full": cell.on_full,
        }
    return Recipe(cell.algo, cell.env, options)


def _teacher(cell: Cell, values: Mapping[str, float]) -> Teacher:
    spec: TeacherSpec = find("teacher", cell.teacher)
    make = resolve(spec.make)
    takes = inspect.signature(make).parameters
    options = _own(spec, values)
    options |= {name: getattr(cell, name) for name in _OF_THE_EXPERIMENT if name in takes}
    if "time_step" in takes:
        options["time_step"] = find("task", cell.env).seconds
    if cell.rate_schedule and "schedule" not in takes:
        raise UserError(f"rate_schedule: the teacher {cell.teacher} has no schedule, give rate")
    is_ours = cell.teacher in built_in("teacher")
    if cell.rate_schedule or is_ours:
        rates = (cell.rate_schedule or (cell.rate,))[: cell.episodes]
        # Ours have one anyway, of as many chances as there are rows: so sweeps with and without one, and of other
        # lengths, share programs.
        size = room_for(cell.episodes) if is_ours else cell.episodes
        options["schedule"] = (*rates, *rates[-1:] * (size - len(rates)))
    return fixed(make(**options))


def make_pool(
    cell: Cell, keeping: Keeping | None = None, programs: Keeper | None = None, learned: bool = True
) -> Pool:
    """A pool for all cells of the program of `cell`, which hands out what is to be kept of their runs on the way.

    What it compiles it looks for in `programs`, where that is kept. Runs that ended come with what they learned if
    `learned` says so.
    """
    program = program_of(cell)
    env, learner = make_env(program.env), recipe_of(cell).made()
    teacher = _teacher(cell, dict(cell.hyperparameters))
    if program.env not in built_in("task"):
        rehearse_task(program.env, env)
    if cell.algo not in built_in("learner"):
        rehearse_learner(cell.algo, learner)
    if not teacher.is_ours:
        rehearse_teacher(cell.teacher, teacher, learner.obs_size, learner.action_size)
    template = start_of(dataclasses.replace(cell, start=None))
    on_the_way = keeping is not None and (keeping.every or keeping.best)
    return Pool(
        env=env,
        expert=idle(env) if program.oracle == NOBODY else make_expert(program.env, program.oracle),
        episodes=program.episodes,
        template=template,
        tiers=_tiers(program),
        keep=Keep(keeping.every, keeping.best) if keeping is not None and on_the_way else None,
        kept=programs,
        learned=learned,
    )


@under_own_settings
def make_oracle(
    env_name: str,
    expert_name: str | None = None,
    *,
    rate: Any = 0.05,
    error: Any = 0.0,
    delta: Any = 0.05,
    active_gain: Any = 0.0,
) -> Advisor:
    """The synthesised teacher (Alg. 4) of a task; its numbers are bounded as on the command line.

    Args:
        env_name: as `make_env` takes it.
        expert_name: whose actions it aims at, of `gpcjax.expert_names(env_name)`; the first by default.
        rate: gamma, its chance of advice at a step and action dimension; the least chance if `active_gain` is given.
        error: e, the chance that an advice has the wrong sign.
        delta: it is silent this near to its target, in units of the action.
        active_gain: c_a of (3.6); 0 is no active learning.

    Returns:
        What advises: `advise(key, obs, action)` is h (action_size,), each -1, 0 or 1, for obs (obs_size,) and an action
        in [-1, 1] (action_size,); it consumes `key`, and with `active_gain` wants `sigma_human` as well. `target(obs)`
        is the expert's action.

    Raises:
        ValueError: an unknown name, or a number out of range.
    """
    known = expert_names(env_name)
    if expert_name is None and not known:
        raise UserError(
            f"{env_name} has no expert: give expert_name, a saved policy's folder or module:function"
        )
    expert = make_expert(env_name, known[0] if expert_name is None else expert_name)
    given = {"rate": rate, "error": error, "delta": delta, "active_gain": active_gain}
    numbers = {name: checked(name, value, float, OPTIONS[name].allowed) for name, value in given.items()}
    return Advisor(expert=expert, oracle=synthesised(**numbers), **sizes_of(find("task", env_name)))


def _tiers(program: Program) -> Sequence[Tier]:
    # Simulations on the host are stepped one after the other, whatever computes the rest.
    wide = together() and not find("task", program.env).on_host
    learner = find("learner", program.algo)
    if learner.dictionary:
        return tiers(program.max_capacity, wide, learner.normalises)
    return (WIDE_TOGETHER if wide else WIDE,)
