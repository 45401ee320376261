"""A run folder before anything runs: is it one, is it this sweep's, can it be written? Loads no jax."""

import json
import tempfile
from pathlib import Path
from typing import Any

from gpcjax.errors import UserError
from gpcjax.sweep.plan import canonical, specification_hash
from gpcjax.sweep.spec import SweepSpec, as_dict

FORMAT = 2
"""Version of the run folder's layout, kept in the manifest."""

MANIFEST = "manifest.json"
EPISODES = "episodes"
CORRECTIONS = "corrections"

_GIVE = "give a folder that a sweep has made"
_GIVE_NEW = "give a new folder, or the one of the same sweep (--out)"


def read_manifest(out: Path) -> dict[str, Any]:
    """The manifest of the run folder `out`.

    Raises:
        UserError: it cannot be read, or is not one of ours.
    """
    path = out / MANIFEST
    try:
        manifest = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{path}: cannot be read ({_reason(error)}), {_GIVE}") from None
    match manifest:
        case {"format": version, "hash": str(), "specification": dict()}:
            if version == FORMAT:
                return manifest
            raise UserError(f"{path}: format {version!r} is not known, this version reads format {FORMAT}")
    raise UserError(f"{path}: this is no manifest of a sweep, {_GIVE}")


def check_report(out: Path) -> None:
    """Refuse a folder that holds nothing to report.

    Raises:
        UserError: `out` is no run folder, or has no episodes yet.
    """
    if not _exists(out) or not out.is_dir():
        raise UserError(f"{out}: no such folder, {_GIVE}")
    read_manifest(out)
    if not any((out / EPISODES).glob("*.parquet")):
        raise UserError(f"{out}: it holds no episodes yet, {_GIVE}")


def check_sweep(out: Path, spec: SweepSpec) -> None:
    """Refuse a folder that is something else, or another sweep's. Writes nothing.

    Raises:
        UserError: `out` is a file, another specification's, or holds what no sweep has put there.
    """
    if not _exists(out):
        return
    if not out.is_dir():
        raise UserError(f"{out}: this is no folder, {_GIVE_NEW}")
    try:
        foreign = {path.name for path in out.iterdir() if path.name[0] != "."} - {EPISODES, CORRECTIONS}
    except OSError as error:
        raise UserError(f"{out}: cannot be read ({_reason(error)}), {_GIVE_NEW}") from None
    if MANIFEST in foreign:
        manifest = read_manifest(out)
        if manifest["hash"] != specification_hash(spec):
            old, new = manifest["specification"], as_dict(spec)
            names = [name for name in new if canonical(old.get(name)) != canonical(new[name])]
            raise UserError(f"{out}: it holds another specification ({', '.join(names)}), {_GIVE_NEW}")
    elif foreign:
        raise UserError(f"{out}: it holds {min(foreign)!r} and no run, {_GIVE_NEW}")


def make_writable(out: Path) -> None:
    """Make the folder, and a file in it for a moment: permissions alone do not tell whether that works.

    Raises:
        UserError: it does not.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise UserError(f"{out}: nothing can be written there ({_reason(error)}), {_GIVE_NEW}") from None


def _exists(out: Path) -> bool:
    """Whether there is something at `out`, where that can be known."""
    try:
        out.lstat()
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as error:
        raise UserError(f"{out}: no folder can be there ({_reason(error)}), {_GIVE_NEW}") from None
    return True


def _reason(error: BaseException) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
