"""One document, set as HTML and as Markdown."""

import pytest

from gpcjax.report import html, markdown
from gpcjax.report.document import (
    Code,
    Definitions,
    Document,
    Folded,
    Heading,
    Paragraph,
    Picture,
    Sheet,
    Warnings,
)
from tests.report.test_run import Reader

NASTY = "a<b> & `c|d` *e* &amp; [f](g) $h$ <i"
"""Everything that means something to a renderer."""

SHEET = Sheet(
    "what | came out",
    ("algo", "final"),
    (("A|B", "-1.5"), (NASTY, "2"), ("", "*")),
    frozenset({1}),
    {"algo": "word"},
    frozenset({(0, 1)}),
)
WHOLE = Document(
    NASTY,
    (
        Paragraph(NASTY, lead=True),
        Warnings((NASTY, "and more")),
        Heading(NASTY),
        SHEET,
        Picture(b"<svg/>", 2.0, NASTY, NASTY, "figures/one.png"),
        Heading("Facts", level=3),
        Definitions({NASTY: NASTY}),
        Code((NASTY,)),
        Folded(NASTY, (SHEET,)),
    ),
)


def test_html_shows_every_text_as_it_is():
    reader = Reader()
    reader.feed(html.render(WHOLE))
    assert not reader.open
    # Title twice (once in the head), lead, warning, heading, two cells, caption, definition twice, code, fold.
    assert reader.text.count(NASTY) == 12
    assert not {"b", "i"} & set(reader.tags)
    assert reader.sources == ["data:image/svg+xml;base64,PHN2Zy8+"]


def test_html_sets_numbers_and_words():
    text = html.render(Document("", (SHEET,)))
    assert '<th class="word">algo</th><th>final</th>' in text
    assert '<td class="word">A|B</td><td><strong>−1.5</strong></td>' in text  # noqa: RUF001
    assert text.count('<tr class="end">') == 1 and "<caption>What | came out</caption>" in text


def test_markdown_escapes_what_would_mean_something():
    assert markdown.text(NASTY) == "a\\<b> & \\`c|d\\` \\*e* \\&amp; [f\\](g) \\$h$ \\<i"
    text = markdown.render(WHOLE)
    assert text.startswith("# a\\<b> & ") and "<b>" not in text.replace("\\<b>", "").replace(
        f"    {NASTY}", ""
    )
    assert f"\n    {NASTY}\n" in text  # code is as it is typed
    assert "![a\\<b>" in text and "](figures/one.png)" in text


@pytest.mark.parametrize(
    "plain",
    [
        "p < 0.001",
        "12 [3, 21] *",
        "2 * 3",
        "l_p and c_r = 0.1",
        "R&D",
        "95 % interval",
        "± 1",
        "a ~ b",
        "5 $",
    ],
)
def test_markdown_leaves_what_means_nothing_there(plain):
    assert markdown.text(plain) == plain


@pytest.mark.parametrize(
    ("plain", "shown"),
    [("# no", "\\# no"), ("- no", "\\- no"), ("1. no", "1\\. no"), ("> no", "\\> no"), ("-5 is", "-5 is")],
)
def test_a_paragraph_begins_no_list(plain, shown):
    assert markdown.render(Document("t", (Paragraph(plain),))) == f"# t\n\n{shown}\n"


def test_a_line_break_ends_no_row_of_markdown():
    assert markdown.table(Sheet("", ("a",), (("b\nc | d",),))) == "| a |\n| --- |\n| b c \\| d |\n"


def test_a_cell_that_stands_out_and_a_title():
    text = markdown.render(Document("t", (SHEET,)))
    assert "**What | came out**\n\n| algo | final |\n| --- | --- |\n| A\\|B | **-1.5** |\n" in text


def test_what_is_empty_is_not_there():
    empty = Document("t", (Definitions({}),))
    assert markdown.render(empty) == "# t\n" and "<dl>" not in html.render(empty)


@pytest.mark.parametrize("row", [("1",), ("1", "2", "3"), ()])
def test_a_ragged_table_is_refused(row):
    with pytest.raises(ValueError, match=f"row 1 has {len(row)} cells, for 2 columns"):
        Sheet("t", ("a", "b"), (("1", "2"), row))
