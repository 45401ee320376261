"""Figures of made-up records: what is drawn, and that it can be read."""

import functools
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from gpcjax.report.figures import style
from gpcjax.reproduce import records, sketched_errors, sketched_planes, sketches

RNG = np.random.default_rng(0)


def hyperparameters():
    x = np.linspace(-1, 1, 21)
    curves = RNG.normal(size=(2, 21))
    return records.Hyperparameters(
        points=x[::4],
        targets=x[::4] ** 2,
        x=x,
        truth=x**2,
        mean=curves,
        deviation=np.full((2, 21), 0.1),
        variance=np.ones(2),
        length_scale=np.array([0.25, 1.5]),
        noise=np.full(2, 0.01),
        log_likelihood=np.array([-18.1, -4.6]),
    )


def situations():
    return records.Situations(
        x=np.linspace(-1.5, 1.5, 31),
        policy=RNG.normal(size=(4, 31)),
        sigma_policy=np.full((4, 31), 0.1),
        actions=np.linspace(-0.6, 1.0, 17),
        sigma_human=np.full((4, 17), 0.1),
        action=np.array([0.0, 0.2, 0.3, 0.3]),
        sigma_human_there=np.full(4, 0.1),
        advice=np.array([1.0, 1.0, 0.0, 0.0]),
        rate=np.array([0.2, 0.1, 0.0, 0.0]),
        parameters=np.array(["c_h = 0.01"]),
    )


def plane():
    theta, theta_dot = np.linspace(-np.pi, np.pi, 13), np.linspace(-8, 8, 9)
    sigma = RNG.uniform(size=(9, 13))
    return records.Plane(
        theta=theta,
        theta_dot=theta_dot,
        policy=RNG.uniform(-0.5, 1.0, (9, 13)),
        sigma_policy=sigma,
        sigma_human=sigma,
        rate=2 * sigma,
        dictionary=RNG.normal(size=(3, 2)),
        advised=RNG.normal(size=(5, 2)),
        returns=np.zeros(2),
        settings=np.array(["env = pendulum"]),
        parameters=np.array(["c_r = 0.01"]),
    )


def sparsification():
    target = np.cumsum(np.full((2, 12), 0.05), axis=1)
    return records.Sparsification(
        action=target - 0.05,
        target=target,
        after=target,
        rate=np.full((2, 12), 0.05),
        points=np.ones((2, 12), int),
        state=np.zeros(4),
        parameters=np.array(["c_h = 0.01"]),
    )


def erroneous():
    rates = np.full((2, 2, 8), 0.1)
    rates[1, 0, 5:] = np.nan
    return records.Erroneous(
        algorithms=np.array(["gpc", "gpc-ns"]),
        length_scales=np.array([0.1, 1.0]),
        wrong=np.array(3),
        action=RNG.uniform(size=(2, 2, 9)),
        advice=np.ones((2, 2, 8)),
        rate=rates,
        sigma_policy=rates,
        sigma_human=0.5 * rates,
        samples=np.array([[5.0, 2.0], [2.0, 4.0]]),
        thesis_length_scales=np.array([0.2, 0.5]),
        scanned_length_scales=np.array([0.05, 0.2, 1.0, 2.0]),
        scanned_wrong=np.array([2, 3, 4]),
        scanned_samples=RNG.integers(1, 6, (2, 4, 3)).astype(float),
        target=np.array(1.0),
        tolerance=np.array(0.05),
        state=np.zeros(4),
        parameters=np.array([["c_h = 0.01"], ["c_h = 0.08"]]),
    )


FIGURES = {
    "hyperparameters": (sketches.hyperparameters, hyperparameters, 2),
    "situations": (sketches.situations, situations, 8),
    "early_plane": (sketched_planes.early_plane, plane, 2),
    "sparsification": (sketches.sparsification, sparsification, 2),
    "late_plane": (sketched_planes.late_plane, plane, 3),
    "erroneous": (sketched_errors.erroneous, erroneous, 6),
}
each_figure = pytest.mark.parametrize("name", FIGURES)
the_fullest = pytest.mark.parametrize(
    "name", [name if name == "situations" else pytest.param(name, marks=pytest.mark.slow) for name in FIGURES]
)


@functools.cache
def drawn(name):
    """A figure that was painted, its panels and how many there are to be: tests only look at it."""
    draw, record, count = FIGURES[name]
    figure = draw(record()).figure
    FigureCanvasAgg(figure).draw()
    return figure, [axis for axis in figure.axes if axis.get_title(loc="left")], count


@each_figure
def test_every_panel_is_titled_and_labelled(name):
    figure, panels, count = drawn(name)
    assert len(panels) == count
    assert all(axis.get_xlabel() for axis in panels)
    first = [axis for axis in panels if axis.get_subplotspec().is_first_col()]
    assert all(axis.get_ylabel() for axis in first)
    letters = [axis.get_title(loc="left")[:3] for axis in panels]
    assert letters == [f"({letter})" for letter in "abcdefgh"[:count]]
    width, _ = figure.get_size_inches()
    assert width <= 7.2  # a page


@the_fullest
def test_nothing_is_clipped_and_no_texts_overlap(name):
    figure, _, _ = drawn(name)
    renderer = FigureCanvasAgg(figure).get_renderer()
    page = figure.bbox
    boxes = []
    for axis in figure.axes:
        texts = [axis.xaxis.label, axis.yaxis.label, axis._left_title]
        low, high = axis.get_xlim()
        ticks = [
            tick.label1
            for tick in axis.xaxis.get_major_ticks()
            if tick.label1.get_visible() and low <= tick.get_loc() <= high
        ]
        boxes += [
            (text.get_text(), text.get_window_extent(renderer))
            for text in texts + ticks
            if text.get_text() and text.get_visible()
        ]
    for text, box in boxes:
        assert box.x0 >= page.x0 - 1 and box.x1 <= page.x1 + 1, text
        assert box.y0 >= page.y0 - 1 and box.y1 <= page.y1 + 1, text
    for i, (text, box) in enumerate(boxes):
        for other, another in boxes[:i]:
            assert not box.overlaps(another), (text, other)


@pytest.mark.parametrize("name", [pytest.param("early_plane", marks=pytest.mark.slow), "late_plane"])
def test_maps_have_units_bars_and_fitting_colours(name):
    figure, panels, count = drawn(name)
    assert panels[0].get_xlabel().endswith("[rad]") and panels[0].get_ylabel().endswith("[rad/s]")
    images = [axis.images[0] for axis in panels]
    assert images[0].get_cmap().name == sketched_planes.DIVERGING
    assert images[0].norm.vmin == -images[0].norm.vmax == -1.0
    for image in images[1:]:
        assert image.get_cmap().name == sketched_planes.SEQUENTIAL and image.norm.vmin == 0.0
    bars = [axis for axis in figure.axes if axis not in panels]
    assert len(bars) == count and all(bar.get_xlabel() for bar in bars)
    # The middle of an outermost colour is at the edge.
    left, right, low, high = images[0].get_extent()
    assert left < -np.pi < np.pi < right and low < -8.0 < 8.0 < high


def test_likelihoods_are_told_with_a_minus_sign():
    _, panels, _ = drawn("hyperparameters")
    assert [axis.get_title(loc="left").split("= ")[-1] for axis in panels] == [
        "\N{MINUS SIGN}18.1",
        "\N{MINUS SIGN}4.6",
    ]


def test_there_is_an_arrow_for_each_advice():
    _, panels, _ = drawn("situations")
    assert [len(axis.texts) for axis in panels[:4]] == [1, 1, 0, 0]
    _, panels, _ = drawn("sparsification")
    assert [len(axis.texts) for axis in panels] == [12, 12]


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("sparsification", "png"),
        *(pytest.param(name, "pdf", marks=pytest.mark.slow) for name in ("sparsification", "late_plane")),
    ],
)
def test_files_repeat_to_the_bit(name, kind):
    draw, record, _ = FIGURES[name]
    value = record()
    first = style.image(draw(value).figure, kind, dpi=50)
    assert first.startswith({"pdf": b"%PDF", "png": b"\x89PNG"}[kind])
    assert style.image(draw(value).figure, kind, dpi=50) == first


@each_figure
def test_the_caption_is_of_its_figure(name):
    draw, record, _ = FIGURES[name]
    drawing = draw(record())
    assert drawing.caption.startswith(drawing.alternative.partition(":")[0] + ": ")


def test_what_the_scan_cannot_show_is_marked():
    """Where the teacher was silent before the advice that would err, a series has a small cross and no point."""
    record = erroneous()
    record.scanned_samples[1, :2, 2] = np.nan
    drawing = sketched_errors.erroneous(record)
    crosses = [line for line in drawing.figure.axes[5].lines if line.get_marker() == "x"]
    assert [len(line.get_xdata()) for line in crosses] == [0, 0, 2]
    np.testing.assert_array_equal(crosses[2].get_xdata(), record.scanned_length_scales[:2])
    assert "A small cross low in the panel" in drawing.caption


def test_no_number_of_the_scan_is_hidden_or_cut():
    record = erroneous()
    record.scanned_samples[:] = 2.0  # all lines are the same
    record.scanned_samples[0, 1] = 11.0
    drawing = sketched_errors.erroneous(record)
    for i, axis in enumerate((drawing.figure.axes[2], drawing.figure.axes[5])):
        lines = [line for line in axis.lines if line.get_marker() in ("o", "s", "D")]
        drawn = np.array([line.get_ydata() for line in lines])
        assert (np.diff(drawn, axis=0) < -0.1).all()
        np.testing.assert_array_equal(drawn.round(), record.scanned_samples[i].T)
        assert axis.get_ylim()[1] > 11.5
    assert "drawn a little apart" in drawing.caption


def test_lines_upon_each_other_differ_in_their_dashes():
    _, panels, _ = drawn("erroneous")
    for panel in (panels[0], panels[1]):
        curves = [line for line in panel.lines if len(line.get_xdata()) > 1 and line.get_linestyle() != ":"]
        assert len({line.get_linestyle() for line in curves}) == 2


@pytest.mark.slow
def test_drawing_loads_no_jax():
    modules = ", ".join(
        f"gpcjax.reproduce.{name}" for name in ("sketches", "sketched_planes", "sketched_errors")
    )
    code = f"import sys, {modules}; assert not {{'jax', 'matplotlib.pyplot'}} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
