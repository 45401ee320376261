import io

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread

from gpcjax.report import curves, grids, style
from gpcjax.report.groups import gather
from gpcjax.report.summary import summarise
from tests.report import synthetic


def summary_of(frame, varying=(), **changes):
    return summarise(gather(frame, synthetic.manifest(frame, varying, **changes)))


def colours(axis):
    return {to_hex(line.get_color()).upper() for line in axis.lines}


def drawn(figure):
    """The picture as an array: it is rendered without a warning and is not empty."""
    picture = imread(io.BytesIO(style.image(figure, "png", dpi=50)), format="png")
    assert picture.std() > 0.05
    return picture


def test_learning_curves_have_a_panel_for_each_error_rate(cartpole):
    figure = curves.learning_curves(cartpole)
    assert [axis.get_title(loc="left") for axis in figure.axes] == [
        "(a) 0% error",
        "(b) 10% error",
        "(c) 20% error",
    ]
    assert figure.axes[0].get_ylabel() == "return (steps upright)"
    assert figure.axes[1].get_ylabel() == ""
    assert all(axis.get_xlabel() == "episode" for axis in figure.axes)
    for axis in figure.axes:
        assert set(style.ALGORITHM_COLOURS.values()) <= colours(axis)
        assert len(axis.collections) == 3  # a band for each algorithm
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "GPC",
        "GPC-NS",
        "COACH",
        "oracle",
        "idle (a = 0)",
    ]
    drawn(figure)


def test_curve_is_the_walking_mean_over_the_mean(cartpole):
    axis = curves.learning_curves(cartpole).axes[0]
    mean = cartpole.rows[0].group.returns.mean(axis=0)
    blue = [line for line in axis.lines if line.get_color() == style.colour("gpc")]
    np.testing.assert_allclose(blue[0].get_ydata(), mean)
    np.testing.assert_allclose(blue[1].get_ydata()[1:-1], np.convolve(mean, np.ones(3) / 3, mode="valid"))
    assert blue[0].get_alpha() < 1


def test_the_oracle_has_a_band_where_its_return_varies():
    figure = curves.learning_curves(summary_of(synthetic.episodes(env="pendulum", seeds=3)))
    assert "oracle ± 1 s.d." in [text.get_text() for text in figure.legends[0].get_texts()]
    assert figure.axes[0].get_ylabel() == "return (negative cost)"


@pytest.mark.parametrize("errors", [1, 2, 4, 7, 24])
def test_any_number_of_error_rates_fits(errors):
    rates = [number / 48 for number in range(errors)]
    figure = curves.learning_curves(
        summary_of(synthetic.episodes(algos=("gpc",), errors=rates, seeds=2, length=6))
    )
    assert len(figure.axes) == errors
    assert figure.get_figwidth() <= 9.7
    if errors == 24:
        drawn(figure)


@pytest.mark.parametrize(
    "changes", [{"seeds": 1}, {"length": 1}, {"algos": ("coach",)}, {"oracles": ("gpc", "lqr")}]
)
def test_small_stores_can_be_drawn(changes):
    frame = synthetic.episodes(**{"seeds": 3, "errors": (0.0, 0.1), **changes})
    drawn(curves.learning_curves(summary_of(frame, baselines={})))


def test_stopped_runs_leave_an_empty_panel():
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0, 0.1), seeds=2)
    frame.loc[(frame["error"] == 0.1) & (frame["episode"] == 30), "status"] = "full"
    drawn(curves.learning_curves(summary_of(frame)))


def test_learning_rates_are_medians_by_index_of_correction(cartpole):
    corrections = synthetic.corrections()
    figure = curves.learning_rates(cartpole, corrections.sample(frac=1, random_state=2))
    axis = figure.axes[1]
    (line,) = [line for line in axis.lines if line.get_color() == style.colour("coach")]
    rows = corrections[(corrections["algo"] == "coach") & (corrections["error"] == 0.1)]
    index = rows.groupby("seed").cumcount()
    number = len(line.get_ydata())
    np.testing.assert_allclose(line.get_ydata(), rows["rate"].groupby(index).median()[:number])
    assert index.value_counts()[number - 1] >= 6 and number <= 150
    assert axis.get_ylim()[0] == 0
    highest = max(
        path.vertices[:, 1].max()
        for panel in figure.axes
        for c in panel.collections
        for path in c.get_paths()
    )
    assert axis.get_ylim()[1] >= highest
    drawn(figure)


def test_learning_rates_of_runs_that_are_not_compared_are_left_out():
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=3)
    frame.loc[(frame["seed"] == 0) & (frame["episode"] == 30), "status"] = "full"
    corrections = synthetic.corrections(algos=("gpc",), errors=(0.0,), seeds=3)
    (line,) = curves.learning_rates(summary_of(frame), corrections).axes[0].lines
    kept = corrections[corrections["seed"] > 0]
    assert line.get_ydata()[0] == pytest.approx(
        kept[(kept["step"] == 0) & (kept["episode"] == 1)]["rate"].mean()
    )


def test_no_corrections_no_figure(cartpole):
    assert curves.learning_rates(cartpole, synthetic.corrections().iloc[:0]) is None


def test_learning_rates_of_a_grid_are_those_of_the_best_point(grid):
    points = synthetic.length_scale_grid()
    corrections = synthetic.corrections(points=points, errors=(0.0, 0.2), seeds=6)
    corrections.loc[corrections["algo"] == "gpc", "rate"] = corrections["policy_length_scale"]
    axis = curves.learning_rates(grid, corrections).axes[0]
    (line,) = [line for line in axis.lines if line.get_color() == style.colour("gpc")]
    assert set(line.get_ydata().round(12)) == {grid.leading[0].group.point.get("policy_length_scale")}


def test_two_settings_make_heatmaps(grid):
    figure = grids.final_returns(grid)
    *panels, bar = figure.axes
    assert [axis.get_title(loc="left")[4:] for axis in panels] == [
        f"{algo}, {error}% error" for algo in ("GPC", "GPC-NS") for error in (0, 20)
    ]
    assert (panels[0].get_xlabel(), panels[0].get_ylabel()) == ("$l_p$", "$l_h$")
    assert bar.get_ylabel() == "final return (steps upright)"
    shown = np.asarray(panels[0].images[0].get_array())
    assert shown.shape == (3, 4)
    for row in (row for row in grid.rows if (row.group.algo, row.group.error) == ("gpc", 0)):
        place = (
            [0.1, 0.2, 0.5].index(row.group.point.get("human_length_scale")),
            [0.1, 0.2, 0.4, 0.8].index(row.group.point.get("policy_length_scale")),
        )
        assert shown[place] == pytest.approx(row.final.estimate)
        (text,) = [text for text in panels[0].texts if text.get_position() == place[::-1]]
        assert (grids.BEST in text.get_text()) == row.best
        assert (grids.TIED in text.get_text()) == (row.tied and not row.best)
    drawn(figure)


def test_one_setting_makes_lines_and_three_show_the_best_of_the_third():
    delta = {algo: [{"delta": value} for value in (0.01, 0.1, 0.5)] for algo in ("gpc", "coach")}
    frame = synthetic.episodes(algos=("gpc", "coach"), errors=(0.0,), seeds=4, length=6, points=delta)
    figure = grids.final_returns(summary_of(frame, ["delta"]))
    (axis,) = figure.axes
    assert axis.get_xscale() == "log" and axis.get_xlabel() == r"$\delta$"
    assert {style.colour("gpc").upper(), style.colour("coach").upper()} <= colours(axis)
    drawn(figure)

    names = ["policy_length_scale", "human_length_scale", "policy_nu"]
    points = {"gpc": [dict(zip(names, p, strict=True)) for p in np.ndindex(2, 2, 2)]}
    points = {"gpc": [{name: 0.1 + value for name, value in point.items()} for point in points["gpc"]]}
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=4, length=6, points=points)
    summary = summary_of(frame, names)
    shown = np.asarray(grids.final_returns(summary).axes[0].images[0].get_array())
    finals = [
        row.final.estimate
        for row in summary.rows
        if row.group.point.values[:2] == tuple(zip(names[:2], (0.1, 0.1), strict=True))
    ]
    assert shown[0, 0] == max(finals) and len(finals) == 2


def test_heatmap_with_holes_and_equal_values():
    points = synthetic.length_scale_grid((0.1, 0.2), (0.1, 0.2))
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=2, length=6, points=points)
    frame["return"] = 7.0
    hole = (frame["policy_length_scale"] == 0.1) & (frame["human_length_scale"] == 0.2)
    drawn(grids.final_returns(summary_of(frame[~hole], list(points["gpc"][0]))))
    frame.loc[frame["episode"] == 6, "status"] = "full"
    assert grids.final_returns(summary_of(frame, list(points["gpc"][0]))) is None


def test_nothing_varies_no_heatmap(cartpole):
    assert grids.final_returns(cartpole) is None


def test_pdf_embeds_its_fonts_and_pictures_repeat(cartpole):
    pdf, again = (style.image(curves.learning_curves(cartpole), "pdf") for _ in range(2))
    assert pdf == again
    assert b"/FontFile2" in pdf and b"/Type3" not in pdf
    svg, again = (style.image(curves.learning_curves(cartpole), "svg") for _ in range(2))
    assert svg == again


def test_drawing_leaves_matplotlib_as_it_was(cartpole):
    before = dict(matplotlib.rcParams)
    style.image(curves.learning_curves(cartpole), "png", dpi=40)
    assert dict(matplotlib.rcParams) == before
