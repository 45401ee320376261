"""Faults injected into the shards of a sweep: is ever anything merged that is no row of it?

Each case takes the shards of a finished sweep, spoils one of them as a run folder is spoiled, and merges them. Right
is: the whole, as a plain sweep would have made it, or one line, after which nothing was written. Then the shard runs
again; where it does not refuse, the merge ends with the whole. What lay there of somebody else stays as it is.
"""

import shutil
import tempfile
import traceback
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from gpcjax.errors import UserError
from gpcjax.sweep.layout import SHARDS
from gpcjax.sweep.merging import merge
from gpcjax.sweep.reading import Rows, read, read_kept
from gpcjax.sweep.run import run
from gpcjax.sweep.shards import Shard
from tests.torture.faults import FAULTS, Case
from tests.torture.folders import LASTING, OTHER, SPEC, assert_same, finished, workers

OF = 2


def sharded(out: Path) -> Path:
    """A sweep in shards, none of them merged."""
    for number in range(1, OF + 1):
        shard = Shard(number, OF)
        finished(shard.folder(out), SPEC, shard=shard)
    return out


def torture(cases: int, seed: int) -> Iterator[tuple[str, str | None, str]]:
    """The names of the faults of each case, what became of it (None: it was not right), and why."""
    with tempfile.TemporaryDirectory() as folder:
        source = sharded(Path(folder, "source"))
        whole, other = finished(Path(folder, "whole")), finished(Path(folder, "other"), OTHER)
        reference, learned = read(whole), read_kept(whole)
        names = np.random.default_rng(seed).permutation(list(FAULTS)).tolist()
        for number in range(cases):
            random = np.random.default_rng([seed, number])
            out = Path(shutil.copytree(source, Path(folder, "case")))
            shard = Shard(1 + number % OF, OF)
            case = Case(shard.folder(out), other, random)
            chosen = [names[number // OF % len(names)]]
            if number >= OF * len(names):  # every fault alone first, then some at once
                chosen += [names[i] for i in random.integers(0, len(names), random.integers(3))]
            what = f"{number}: {'; '.join(chosen)}"
            try:
                for name in chosen:
                    FAULTS[name](case)
                yield what, judge(case, out, shard, reference, learned), ""
            except Exception:
                yield what, None, traceback.format_exc()
            shutil.rmtree(out)


def judge(case: Case, out: Path, shard: Shard, reference: Rows, learned: pd.DataFrame) -> str:
    """What became of a spoiled shard, in a word.

    Raises:
        AssertionError: it was not right.
    """
    status = "merged"
    before = _contents(out)
    try:
        merge([out])
    except UserError as error:
        status = "merged when it had run again"
        assert "\n" not in str(error)
        assert _contents(out) == before, "a merge that was refused has written something"
        try:
            with workers():
                run(SPEC, case.out, 1, shard=shard)
            merge([out])
        except UserError as refused:
            assert "\n" not in str(refused)
            status = "refused"
    for path, content in case.foreign.items():
        assert path.read_bytes() == content, f"{path} is another's, and was changed"
    if status == "refused":
        return status
    assert sorted(path.name for path in out.iterdir() if path.name != SHARDS) == sorted(
        ["manifest.json", "episodes", "corrections", "kept"]
    )
    later: list[str] = []
    got = read(out, later.append)
    assert_same(got.episodes, reference.episodes)
    assert_same(got.corrections, reference.corrections)
    assert_same(read_kept(out, later.append), learned)
    assert not later, later
    for name in LASTING:
        assert got.manifest[name] == reference.manifest[name], name
    return status


def _contents(out: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in sorted(out.rglob("*"))}
