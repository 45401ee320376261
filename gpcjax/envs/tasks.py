"""The built-in tasks: their descriptions, with hyperparameters for each learner. Data only, no jax.

Tables 5.1 to 5.3 of the thesis for GPC and GPC-NS, Table A.1 for COACH. How large observations are (`obs_scale`) is
what the thesis divides them by for GPC; the lander's are about one by themselves. The mountain car is not of the
thesis.
"""

from types import MappingProxyType
from typing import Any

from gpcjax.describe import Control, TaskSpec, View

_SHIPPED = "gpcjax.policies.saved:load_shipped"


def _gp(
    c_h: float, l_h: float, c_p: float, l_p: float, nu_p: float, c_r: float, **more: Any
) -> dict[str, Any]:
    """One column of Tables 5.1 to 5.3, in their order of rows."""
    return {
        "human_variance": c_h,
        "human_length_scale": l_h,
        "policy_variance": c_p,
        "policy_length_scale": l_p,
        "policy_nu": nu_p,
        "constant_rate": c_r,
        **more,
    }


CARTPOLE = TaskSpec(
    name="cartpole",
    make="gpcjax.envs.cartpole:CartPole",
    label="Cart-pole",
    unit="steps upright",
    experts=MappingProxyType(
        {
            "gpc": (_SHIPPED, "cartpole"),
            "gpc-2": (_SHIPPED, "cartpole-2"),
            "gpc-3": (_SHIPPED, "cartpole-3"),
            "lqr": ("gpcjax.envs.experts:LQR",),
            "network": (_SHIPPED, "cartpole-network"),
            "mpc": ("gpcjax.envs.predictive:CartPoleMPC",),
        }
    ),
    episodes=30,
    sizes=(4, 1),
    obs_scale=(1.0, 1.0, 0.13, 0.4),
    time_step=0.02,
    view=View(
        scene="cartpole",
        observed=(
            ("place (m)", -2.4, 2.4),
            ("speed (m/s)", -2.0, 2.0),
            ("angle (rad)", -0.21, 0.21),
            ("turning (rad/s)", -2.0, 2.0),
        ),
        controls=(Control(less=("left", "push left"), more=("right", "push right")),),
        axes=(2, 3),
        hint="Keep the pole upright and the cart on its track.",
    ),
    presets=MappingProxyType(
        {
            "gpc": _gp(0.01, 0.2, 0.01, 0.2, 1.5, 0.02, scaling=(1.0, 1.0, 1 / 0.13, 1 / 0.4)),
            "gpc-ns": _gp(0.08, 0.5, 1e-3, 0.7, 1.5, 0.05),
            "coach": {
                "lower": (-1.44, -0.12, -0.126, -0.4),
                "counts": (4, 4, 4, 4),
                "upper": (1.44, 0.12, 0.126, 0.4),
                "beta": 30.0,
                "magnitude": 5.0,
                "coach_constant": 1.8,
            },
        }
    ),
)

PENDULUM = TaskSpec(
    name="pendulum",
    make="gpcjax.envs.pendulum:Pendulum",
    label="Pendulum",
    unit="negative cost",
    experts=MappingProxyType(
        {
            "gpc": (_SHIPPED, "pendulum"),
            "energy": ("gpcjax.envs.experts:EnergySwingUp",),
            "network": (_SHIPPED, "pendulum-network"),
            "mpc": ("gpcjax.envs.predictive:PendulumMPC",),
        }
    ),
    episodes=40,
    sizes=(3, 1),
    obs_scale=(1.0, 1.0, 6.0),
    time_step=0.05,
    view=View(
        scene="pendulum",
        observed=(
            ("cos of the angle", -1.0, 1.0),
            ("sin of the angle", -1.0, 1.0),
            ("turning (rad/s)", -8.0, 8.0),
        ),
        # A positive torque turns it counter-clockwise: its lower half, where it starts, to the right.
        controls=(Control(less=("right", "turn clockwise"), more=("left", "turn counter-clockwise")),),
        axes=(1, 2),
        hint="Swing the rod up and hold it there. The motor is weak: let it swing higher and higher.",
    ),
    presets=MappingProxyType(
        {
            "gpc": _gp(0.7, 0.1, 0.01, 0.7, 0.5, 0.01, scaling=(1.0, 1.0, 1 / 6)),
            "gpc-ns": _gp(0.45, 0.1, 0.03, 0.5, 1.5, 0.02),
            "coach": {
                "lower": (-1.0, -1.0, -6.0),
                "counts": (6, 6, 7),
                "upper": (1.0, 1.0, 6.0),
                "beta": 30.0,
                "magnitude": 5.0,
                "coach_constant": 1.8,
            },
        }
    ),
)

LUNAR_LANDER = TaskSpec(
    name="lunarlander",
    make="gpcjax.envs.host:lunar_lander",
    label="Lunar lander",
    actions=("main engine", "side engines"),
    experts=MappingProxyType({"heuristic": ("gpcjax.envs.experts:LanderHeuristic",)}),
    episodes=200,
    max_capacity=4096,
    on_host=True,
    sizes=(8, 2),
    time_step=0.02,
    view=View(
        observed=(
            ("place", -1.0, 1.0),
            ("height", 0.0, 1.5),
            ("speed sideways", -1.0, 1.0),
            ("speed upwards", -1.5, 0.5),
            ("angle (rad)", -0.7, 0.7),
            ("turning", -1.0, 1.0),
            ("left leg touches", 0.0, 1.0),
            ("right leg touches", 0.0, 1.0),
        ),
        controls=(
            Control(less=("down", "less thrust"), more=("up", "more thrust")),
            # The left engine pushes it to the right.
            Control(less=("right", "fire the left engine"), more=("left", "fire the right engine")),
        ),
        axes=(1, 3),
        hint="Land between the flags, upright and slowly.",
    ),
    presets=MappingProxyType(
        {
            # Table 5.3 is what holds for GPC and GPC-NS where nothing else is said (`gpcjax.learners.descriptions`).
            "coach": {
                "lower": (-1.0,) * 8,
                "counts": (2, 3, 2, 2, 2, 2, 2, 2),
                "upper": (1.0,) * 8,
                "beta": (1.0, 1.0),
                "magnitude": (5.0, 1.0),
                "coach_constant": (1.0, 20.0),
            },
        }
    ),
)

MOUNTAIN_CAR = TaskSpec(
    name="mountaincar",
    make="gpcjax.envs.mountaincar:MountainCar",
    label="Mountain car",
    unit="100 at the goal, less effort",
    experts=MappingProxyType({"pump": ("gpcjax.envs.experts:ValleyPump",)}),
    episodes=30,
    sizes=(2, 1),
    obs_scale=(0.5, 0.04),
    view=View(
        scene="mountaincar",
        observed=(("place", -1.2, 0.6), ("speed", -0.07, 0.07)),
        controls=(Control(less=("left", "push left"), more=("right", "push right")),),
        hint="Reach the flag on the hill. The engine is weak: swing up on both sides first.",
    ),
    presets=MappingProxyType(
        {
            # Chosen by the grids of sweeps/grid_mountaincar_*.toml, which tell their figures.
            "gpc": _gp(0.01, 0.1, 0.01, 0.4, 1.5, 0.1, scaling=(1 / 0.5, 1 / 0.04)),
            "gpc-ns": _gp(0.08, 1.0, 0.03, 0.6, 1.5, 0.05),
            "coach": {
                "lower": (-1.2, -0.07),
                "counts": (6, 7),
                "upper": (0.6, 0.07),
                "beta": 3.0,
                "magnitude": 1.0,
                "coach_constant": 1.8,
            },
        }
    ),
)

TASKS = (CARTPOLE, PENDULUM, LUNAR_LANDER, MOUNTAIN_CAR)
