"""Rows that are tables when they come: the same store as of single cells' rows, with less to do for who writes it."""

import dataclasses
import pickle

import numpy as np
import pandas as pd
import pytest

from gpcjax.sweep.blocks import block_of
from gpcjax.sweep.executors.remote import together
from gpcjax.sweep.keepable import check_keeping
from gpcjax.sweep.keeping import keeping_of
from gpcjax.sweep.plan import plan, varying
from gpcjax.sweep.reading import read_corrections, read_episodes
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.store import Store
from tests.sweep.folders import begun, manifest_of
from tests.sweep.pretended import rows

SPEC = spec_of(
    env="cartpole", algo=["gpc", "coach"], error=[0, 0.1], seeds=3, episodes=3, policy_variance=[0.1, 0.2]
)


def sent(block):
    """As it comes out of the other end."""
    return pickle.loads(pickle.dumps(block, protocol=5))


def finished(cells):
    """Their rows; one ended early, one never began, one's learner measures something of its own."""
    made = [
        rows(cell, episodes=2 if cell.seed == 1 else 3, status="full" if cell.seed == 1 else "ok")
        for cell in cells
    ]
    made[2] = rows(cells[2], episodes=0, corrections=0)
    made[2] = dataclasses.replace(made[2], status=[])
    made[3] = dataclasses.replace(made[3], own={"regret": np.array([1.0, np.nan, 3.0])})
    return made


@pytest.fixture
def folders(tmp_path):
    """The run folder of rows that came one by one, and that of blocks; in both two of another kind of machine."""
    made = finished(plan(SPEC))
    made[-2:] = [dataclasses.replace(each, machine="other") for each in made[-2:]]
    names = varying(SPEC)
    mine, theirs = made[:-2], made[-2:]
    blocks = [sent(block_of(each, names)) for each in (mine[:5], mine[5:6], theirs)]
    found = {"single": made, "blocks": [*mine[6:], *blocks]}
    for name, given in found.items():
        store = Store(begun(tmp_path / name, SPEC), manifest_of(SPEC))
        store.missing([])
        store.append(given)
        assert store.machines == {"", "other"} and store.cells == len(made)
        assert not [cell for cell in plan(SPEC) if not store.holds(cell)]
    return [tmp_path / name for name in found]


@pytest.mark.parametrize("reader", [read_episodes, read_corrections])
def test_the_store_holds_the_same(folders, reader):
    frames = [reader(folder) for folder in folders]
    names = [
        name for name in frames[0] if name in ("algo", "error", "seed", "policy_variance", "episode", "step")
    ]
    one, other = (frame.sort_values(names, ignore_index=True) for frame in frames)
    pd.testing.assert_frame_equal(one, other[list(one)], check_exact=True)
    assert set(one) == set(other) and len(one) > 30


def test_it_tells_of_each_run():
    made = finished(plan(SPEC))
    block = sent(block_of(made, varying(SPEC)))
    assert block.cells == tuple(each.cell for each in made)
    for run, single in zip(block.runs, made, strict=True):
        (expected,) = single.runs
        assert run.cell == expected.cell
        np.testing.assert_array_equal(run.returns, expected.returns)
        np.testing.assert_array_equal(run.lengths, expected.lengths)


def test_what_was_kept_goes_along(tmp_path):
    spec = spec_of(env="cartpole", algo="gpc", seeds=2, episodes=3)
    check_keeping(keeping_of("policies", "last"), spec)
    made = [rows(cell, kept=True) for cell in plan(spec)]
    tables = sent(block_of(made, ())).tables
    assert tables["kept"].column("arrays").to_pylist() == [each.arrays for row in made for each in row.kept]
    assert "kept" not in block_of([dataclasses.replace(row, kept=()) for row in made], ()).tables


def test_rows_among_other_words_become_one_block_before_them():
    made = finished(plan(SPEC))
    heard = [("rows", made[0]), ("progress", 1), ("rows", made[1]), ("next",)]
    (word, block), *others = together(heard, ())
    assert word == "rows" and block.cells == (made[0].cell, made[1].cell)
    assert others == [("progress", 1), ("next",)]
    assert together(others, ()) == others


def test_one_whose_rows_are_not_of_its_cells_is_refused():
    block = block_of([rows(cell) for cell in plan(SPEC)[:2]], ())
    counts = {**block.counts, "episodes": (3, 2)}
    with pytest.raises(ValueError, match=r"^episodes of a block of 2 cells: 6 rows, not 5$"):
        sent(dataclasses.replace(block, counts=counts))


def test_some_of_its_cells_alone():
    made, names = finished(plan(SPEC)), varying(SPEC)
    some = sent(block_of(made, names)).chosen([1, 2, 3, 5])
    expected = block_of([made[place] for place in (1, 2, 3, 5)], names)
    assert some.cells == expected.cells and some.counts == expected.counts
    for folder, table in expected.tables.items():
        theirs = some.tables[folder].to_pandas()
        pd.testing.assert_frame_equal(theirs, table.to_pandas(), check_exact=True)
