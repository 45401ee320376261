"""Faults injected into finished run folders: is each one found, and everything as before after the same sweep again?

The rows are pretended (no jax), the store is the real one. Each case takes a finished folder, spoils it in one to three
ways, reads it, and runs its sweep again. Right is: the rows that are read are rows of the sweep, each once; the same
sweep ends with all of them, as they were, or refuses in one line; what lay there of somebody else stays as it is. A
folder of format 2 has no checksums: of it only what can be known is asked, that no fault ends in a traceback.
"""

import contextlib
import io
import json
import shutil
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from gpcjax.errors import UserError
from gpcjax.sweep import going
from gpcjax.sweep import run as run_module
from gpcjax.sweep.layout import CORRECTIONS, EPISODES, MANIFEST
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.reading import Rows, read, read_kept
from gpcjax.sweep.run import run
from gpcjax.sweep.shards import Shard
from gpcjax.sweep.sources import contents_of
from gpcjax.sweep.spec import SweepSpec, spec_of
from tests.sweep.pretended import Pretended
from tests.torture.faults import FAULTS, Case

SETTINGS = {"env": "cartpole", "episodes": 3, "oracle": "lqr", "error": 0.1, "delta": [0.0, 0.05]}
FIRST = spec_of(algo=["gpc", "coach"], seeds=1, **SETTINGS)
SPEC = spec_of(algo=["gpc", "coach"], seeds=2, **SETTINGS)
OTHER = spec_of(algo="gpc", seeds=3, sparsify=False, **SETTINGS)
KEYS = ["algo", "oracle", "error", "delta", "seed"]
LASTING = ("hash", "specification", "varying", "cells", "baselines", "versions", "machine", "complete")
"""What a manifest says, however often the sweep went on."""


def finished(
    out: Path, spec: SweepSpec = SPEC, first: SweepSpec | None = None, shard: Shard | None = None
) -> Path:
    """A whole sweep or a share of one, a part for each cell; it grew, if it was asked for `first` before."""
    out.mkdir(parents=True)
    with workers(), mock.patch.object(going, "FLUSH_SECONDS", -1.0):
        for each in filter(None, (first, spec)):
            run(each, out, 1, shard=shard)
    return out


def unsealed(out: Path, source: Path) -> Path:
    """The same folder in format 2."""
    for folder in (EPISODES, CORRECTIONS):
        (out / folder).mkdir(parents=True)
        for number, path in enumerate(sorted((source / folder).glob("*.parquet"))):
            table = pq.read_table(path).replace_schema_metadata(None)
            pq.write_table(table, out / folder / f"part-{number:05d}-{number:012x}.parquet")
    manifest = read_manifest(source) | {"format": 2}
    del manifest["sha256"]
    (out / MANIFEST).write_text(json.dumps(manifest, indent=2))
    return out


class Whole(NamedTuple):
    """What a finished sweep holds."""

    rows: Rows
    learned: pd.DataFrame
    """What was kept of its runs."""


def judge(case: Case, whole: Whole, other: Whole, sealed: bool) -> str:
    """What became of a spoiled folder of one sweep, with things of another one, in a word.

    Raises:
        AssertionError: it was not right.
    """
    lines: list[str] = []
    # With the manifest of the other one it is a folder of that, until it is asked for what it is not.
    present = other if _is_of(case.out, other) else whole
    _assert_begins_with_some_of(case.out, present.learned)
    try:
        got = read(case.out, lines.append)
    except UserError as error:
        lines.append(str(error))
    else:
        if sealed:
            _assert_some_of(got, present.rows)
    printed, status = io.StringIO(), "as it was"
    try:
        with workers() as pretended, contextlib.redirect_stderr(printed):
            run(SPEC, case.out, 1)
        status = "computed again" if pretended.calls else status
    except UserError as error:
        lines.append(str(error))
        status = "refused"
    told = printed.getvalue()
    lines += [line for line in told.splitlines() if line.startswith("gpcjax: ")]
    assert all(lines) and "\n" not in "".join(lines), lines
    assert "Traceback" not in told and len(lines) <= 8, told
    for path, content in case.foreign.items():
        assert path.read_bytes() == content, f"{path} is another's, and was changed"
    if status != "refused" and sealed:
        later: list[str] = []
        again = read(case.out, later.append)
        assert not [line for line in later if "damaged" in line or "twice" in line], later
        assert_same(again.episodes, whole.rows.episodes)
        assert_same(again.corrections, whole.rows.corrections)
        assert_same(read_kept(case.out, later.append), whole.learned)
        for name in LASTING:
            assert again.manifest[name] == whole.rows.manifest[name], name
    return status


def _is_of(out: Path, whole: Whole) -> bool:
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        return json.loads((out / MANIFEST).read_text())["hash"] == whole.rows.manifest["hash"]
    return False


def torture(cases: int, seed: int, sealed: bool = True) -> Iterator[tuple[str, str | None, str]]:
    """The names of the faults of each case, what became of it (None: it was not right), and why."""
    with tempfile.TemporaryDirectory() as folder:
        whole = finished(Path(folder, "whole"), first=FIRST if sealed else None)
        other = finished(Path(folder, "other"), OTHER)
        if not sealed:
            whole = unsealed(Path(folder, "unsealed"), whole)
        ours, others = (Whole(read(out), read_kept(out)) for out in (whole, other))
        names = list(FAULTS)
        for number in range(cases):
            random = np.random.default_rng([seed, number])
            case = Case(Path(folder, "case"), other, random)
            shutil.copytree(whole, case.out)
            # Every fault alone first, then some at once.
            chosen = [names[number % len(names)]]
            if number >= len(names):
                chosen += [names[i] for i in random.integers(0, len(names), random.integers(3))]
            try:
                for name in chosen:
                    FAULTS[name](case)
                yield f"{number}: {'; '.join(chosen)}", judge(case, ours, others, sealed), ""
            except Exception:
                yield f"{number}: {'; '.join(chosen)}", None, traceback.format_exc()
            shutil.rmtree(case.out)


@contextlib.contextmanager
def workers() -> Iterator[Pretended]:
    """Those that `gpcjax.sweep.run.run` has here: they say nothing, and their rows are pretended."""
    pretended = Pretended(kept=True)
    with (
        mock.patch.object(run_module, "Processes", pretended),
        contextlib.redirect_stderr(io.StringIO() if not isinstance(sys.stderr, io.StringIO) else sys.stderr),
    ):
        yield pretended


def assert_same(got: pd.DataFrame, expected: pd.DataFrame) -> None:
    """To the bit."""
    pd.testing.assert_frame_equal(got, expected, check_exact=True)


def _assert_some_of(got: Rows, reference: Rows) -> None:
    """Whole runs of the sweep, each once, with the rows that they have."""
    if not len(got.episodes):
        return
    cells = got.episodes[KEYS].drop_duplicates()
    for frame, expected in ((got.episodes, reference.episodes), (got.corrections, reference.corrections)):
        some = expected.merge(cells, on=KEYS, how="inner")[list(expected.columns)]
        order = [*KEYS, "episode", *(["step"] if "step" in frame else [])]
        # Without runs of COACH a column has no nulls, and keeps its integers.
        pd.testing.assert_frame_equal(
            frame.sort_values(order, ignore_index=True),
            some.sort_values(order, ignore_index=True),
            check_exact=True,
            check_dtype=False,
        )


def _assert_begins_with_some_of(out: Path, learned: pd.DataFrame) -> None:
    """What a sweep would begin with (`--start`) is what was kept of that run, or nothing of the folder is taken."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            contents = contents_of(out, "start")
            taken = [(state, contents.packed(state)) for state in contents.states]
        except UserError as error:
            assert "\n" not in str(error)
            return
    assert not any("\n" in str(each.message) for each in said)
    columns = [*KEYS, "card", "arrays"]
    kept = {tuple(row[:-2]): tuple(row[-2:]) for row in learned[columns].itertuples(index=False)}
    for state, packed in taken:
        assert kept[tuple(state.values[name] for name in KEYS)] == packed
