"""The episodes of one specification among those of a run folder that was asked for more. Loads no jax."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from gpcjax.sweep.counted import Episodes
from gpcjax.sweep.growth import requests
from gpcjax.sweep.plan import count, plan, specification_hash, varying
from gpcjax.sweep.rows import key_of
from gpcjax.sweep.spec import SweepSpec, as_dict

_OWN = ("algo", "oracle", "error")


def chosen_of(
    episodes: Episodes, manifest: Mapping[str, Any], spec: SweepSpec
) -> tuple[Episodes, Mapping[str, Any]]:
    """Those of the cells of `spec`, with the manifest of a folder that was asked for nothing else."""
    before, now = tuple(manifest["varying"]), varying(spec)
    if [each["hash"] for each in requests(manifest)] == [specification_hash(spec)]:
        return episodes, manifest
    cells = {key_of(cell, before) for cell in plan(spec)}
    names = [*_OWN, *before]
    algo, oracle, error, *others = (_values(episodes, name) for name in names)
    env, seeds = [episodes.env] * len(episodes.seeds), episodes.seeds.tolist()
    keys = zip(env, algo, oracle, error, seeds, *others, strict=True)
    mine = episodes.of_cells(np.array([key in cells for key in keys], bool))
    settings = {name: mine.settings[name] for name in names if name in (*_OWN, *now)}
    return replace(mine, settings=settings), {
        name: value for name, value in manifest.items() if name != "asked"
    } | {
        "hash": specification_hash(spec),
        "specification": as_dict(spec),
        "varying": now,
        "cells": count(spec),
    }


def _values(episodes: Episodes, name: str) -> list[Any]:
    """Of a setting, for each cell; None where it changes nothing."""
    codes, values = episodes.settings[name]
    told = [*(None if value != value else value for value in values), None]
    return [told[code] for code in codes.tolist()]
