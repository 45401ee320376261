"""What the runs of a folder had learned, as policies and as states to go on teaching with."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gpcjax.allowed import checked_path, shown, suggestion
from gpcjax.errors import UserError
from gpcjax.learners.packed import unpack_learner
from gpcjax.policies.saved import Unfit, unpack_policy
from gpcjax.sweep.packing import unpacked
from gpcjax.sweep.reading import read_kept
from gpcjax.sweep.runfolder import check_report


def load_policies(out: Any, /, **where: Any) -> pd.DataFrame:
    """The policies that a sweep kept (`--keep policies`, or those of `--keep states`), a row for each.

    Args:
        out: the run folder.
        **where: columns and the values that are wanted, one or several: `seed=3`, `algo=["gpc", "coach"]`.

    | column | type | what |
    |---|---|---|
    | env, algo, oracle, error, seed | | the run, as in `load` |
    | delta, rate, ... | float | each setting with several values |
    | episode | int | after which it was kept, from 1 |
    | return | float | of that episode, while it was taught |
    | policy | Policy | obs (obs_size,) -> action (action_size,) in [-1, 1] |

    Raises:
        ValueError: `out` is no run folder, nothing was kept there, no column is called so, or what was kept is damaged.
    """
    return _loaded(out, "policy", where, {"policy": lambda made: made})


def load_states(out: Any, /, **where: Any) -> pd.DataFrame:
    """What learners had learned in a sweep (`--keep states`), a row for each: teaching goes on from there.

    As `load_policies`; in the place of `policy` are `learner` and `state`, as `gpcjax.load_learner` gives them. A
    dictionary has room for as many points again as it holds.

    Raises:
        ValueError: as `load_policies`.
    """
    return _loaded(out, "state", where, {"learner": lambda made: made[0], "state": lambda made: made[1]})


def _loaded(
    out: Any, kind: str, where: dict[str, Any], columns: dict[str, Callable[[Any], Any]]
) -> pd.DataFrame:
    folder = checked_path("out", out)
    check_report(folder)
    frame = read_kept(folder)
    wanted: pd.DataFrame = frame if kind == "policy" else frame.loc[frame["kind"] == kind]
    if wanted.empty:
        what = "states" if kind == "state" else "policies"
        raise UserError(
            f"{folder}: no {what} were kept there, give --keep {what} to the sweep that makes them"
        )
    names = [name for name in wanted.columns if name not in ("kind", "card", "arrays")]
    for name, values in where.items():
        if name not in names:
            raise UserError(f"{shown(name)} is no column{suggestion(name, names)}: give {', '.join(names)}")
        several = [values] if isinstance(values, str) or not np.iterable(values) else list(values)
        wanted = wanted.loc[wanted[name].isin(several)]
    found = [
        _row(folder, kind, *entries)
        for entries in zip(
            *(wanted[name] for name in ("kind", "card", "arrays", "algo", "seed")), strict=True
        )
    ]
    made = {
        name: pd.Series([make(each) for each in found], wanted.index, object)
        for name, make in columns.items()
    }
    return wanted.loc[:, names].assign(**made).reset_index(drop=True)


def _row(folder: Path, wanted: str, kind: str, card: str, arrays: bytes, algo: str, seed: int) -> Any:
    """A policy, or a learner and its state."""
    source = f"{folder}: what {algo} learned with seed {seed}"
    try:
        told, named = unpacked(card, arrays)
        if kind == "policy":
            return unpack_policy(told, named)
        learner, state = unpack_learner(told, named, source)
    except (Unfit, KeyError, TypeError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{source} is damaged ({error})") from None
    return (learner, learner.grow(state)) if wanted == "state" else learner.policy_of(state)
