"""What a lesson may begin with: a learner that was saved, or what a run of a sweep had learned. Loads no jax."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.errors import UserError
from gpcjax.lateness import CREDIT
from gpcjax.registry import find
from gpcjax.sweep.kept import differences, kept_rows, narrowed, newest
from gpcjax.sweep.layout import tell
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.packing import unpacked
from gpcjax.sweep.sources import RELATIVES
from gpcjax.teach.made_with import made_with


class Run(NamedTuple):
    """A run with a kept state."""

    folder: Path
    """The run folder."""
    env: str
    algo: str
    """Who is to go on; the state may be of a relative."""
    seed: int
    row: Mapping[str, Any]
    """As `gpcjax.sweep.kept.kept_rows` has it."""
    settings: Mapping[str, Any] | None = None
    """As of a saved learner (`gpcjax.teach.saved.Saved`)."""


Origin = Path | Run
"""The folder of a saved learner, or a run."""


def of_run(
    folder: Path, algo: str | None, seed: int | None, where: Mapping[str, str], env: str | None = None
) -> Run:
    """The one run that a person means: its newest state counts.

    Args:
        folder: a run folder.
        algo: who is to go on, if that was said; a relative's state will do where there is none of its own.
        seed: of the run, likewise.
        where: columns of the run folder, and the value that the run has there.
        env: what is to be taught, if that was said.

    Raises:
        UserError: there is none, or there are several, or it is damaged, or has a setting that no lesson has.
    """
    place = f"--from {folder}"
    asked = {**where, **({} if seed is None else {"seed": str(seed)})}
    left = narrowed(newest(kept_rows(folder, "state", {}, tell)), asked, place)
    if algo is not None:
        held = set(left["algo"])
        fitting = next((name for name in (algo, *RELATIVES.get(algo, ())) if name in held), None)
        if fitting is None:
            raise UserError(
                f"{place}: it holds what {', '.join(sorted(held))} learned, which means nothing to {algo}: leave "
                "--algo out, or give another folder"
            )
        left = left.loc[left["algo"] == fitting]
    if len(left) > 1:
        raise UserError(
            f"{place}: {len(left):,} runs of it may be meant, which differ in {differences(left)}: say which "
            "(--seed, --where NAME=VALUE)"
        )
    (row,) = left.to_dict("records")
    specification = read_manifest(folder)["specification"]
    learned, settings = specification["env"], None
    if algo in (None, row["algo"]) and env in (None, learned):
        try:
            card, arrays = unpacked(row["card"], row["arrays"])
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise UserError(
                f"{place}: what {row['algo']} learned with seed {row['seed']} is damaged ({error})"
            ) from None
        credit = {name: _credit(name, row, specification) for name in CREDIT}
        settings = made_with(place, find("learner", row["algo"]), learned, card, arrays, credit)
    return Run(folder, learned, algo or row["algo"], int(row["seed"]), row, settings)


def _credit(name: str, row: Mapping[str, Any], specification: Mapping[str, Any]) -> float | None:
    """A setting of credit of this run: the column of it where runs differ, or else the one that all have."""
    values = specification.get("hyperparameters", {}).get(name, [None])
    value = row[name] if name in row else values[0]
    return None if value is None or value != value else value
