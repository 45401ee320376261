import io

import numpy as np
import pytest
from rich.console import Console

from gpcjax.report import tables, terminal, words
from gpcjax.report.groups import gather
from gpcjax.report.statistics import Interval
from gpcjax.report.summary import summarise
from tests.report import synthetic


def printed(summary, width=80):
    stream = io.StringIO()
    Console(file=stream, width=width).print(terminal.render(summary))
    return stream.getvalue()


def summary_of(frame, varying=(), **changes):
    return summarise(gather(frame, synthetic.manifest(frame, varying, **changes)))


@pytest.mark.parametrize("env", ["cartpole", "pendulum"])
@pytest.mark.parametrize("width", [80, 100])
def test_tables_fit_the_terminal(env, width):
    text = printed(summary_of(synthetic.episodes(env=env, seeds=15)), width)
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    assert "GPC-NS - COACH" in text


def test_terminal_shows_estimate_interval_oracle_and_idle(cartpole):
    text = printed(cartpole)
    row = cartpole.rows[0]
    assert f"{row.final.estimate:.0f} [{row.final.lower:.0f}, {row.final.upper:.0f}]" in text
    assert "2500 ± 0" in text and "40 ± 12" in text
    assert "stopped" not in text and "finished" not in text


def test_never_is_shown_as_such():
    frame = synthetic.episodes(algos=("coach",), errors=(0.4,), seeds=6)
    (sheet,) = tables.result_sheets(summary_of(frame))
    cells = dict(zip(sheet.columns, sheet.rows[0], strict=True))
    assert cells["to 90%"] == "never" and int(cells["never"]) > 3


def stopping(seeds=12):
    frame = synthetic.episodes(algos=("gpc",), seeds=seeds)
    early = frame["seed"].isin(range(10)) & (frame["error"] == 0.2)
    frame.loc[early & (frame["episode"] == 7), "status"] = "full"
    return frame[~(early & (frame["episode"] > 7))]


def test_stopped_runs_stand_above_everything_and_in_their_row():
    summary = summary_of(stopping())
    text = printed(summary, 200)
    lines = text.splitlines()
    assert lines[0] == (
        "10 runs stopped (dictionary full: 10) and count as a robot that does nothing: from the episode in which one "
        "stopped on, it has the mean return of the idle policy (40.0)."
    )
    assert "GPC, 20% error: seed 0 (episode 7), 1 (episode 7)" in lines[1] and "and 2 more" in lines[1]
    (sheet,) = tables.result_sheets(summary)
    cells = [dict(zip(sheet.columns, row, strict=True)) for row in sheet.rows]
    assert [(row["runs"], row["stopped"]) for row in cells[:3]] == [("12", "0"), ("12", "0"), ("12", "10")]
    assert max(map(len, printed(summary).splitlines())) <= 80 and "…" not in printed(summary)


def test_stopped_runs_that_cannot_be_counted_are_said_to_be_left_out():
    lines = tables.warnings(summary_of(stopping(), baselines={}))
    assert lines[0] == (
        "10 runs stopped (dictionary full: 10) and are in no number below: the store lacks the idle policy's return."
    )


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "cp437", "utf-8"])
def test_tables_print_on_a_stream_of_any_encoding(encoding):
    frame = synthetic.episodes(env="pendulum", seeds=3, oracles=("gpc", "Übung №1"))
    stream = io.BytesIO()
    text = io.TextIOWrapper(stream, encoding=encoding)
    Console(file=text, width=100).print(terminal.render(summary_of(frame)))
    text.flush()
    shown = stream.getvalue().decode(encoding)
    assert ("-150 +/- 95" if encoding == "ascii" else "-150 ± 95") in shown
    assert "number" not in shown and "GPC-NS - COACH" in shown
    assert ("Übung №1" in shown) == (encoding == "utf-8")
    assert max(map(len, shown.splitlines())) <= 100


def test_what_is_missing_is_said():
    frame = synthetic.episodes(seeds=3)
    summary = summary_of(frame[(frame["seed"] != 2) | (frame["algo"] != "coach")], cells=27)
    assert "3 runs of the specification have no episode yet." in tables.warnings(summary)
    part = summarise(gather(frame[frame["episode"] < 9], synthetic.manifest(frame)))
    assert "No run is complete: these are the first 8 of 30 episodes." in tables.warnings(part)


def test_clipped_actions_and_full_dictionaries_are_said():
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0, 0.1), seeds=3)
    frame.loc[(frame["seed"] == 1) & (frame["episode"] == 4), "full"] = 7
    frame["clipped"] = np.where(frame["error"] == 0.1, 50, 0)
    summary = summary_of(frame)
    assert "14 corrections met a full dictionary (on_full error) in runs that are in the numbers." in printed(
        summary, 120
    )
    assert "clipped at up to 25% of a row's steps" in printed(summary, 120)
    (sheet,) = tables.limits_sheets(summary)
    assert sheet.rows[1] == ("10%", "GPC", "3", "18,000", "25.00%", "7", "0")
    assert summary.table()[["steps", "clipped", "met_full"]].to_numpy().tolist() == [
        [18000, 0, 7],
        [18000, 4500, 7],
    ]


def test_few_seeds_are_said_to_be_few():
    assert "One run has no interval" in printed(summary_of(synthetic.episodes(seeds=1)), 100)
    assert "Fewer than ten runs" in printed(summary_of(synthetic.episodes(seeds=4)), 100)


def test_grid_shows_best_points_and_refers_to_the_files(grid):
    text = printed(grid)
    assert "…" not in text
    assert "best points of the grid" in text and "l_p" in text
    assert "72 paired differences between algorithms are in differences.csv." in text
    (sheet,) = tables.point_sheets(grid)
    assert {row[1] for row in sheet.rows} == {"GPC", "GPC-NS"}  # COACH has one point
    (every,) = tables.grid_sheets(grid)
    assert len(every.rows) == 50 + 2


def test_a_store_without_baselines_has_no_such_rows():
    (sheet,) = tables.result_sheets(summary_of(synthetic.episodes(seeds=2), baselines=None))
    assert not {"oracle", "idle"} & {row[1] for row in sheet.rows}
    assert {row[sheet.columns.index("to 90%")] for row in sheet.rows} == {"-"}


def test_numbers_are_written_with_the_digits_of_their_column():
    assert words.places([0.12, 3.4]) == 2
    assert words.places([2500.0, float("nan")]) == 0
    assert words.places([]) == 0
    assert words.number(-0.2, 0) == "0"
    assert words.interval(Interval(1.26, 1.0, 1.5), 1) == "1.3 [1.0, 1.5]"
    assert words.interval(Interval(1.26, float("nan"), float("nan")), 1) == "1.3"
    assert words.percent(0.125) == "12.5%"
    assert words.math_symbol("policy_nu") == r"$\nu_p$"
