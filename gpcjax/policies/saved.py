"""Policies on disk: a folder with the arrays of a controller and a card that says what they are.

See `gpcjax.policies.folder` for the files; the card holds

format          of the folder; 2 for what this version writes, 1 is read too
kind            of the controller, one of `KINDS`, and what that kind needs beside its arrays
obs_size, action_size
arrays          the shape of each array
provenance      where the policy comes from
"""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from gpcjax.errors import UserError
from gpcjax.policies.checkpoint import Shapes
from gpcjax.policies.folder import CARD, FORMAT, FORMATS, read_arrays, read_card, write_folder
from gpcjax.policies.kinds import KINDS, Arrays, Kind, Settings
from gpcjax.policies.kinds import Unfit as Unfit
from gpcjax.policies.policy import Controller, Policy
from gpcjax.registry import resolve


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
    from gpcjax.policies.counterparts import has_counterpart

    return has_counterpart(controller)


def pack_controller(controller: Controller) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a folder keeps of a controller without lanes, for whoever keeps it elsewhere.

    That is a card of JSON values, and named float64 arrays of at least one entry each.

    Raises:
        ValueError: the controller is not finite, or has lanes.
        TypeError: there is no format for such a controller.
    """
    from gpcjax.policies.counterparts import in_numpy  # loads jax, which whoever has a controller has

    plain = in_numpy(controller)
    if plain is None:
        raise TypeError(f"no format for a {type(controller).__name__}")
    name = next(name for name, kind in KINDS.items() if kind.holds(plain))
    settings, arrays = KINDS[name].write(plain)
    sizes = {"obs_size": plain.obs_size, "action_size": plain.action_size}
    card = {"kind": name, **settings, **sizes}
    try:
        _check(KINDS[name], card, {key: value.shape for key, value in arrays.items()}, arrays)
    except Unfit as error:
        raise UserError(f"this policy cannot be saved: {error}") from None
    return {"format": FORMAT, **card}, arrays


def load_policy(path: Any) -> Policy:
    """The policy saved at `path`, a function obs (obs_size,) -> action (action_size,) in [-1, 1].

    It may be called directly, which loads no jax (see `Policy`), or inside jit and vmap. That of a person's own
    learner needs jax, and that learner's module.

    Args:
        path: the folder that `save_policy` wrote.

    Raises:
        ValueError: there is no policy at `path`, one of another format, or one that is damaged; the message names the
            file.
    """
    card = read_card(path, "policy")
    if card.get("kind") == "learner" and "recipe" in card:  # of `gpcjax.learners.recipes`
        learner, state = resolve("gpcjax.learners.saved:load_learner")(path)
        return learner.policy_of(state)
    card = load_card(path)
    try:
        return unpack_policy(card, read_arrays(path, card, "policy"))
    except Unfit as error:
        raise UserError(f"{Path(path)}: this policy is damaged ({error})") from None


def unpack_policy(card: Settings, arrays: Arrays) -> Policy:
    """The policy that was packed (`pack_controller`).

    Raises:
        Unfit: card and arrays make none.
    """
    kind = card.get("kind")
    if card.get("format") not in FORMATS or not isinstance(kind, str) or kind not in KINDS:
        raise Unfit(f"format {FORMAT} and as kind {' or '.join(KINDS)} are needed")
    _check(KINDS[kind], card, {name: value.shape for name, value in arrays.items()}, arrays)
    return Policy.of(KINDS[kind].read(card, arrays))


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
