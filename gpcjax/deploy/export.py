"""Files in which a policy acts without gpcjax. Loads no jax for a policy that was saved."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from gpcjax.allowed import OneOf, checked, checked_path, shown
from gpcjax.errors import UserError, unwritten

if TYPE_CHECKING:
    from gpcjax.play.chosen import Chosen


def _python(plain: Any, label: Any) -> bytes:
    from gpcjax.deploy.python_file import python_file

    return python_file(plain, label).encode("ascii")


def _c(plain: Any, label: Any) -> bytes:
    from gpcjax.deploy.c_header import c_header

    return c_header(plain, label).encode("ascii")


def _onnx(plain: Any, label: Any) -> bytes:
    from gpcjax.deploy.onnx_graph import onnx_graph

    return onnx_graph(plain, label)


@dataclass(frozen=True)
class Format:
    """A kind of file: how its name ends, what it is called by (with `name`), and what makes it."""

    suffix: str
    call: str
    make: Callable[[Any, Any], bytes]


FORMATS: Mapping[str, Format] = {
    "python": Format(".py", "action = act(obs)", _python),
    "c": Format(".h", "void {name}_act(const double *obs, double *action)", _c),
    "onnx": Format(".onnx", "obs (batch, {obs_size}) -> action (batch, {action_size})", _onnx),
}
TO = OneOf(tuple(FORMATS))
TO_END = OneOf(tuple(form.suffix for form in FORMATS.values()))
NAMES = "an identifier of Python and C: letters, digits and _, a letter first, 60 at most"


class Exported(NamedTuple):
    """A file that was written."""

    file: Path
    to: str
    name: str
    call: str
    """How it is called."""
    obs_size: int
    action_size: int


def export_policy(policy: Any, out: Any, to: Any = None, name: Any = None) -> Path:
    """Writes a policy into one file that acts without gpcjax, equal to it to 1e-9 (`docs/policies.md`).

    Args:
        policy: what `gpcjax.load_policy` or `learner.policy_of(state)` gave; or, as text or path, a folder: of a saved
            policy or learner, of `gpcjax teach`, or a run folder, of whose runs the best is taken; or `ENV:EXPERT`.
        out: the file; what was there is replaced. Folders above it are made.
        to: "python" (.py), "c" (.h) or "onnx" (.onnx); the end of `out` says it, too.
        name: of the function in C and of the graph in ONNX; without it, after the file.

    Returns:
        The file.

    Raises:
        ValueError: there is no such policy, it is damaged, code of its own or not finite, or nothing can be written at
            `out`.
    """
    return export(chosen_of(policy), out, to, name).file


def chosen_of(policy: Any) -> "Chosen":
    """What `export_policy` takes, with what is known of it. Raises UserError."""
    from gpcjax.play.chosen import Chosen, policy_of
    from gpcjax.policies.policy import Policy

    if isinstance(policy, Policy):
        return Chosen(policy, "this policy", None, 0)
    if not isinstance(policy, str | os.PathLike):
        raise UserError(f"policy {shown(policy)}: give a policy, or the path of one")
    return policy_of(str(checked_path("policy", policy)), None, None, {})


def export(chosen: "Chosen", out: Any, to: Any, name: Any, source: str = "out") -> Exported:
    """Writes the file; see `export_policy`. `source` names what gave `out`, for messages."""
    from gpcjax.deploy.label import identifier, label_of
    from gpcjax.sweep.atomic import write_atomic

    path, to = checked_file(out, to, source)
    name = identifier(path.stem) if name is None else checked_name(name)
    plain = exportable(chosen)
    content = FORMATS[to].make(plain, label_of(plain, name, chosen.env, chosen.provenance))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, content)
    except OSError as error:
        line = f"{path}: it cannot be written there ({error.strerror}), give another path"
        raise unwritten(error, line) from None
    sizes = {"obs_size": plain.obs_size, "action_size": plain.action_size}
    return Exported(path, to, name, FORMATS[to].call.format(name=name, **sizes), **sizes)


def checked_file(out: Any, to: Any, source: str) -> tuple[Path, str]:
    """The path, and the format that it or `to` says.

    Raises:
        UserError: the two disagree, or neither says a format, or a folder is there.
    """
    path = Path(os.path.expanduser(checked_path(source, out)))
    by_suffix = {form.suffix: name for name, form in FORMATS.items()}
    if to is None:
        if path.suffix not in by_suffix:
            raise UserError(f"{source} {path}: give a path that ends in {TO_END}, or a format")
        to = by_suffix[path.suffix]
    to = checked("to", to, str, TO)
    if path.suffix != FORMATS[to].suffix or path.is_dir():
        raise UserError(f"{source} {path}: give a path that ends in {FORMATS[to].suffix}, for {to}")
    return path, to


def checked_name(name: Any) -> str:
    """An identifier as somebody gives it. Raises UserError."""
    from gpcjax.deploy.label import LONGEST_NAME

    fits = isinstance(name, str) and name.isascii() and name.isidentifier() and name[0].isalpha()
    if not fits or len(name) > LONGEST_NAME:
        raise UserError(f"name {shown(name)}: give {NAMES}")
    return name


def exportable(chosen: "Chosen") -> Any:
    """The numbers of a policy, without what it does not use.

    Raises:
        UserError: it has none, as a rule in code, or none that are finite.
    """
    import numpy as np

    from gpcjax.policies.kinds import KINDS
    from gpcjax.policies.policy import Policy

    plain = chosen.act.plain if isinstance(chosen.act, Policy) else None
    if plain is None:
        kinds = "of a Gaussian process, a grid or a network"
        raise UserError(f"{chosen.who}: it cannot be exported, it is code of its own and no policy {kinds}")
    kind = next(kind for kind in KINDS.values() if kind.holds(plain))
    settings, arrays = kind.write(plain)
    if not all(np.isfinite(values).all() for values in arrays.values()):
        raise UserError(f"{chosen.who}: it cannot be exported, its numbers are not all finite")
    return kind.read(settings, arrays)
