"""Which of the runs of a folder is meant, of those whose policy or state was kept. Loads no jax."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from gpcjax.allowed import shown, suggestion
from gpcjax.errors import UserError
from gpcjax.sweep.layout import Say, warn
from gpcjax.sweep.reading import read_kept

Kind = Literal["policy", "state"]
"""What of a run is wanted."""

PACKED = ("kind", "card", "arrays")
"""Columns of what was kept, as it is kept; `gpcjax.sweep.learned` makes a policy or a learner of them."""

_MOST_SHOWN = 6


def kept_rows(folder: Path, kind: Kind, where: Mapping[str, Any], say: Say = warn) -> pd.DataFrame:
    """What was kept in a run folder of the runs that `where` names, a row for each, in the order of `load`.

    Args:
        folder: the run folder.
        kind: what is wanted; a state is a policy, too.
        where: columns, and the values that are wanted, one or several.
        say: takes a line for what is damaged; a command tells it, a Python call warns.

    Raises:
        UserError: nothing was kept there, or no column is called so.
    """
    frame = read_kept(folder, say)
    if len(frame) and kind == "state":
        frame = frame.loc[frame["kind"] == kind]
    if frame.empty:
        what = "states" if kind == "state" else "policies"
        raise UserError(
            f"{folder}: no {what} were kept there, give --keep {what} to the sweep that makes them"
        )
    names = [name for name in frame.columns if name not in PACKED]
    for name, values in where.items():
        if name not in names:
            raise UserError(f"{shown(name)} is no column{suggestion(name, names)}: give {', '.join(names)}")
        several = [values] if isinstance(values, str) or not np.iterable(values) else list(values)
        frame = frame.loc[frame[name].isin(several)]
    return frame


def newest(kept: pd.DataFrame) -> pd.DataFrame:
    """Of the rows of `kept_rows`, the last one of each run."""
    return kept.groupby(_telling(kept), sort=False, dropna=False).tail(1)


def narrowed(kept: pd.DataFrame, conditions: Mapping[str, str], place: str) -> pd.DataFrame:
    """Of the rows of `newest`, those of the runs that have these values, as a person writes them.

    Raises:
        UserError: there is no such column, or no such run; `place` begins the message.
    """
    for name, text in conditions.items():
        names = _telling(kept)
        if name not in names:
            raise UserError(f"{place}: {shown(name)} is no column of its runs, give {', '.join(names)}")
        wanted: Any = text
        if pd.api.types.is_numeric_dtype(kept[name]):
            try:
                wanted = float(text)
            except ValueError:
                wanted = None  # which equals no number
        chosen = kept.loc[kept[name] == wanted]
        if chosen.empty:
            raise UserError(
                f"{place}: no run with {name} {text} was kept, give {_listed(kept[name].tolist())}"
            )
        kept = chosen
    return kept


def differences(kept: pd.DataFrame) -> str:
    """What tells several runs apart, with the values: "seed (0, 1, 2), error (0.0, 0.1)"."""
    values = {name: _listed(kept[name].tolist()) for name in _telling(kept)}
    return ", ".join(f"{name} ({told})" for name, told in values.items() if "," in told)


def _telling(kept: pd.DataFrame) -> list[str]:
    """The columns that tell runs apart."""
    return [name for name in kept.columns if name not in ("episode", "return", *PACKED)]


def _listed(column: Iterable[object]) -> str:
    values = list(dict.fromkeys(map(str, column)))
    some = values if len(values) <= _MOST_SHOWN else [*values[: _MOST_SHOWN - 2], "...", values[-1]]
    return ", ".join(some)
