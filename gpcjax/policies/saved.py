"""Policies on disk: a folder with the arrays of a controller and a card that says what they are.

See `gpcjax.policies.folder` for the files; the card holds

format          of the folder; 2 for what this version writes, 1 is read too
kind            of the controller, one of `KINDS`, and what that kind needs beside its arrays
obs_size, action_size
arrays          the shape of each array
provenance      where the policy comes from
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from gpcjax._x64 import under_own_settings
from gpcjax.errors import UserError
from gpcjax.gp.kernels import SMOOTHNESSES, SQUARED_EXPONENTIAL
from gpcjax.policies.base import Controller, Policy
from gpcjax.policies.folder import CARD, FORMAT, FORMATS, Shapes, read_arrays, read_card, write_folder
from gpcjax.policies.grid import Grid, GridController
from gpcjax.policies.kernel import KernelController
from gpcjax.policies.network import NetworkController, SquashedNetwork

MOST_LAYERS = 64
"""Of a network: what is more is no card of ours."""

Arrays = Mapping[str, np.ndarray]
Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Kind:
    """How controllers of one type are kept.

    Fields:
        type: of the controllers.
        write: a controller without lanes -> what its card says beside the arrays (JSON values), and the arrays.
        shapes: what the card says, obs_size, action_size, and the shapes it names -> the shapes there must be. What the
            sizes do not settle, such as the number of points, comes from those it names. Raises `Unfit`.
        read: what the card says, and the arrays (finite float64, of those shapes) -> the controller. Raises `Unfit`.
    """

    type: type[Controller]
    write: Callable[[Any], tuple[dict[str, Any], dict[str, np.ndarray]]]
    shapes: Callable[[Settings, int, int, Shapes], Shapes]
    read: Callable[[Settings, Arrays], Controller]


class Unfit(Exception):
    """What a card or its arrays say makes no controller; the message says why."""


@under_own_settings
def save_controller(path: Any, controller: Controller, provenance: Mapping[str, Any]) -> None:
    """Writes a controller without lanes; `provenance` (JSON values, or numpy's numbers) goes into the card.

    Raises:
        FileExistsError: there is something at `path`.
        ValueError: the controller is not finite, it has lanes, or provenance has no form in JSON.
        TypeError: there is no format for such a controller, or JSON knows no such value.
    """
    card, arrays = pack_controller(controller)
    write_folder(path, {**card, "provenance": dict(provenance)}, arrays)


def has_format(controller: Controller) -> bool:
    """Whether `pack_controller` takes controllers of this type."""
    return any(type(controller) is kind.type for kind in KINDS.values())


@under_own_settings
def pack_controller(controller: Controller) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a folder keeps of a controller without lanes, for whoever keeps it elsewhere.

    That is a card of JSON values, and named float64 arrays of at least one entry each.

    Raises:
        ValueError: the controller is not finite, or has lanes.
        TypeError: there is no format for such a controller.
    """
    name = next((name for name, kind in KINDS.items() if type(controller) is kind.type), None)
    if name is None:
        raise TypeError(f"no format for a {type(controller).__name__}")
    settings, arrays = KINDS[name].write(controller)
    sizes = {"obs_size": controller.obs_size, "action_size": controller.action_size}
    card = {"kind": name, **settings, **sizes}
    try:
        _check(KINDS[name], card, {key: value.shape for key, value in arrays.items()}, arrays)
    except Unfit as error:
        raise UserError(f"this policy cannot be saved: {error}") from None
    return {"format": FORMAT, **card}, arrays


@under_own_settings
def load_policy(path: Any) -> Policy:
    """The policy saved at `path`, a function obs (obs_size,) -> action (action_size,) in [-1, 1].

    It may be called directly, or inside jit and vmap.

    Raises:
        ValueError: there is no policy at `path`, one of another format, or one that is damaged; the message names the
            file.
    """
    card = load_card(path)
    try:
        return unpack_policy(card, read_arrays(path, card, "policy"))
    except Unfit as error:
        raise UserError(f"{Path(path)}: this policy is damaged ({error})") from None


@under_own_settings
def unpack_policy(card: Settings, arrays: Arrays) -> Policy:
    """The policy that was packed (`pack_controller`).

    Raises:
        Unfit: card and arrays make none.
    """
    kind = card.get("kind")
    if card.get("format") not in FORMATS or not isinstance(kind, str) or kind not in KINDS:
        raise Unfit(f"format {FORMAT} and as kind {' or '.join(KINDS)} are needed")
    _check(KINDS[kind], card, {name: value.shape for name, value in arrays.items()}, arrays)
    return Policy(KINDS[kind].read(card, arrays))


def load_card(path: Any) -> dict[str, Any]:
    """What the policy at `path` is and where it comes from, checked. Raises ValueError as `load_policy` does."""
    card = read_card(path, "policy")
    file, kind = Path(path) / CARD, card.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise UserError(f"{file}: this is not a policy's card (it needs as kind {' or '.join(KINDS)})")
    if not isinstance(card.get("provenance", {}), dict):
        raise UserError(f"{file}: this is not a policy's card (its provenance is no table)")
    try:
        _check(KINDS[kind], card, {name: tuple(shape) for name, shape in card["arrays"].items()})
    except Unfit as error:
        raise UserError(f"{file}: this is not a policy's card ({error})") from None
    return card


def _check(kind: Kind, card: Settings, shapes: Shapes, arrays: Arrays | None = None) -> None:
    """Whether card, shapes and arrays fit together. Raises `Unfit`."""
    # Format 1 names the sizes in its provenance, or nowhere: there the arrays alone say what they are.
    told = card if card.get("format") != 1 else card.get("provenance", {})
    sizes = {}
    for name in ("obs_size", "action_size"):
        sizes[name] = told.get(name) if told is card or name in told else _size_of(shapes, name)
        if type(sizes[name]) is not int or sizes[name] < 1:
            raise Unfit(f"{name} {str(sizes[name])[:20]}: a whole number of at least 1 is needed")
    expected = kind.shapes(card, sizes["obs_size"], sizes["action_size"], shapes)
    if dict(expected) != dict(shapes):
        raise Unfit(f"arrays of shapes {dict(expected)} are needed, not {dict(shapes)}"[:300])
    for name, value in (arrays or {}).items():
        if value.dtype != np.float64 or not np.isfinite(value).all():
            raise Unfit(f"{name} holds other than finite numbers of float64")


def _size_of(shapes: Shapes, name: str) -> int:
    """A size as an old card's arrays have it; the kinds of that time are `kernel` and `grid`."""
    first, place = ("scale", 1) if "scale" in shapes else ("lower", 0)
    if name == "action_size":
        first, place = "weights", 0
    shape = shapes.get(first, ())
    return shape[place] if len(shape) > place else 0


def shipped_path(name: str) -> Path:
    """Where a shipped oracle is kept inside the package.

    A `gpc` oracle goes by the name of its task, further ones with -2, -3; a `network` with -network.
    """
    return Path(str(resources.files("gpcjax.policies") / "shipped" / name))


def load_shipped(name: str) -> Policy:
    """An oracle that was learned: by GPC itself or, a network, by reinforcement. See its card (`make oracles`)."""
    return load_policy(shipped_path(name))


def _write_kernel(controller: KernelController) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    used = np.asarray(controller.weights != 0).any(0)
    kept = max(1, int(np.flatnonzero(used).max(initial=0)) + 1)
    arrays = {
        "points": np.asarray(controller.points)[:, :kept],
        "weights": np.asarray(controller.weights)[:, :kept],
        "scale": np.asarray(controller.scale),
    }
    smooth = "infinity" if controller.smoothness == SQUARED_EXPONENTIAL else controller.smoothness
    return {"smoothness": smooth}, arrays


def _kernel_shapes(settings: Settings, obs_size: int, action_size: int, named: Shapes) -> Shapes:
    points = named.get("weights", ())[1:2] or (0,)
    if points[0] < 1:
        raise Unfit("weights for at least one point are needed")
    _smoothness(settings)
    return {
        "points": (action_size, *points, obs_size),
        "weights": (action_size, *points),
        "scale": (action_size, obs_size),
    }


def _read_kernel(settings: Settings, arrays: Arrays) -> Controller:
    return KernelController(**_on_device(arrays), smoothness=_smoothness(settings))


def _smoothness(settings: Settings) -> float:
    """JSON has no infinity: the squared exponential's is a word. Format 1 wrote what json made of it."""
    given = settings.get("smoothness")
    value = SQUARED_EXPONENTIAL if given == "infinity" else given
    if type(value) is not float or value not in SMOOTHNESSES:
        raise Unfit(f'smoothness {str(given)[:20]}: 0.5, 1.5, 2.5 or "infinity" is needed')
    return value


def _write_grid(controller: GridController) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    grid = controller.grid
    arrays = {
        "weights": np.asarray(controller.weights),
        "lower": np.asarray(grid.lower),
        "upper": np.asarray(grid.upper),
    }
    return {"counts": list(grid.counts)}, arrays


def _grid_shapes(settings: Settings, obs_size: int, action_size: int, named: Shapes) -> Shapes:
    counts = settings.get("counts")
    if not isinstance(counts, list) or not all(type(count) is int and count >= 2 for count in counts):
        raise Unfit("counts: a list of whole numbers of at least 2 is needed")
    if len(counts) != obs_size:
        raise Unfit(f"{len(counts)} counts for obs_size {obs_size}")
    return {"weights": (action_size, *counts), "lower": (obs_size,), "upper": (obs_size,)}


def _read_grid(settings: Settings, arrays: Arrays) -> Controller:
    if not (arrays["lower"] < arrays["upper"]).all():
        raise Unfit("lower must be below upper")
    values = _on_device(arrays)
    grid = Grid(lower=values["lower"], upper=values["upper"], counts=tuple(settings["counts"]))
    return GridController(weights=values["weights"], grid=grid)


def _write_network(controller: NetworkController) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    layers = enumerate(zip(controller.weights, controller.biases, strict=True), 1)
    arrays = {
        f"{name}_{layer}": np.asarray(value)
        for layer, pair in layers
        for name, value in zip(("weights", "biases"), pair, strict=True)
    }
    return {"layers": len(controller.weights)}, arrays


def _network_shapes(settings: Settings, obs_size: int, action_size: int, named: Shapes) -> Shapes:
    layers = settings.get("layers")
    if type(layers) is not int or not 1 <= layers <= MOST_LAYERS:
        raise Unfit(f"layers {str(layers)[:20]}: a whole number from 1 to {MOST_LAYERS} is needed")
    widths = [(*named.get(f"biases_{layer}", ()), 0)[0] for layer in range(1, layers)]
    if min(widths, default=1) < 1:
        raise Unfit("biases for at least one unit in each layer are needed")
    sizes = [obs_size, *widths, action_size]
    return {
        name: shape
        for layer, (inputs, outputs) in enumerate(itertools.pairwise(sizes), 1)
        for name, shape in ((f"weights_{layer}", (outputs, inputs)), (f"biases_{layer}", (outputs,)))
    }


def _read_network(settings: Settings, arrays: Arrays) -> NetworkController:
    values, layers = _on_device(arrays), range(1, settings["layers"] + 1)
    return NetworkController(
        weights=tuple(values[f"weights_{layer}"] for layer in layers),
        biases=tuple(values[f"biases_{layer}"] for layer in layers),
    )


def _on_device(arrays: Arrays) -> dict[str, Any]:
    return {name: jnp.asarray(value) for name, value in arrays.items()}


KINDS: Mapping[str, Kind] = {
    "kernel": Kind(KernelController, _write_kernel, _kernel_shapes, _read_kernel),
    "grid": Kind(GridController, _write_grid, _grid_shapes, _read_grid),
    "network": Kind(NetworkController, _write_network, _network_shapes, _read_network),
    "squashed-network": Kind(
        SquashedNetwork,
        lambda controller: _write_network(controller.network),
        _network_shapes,
        lambda settings, arrays: SquashedNetwork(_read_network(settings, arrays)),
    ),
}
"""By the name in the card."""
