"""Experts for tasks of brax, trained by brax's own PPO: `make oracles ENV=brax:NAME`."""

import importlib.metadata
import json
import math
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from gpcjax.engine.evaluate import evaluate
from gpcjax.envs.brax_training import DEFAULTS
from gpcjax.envs.registry import make_env
from gpcjax.policies.base import Policy
from gpcjax.policies.network import NetworkController
from gpcjax.sweep.environment import python

STARTS = 100

SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "inverted_pendulum": {
        # Updates after few steps: with four times as many it reached 15 of 1,000 after 205,000 steps, so 175.
        "num_timesteps": 2_000_000,
        "unroll_length": 5,
        "num_updates_per_batch": 4,
        "learning_rate": 1e-3,
        "reward_scaling": 10.0,
        "num_evals": 11,
    },
    "reacher": {
        "num_timesteps": 3_000_000,
        "episode_length": 50,
        "unroll_length": 10,
        "discounting": 0.95,
        "learning_rate": 6e-4,
        "reward_scaling": 5.0,
        "num_evals": 9,
    },
}
"""How the training of a task differs from `DEFAULTS`."""


def trained(name: str, seed: int = 0) -> tuple[NetworkController, dict[str, Any]]:
    """A network for brax's task of this name, and its card: trained in a process of its own, with its progress printed.

    Raises:
        RuntimeError: the training failed; its last lines are in the message.
    """
    settings = {**DEFAULTS, **SETTINGS.get(name, {})}
    reached: dict[str, Any] = {"steps": 0, "return": -math.inf}
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "policy.npz"
        command = [*python("gpcjax.envs.brax_training"), name, str(file), str(seed), json.dumps(settings)]
        with open(Path(scratch) / "stderr", "w+") as errors:
            running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
            try:
                assert running.stdout is not None
                for line in filter(lambda line: line.startswith("{"), running.stdout):
                    seen = json.loads(line)
                    print(f"brax:{name}: {seen['steps']:,} steps, return {seen['return']:.1f}", flush=True)
                    if seen["return"] >= reached["return"]:
                        reached = seen
                status = running.wait()
            finally:  # it does not outlive this process
                running.kill()
                running.wait()
            if not file.exists():
                errors.seek(0)
                raise RuntimeError(f"brax:{name}: the training failed ({status}): {errors.read()[-2000:]}")
        with np.load(file) as arrays:
            controller = network_of(dict(arrays))
    returns = np.asarray(evaluate(make_env(f"brax:{name}"), Policy(controller), STARTS).returns)
    return controller, {
        "env": f"brax:{name}",
        "learner": "ppo of brax",
        "brax": importlib.metadata.version("brax"),
        "seed": seed,
        "steps": reached["steps"],
        "training": settings,
        "starts": STARTS,
        "return_mean": float(returns.mean()),
        "return_std": float(returns.std(ddof=1)),
    }


def network_of(arrays: Mapping[str, np.ndarray]) -> NetworkController:
    """What brax's policy does without its noise: `gpcjax.envs.brax_training.train` says what its arrays mean."""
    arrays = {name: np.asarray(value, np.float64) for name, value in arrays.items()}
    count = sum(name.startswith("kernel_") for name in arrays)
    weights = [arrays[f"kernel_{index}"].T for index in range(count)]
    biases = [arrays[f"bias_{index}"] for index in range(count)]
    first = weights[0] / arrays["deviation"][None]
    biases[0] = biases[0] - first @ arrays["mean"]
    # The last layer gives means and deviations; tanh of the means is the action, so one more layer hands it on.
    size = len(biases[-1]) // 2
    weights = [first, *weights[1:-1], weights[-1][:size], np.eye(size)]
    biases = [*biases[:-1], biases[-1][:size], np.zeros(size)]
    return NetworkController(weights=tuple(map(jnp.asarray, weights)), biases=tuple(map(jnp.asarray, biases)))
