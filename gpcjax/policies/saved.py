"""Policies on disk: a folder with an orbax checkpoint of the arrays and a JSON card that says what they are.

policy/card.json     kind, sizes, and where the policy comes from
policy/arrays/       the checkpoint
"""

import json
import os
import shutil
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gpcjax._x64 import under_own_settings
from gpcjax.policies.base import Controller, Policy
from gpcjax.policies.grid import Grid, GridController
from gpcjax.policies.kernel import KernelController
from gpcjax.policies.network import NetworkController

FORMAT = 1
_KINDS = ("kernel", "grid", "network")


@under_own_settings
def save_controller(path: str | os.PathLike[str], controller: Controller, provenance: dict[str, Any]) -> None:
    """Writes a controller without lanes; `provenance` (JSON values) goes into the card.

    Raises:
        FileExistsError: there is something at `path`.
    """
    path = Path(path)
    if path.exists():
        raise FileExistsError(f"{path} exists: choose another path, or remove it first")
    settings, arrays = _parts(controller)
    card = {
        "format": FORMAT,
        **settings,
        "arrays": {name: list(value.shape) for name, value in arrays.items()},
        "provenance": provenance,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    try:
        with _checkpointer() as checkpointer:
            checkpointer.save((scratch / "arrays").absolute(), arrays)
        (scratch / "card.json").write_text(json.dumps(card, indent=2) + "\n")
        scratch.chmod(0o755)
        os.replace(scratch, path)
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise


@under_own_settings
def load_policy(path: str | os.PathLike[str]) -> Policy:
    """The policy saved at `path`, a function obs (obs_size,) -> action (action_size,) in [-1, 1].

    It may be called directly, or inside jit and vmap.

    Raises:
        ValueError: there is no policy at `path`, or one of another format.
    """
    path = Path(path)
    card = load_card(path)
    shapes = {name: np.zeros(shape) for name, shape in card["arrays"].items()}
    try:
        with _checkpointer() as checkpointer:
            arrays = checkpointer.restore((path / "arrays").absolute(), shapes)
    except (OSError, ValueError, KeyError) as error:
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise ValueError(f"{path / 'arrays'}: the arrays of this policy cannot be read ({reason})") from None
    return Policy(_controller(card, {name: jnp.asarray(value) for name, value in arrays.items()}))


def load_card(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What the policy at `path` is and where it comes from. Raises ValueError as `load_policy` does."""
    file = Path(path) / "card.json"
    try:
        card = json.loads(file.read_text())
        version = card["format"]
    except FileNotFoundError:
        raise ValueError(f"{path}: no policy here (card.json is missing)") from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{file}: this is not a policy's card ({error})") from None
    if version != FORMAT:
        raise ValueError(f"{file}: format {version!r} is not known, this version reads {FORMAT}")
    if card.get("kind") not in _KINDS or not isinstance(card.get("arrays"), dict):
        raise ValueError(
            f"{file}: this is not a policy's card (it needs arrays, and as kind {' or '.join(_KINDS)})"
        )
    return card


def shipped_path(name: str) -> Path:
    """Where a shipped oracle is kept inside the package.

    A `gpc` oracle goes by the name of its task, further ones with -2, -3; a `network` with -network.
    """
    return Path(str(resources.files("gpcjax.policies") / "shipped" / name))


def load_shipped(name: str) -> Policy:
    """An oracle that was learned: by GPC itself or, a network, by reinforcement. See its card (`make oracles`)."""
    return load_policy(shipped_path(name))


def _parts(controller: Controller) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    if isinstance(controller, KernelController):
        used = np.asarray(controller.weights != 0).any(0)
        kept = max(1, int(np.flatnonzero(used).max(initial=0)) + 1)
        arrays = {
            "points": np.asarray(controller.points)[:, :kept],
            "weights": np.asarray(controller.weights)[:, :kept],
            "scale": np.asarray(controller.scale),
        }
        return {"kind": "kernel", "smoothness": controller.smoothness}, arrays
    if isinstance(controller, GridController):
        arrays = {
            "weights": np.asarray(controller.weights),
            "lower": np.asarray(controller.grid.lower),
            "upper": np.asarray(controller.grid.upper),
        }
        return {"kind": "grid", "counts": list(controller.grid.counts)}, arrays
    if isinstance(controller, NetworkController):
        layers = enumerate(zip(controller.weights, controller.biases, strict=True), 1)
        arrays = {
            f"{name}_{layer}": np.asarray(value)
            for layer, pair in layers
            for name, value in zip(("weights", "biases"), pair, strict=True)
        }
        return {"kind": "network", "layers": len(controller.weights)}, arrays
    raise TypeError(f"no format for a {type(controller).__name__}")


def _controller(card: dict[str, Any], arrays: dict[str, jax.Array]) -> Controller:
    if card["kind"] == "kernel":
        return KernelController(**arrays, smoothness=card["smoothness"])
    if card["kind"] == "network":
        weights, biases = (
            tuple(arrays[f"{name}_{layer}"] for layer in range(1, card["layers"] + 1))
            for name in ("weights", "biases")
        )
        return NetworkController(weights=weights, biases=biases)
    grid = Grid(lower=arrays["lower"], upper=arrays["upper"], counts=tuple(card["counts"]))
    return GridController(weights=arrays["weights"], grid=grid)


def _checkpointer() -> Any:
    import orbax.checkpoint  # costs more than everything else here: only where a policy is read or written

    return orbax.checkpoint.StandardCheckpointer()
