"""The built-in teachers: their descriptions. Data only, no jax."""

from gpcjax.allowed import NON_NEGATIVE, POSITIVE, Numbers
from gpcjax.describe import Setting, TeacherSpec

ORACLE = TeacherSpec(
    name="oracle",
    make="gpcjax.teachers.oracle:synthesised",
    label="synthesised oracle (Alg. 4)",
    settings=(
        Setting(
            "active_gain",
            "c_a",
            NON_NEGATIVE,
            "gain of active learning (3.6), 0 is off",
            compiled="nonzero",
            uncertain=True,
        ),
        # The steps that are kept of every lane are part of a compiled program.
        Setting(
            "delay", "", NON_NEGATIVE, "seconds between a step and the advice about it", compiled="value"
        ),
        Setting(
            "delay_longest",
            "",
            NON_NEGATIVE,
            "delays are uniform, from delay to this many seconds",
            compiled="value",
        ),
        Setting(
            "delay_shape",
            "",
            POSITIVE,
            "delays are gamma-distributed with this shape, and delay as mean",
            compiled="value",
        ),
        Setting("attention", "", POSITIVE, "mean seconds that the teacher looks at a time", compiled="given"),
        Setting(
            "distraction",
            "",
            POSITIVE,
            "mean seconds that it looks away at a time (without a value: as attention)",
        ),
        Setting(
            "fading", "tau", NON_NEGATIVE, "the chance of advice dies as exp(-tau * steps)", compiled="given"
        ),
        Setting(
            "whole_error",
            "",
            Numbers(0, 1, whole=True),
            "1: a wrong advice is wrong in all action dimensions, 0: in each for itself",
            compiled="nonzero",
        ),
    ),
)

PERSON = TeacherSpec(name="person", make="", label="a person", needs_expert=False, live=True)
"""Who teaches in the browser. It is found by its name, as rows have it, and listed nowhere: no sweep can ask it."""

TEACHERS = (ORACLE,)
