from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from gpcjax.errors import UserError
from gpcjax.report.compare_notes import uncounted
from gpcjax.report.groups import gather
from gpcjax.report.summary import summarise
from gpcjax.report.tables import warnings
from gpcjax.report.words import cut_short
from tests.report import synthetic


def summary_of(frame, varying=(), **changes):
    return summarise(gather(frame, synthetic.manifest(frame, varying, **changes)))


def per_run(frame, column, function):
    return frame.groupby("seed")[column].apply(function)


def test_row_says_what_pandas_says(cartpole):
    frame = synthetic.episodes()
    frame = frame[(frame["algo"] == "coach") & (frame["error"] == 0.1)].sort_values("episode")
    row = cartpole.table().set_index(["algo", "error"]).loc[("coach", 0.1)]
    assert row["runs"] == 12
    assert row["final_return"] == pytest.approx(per_run(frame, "return", lambda r: r.tail(5).mean()).mean())
    assert row["area"] == pytest.approx(per_run(frame, "return", "mean").mean())
    assert row["corrections"] == pytest.approx(per_run(frame, "corrections", "sum").mean())
    threshold = 40 + 0.9 * (2500 - 40)
    crossings = [next((e for e, r in zip(run["episode"], run["return"], strict=True) if r >= threshold), np.inf)
                 for _, run in frame.groupby("seed")]  # fmt: skip
    assert row["episodes_to_90"] == np.median(crossings)
    assert row["never"] == np.isinf(crossings).sum()
    assert (row["oracle_return"], row["idle_return"]) == (2500, 40)
    assert row["final_return_lower"] < row["final_return"] < row["final_return_upper"]


def test_rows_are_ordered_and_tidy(cartpole):
    table = cartpole.table()
    assert table["error"].tolist() == [0.0] * 3 + [0.1] * 3 + [0.2] * 3
    assert table["algo"].tolist() == ["gpc", "gpc-ns", "coach"] * 3
    assert table.drop(columns=["env", "oracle", "algo"]).dtypes.map(pd.api.types.is_numeric_dtype).all()


def test_differences_are_paired_and_first_minus_second(cartpole):
    table = cartpole.difference_table()
    assert list(zip(table["first"], table["second"], strict=True))[:3] == [
        ("gpc", "gpc-ns"),
        ("gpc", "coach"),
        ("gpc-ns", "coach"),
    ]
    assert len(table) == 9 and (table["pairs"] == 12).all()
    frame = synthetic.episodes()
    area = frame[frame["error"] == 0].groupby(["algo", "seed"])["return"].mean()
    row = table[(table["error"] == 0) & (table["second"] == "coach")].iloc[0]
    assert row["area_difference"] == pytest.approx((area["gpc"] - area["coach"]).mean())
    assert row["excludes_zero"] and row["area_difference_lower"] > 0


def test_an_episode_that_was_cut_is_in_no_number():
    """Those that are left count as if it had never been, in each run for itself."""
    frame = synthetic.episodes().query("algo == 'coach' and error == 0").sample(frac=1, random_state=2)
    last = frame["episode"].max()
    without = summary_of(frame[frame["episode"] < last - 1])
    cut = frame.copy()
    # The same returns, with one in the middle and the last one cut, and that in the middle elsewhere in each run.
    cut["episode"] = frame["episode"].where(frame["episode"] <= frame["seed"], frame["episode"] + 1)
    cut = cut[cut["episode"] < last]
    first = frame[frame["episode"] == 1]
    spoilt = first.assign(status="cut", **{"return": 1e9, "episode": first["seed"] + 1})
    end = first.assign(status="cut", **{"return": -1e9, "episode": last})
    summary = summary_of(pd.concat([cut, spoilt, end]))
    assert summary.study.cut == 24 and summary.study.episodes == last - 2
    for name in ("returns", "corrections"):
        left, as_if = (getattr(each.study.groups[0], name) for each in (summary, without))
        np.testing.assert_array_equal(left, as_if)
    assert summary.study.groups[0].limits == without.study.groups[0].limits
    sentence = "24 episodes that were ended before the task did (by a person, a limit of time, or a failure)"
    assert f"{sentence} are in no number below." in warnings(summary)
    folder = SimpleNamespace(name="first", study=summary.study)
    assert uncounted([folder]) == [f"first: {sentence}, in no number."]


def test_a_lesson_of_which_no_episode_is_whole_says_so():
    frame = synthetic.episodes().query("algo == 'coach' and error == 0").assign(status="cut")
    with pytest.raises(UserError, match="each of its episodes was ended before the task did"):
        summary_of(frame)


def test_a_run_of_which_no_episode_is_whole_is_in_no_group_and_not_missing():
    """No sweep could run it again, nor one that has fewer whole episodes than others."""
    frame = synthetic.episodes(algos=("gpc", "coach"), errors=(0.0,), seeds=4)
    gpc, last = frame["algo"] == "gpc", frame["episode"] == frame["episode"].max()
    others = frame[(frame["seed"] != 2) & gpc]
    frame.loc[((frame["seed"] == 2) & gpc) | ~gpc | (last & (frame["seed"] == 3)), "status"] = "cut"
    summary = summary_of(frame)
    (group,) = summary.study.groups
    assert group.algo == "gpc" and group.seeds.tolist() == [0, 1] and group.unfinished == (3,)
    assert (summary.unfinished, summary.missing, summary.study.cut_runs) == (1, 0, 5)
    assert warnings(summary) == [
        "1 run has not finished and is in no number below.",
        f"{cut_short(151)} are in no number below.",
        "5 runs have no other episode.",
    ]
    assert uncounted([SimpleNamespace(name="first", study=summary.study)])[0].endswith(
        ", in no number; 5 runs without any other episode."
    )
    as_if = summary_of(others[others["seed"] < 2]).table()
    left = summary.table()
    pd.testing.assert_frame_equal(left.drop(columns="unfinished"), as_if.drop(columns="unfinished"))


def test_of_people_no_sweep_makes_up_for_what_is_missing():
    frame = synthetic.episodes(algos=("coach",), errors=(0.0,), seeds=4)
    frame = frame[(frame["seed"] != 2) | (frame["episode"] < 9)]
    assert "The same sweep again runs what is missing." in warnings(summary_of(frame))
    manifest = synthetic.manifest(frame)
    manifest["specification"]["teacher"] = "person"
    said = warnings(summarise(gather(frame, manifest)))
    assert said == ["1 run has not finished and is in no number below."]


def test_order_of_the_rows_of_a_store_does_not_count(cartpole):
    frame = synthetic.episodes()
    shuffled = summary_of(frame.sample(frac=1, random_state=1))
    pd.testing.assert_frame_equal(shuffled.table(), cartpole.table())
    pd.testing.assert_frame_equal(shuffled.difference_table(), cartpole.difference_table())


def test_a_row_does_not_depend_on_the_others(cartpole):
    alone = summary_of(synthetic.episodes(algos=("gpc-ns",), errors=(0.1,))).table()
    whole = cartpole.table()
    same = whole[(whole["algo"] == "gpc-ns") & (whole["error"] == 0.1)].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone, same)


def test_stopped_runs_count_as_idle_from_their_stop_on_and_unfinished_ones_not_at_all():
    frame = synthetic.episodes(algos=("gpc", "coach"), errors=(0.0,), seeds=8)
    planned = synthetic.manifest(frame)
    gpc, seed, episode = frame["algo"] == "gpc", frame["seed"], frame["episode"]
    frame.loc[gpc & (seed == 3) & (episode == 11), "status"] = "full"
    frame.loc[gpc & (seed == 4) & (episode == 30), "status"] = "non-finite"  # in its last episode
    frame.loc[gpc & (seed == 4) & (episode == 30), "return"] = np.nan
    gone = (
        (seed == 3) & (episode > 11)
        | (seed == 5) & (episode > 20)
        | (seed == 6) & (episode == 2)
        | (seed == 7)
    )
    frame = frame[~(gpc & gone)]
    summary = summarise(gather(frame, planned))
    row = summary.table().iloc[0]
    assert (row["runs"], row["stopped"], row["unfinished"]) == (5, 2, 2)
    assert (summary.stopped, summary.uncounted, summary.unfinished, summary.missing) == (2, 0, 2, 1)
    group = summary.rows[0].group
    assert [(stop.seed, stop.episode, stop.status) for stop in group.stopped] == [
        (3, 11, "full"),
        (4, 30, "non-finite"),
    ]
    assert group.broke_down.tolist() == [False, False, False, True, True]
    idle = planned["baselines"]["idle"]["mean"]
    whole = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=5)
    late = (whole["seed"] == 3) & (whole["episode"] >= 11) | (whole["seed"] == 4) & (whole["episode"] == 30)
    whole.loc[late, "return"] = idle
    assert row["area"] == pytest.approx(whole["return"].mean())
    assert row["final_return"] == pytest.approx(whole[whole["episode"] > 25]["return"].mean())
    after = (whole["seed"] == 3) & (whole["episode"] > 11)
    assert row["corrections"] == pytest.approx(whole[~after]["corrections"].sum() / 5)
    assert row["steps"] == 200 * (4 * 30 + 11)
    difference = summary.differences[0]
    coach = synthetic.episodes(algos=("coach",), errors=(0.0,), seeds=5)
    assert difference.pairs == 5
    assert difference.area.estimate == pytest.approx((whole["return"] - coach["return"]).mean())


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_return_that_is_not_finite_stops_a_run_whatever_its_status_says(value):
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=3)
    frame.loc[(frame["seed"] == 1) & (frame["episode"] == 7), "return"] = value
    summary = summary_of(frame)
    (group,) = summary.study.groups
    assert [(stop.seed, stop.episode, stop.status) for stop in group.stopped] == [(1, 7, "non-finite")]
    assert (group.returns[1, 6:] == 40).all() and (group.returns[1, :6] != 40).all()
    assert np.isfinite(group.returns).all()


def test_a_high_return_beside_a_status_that_is_not_ok_counts_as_idle():
    """A row of 2500 with numbers that were not finite is no success."""
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=2)
    frame["return"] = 2500.0
    frame.loc[(frame["seed"] == 0) & (frame["episode"] == 30), "status"] = "non-finite"
    (group,) = summary_of(frame).study.groups
    assert group.returns[0, -1] == 40 and group.final.values[0] == pytest.approx((4 * 2500 + 40) / 5)


def test_all_runs_stopped():
    frame = synthetic.episodes(algos=("gpc", "coach"), errors=(0.0,), seeds=2)
    gpc = frame["algo"] == "gpc"
    frame.loc[gpc & (frame["episode"] == 4), "status"] = "full"
    frame = frame[~(gpc & (frame["episode"] > 4))]
    table = summary_of(frame).table()
    assert table["runs"].tolist() == [2, 2]
    assert table["final_return"][0] == 40
    manifest = synthetic.manifest(frame)
    alone = summarise(gather(frame[frame["algo"] == "gpc"], manifest))
    assert alone.study.episodes == 30 and alone.table()["final_return"][0] == 40


def test_without_the_idle_policys_return_stopped_runs_cannot_be_counted():
    frame = synthetic.episodes(algos=("gpc", "coach"), errors=(0.0,), seeds=2)
    frame.loc[(frame["algo"] == "gpc") & (frame["episode"] == 30), "status"] = "full"
    summary = summary_of(frame, baselines={})
    table = summary.table()
    assert table["runs"].tolist() == [0, 2] and summary.uncounted == 2 and summary.missing == 0
    assert np.isnan(table["final_return"][0]) and not table["best"][0]


def test_sweep_that_is_nowhere_complete_is_compared_as_far_as_it_got():
    frame = synthetic.episodes(seeds=4)
    manifest = synthetic.manifest(frame)
    frame = frame[frame["episode"] <= 12]
    summary = summarise(gather(frame, manifest))
    assert summary.study.episodes == 12
    assert (summary.table()["runs"] == 4).all()


def test_one_seed_has_estimates_without_intervals():
    summary = summary_of(synthetic.episodes(seeds=1))
    table = summary.table()
    assert table["final_return"].notna().all()
    assert table.filter(regex="_(lower|upper)$").isna().all(axis=None)
    assert not summary.difference_table()["excludes_zero"].any()


def test_without_baselines_nothing_is_said_about_the_gap():
    table = summary_of(synthetic.episodes(seeds=2), baselines={}).table()
    assert table[["episodes_to_90", "oracle_return", "idle_return"]].isna().all(axis=None)
    assert (table["never"] == 0).all()


def test_an_oracle_below_idle_leaves_no_gap_to_close():
    baselines = {
        "idle": {"mean": 9.0, "std": 1.0, "n": 5},
        "oracles": {"gpc": {"mean": 8.0, "std": 1.0, "n": 5}},
    }
    assert summary_of(synthetic.episodes(seeds=2), baselines=baselines).table()["episodes_to_90"].isna().all()


def test_grid_has_a_best_point_for_each_algorithm_and_error_rate(grid):
    table = grid.table()
    assert len(table) == 2 * (12 + 12 + 1)
    assert (table.groupby(["algo", "error"])["best"].sum() == 1).all()
    assert table.loc[table["best"], "tied"].all()
    assert table.loc[table["algo"] == "coach", "policy_length_scale"].isna().all()
    assert len(grid.leading) == 6 and all(row.best for row in grid.leading)


def test_pairs_of_a_grid_agree_in_what_both_have(grid):
    table = grid.difference_table()
    both = table[(table["first"] == "gpc") & (table["second"] == "gpc-ns") & (table["error"] == 0)]
    assert len(both) == 12
    assert len(table[(table["second"] == "coach") & (table["error"] == 0)]) == 24
    assert table["policy_length_scale"].notna().all()


def test_two_oracles_are_not_mixed():
    frame = synthetic.episodes(seeds=3, oracles=("gpc", "lqr"), errors=(0.0,))
    summary = summary_of(frame)
    assert summary.table()["oracle"].tolist() == ["gpc"] * 3 + ["lqr"] * 3
    assert all(d.first.oracle == d.second.oracle for d in summary.differences)
    assert len(summary.differences) == 6


def test_no_episodes_is_the_users_mistake():
    frame = synthetic.episodes(seeds=1)
    with pytest.raises(UserError, match="holds no episodes"):
        gather(frame.iloc[:0], synthetic.manifest(frame))
