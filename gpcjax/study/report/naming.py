"""What learners and arms are called in the report of a study. Loads no jax."""

from gpcjax.report import words
from gpcjax.study.design import Treatment
from gpcjax.study.report.held import Held


def names_of(held: Held) -> dict[Treatment, str]:
    """What each learner in each arm is called in tables and figures."""
    algorithms = algorithms_of(held)
    found = {}
    for arm in held.study.arms:
        for learner in arm.learners:
            treatment = Treatment(learner, arm.name)
            title = title_of(learner, algorithms[treatment])
            found[treatment] = title if len(held.study.arms) == 1 else f"{title} ({arm.name})"
    return found


def algorithms_of(held: Held) -> dict[Treatment, str]:
    """What learner each is."""
    return {Treatment(learner, arm): course.algo for (learner, arm, _), course in held.study.courses.items()}


def learners_of(held: Held) -> list[str]:
    """What they are called, whatever the arm."""
    algorithms = algorithms_of(held)
    return list(dict.fromkeys(title_of(each.learner, algorithms[each]) for each in names_of(held)))


def title_of(learner: str, algo: str) -> str:
    """As the thesis writes it, unless the study has a name of its own for it."""
    return words.algorithm(algo) if learner == algo else learner
