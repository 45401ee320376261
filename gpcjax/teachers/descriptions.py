"""The built-in teachers: their descriptions. Data only, no jax."""

from gpcjax.allowed import NON_NEGATIVE
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
    ),
)

TEACHERS = (ORACLE,)
