"""Trains a policy with brax's own PPO, in a process of its own.

    python -m gpcjax.envs.brax_training TASK FILE SEED SETTINGS

brax trains in float32, and what computes in gpcjax switches its process to float64: so nothing of that is imported
here. What was learned is written to FILE, as numpy arrays; a line of JSON on standard output tells how far it is.
"""

import contextlib
import functools
import io
import json
import sys
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

HIDDEN = (32, 32)
"""Units of each layer of the policy."""

DEFAULTS: Mapping[str, Any] = {
    "num_timesteps": 3_000_000,
    "episode_length": 1000,
    "num_envs": 256,
    "unroll_length": 20,
    "batch_size": 256,
    "num_minibatches": 8,
    "num_updates_per_batch": 8,
    "discounting": 0.97,
    "learning_rate": 3e-4,
    "entropy_cost": 1e-3,
    "reward_scaling": 1.0,
    "normalize_observations": True,
    "num_evals": 6,
    "num_eval_envs": 64,
}
"""Arguments of `brax.training.agents.ppo.train.train`, where a task has no others."""


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Without what brax and mujoco say when they are imported: that parts nobody asked for are missing, or are old."""
    said = io.StringIO()
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(said):
            warnings.filterwarnings("ignore", message="Brax System")
            yield
    finally:
        for line in said.getvalue().splitlines():
            if not line.startswith("Failed to import "):
                print(line)


def train(task: str, seed: int, settings: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The parameters of a trained policy: `mean` and `deviation` of observations, and `kernel_i`, `bias_i`.

    Its action is tanh of the first half of what the last layer gives, with tanh between layers. Training may ruin what
    it had reached, so it is the policy of the best of the evaluations on the way; of equal ones the last.
    """
    with quiet():
        import brax.envs
        import jax
        import jax.numpy as jnp
        from brax.training.agents.ppo import networks
        from brax.training.agents.ppo import train as ppo
        from flax import linen

        env = brax.envs.get_environment(task)
    jax.config.update("jax_enable_x64", False)
    if not hasattr(jax, "device_put_replicated"):
        # brax 0.14.2 calls it, jax 0.10 no longer has it. On one device it is one more axis.
        jax.device_put_replicated = lambda tree, devices: jax.tree.map(  # pyright: ignore
            lambda leaf: jnp.stack([leaf] * len(devices)), tree
        )
    factory = functools.partial(
        networks.make_ppo_networks,
        policy_hidden_layer_sizes=HIDDEN,
        value_hidden_layer_sizes=(64, 64),
        activation=linen.tanh,
    )

    present: dict[int, dict[str, np.ndarray]] = {}
    best: tuple[float, dict[str, np.ndarray]] = (-np.inf, {})

    def note(steps: int, make: Any, params: Any) -> None:
        present.clear()
        present[steps] = arrays_of(params[0], params[1])

    def progress(steps: int, metrics: Mapping[str, Any]) -> None:
        nonlocal best
        reached = float(metrics["eval/episode_reward"])
        if steps in present and reached >= best[0]:
            best = reached, present[steps]
        print(json.dumps({"steps": int(steps), "return": reached}), flush=True)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ppo.train(
            environment=env,
            seed=seed,
            network_factory=factory,
            progress_fn=progress,
            policy_params_fn=note,
            **settings,
        )
    return best[1]


def arrays_of(normaliser: Any, policy: Any) -> dict[str, np.ndarray]:
    """The parameters of brax's policy by name, in float32 as they are."""
    layers = policy["params"]
    named = {"mean": normaliser.mean, "deviation": normaliser.std}
    for index in range(len(layers)):
        layer = layers[f"hidden_{index}"]
        named |= {f"kernel_{index}": layer["kernel"], f"bias_{index}": layer["bias"]}
    return {name: np.asarray(value) for name, value in named.items()}


if __name__ == "__main__":
    _, name, file, number, text = sys.argv
    np.savez(file, allow_pickle=False, **train(name, int(number), json.loads(text)))
