"""Whether the settings of a sweep fit together: each changes something, and the teacher can advise. Loads no jax."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from gpcjax.describe import LearnerSpec, TaskSpec, TeacherSpec
from gpcjax.envs.registry import check_expert
from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.sweep.options import OF_THE_THESIS, OPTIONS, concerns

if TYPE_CHECKING:
    from gpcjax.sweep.spec import Given


def check_advised(task: TaskSpec, teacher: TeacherSpec, oracle: "Given | None") -> None:
    """Raises UserError: the teacher cannot advise on this task, or has no expert, or one that is none of the task's."""
    if teacher.action_size is not None and task.sizes and task.sizes[1] != teacher.action_size:
        raise UserError(
            f"teacher {teacher.name}: it advises on {teacher.action_size} action dimensions, "
            f"{task.name} has {task.sizes[1]}"
        )
    if oracle is not None:
        for each in oracle.value:
            check_expert(task.name, each, oracle.source)
    elif task.experts:
        check_expert(task.name, next(iter(task.experts)), "oracle")
    elif teacher.needs_expert:
        raise UserError(
            f"{task.name} has no expert of its own: give the folder of a saved policy, or module:function "
            "(--oracle, or oracle = in the TOML file)"
        )


def lacking(learner: LearnerSpec, task: TaskSpec) -> tuple[str, ...]:
    """What this learner needs and no preset of the task gives, by name: without it there is no such learner."""
    return tuple(name for name in learner.needs if name not in task.presets.get(learner.name, {}))


def learners_for(task: TaskSpec, algo: "Given | None") -> tuple[str, ...]:
    """Who learns: those that were asked for, or else those of the thesis that this task has all for.

    Raises:
        UserError: one that was asked for needs what no preset of the task gives.
    """
    if algo is None:
        return tuple(name for name in OF_THE_THESIS if not lacking(find("learner", name), task))
    for name in algo.value:
        if missing := lacking(find("learner", name), task):
            raise UserError(
                f"{algo.source} {name}: it needs {', '.join(missing)}, which {task.name} does not give: make it a "
                f'gpcjax.TaskSpec with presets={{"{name}": ...}}, or give another learner'
            )
    return algo.value


def left_out(env: str) -> list[str]:
    """A line for each learner of the thesis that a sweep of this task leaves out where nobody names any."""
    task = find("task", env)
    named = {name: lacking(find("learner", name), task) for name in OF_THE_THESIS}
    return [
        f"{env}: without {name}, which needs {', '.join(missing)} of a gpcjax.TaskSpec's presets"
        for name, missing in named.items()
        if missing
    ]


def check_concerns(
    known: "Mapping[str, Given]", algo: Sequence[str], learners: Sequence[LearnerSpec], teacher: TeacherSpec
) -> None:
    """Raises UserError: a setting would change nothing with these learners and this teacher, or beside another one."""
    for name, setting in known.items():
        if not any(concerns(name, learner, teacher) for learner in learners):
            alone = f"with {' and '.join(algo)} alone it changes nothing"
            others = [
                each for each in OPTIONS["algo"].default if concerns(name, find("learner", each), teacher)
            ]
            raise UserError(
                f"{setting.source}: {alone}, give it with {' or '.join(others) or 'another teacher'}"
            )
    for stronger, weaker in (("static_rate", "constant_rate"), ("rate_schedule", "rate")):
        if stronger in known and weaker in known:
            source = known[weaker].source
            raise UserError(f"{source}: beside {stronger} it changes nothing, give one of the two")
