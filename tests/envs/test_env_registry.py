"""Names of tasks and experts."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from gpcjax.envs.cartpole import CartPole
from gpcjax.envs.experts import LQR, EnergySwingUp
from gpcjax.envs.registry import ENVS, default_episodes, env_names, expert_names, make_env, make_expert


@pytest.mark.parametrize("name", env_names())
def test_make_env(name: str) -> None:
    env = make_env(name)
    assert env.name == name
    assert env.reset(jax.random.key(0)).obs.shape == (env.obs_size,)


def test_parameters_reach_the_env() -> None:
    env = make_env("cartpole", pole_mass=0.3, max_steps=7)
    assert isinstance(env, CartPole)
    assert env.pole_mass == 0.3 and env.max_steps == 7 and env.pole_mass.dtype == jnp.float64


@pytest.mark.parametrize(
    ("env_name", "expert", "kind"), [("cartpole", "lqr", LQR), ("pendulum", "energy", EnergySwingUp)]
)
def test_make_expert(env_name: str, expert: str, kind: type) -> None:
    assert isinstance(make_expert(env_name, expert), kind)


def test_names() -> None:
    assert env_names() == ("cartpole", "pendulum")
    assert expert_names("cartpole") == ("gpc", "lqr")
    assert expert_names("pendulum") == ("gpc", "energy")
    assert (default_episodes("cartpole"), default_episodes("pendulum")) == (30, 40)


def test_targets_are_well_formed() -> None:
    for entry in ENVS.values():
        for target, *_ in ((entry.target,), *entry.experts.values()):
            module, attribute = target.split(":")
            assert module.startswith(("gpcjax.envs.", "gpcjax.policies.")) and attribute.isidentifier()


def test_unknown_names() -> None:
    for call in (make_env, expert_names, default_episodes, lambda name: make_expert(name, "lqr")):
        with pytest.raises(ValueError, match="unknown environment 'cartpol'; allowed: cartpole, pendulum"):
            call("cartpol")
    with pytest.raises(ValueError, match="unknown oracle 'energy' for cartpole; allowed: gpc, lqr"):
        make_expert("cartpole", "energy")
    with pytest.raises(
        ValueError, match=r"unknown parameter 'masspole' of cartpole; allowed: gravity, .*pole_mass"
    ):
        make_env("cartpole", masspole=0.1)
    with pytest.raises(ValueError, match="pendulum: max_steps must be at least 1, got 0"):
        make_env("pendulum", max_steps=0)


def test_import_loads_no_jax() -> None:
    code = (
        "import sys; from gpcjax.envs.registry import expert_names\n"
        "expert_names('cartpole')\n"
        "assert not {'jax', 'jaxtyping', 'equinox', 'numpy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_tasks_load_neither_brax_nor_gymnasium() -> None:
    code = (
        "import sys; from gpcjax.envs.registry import make_env, make_expert; import gpcjax.envs.brax_adapter\n"
        "make_env('cartpole'), make_expert('cartpole', 'lqr'), make_env('pendulum')\n"
        "assert not {'brax', 'gymnasium', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
