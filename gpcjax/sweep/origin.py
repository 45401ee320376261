"""What rows of a folder come from: the versions that made them, and the machines. Loads no jax."""

from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any

from gpcjax.errors import UserError
from gpcjax.sweep import machine
from gpcjax.sweep.layout import tell
from gpcjax.sweep.versions import versions


def refuse_other_versions(out: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse a folder that was begun with other versions of what computes. Raises UserError."""
    for name, version in versions().items():
        before = manifest["versions"].get(name)
        if before != version:
            raise UserError(
                f"{out}: it was begun with {name} {before}, this is {version}: give a new folder (--out)"
            )


def note_machine(out: Path, manifest: dict[str, Any], here: Mapping[str, Any]) -> None:
    """Adds this machine to a manifest that was begun on one of another kind, and says that bits may differ."""
    kind = machine.kind_of(here)
    known = [manifest["machine"], *manifest.get("further_machines", [])]
    if kind in map(machine.kind_of, known):
        return
    manifest["further_machines"] = [*known[1:], here]
    before = known[0]
    if machine.kind_of(before):  # an old manifest does not say enough to tell
        names = ", ".join(machine.differences(before, here))
        tell(f"{out}: begun on another kind of machine ({names}): last bits may differ, see its manifest")


def forget_idle_machines(manifest: dict[str, Any], with_rows: Container[str]) -> None:
    """Leaves those machines in the manifest that have computed rows: who hands out cells need not compute any."""
    known = [manifest["machine"], *manifest.get("further_machines", [])]
    kinds = [machine.kind_of(each) for each in known]
    used = [each for each, kind in zip(known, kinds, strict=True) if not kind or kind in with_rows] or known[
        :1
    ]
    manifest["machine"] = used[0]
    manifest.pop("further_machines", None)
    if used[1:]:
        manifest["further_machines"] = used[1:]
