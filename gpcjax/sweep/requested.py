"""The rows of one specification among those of a run folder that was asked for more. Loads no jax."""

from collections.abc import Sequence

import pandas as pd

from gpcjax.sweep.plan import count, plan, specification_hash, varying
from gpcjax.sweep.reading import Rows
from gpcjax.sweep.rows import IDENTITY, correction_column, key_of
from gpcjax.sweep.spec import SweepSpec, as_dict


def chosen_of(rows: Rows, spec: SweepSpec) -> Rows:
    """The rows of the cells of `spec`, with the manifest of a folder that was asked for nothing else."""
    before, now = tuple(rows.manifest["varying"]), varying(spec)
    if rows.manifest["hash"] == specification_hash(spec):
        return rows
    cells = {key_of(cell, before) for cell in plan(spec)}

    def chosen(frame: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
        if frame.empty:
            return frame
        keys = frame[[*IDENTITY, *names]].itertuples(index=False, name=None)
        mine = [tuple(None if value != value else value for value in key) in cells for key in keys]
        gone = [name for name, setting in zip(names, before, strict=True) if setting not in now]
        return frame.loc[mine].drop(columns=gone).reset_index(drop=True)

    manifest = {name: value for name, value in rows.manifest.items() if name != "asked"}
    manifest |= {
        "hash": specification_hash(spec),
        "specification": as_dict(spec),
        "varying": now,
        "cells": count(spec),
    }
    return Rows(
        chosen(rows.episodes, before), chosen(rows.corrections, [*map(correction_column, before)]), manifest
    )
