"""Whether what the learners of a sweep learn can be kept, in this folder. Loads no jax for those that are built in."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gpcjax.errors import UserError
from gpcjax.registry import built_in
from gpcjax.sweep.growth import covering
from gpcjax.sweep.keeping import ENTRY, Keeping, held_keeping, words_of
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.plan import plan
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import SweepSpec


def check_keeping(keeping: Keeping | None, spec: SweepSpec, source: str = "keep") -> None:
    """Refuses to keep what has no form in which it could be kept, before anything is computed.

    Raises:
        UserError: a learner of a person's own has a part that is no array of numbers, or cannot be made.
    """
    others = [name for name in spec.algo if name not in built_in("learner")]
    if keeping is None or not others:
        return
    from gpcjax.learners.recipes import check_recipe
    from gpcjax.sweep.build import recipe_of

    for name in others:
        one_seed = dataclasses.replace(spec, algo=(name,), seeds=Seeds(((0, 0),)))
        check_recipe(recipe_of(plan(one_seed)[0]), source)


def check_kept(out: Path, keeping: Keeping | None, spec: SweepSpec) -> None:
    """Refuses a folder whose runs keep something else. Where none would run, to ask for nothing is no difference.

    Raises:
        UserError: they do, by what the manifest says.
    """
    try:
        manifest = read_manifest(out)
    except UserError:
        return  # there is none, or it is checked and told elsewhere
    if keeping is not None or not manifest["complete"] or covering(manifest, spec) is None:
        refuse_other(out, manifest, keeping)


def refuse_other(out: Path, manifest: Mapping[str, Any], keeping: Keeping | None) -> None:
    """Refuses to run anything that keeps what the runs of a folder do not. Raises UserError."""
    if ENTRY not in manifest or (held := held_keeping(manifest)) == keeping:
        return
    flags = "no --keep" if held is None else " ".join(held.flags)
    raise UserError(
        f"{out}: of its runs it keeps {words_of(held)}, not {words_of(keeping)}: give {flags}, or a new folder (--out)"
    )
