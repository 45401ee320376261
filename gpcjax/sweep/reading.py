"""The rows of a run folder as pandas frames. Loads no jax."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa

from gpcjax.allowed import checked_path
from gpcjax.errors import UserError
from gpcjax.registry import built_in
from gpcjax.sweep.layout import CORRECTIONS, EPISODES, KEPT, Say, warn
from gpcjax.sweep.parts import Found, whole_parts
from gpcjax.sweep.rows import IDENTITY, cells_of, correction_column, of_cells
from gpcjax.sweep.runfolder import check_report
from gpcjax.sweep.steady import steadily


class Rows(NamedTuple):
    """What a run folder holds."""

    episodes: pd.DataFrame
    corrections: pd.DataFrame
    manifest: dict[str, Any]


def read(out: Path, say: Say = warn) -> Rows:
    """All rows of a run folder that are whole and of its sweep, while a sweep may be writing there.

    What is damaged is left out, and what is not of this sweep is not read: `say` gets a line for each, if there is any.
    No row is read twice.

    Raises:
        UserError: `out` is no run folder, its manifest is damaged, or none of its rows is whole.
    """
    tables, manifest, found = _once(out, lambda keys: {EPISODES: None, CORRECTIONS: None})
    varying = manifest["varying"]
    episodes, corrections = tables[EPISODES], tables[CORRECTIONS]
    if found.damaged and not episodes:
        path, what = next(iter(found.damaged.items()))
        raise UserError(
            f"{out}: none of its rows is whole ({path}: {what}), the same sweep computes them again"
        )
    found.speak(out, say, "left out, the same sweep computes what is missing again")
    return Rows(
        _frame(episodes, varying, ["episode"]),
        _frame(corrections, [*map(correction_column, varying)], ["episode", "step", "action_dim"]),
        manifest,
    )


def read_episodes(out: Path, say: Say = warn) -> pd.DataFrame:
    """One row for each cell and episode, in the order algo, error, the varying columns, seed, episode: see `read`."""
    return read(out, say).episodes


def read_corrections(out: Path, say: Say = warn) -> pd.DataFrame:
    """One row for each of the first corrections of each cell, in the order of `read_episodes`, then by step."""
    return read(out, say).corrections


def read_kept(out: Path, say: Say = warn) -> pd.DataFrame:
    """What runs had learned, a row for each that was kept, in the order of `read_episodes`; empty if nothing was.

    Raises:
        UserError: `out` is no run folder, or its manifest is damaged.
    """
    tables, manifest, found = _once(out, lambda keys: {EPISODES: keys, KEPT: None})
    found.speak(out, say, "left out, the same sweep computes what is missing again")
    return _frame(tables[KEPT], manifest["varying"], ["episode"])


def kept_parts(out: Path, manifest: Mapping[str, Any], found: Found) -> Iterator[tuple[str, pa.Table]]:
    """The same as `read_kept`, one part in memory at a time: its name, and the rows of it that count.

    Args:
        out: the run folder.
        manifest: of it, see `gpcjax.sweep.steady.steadily`.
        found: is filled on the way.

    Raises:
        UserError: as `read_kept`.
    """
    keys = [*IDENTITY, *manifest["varying"]]
    for part, tables in _parts_once(out, manifest, found, {EPISODES: keys, KEPT: None}):
        if KEPT in tables:
            yield part, tables[KEPT]


def load(out: Any) -> pd.DataFrame:
    """The episodes of a run folder as a pandas frame: a row for each run and episode.

    Rows are ordered by algo, oracle, error, the settings that vary, seed, episode. Parts that are damaged are left out
    with a warning (`UserWarning`), and so is what is not of this sweep. A sweep may be writing there meanwhile.

    Args:
        out: the run folder.

    | column | type | unit | what |
    |---|---|---|---|
    | env, algo, oracle | str | | the task, who learned, whose actions the teacher aimed at |
    | error | float | | chance that an advice had the wrong sign |
    | seed | int | | of the run's random streams |
    | episode | int | | from 1 |
    | return | float | the task's reward | sum of rewards |
    | length | int | steps | until the episode ended |
    | corrections | int | | advices that the learner took |
    | mean_rate | float | normalised action | mean learning rate of these; null without any |
    | asked | int | steps | at which the teacher's coins allowed advice |
    | chance | float | | mean chance of advice at these; null without any |
    | policy_points, human_points | int | points | in the dictionaries at the episode's end; null for learners without |
    | clipped | int | steps | whose action was outside [-1, 1] |
    | full | int | | corrections that met a full dictionary |
    | status | str | | "ok", or why the run ended after this episode |
    | delta, rate, ... | float | as the setting | each setting with several values; null for learners without it |

    Raises:
        ValueError: `out` is no run folder, holds no episodes yet, or none that is whole.
    """
    return _read_some(checked_path("out", out)).episodes


def load_corrections(out: Any) -> pd.DataFrame:
    """The corrections of a run folder as a pandas frame: a row for each of the first 200 of each run.

    A correction of several action dimensions has a row for each. Rows are ordered as those of `load`, then by step and
    action dimension; what is damaged or foreign is treated as there.

    Args:
        out: the run folder.

    | column | type | unit | what |
    |---|---|---|---|
    | env, algo, oracle, error, seed, episode | | | as in `load` |
    | step | int | steps | of the episode, from 0 |
    | action_dim | int | | which dimension of the action was corrected |
    | rate | float | normalised action | learning rate: from the action to its target |
    | sigma_policy | float | normalised action | the policy's deviation before the correction, null without |
    | sigma_human | float | advice | the same of the human model; null for learners without |
    | appended, replaced, full | bool | | what became of the point in the policy's dictionary |
    | delta, advice_rate, ... | float | as the setting | as in `load`; `advice_rate` is the setting `rate` |

    Raises:
        ValueError: as `load`.
    """
    return _read_some(checked_path("out", out)).corrections


def _read_some(out: Path) -> Rows:
    check_report(out)
    rows = read(out)
    if rows.episodes.empty:
        raise UserError(f"{out}: it holds no episodes of its sweep")
    manifest = rows.manifest
    lost = manifest["cells"] - len(rows.episodes.drop_duplicates([*IDENTITY, *manifest["varying"]]))
    if manifest["complete"] and lost > 0:
        warn(f"{out}: {lost} of its {manifest['cells']} runs are lost, the same sweep computes them again")
    return rows


def _once(
    out: Path, wanted_of: Callable[[list[str]], Mapping[str, Sequence[str] | None]]
) -> tuple[dict[str, list[pa.Table]], dict[str, Any], Found]:
    """The wanted tables of all whole parts by folder, the episodes among them, without cells that came before.

    What is wanted depends on the columns that tell cells apart. With the manifest, and what else was found.
    """

    def read(manifest: Mapping[str, Any], found: Found) -> dict[str, list[pa.Table]]:
        wanted = wanted_of([*IDENTITY, *manifest["varying"]])
        tables: dict[str, list[pa.Table]] = {folder: [] for folder in wanted}
        for _, some in _parts_once(out, manifest, found, wanted):
            for folder, table in some.items():
                tables[folder].append(table)
        return tables

    return steadily(out, read)


def _parts_once(
    out: Path, manifest: Mapping[str, Any], found: Found, wanted: Mapping[str, Sequence[str] | None]
) -> Iterator[tuple[str, dict[str, pa.Table]]]:
    """The same part by part, with its name."""
    keys = [*IDENTITY, *manifest["varying"]]
    seen: set[tuple[Any, ...]] = set()
    for part in whole_parts(out, manifest, found, wanted):
        cells = cells_of(part.tables[EPISODES], keys)
        new, old = cells - seen, cells & seen
        found.repeated += 0 if part.again else len(old)
        seen |= new
        yield part.name, of_cells(part.tables, keys, new) if old else part.tables


def _frame(tables: Sequence[pa.Table], varying: Sequence[str], order: Sequence[str]) -> pd.DataFrame:
    """All rows; what a learner measures besides has no part in their order."""
    if not tables:
        return pd.DataFrame()
    frame = pa.concat_tables(tables, promote_options="permissive").to_pandas()
    others = sorted({*frame["algo"]} - {*built_in("learner")})
    ranks = {name: rank for rank, name in enumerate([*built_in("learner"), *others])}
    keys = ["algo", "oracle", "error", *varying, "seed", *order]
    return frame.sort_values(
        keys, key=lambda column: column.map(ranks) if column.name == "algo" else column, kind="stable"
    ).reset_index(drop=True)
