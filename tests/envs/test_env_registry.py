"""Names of tasks and experts."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from gpcjax.envs.base import Env
from gpcjax.envs.cartpole import CartPole
from gpcjax.envs.experts import LQR, EnergySwingUp, LanderHeuristic, ValleyPump
from gpcjax.envs.host import HostEnv
from gpcjax.envs.predictive import CartPoleMPC, PendulumMPC
from gpcjax.envs.registry import (
    env_names,
    expert_names,
    make_env,
    make_expert,
    task,
)
from gpcjax.envs.tasks import TASKS
from gpcjax.policies.base import Policy


@pytest.mark.parametrize("name", env_names())
def test_make_env(name: str) -> None:
    env = make_env(name)
    assert env.name == name
    on_host = name == "lunarlander"
    assert isinstance(env, HostEnv if on_host else Env)
    obs = env.simulate().reset(0) if on_host else env.reset(jax.random.key(0)).obs
    assert obs.shape == (env.obs_size,)


def test_parameters_reach_the_env() -> None:
    env = make_env("cartpole", pole_mass=0.3, max_steps=7)
    assert isinstance(env, CartPole)
    assert env.pole_mass == 0.3 and env.max_steps == 7 and env.pole_mass.dtype == jnp.float64
    assert make_env("lunarlander", max_steps=7).max_steps == 7


@pytest.mark.parametrize(
    ("env_name", "expert", "kind"),
    [
        ("cartpole", "lqr", LQR),
        ("cartpole", "mpc", CartPoleMPC),
        ("pendulum", "energy", EnergySwingUp),
        ("pendulum", "mpc", PendulumMPC),
        ("pendulum", "network", Policy),
        ("lunarlander", "heuristic", LanderHeuristic),
        ("mountaincar", "pump", ValleyPump),
    ],
)
def test_make_expert(env_name: str, expert: str, kind: type) -> None:
    assert isinstance(make_expert(env_name, expert), kind)


def test_names() -> None:
    """The default expert of a task comes first."""
    assert env_names() == ("cartpole", "pendulum", "lunarlander", "mountaincar")
    assert expert_names("cartpole") == ("gpc", "gpc-2", "gpc-3", "lqr", "network", "mpc")
    assert expert_names("pendulum") == ("gpc", "energy", "network", "mpc")
    assert expert_names("lunarlander") == ("heuristic",)
    assert expert_names("mountaincar") == ("pump",)
    assert [task(name).episodes for name in env_names()] == [30, 40, 200, 30]
    assert [task(name).max_capacity for name in env_names()] == [1024, 1024, 4096, 1024]


def test_targets_are_well_formed() -> None:
    for spec in TASKS:
        for target, *_ in ((spec.make,), *spec.experts.values()):
            module, attribute = target.split(":")
            assert module.startswith(("gpcjax.envs.", "gpcjax.policies.")) and attribute.isidentifier()


def test_unknown_names() -> None:
    unknown = (
        "env 'cartpol': give cartpole, pendulum, lunarlander, mountaincar, module:NAME, gym:ID or brax:NAME"
    )
    for call in (make_env, expert_names, task, lambda name: make_expert(name, "lqr")):
        with pytest.raises(ValueError, match=unknown):
            call("cartpol")
    known = ", ".join(expert_names("cartpole"))
    with pytest.raises(ValueError, match=f"oracle 'energy': give {known}, the folder of a saved policy"):
        make_expert("cartpole", "energy")
    with pytest.raises(
        ValueError, match=r"unknown parameter 'masspole' of cartpole.*; allowed: gravity, .*pole_mass"
    ):
        make_env("cartpole", masspole=0.1)
    with pytest.raises(ValueError, match="unknown parameter 'gravity' of lunarlander; allowed: max_steps"):
        make_env("lunarlander", gravity=-5.0)
    with pytest.raises(ValueError, match="pendulum: max_steps 0: give a whole number from 1"):
        make_env("pendulum", max_steps=0)


@pytest.mark.parametrize("name", ["9" * 400, "~nobody-of-this-name/policy", "a\0b", ""])
def test_a_name_that_no_folder_could_have(name: str) -> None:
    with pytest.raises(ValueError, match=r"oracle '.*: give gpc, gpc-2, .* the folder of a saved policy"):
        make_expert("cartpole", name)


def test_import_loads_no_jax() -> None:
    code = (
        "import sys; from gpcjax.envs.registry import expert_names\n"
        "expert_names('cartpole')\n"
        "assert not {'jax', 'jaxtyping', 'equinox', 'numpy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
