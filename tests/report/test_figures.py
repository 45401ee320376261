import io
import threading

import matplotlib
import matplotlib.style
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread

from gpcjax.report import words
from gpcjax.report.figures import curves, grids, style
from gpcjax.report.groups import gather
from gpcjax.report.summary import summarise
from tests.report import synthetic


def colour_of(algo):
    return style.looks([algo])[algo].colour


def summary_of(frame, varying=(), **changes):
    return summarise(gather(frame, synthetic.manifest(frame, varying, **changes)))


def colours(axis):
    return {to_hex(line.get_color()).upper() for line in axis.lines}


def lines_of(axis, algo):
    """The curves of an algorithm, without the dots of its runs' final returns."""
    return [
        line
        for line in axis.lines
        if line.get_color() == colour_of(algo) and line.get_linestyle() not in ("None", "none", "")
    ]


def drawn(figure):
    """The picture as an array: it is rendered without a warning and is not empty."""
    picture = imread(io.BytesIO(style.image(figure, "png", dpi=50)), format="png")
    assert picture.std() > 0.05
    return picture


def test_learning_curves_have_a_panel_for_each_error_rate(cartpole):
    figure, alternative, caption = curves.learning_curves(cartpole)
    assert alternative == "Learning curves" and "12 runs a line" in caption and "mean over runs" in caption
    assert "stopped" not in caption and "grid" not in caption and "cut" not in caption
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
    axis = curves.learning_curves(cartpole).figure.axes[0]
    mean = cartpole.rows[0].group.returns.mean(axis=0)
    blue = lines_of(axis, "gpc")
    np.testing.assert_allclose(blue[0].get_ydata(), mean)
    np.testing.assert_allclose(blue[1].get_ydata()[1:-1], np.convolve(mean, np.ones(3) / 3, mode="valid"))
    assert blue[0].get_alpha() < 1


def test_the_oracle_has_a_band_where_its_return_varies():
    figure = curves.learning_curves(summary_of(synthetic.episodes(env="pendulum", seeds=3))).figure
    assert "oracle ± 1 s.d." in [text.get_text() for text in figure.legends[0].get_texts()]
    assert figure.axes[0].get_ylabel() == "return (negative cost)"


@pytest.mark.parametrize(
    "errors", [1, 7, *(pytest.param(each, marks=pytest.mark.slow) for each in (2, 4, 24))]
)
def test_any_number_of_error_rates_fits(errors):
    rates = [number / 48 for number in range(errors)]
    figure = curves.learning_curves(
        summary_of(synthetic.episodes(algos=("gpc",), errors=rates, seeds=2, length=6))
    ).figure
    assert len(figure.axes) == errors
    assert figure.get_figwidth() <= 9.7
    if errors == 24:
        drawn(figure)


@pytest.mark.parametrize(
    "changes",
    [
        {"seeds": 1, "length": 1},
        *(
            pytest.param(each, marks=pytest.mark.slow)
            for each in ({"seeds": 1}, {"length": 1}, {"algos": ("coach",)}, {"oracles": ("gpc", "lqr")})
        ),
    ],
)
def test_small_stores_can_be_drawn(changes):
    frame = synthetic.episodes(**{"seeds": 3, "errors": (0.0, 0.1), **changes})
    drawn(curves.learning_curves(summary_of(frame, baselines={})).figure)


def test_stopped_runs_that_cannot_be_counted_leave_an_empty_panel():
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0, 0.1), seeds=2)
    frame.loc[(frame["error"] == 0.1) & (frame["episode"] == 30), "status"] = "full"
    drawn(curves.learning_curves(summary_of(frame, baselines={})).figure)


def test_the_final_return_of_every_run_stands_beside_the_curves():
    frame = synthetic.episodes(algos=("gpc", "coach"), errors=(0.0, 0.1), seeds=9)
    frame.loc[frame["seed"] < 4, "return"] = 60.0  # two kinds of outcomes
    frame.loc[(frame["algo"] == "gpc") & (frame["seed"] == 8) & (frame["episode"] == 20), "status"] = "full"
    summary = summary_of(frame)
    figure, _, caption = curves.learning_curves(summary)
    for axis, (oracle, error) in zip(figure.axes, summary.study.panels, strict=True):
        places = []
        for group in summary.study.select(oracle, error):
            dots = [line for line in axis.lines if line.get_marker() in (".", "x")]
            dots = [line for line in dots if line.get_color() == colour_of(group.algo)]
            shown = np.concatenate([line.get_ydata() for line in dots])
            assert sorted(shown) == pytest.approx(sorted(group.final.values))
            crosses = [line.get_ydata().tolist() for line in dots if line.get_marker() == "x"]
            assert crosses == [[40.0]] if group.algo == "gpc" else crosses == [[]]
            x = np.concatenate([line.get_xdata() for line in dots])
            assert len(set(x.round(9)[shown == 60])) == 4  # side by side
            places.append((x.min(), x.max()))
            low, high = axis.get_ylim()
            assert low < shown.min() and shown.max() < high
        assert summary.study.episodes < places[0][0] and places[0][1] < places[1][0]
        assert places[1][1] < axis.get_xlim()[1]
        assert axis.get_xlim() == figure.axes[0].get_xlim()
        assert max(axis.get_xticks()) <= summary.study.episodes
    assert "final return of every run (mean of its last 5 episodes)" in caption and "crosses" in caption
    drawn(figure)


def test_axes_follow_the_lines_and_the_caption_says_what_is_cut():
    """One run of eight that is far off: its interval would press all lines onto the axis."""
    corrections = synthetic.corrections(seeds=8)
    corrections.loc[(corrections["algo"] == "coach") & (corrections["seed"] == 3), "rate"] *= 400
    summary = summary_of(synthetic.episodes(seeds=8))
    figure, _, caption = curves.learning_rates(summary, corrections)
    highest = max(max(line.get_ydata()) for axis in figure.axes for line in axis.lines)
    assert highest < figure.axes[0].get_ylim()[1] < 1.5 * highest
    assert caption.endswith(curves.CUT)
    usual = curves.learning_rates(summary, synthetic.corrections(seeds=8))
    assert curves.CUT not in usual.caption
    bands = [p.vertices[:, 1].max() for a in usual.figure.axes for c in a.collections for p in c.get_paths()]
    assert max(bands) <= usual.figure.axes[0].get_ylim()[1]


def test_returns_follow_their_lines_with_two_runs():
    """Two runs have an interval of 25 standard errors."""
    frame = synthetic.episodes(seeds=2, errors=(0.0,))
    figure, _, caption = curves.learning_curves(summary_of(frame))
    low, high = figure.axes[0].get_ylim()
    assert low > -800 and high < 3300 and curves.CUT in caption


def test_captions_say_which_algorithm_has_how_many_runs():
    frame = synthetic.episodes(seeds=6, errors=(0.0,))
    frame = frame[(frame["algo"] != "gpc-ns") | (frame["seed"] < 2)]
    caption = curves.learning_curves(summary_of(frame)).caption
    assert "(6 runs of GPC and COACH, 2 of GPC-NS a line)" in caption


def test_learning_rates_are_medians_by_index_of_correction(cartpole):
    corrections = synthetic.corrections()
    figure, _, caption = curves.learning_rates(cartpole, corrections.sample(frac=1, random_state=2))
    assert "median over runs" in caption and " mean " not in caption
    assert figure.axes[0].get_ylabel() == "learning rate, median of runs"
    axis = figure.axes[1]
    (line,) = [line for line in axis.lines if line.get_color() == colour_of("coach")]
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


def test_learning_rates_of_stopped_runs_count_as_far_as_they_are_numbers():
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=3)
    frame.loc[(frame["seed"] == 0) & (frame["episode"] == 30), "status"] = "full"
    corrections = synthetic.corrections(algos=("gpc",), errors=(0.0,), seeds=3)
    first = (corrections["step"] == 0) & (corrections["episode"] == 1)
    corrections.loc[first & (corrections["seed"] == 1), "rate"] = np.inf
    kept = corrections[first & (corrections["seed"] != 1)]["rate"].mean()
    (line,) = curves.learning_rates(summary_of(frame), corrections).figure.axes[0].lines
    assert line.get_ydata()[0] == pytest.approx(kept)
    left_out = curves.learning_rates(summary_of(frame, baselines={}), corrections).figure.axes[0].lines[0]
    two = corrections[first & (corrections["seed"] == 2)]["rate"].mean()
    assert left_out.get_ydata()[0] == pytest.approx(two)


def test_action_dimensions_have_rates_of_their_own():
    """Two dimensions in one line would be a zigzag between two curves."""
    one = synthetic.corrections(algos=("gpc",), errors=(0.0, 0.1), seeds=4)
    other = one.assign(action_dim=1, rate=one["rate"] + 1)
    both = pd.concat([one, other]).sample(frac=1, random_state=1)
    summary = summary_of(synthetic.episodes("lunarlander", ("gpc",), (0.0, 0.1), seeds=4))
    figure, _, caption = curves.learning_rates(summary, both)
    assert [axis.get_title(loc="left")[4:] for axis in figure.axes] == [
        "0% error, main engine",
        "10% error, main engine",
        "0% error, side engines",
        "10% error, side engines",
    ]
    assert "of each action dimension" in caption
    alone = curves.learning_rates(summary, one).figure
    assert [axis.get_title(loc="left")[4:] for axis in alone.axes] == ["0% error", "10% error"]
    for column in (0, 1):
        expected = alone.axes[column].lines[0].get_ydata()
        np.testing.assert_allclose(figure.axes[column].lines[0].get_ydata(), expected)
        np.testing.assert_allclose(figure.axes[2 + column].lines[0].get_ydata(), expected + 1)
    group = summary.study.groups[0]
    assert curves.first_rates(group, both)[0, :2].tolist() == pytest.approx(
        [curves.first_rates(group, both, d)[0, 0] for d in (0, 1)]
    )


def test_no_corrections_no_figure(cartpole):
    assert curves.learning_rates(cartpole, synthetic.corrections().iloc[:0]) is None


def test_learning_rates_of_a_grid_are_those_of_the_best_point(grid):
    points = synthetic.length_scale_grid()
    corrections = synthetic.corrections(points=points, errors=(0.0, 0.2), seeds=6)
    corrections.loc[corrections["algo"] == "gpc", "rate"] = corrections["policy_length_scale"]
    figure, _, caption = curves.learning_rates(grid, corrections)
    axis = figure.axes[0]
    assert "highest mean final return" in caption
    (line,) = [line for line in axis.lines if line.get_color() == colour_of("gpc")]
    assert set(line.get_ydata().round(12)) == {grid.leading[0].group.point.get("policy_length_scale")}


def test_two_settings_make_heatmaps(grid):
    figure, _, caption = grids.final_returns(grid)
    assert "mean over runs" in caption and "interval" not in caption
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
    figure, _, caption = grids.final_returns(summary_of(frame, ["delta"]))
    assert "of lines with its 95% interval" in caption
    (axis,) = figure.axes
    assert axis.get_xscale() == "log" and axis.get_xlabel() == r"$\delta$"
    assert {colour_of("gpc").upper(), colour_of("coach").upper()} <= colours(axis)
    drawn(figure)

    names = ["policy_length_scale", "human_length_scale", "policy_nu"]
    points = {"gpc": [dict(zip(names, p, strict=True)) for p in np.ndindex(2, 2, 2)]}
    points = {"gpc": [{name: 0.1 + value for name, value in point.items()} for point in points["gpc"]]}
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=4, length=6, points=points)
    summary = summary_of(frame, names)
    shown = np.asarray(grids.final_returns(summary).figure.axes[0].images[0].get_array())
    finals = [
        row.final.estimate
        for row in summary.rows
        if row.group.point.values[:2] == tuple(zip(names[:2], (0.1, 0.1), strict=True))
    ]
    assert shown[0, 0] == max(finals) and len(finals) == 2


def test_points_that_are_no_grid_lie_where_they_are():
    """A search's: not in the fields of a heatmap, most of which would be empty."""
    pairs = [(0.01, 5.0), (0.1, 2.0), (0.3, 0.5), (2.0, 0.1), (5.0, 1.0)]
    points = {"gpc": [{"policy_length_scale": x, "human_length_scale": y} for x, y in pairs]}
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=4, length=6, points=points)
    axis = grids.final_returns(summary_of(frame, list(points["gpc"][0]))).figure.axes[0]
    (drawn_points,) = axis.collections
    assert not axis.images and {tuple(pair) for pair in drawn_points.get_offsets().tolist()} == set(pairs)
    assert axis.get_xscale() == axis.get_yscale() == "log"
    (star,) = [line for line in axis.lines if line.get_marker() == "*"]
    assert (star.get_xdata()[0], star.get_ydata()[0]) in pairs


def test_heatmap_with_holes_and_equal_values():
    points = synthetic.length_scale_grid((0.1, 0.2), (0.1, 0.2))
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=2, length=6, points=points)
    frame["return"] = 7.0
    hole = (frame["policy_length_scale"] == 0.1) & (frame["human_length_scale"] == 0.2)
    drawn(grids.final_returns(summary_of(frame[~hole], list(points["gpc"][0]))).figure)
    frame.loc[frame["episode"] == 6, "status"] = "full"
    assert grids.final_returns(summary_of(frame, list(points["gpc"][0]), baselines={})) is None


def test_nothing_varies_no_heatmap(cartpole):
    assert grids.final_returns(cartpole) is None


def test_pdf_embeds_its_fonts_and_pictures_repeat(small):
    pdf, again = (style.image(curves.learning_curves(small).figure, "pdf") for _ in range(2))
    assert pdf == again
    assert b"/FontFile2" in pdf and b"/Type3" not in pdf


@pytest.mark.slow
def test_pictures_for_pages_repeat_too(small):
    svg, again = (style.image(curves.learning_curves(small).figure, "svg") for _ in range(2))
    assert svg == again


HOSTILE = {
    "text.usetex": True,
    "font.family": "Papyrus",
    "font.size": 30.0,
    "axes.grid": True,
    "axes.facecolor": "black",
    "figure.facecolor": "black",
    "figure.dpi": 33.0,
    "savefig.bbox": "tight",
    "savefig.transparent": True,
    "savefig.dpi": 20.0,
    "axes.formatter.use_locale": True,
    "lines.linestyle": ":",
    "lines.marker": "s",
    "path.sketch": (1.0, 100.0, 2.0),
    "axes.prop_cycle": matplotlib.cycler(color=["red"]),
    "xtick.direction": "in",
    "legend.loc": "lower right",
    "image.cmap": "jet",
    "image.origin": "lower",
    "svg.fonttype": "none",
    "pdf.compression": 0,
    "pdf.use14corefonts": True,
    "mathtext.fontset": "cm",
}


def pictures(summary, kind):
    return [
        style.image(figure, kind, 40)
        for figure in (curves.learning_curves(summary).figure, grids.final_returns(summary).figure)
    ]


@pytest.fixture(scope="module")
def small():
    points = {"gpc": synthetic.length_scale_grid((0.1, 0.2), (0.1, 0.2))["gpc"]}
    frame = synthetic.episodes(algos=("gpc",), errors=(0.0,), seeds=2, length=4, points=points)
    return summary_of(frame, list(points["gpc"][0]))


@pytest.mark.parametrize("kind", ["png", pytest.param("svg", marks=pytest.mark.slow)])
def test_figures_depend_on_nothing_of_the_users(small, kind):
    plain = pictures(small, kind)
    with matplotlib.style.context(["dark_background", HOSTILE]):
        before = dict(matplotlib.rcParams)
        assert pictures(small, kind) == plain
        assert dict(matplotlib.rcParams) == before


def test_another_backend_for_a_format_is_not_asked(small, monkeypatch):
    plain = style.image(curves.learning_curves(small).figure, "png", 40)
    monkeypatch.setitem(matplotlib.backend_bases._default_backends, "png", "tests.no_such_backend")
    assert style.image(curves.learning_curves(small).figure, "png", 40) == plain


def test_threads_that_draw_at_once_restore_what_was_set():
    """Contexts that overlap would restore each other's settings."""
    inside, leave = threading.Event(), threading.Event()
    sizes = []

    def first():
        with style.publication():
            inside.set()
            leave.wait(10)

    def second():
        inside.wait(10)
        with style.publication():
            sizes.append(matplotlib.rcParams["font.size"])

    with matplotlib.rc_context({"font.size": 31.0}):
        threads = [threading.Thread(target=each) for each in (first, second)]
        for thread in threads:
            thread.start()
        inside.wait(10)
        threads[1].join(0.2)
        assert threads[1].is_alive()  # it takes its turn
        leave.set()
        for thread in threads:
            thread.join()
        assert sizes == [8.0] and matplotlib.rcParams["font.size"] == 31.0


MANY = ("gpc", "gpc-ns", "coach", "d-coach", "drifting:Linear", "mine:A", "mine:B", "_mine:$C$")


def test_every_learner_has_a_look_of_its_own():
    looks = style.looks(MANY)
    assert tuple(looks) == MANY and len(set(looks.values())) == len(MANY)
    assert all(looks[name].colour == colour for name, colour in style.ALGORITHM_COLOURS.items())
    assert len({(look.colour, look.dash) for look in looks.values()}) == len(MANY)
    twenty = [f"a:L{i}" for i in range(20)]
    assert len(set(style.looks(twenty).values())) == 20
    # What is free of the eight colours comes first, the same wherever these learners are compared.
    assert [look.colour for look in style.looks(("drifting:Linear", "gpc")).values()] == [
        "#E69F00",
        "#0072B2",
    ]


def test_learners_that_nobody_knows_are_drawn_and_named():
    frame = synthetic.episodes(algos=("coach",), errors=(0.0,), seeds=3, length=12)
    frames = [frame.assign(algo=name, **{"return": frame["return"] + 100 * i}) for i, name in enumerate(MANY)]
    manifest = synthetic.manifest(frame)
    manifest["specification"]["algo"] = list(MANY)
    summary = summarise(gather(pd.concat(frames, ignore_index=True), manifest))
    figure, *_ = curves.learning_curves(summary)
    (axis,), (legend,) = figure.axes, figure.legends
    names = [text.get_text() for text in legend.get_texts()][: len(MANY)]
    assert names[:5] == ["GPC", "GPC-NS", "COACH", words.algorithm("d-coach"), "drifting:Linear"]
    assert names[-1] == " _mine:\\$C\\$"
    for look in style.looks(MANY).values():
        strong = [line for line in axis.lines if line.get_color() == look.colour and line.get_zorder() == 4]
        assert any(line.get_marker() == (look.marker or "None") for line in strong)
    assert {f"{row.group.algo}" for row in summary.leading} == set(MANY)
    assert len(summary.differences) == 8 * 7 // 2
    drawn(figure)
