"""The numbers and the table that grow while a sweep runs."""

import io

import numpy as np
import pytest
from rich.console import Console

from gpcjax.sweep.growing import BARS, PLAIN_BARS, WIDTH, curve, table
from gpcjax.sweep.plan import plan
from gpcjax.sweep.progress import Bar
from gpcjax.sweep.rows import Run
from gpcjax.sweep.sofar import FINAL_EPISODES, Range, SoFar
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.telling import State

SPEC = spec_of(env="cartpole", algo=("gpc", "coach"), error=(0.0, 0.2), seeds=3, episodes=8)


def rows(cell, returns):
    """Of a run with these returns; what else there is does not count here."""
    returns = np.asarray(returns, float)
    return Run(cell, np.asarray(returns), np.ones(len(returns), int))


def taught(seed=0, spec=SPEC):
    """All runs of the specification, and what they returned."""
    random = np.random.default_rng(seed)
    cells = plan(spec)
    return cells, {cell: random.normal(100.0, 30.0, cell.episodes) for cell in cells}


def test_groups_are_the_runs_that_differ_in_seeds_alone():
    cells, returns = taught()
    sofar = SoFar(cells)
    assert sofar.names == ("algo", "error")
    assert [group.label for group in sofar.groups] == [
        ("gpc", 0.0),
        ("gpc", 0.2),
        ("coach", 0.0),
        ("coach", 0.2),
    ]
    assert {(group.runs, group.finished) for group in sofar.groups} == {(3, 0)} and sofar.range is None
    for cell in cells:
        sofar.add(rows(cell, returns[cell]))
    for group in sofar.groups:
        of_group = np.stack([returns[cell] for cell in cells if (cell.algo, cell.error) == group.label])
        np.testing.assert_allclose(group.curve, of_group.mean(0), rtol=1e-12)
        np.testing.assert_allclose(group.final, of_group[:, -FINAL_EPISODES:].mean(), rtol=1e-12)
        assert (group.finished, group.stopped) == (3, 0)


def test_settings_that_vary_tell_groups_apart():
    spec = spec_of(env="cartpole", algo=("gpc",), oracle=("lqr", "gpc"), delta=(0.0, 0.05), seeds=2)
    sofar = SoFar(plan(spec), ["delta"])
    assert sofar.names == ("algo", "error", "oracle", "delta")
    assert len(sofar.groups) == 4 and {group.runs for group in sofar.groups} == {2}


@pytest.mark.parametrize("returns", [[1.0, 2.0], [1.0] * 7 + [np.nan], []], ids=["short", "nan", "none"])
def test_a_run_that_stopped_counts_in_no_mean(returns):
    cells, known = taught()
    sofar = SoFar(cells)
    sofar.add(rows(cells[0], returns))
    group = sofar.groups[0]
    assert (group.finished, group.stopped, group.curve.size) == (1, 1, 0) and sofar.range is None
    sofar.add(rows(cells[1], known[cells[1]]))
    np.testing.assert_array_equal(group.curve, known[cells[1]])


def test_a_curve_reaches_from_the_low_end_to_the_high_one():
    rising = np.linspace(0.0, 80.0, 8)
    assert curve(rising, Range(0.0, 80.0)) == BARS
    assert curve(rising, Range(0.0, 80.0), PLAIN_BARS) == PLAIN_BARS
    assert curve(rising[::-1], Range(0.0, 80.0)) == BARS[::-1]
    assert curve(np.full(3, 5.0), Range(5.0, 5.0)) == BARS[0] * 3
    assert len(curve(np.arange(200.0), Range(0.0, 199.0))) == WIDTH
    assert curve(np.zeros(0), Range(0.0, 1.0)) == ""


def shown(sofar, most=10, encoding="utf-8"):
    console = Console(file=io.StringIO(), width=100)
    console.print(table(sofar, most, encoding))
    return console.file.getvalue()


def test_the_table_has_a_line_for_each_group():
    cells, _ = taught()
    sofar = SoFar(cells)
    sofar.add(rows(cells[0], [10.0] * 7 + [2500.0]))
    text = shown(sofar)
    assert "GPC" in text and "COACH" in text and "20%" in text
    (first,) = [line for line in text.splitlines() if "1/3" in line]
    assert first.split() == ["GPC", "0%", BARS[0] * 7 + BARS[-1], "508", "1/3"]
    shown(sofar, encoding="ascii").encode("ascii")
    sofar.add(rows(cells[1], [1.0]))
    assert "2/3 (1 stopped)" in shown(sofar)


def test_a_small_terminal_shows_the_groups_that_have_begun():
    cells, returns = taught()
    sofar = SoFar(cells)
    for cell in cells[-3:]:
        sofar.add(rows(cell, returns[cell]))
    text = shown(sofar, most=1)
    assert "COACH" in text and "20%" in text and "GPC" not in text and "and 3 groups more" in text


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True

    def fileno(self):
        raise OSError


def test_a_terminal_shows_it_until_the_report_does(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    cells, returns = taught()
    stream, sofar = Terminal(), SoFar(cells)
    for cell in cells:
        sofar.add(rows(cell, returns[cell]))
    with Bar("cartpole", len(cells), 1, stream) as bar:
        bar.show(State(finished=3, steps=10, sofar=sofar))
        bar._live.refresh()
        assert "by episode, so far" in stream.getvalue()
        before = len(stream.getvalue())
    assert "so far" not in stream.getvalue()[before:] and "3/12" in stream.getvalue()[before:]
    log = io.StringIO()
    with Bar("cartpole", len(cells), 1, log) as bar:
        bar.show(State(finished=3, steps=10, sofar=sofar))
    assert "so far" not in log.getvalue()
