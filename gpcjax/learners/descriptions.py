"""The built-in learners: their descriptions. Data only, no jax.

Where a task has no preset, GPC and GPC-NS have the kernels of the lander (Table 5.3), whose observations are about one
in size: GPC's length-scales fit a task whose observations are so too, or which says how large they are
(`Env.obs_scale`); GPC-NS finds that out by itself. COACH has no default grid: it must know where observations lie.
"""

from gpcjax.allowed import NON_NEGATIVE, POSITIVE, Numbers, OneOf
from gpcjax.describe import Column, LearnerSpec, Setting

ON_FULL = ("error", "replace-nearest", "drop")
"""What a dictionary does that is full."""

CAPACITY = Numbers(1, 16384, whole=True)
"""Points for which a dictionary may have room from the start."""

CREDIT = (
    Setting(
        "credit",
        "",
        NON_NEGATIVE,
        "seconds between a step and the advice about it, as the learner reckons",
        compiled="value",
    ),
    Setting(
        "credit_longest",
        "",
        NON_NEGATIVE,
        "the advice is about all steps from credit to this many seconds back, in equal parts",
        compiled="value",
    ),
    Setting(
        "credit_shape",
        "",
        POSITIVE,
        "it is about steps back by the weights of a gamma distribution of this shape, and credit as mean",
        compiled="value",
    ),
)
"""Settings of every learner: which steps it takes an advice to be about (COACH's credit assigner, section 2.3.1)."""

_SMOOTHNESS = OneOf((0.5, 1.5, 2.5))

_GP = (
    Setting("policy_length_scale", "l_p", POSITIVE, "length-scale of the policy"),
    Setting("policy_variance", "c_p", POSITIVE, "signal variance of the policy"),
    Setting("policy_nu", "nu_p", _SMOOTHNESS, "smoothness of the policy's Matern kernel", compiled="value"),
    Setting("human_length_scale", "l_h", POSITIVE, "length-scale of the human model"),
    Setting("human_variance", "c_h", POSITIVE, "signal variance of the human model"),
    Setting("constant_rate", "c_r", NON_NEGATIVE, "constant part of the learning rate (3.5)"),
    Setting("static_rate", "r_c", POSITIVE, "learning rate that replaces the adaptive one"),
    Setting("noise", "sigma_n^2", POSITIVE, "noise variance on both diagonals"),
    Setting("human_noise", "", POSITIVE, "noise variance on the human model's diagonal, in place of noise"),
)
"""Without a value, the thesis' (Tables 5.1 to 5.3) holds."""

_GP_OPTIONS = (
    "scaling",
    "human_scaling",
    "sparsify",
    "on_full",
    "capacity",
    "policy_capacity",
    "human_capacity",
)

_GP_COLUMNS = (
    Column("policy_points", "int", "points in the policies' dictionaries at the episode's end"),
    Column("human_points", "int", "points in the human models' dictionaries at the episode's end"),
)


def _kernels(c_h: float, l_h: float, c_p: float, l_p: float, nu_p: float, c_r: float) -> dict[str, float]:
    """One column of Tables 5.1 to 5.3, in their order of rows."""
    return {
        "human_variance": c_h,
        "human_length_scale": l_h,
        "policy_variance": c_p,
        "policy_length_scale": l_p,
        "policy_nu": nu_p,
        "constant_rate": c_r,
    }


GPC = LearnerSpec(
    name="gpc",
    make="gpcjax.learners.factory:make_gpc",
    label="GPC",
    settings=_GP,
    options=_GP_OPTIONS,
    columns=_GP_COLUMNS,
    dictionary=True,
    uncertain=True,
    defaults=_kernels(0.01, 0.2, 0.01, 0.4, 1.5, 0.02),
)

GPC_NS = LearnerSpec(
    name="gpc-ns",
    make="gpcjax.learners.factory:make_gpc_ns",
    label="GPC-NS",
    settings=_GP,
    options=_GP_OPTIONS,
    columns=_GP_COLUMNS,
    dictionary=True,
    uncertain=True,
    normalises=True,
    defaults=_kernels(0.08, 0.2, 1e-3, 0.6, 1.5, 0.05),
)

COACH = LearnerSpec(
    name="coach",
    make="gpcjax.learners.factory:make_coach",
    label="COACH",
    settings=(
        Setting("beta", "beta", POSITIVE, "learning rate of COACH's human model"),
        Setting("magnitude", "e", POSITIVE, "error magnitude that COACH and D-COACH assume"),
        Setting("coach_constant", "c_c", NON_NEGATIVE, "constant part of COACH's rate (2.3)"),
    ),
    options=("lower", "upper", "counts"),
    needs=("lower", "upper", "counts"),
)

# As published but for the learning rate (0.003), which sweeps/grid_pendulum_d-coach.toml found for sparser advice.
D_COACH = LearnerSpec(
    name="d-coach",
    make="gpcjax.learners.dcoach:make_dcoach",
    label="D-COACH",
    settings=(
        Setting("learning_rate", "alpha", POSITIVE, "learning rate of D-COACH's network"),
        Setting("magnitude", "e", POSITIVE, "error magnitude that COACH and D-COACH assume"),
        Setting(
            "buffer_size", "K", Numbers(1, 1 << 20, whole=True), "corrections that are kept", compiled="value"
        ),
        Setting(
            "batch_size", "N", Numbers(1, 1 << 14, whole=True), "corrections of a minibatch", compiled="value"
        ),
        Setting(
            "replay_every",
            "b",
            Numbers(0, 1 << 20, whole=True),
            "steps between minibatches without advice, 0 for none",
            compiled="value",
        ),
        Setting("width", "", Numbers(1, 1 << 12, whole=True), "units of each hidden layer", compiled="value"),
    ),
    options=("scaling",),
    columns=(
        Column("buffer_points", "int", "corrections in the buffer at the episode's end"),
        Column(
            "replay_loss", "float", "half the mean squared error of the newest minibatch, before its step"
        ),
    ),
    defaults={
        "learning_rate": 0.3,
        "magnitude": 1.0,
        "buffer_size": 200,
        "batch_size": 50,
        "replay_every": 10,
        "width": 64,
    },
)

LEARNERS = (GPC, GPC_NS, COACH, D_COACH)
