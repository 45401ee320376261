"""The figures of docs/concepts.md: each is drawn, each is shown, and the page says of them what they are."""

import re

import pytest

from tests.docs.pages import ROOT

PAGE = (ROOT / "docs" / "concepts.md").read_text()


def _titles(figure):
    return [axis.get_title(loc="left") or axis.get_title() for axis in figure.axes]


def test_each_figure_is_shown_and_there():
    from docs.making.concepts import FIGURES, FOLDER

    assert {*re.findall(r"\(figures/(\w+)\.png\)", PAGE)} == {*FIGURES}
    assert all((FOLDER / f"{name}.png").stat().st_size > 10_000 for name in FIGURES)


@pytest.mark.slow
def test_what_the_page_says_of_them():
    """Numbers of corrections, and of the points that are kept, as the learners of today have them."""
    from docs.making.concepts import FIGURES

    drawn = {name: draw() for name, draw in FIGURES.items()}
    told = {
        name: re.findall(r"\d+", text)
        for text, name in re.findall(r"!\[([^]]*)\]\(figures/(\w+)\.png\)", PAGE)
    }
    for name in ("kernel_policy", "human_model"):
        counts = [count[0] for title in _titles(drawn[name]) if (count := re.findall(r"\d+", title))]
        assert counts == told[name], name
    kept = [text.get_text() for axis in drawn["replacement"].axes for text in axis.texts]
    assert [line for line in kept if "kept" in line] == ["8 of 8 kept", "1 of 8 kept"]
    parts = [[bar.get_height() for bar in axis.patches] for axis in drawn["learning_rate"].axes]
    always, in_turn = (sum(heights) for heights in parts)
    assert always > in_turn  # "stays up longer"
