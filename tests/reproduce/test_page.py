"""The report of a reproduction: every claim is on it, and it needs nothing beside itself."""

import re
from dataclasses import replace
from html import escape

import pytest

from gpcjax.report import html as html_renderer
from gpcjax.report import markdown as markdown_renderer
from gpcjax.report.document import Picture
from gpcjax.report.statistics import Interval
from gpcjax.report.tables import result_sheets
from gpcjax.reproduce import page as contents
from gpcjax.reproduce.claims import claims
from gpcjax.reproduce.parts import CHANGES, PARTS
from gpcjax.reproduce.verdicts import ABOVE_ZERO, HOLDS, NOT_SHOWN, REFUTED, Claim
from gpcjax.reproduce.verdicts import Test as Outcome
from tests.report.test_run import Reader
from tests.reproduce.studies import experiment, table

COMMAND = "make reproduce"


@pytest.fixture(scope="module")
def results():
    swept = {
        "pendulum": experiment("pendulum", seeds=4),
        "cartpole": experiment("cartpole", seeds=4),
        "lander": experiment("lunarlander", seeds=4),
        "oracles_cartpole": experiment(oracles=("gpc", "lqr"), deltas=(0.05, 0.1), seeds=4),
    }
    swept["pendulum"].study.manifest["machine"]["platform"] = "Linux-6.1-of-somebody"
    return swept | table()


@pytest.fixture(scope="module")
def tested(results):
    return claims(results)


def page(*given, **options):
    return html_renderer.render(contents.page(*given, **options))


def markdown(claims):
    return markdown_renderer.table(contents.claims_table(claims))


def read(text):
    reader = Reader()
    reader.feed(text)
    assert not reader.open
    return reader


BOUNDS = {HOLDS: (0.5, 1.5), REFUTED: (-1.5, -0.5), NOT_SHOWN: (-0.5, 1.5)}


def a_claim(verdicts=(HOLDS,), text="It is so", condition="{}0%", **options):
    values = [Interval(1.0, *BOUNDS[verdict]) for verdict in verdicts]
    tests = [Outcome(condition.format(i), value, 7, ABOVE_ZERO, 0.001) for i, value in enumerate(values)]
    return Claim("5.1", text, "what tests it", tuple(tests), **options)


def lines_of(text):
    """The cells of each line of a Markdown table; an escaped bar is no border."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


@pytest.fixture(scope="module")
def html(results, tested):
    picture = Picture(b"<svg/>", 6.0, "A <figure>", "Fig. 5.1: what & how")
    sheets = {"pendulum": result_sheets(results["pendulum"].summary)}
    return page(tested, {"pendulum": [picture]}, sheets, results, [COMMAND], False)


class TestPage:
    def test_every_claim_of_every_part(self, tested, html):
        assert set(tested) == {"pendulum", "cartpole", "lander", "active", "oracles", "all"}
        reader = read(html)
        for claim in (claim for part in tested.values() for claim in part):
            # Once among the verdicts, once with what tests it.
            assert reader.text.count(claim.text) >= 2, claim.text
            statistic = f"{claim.statistic} ({claim.remark})" if claim.remark else claim.statistic
            assert statistic in reader.text
            assert all(escape(test.shown).replace("-", "−") in html for test in claim.tests)  # noqa: RUF001

    def test_every_part_has_its_heading_and_every_deviation_its_line(self, tested, html):
        reader = read(html)
        for part in tested.keys() & PARTS.keys():
            assert PARTS[part].title in reader.text
        assert all(name in reader.text and text in reader.text for name, text in CHANGES.items())

    def test_it_stands_alone(self, html):
        reader = read(html)
        assert reader.sources and all(source.startswith("data:image/svg+xml;") for source in reader.sources)
        assert not {"script", "link", "iframe", "a"} & set(reader.tags)
        assert not re.search(r"https?://|@import|url\(", html)

    def test_what_was_run(self, results, html):
        reader = read(html)
        assert COMMAND in reader.text and all(name in reader.text for name in results)
        for fact in ("0123456789ab", "41,000,000", "0.10.0", "x86_64"):
            assert fact in reader.text

    def test_a_quick_one_says_so(self, results, tested, html):
        quick = page(tested, {}, {}, results, [COMMAND], True)
        assert "A quick reproduction" in quick and "A quick reproduction" not in html

    def test_a_part_that_is_missing_has_no_heading(self, results, tested):
        small = page({"pendulum": tested["pendulum"]}, {}, {}, {"pendulum": results["pendulum"]}, [], False)
        text = read(small).text
        assert PARTS["pendulum"].title in text and PARTS["lander"].title not in text

    def test_nothing_at_all(self):
        assert "Of 0 claims 0 hold" in page({}, {}, {}, {}, [COMMAND], False)

    def test_the_verdicts_are_counted(self):
        made = [a_claim(each) for each in ((HOLDS, HOLDS), (HOLDS,), (HOLDS, REFUTED), (REFUTED,))]
        text = page({"pendulum": made[:2], "active": made[2:]}, {}, {}, {}, [], False)
        assert "Of 4 claims 2 hold, 1 are refuted, 0 are not shown, 0 are not tested, and 1 are mixed" in text

    def test_what_means_something_in_html_is_text(self):
        text = page({"pendulum": [a_claim(text="<b>a & b</b>")]}, {}, {}, {}, [], False)
        assert "<b>a & b</b>" in read(text).text and "<b>" not in text


class TestMarkdown:
    def test_a_row_for_each_claim_with_as_many_cells_as_the_head(self, tested):
        head, rule, *rows = lines_of(markdown(tested))
        assert head[:3] == ["section", "claim", "verdict"] and set(rule) == {"---"}
        assert {len(row) for row in rows} == {len(head)} == {len(rule)}
        every = [claim for part in tested.values() for claim in part]
        assert [row[:2] for row in rows] == [[claim.section, claim.text] for claim in every]

    def test_a_bar_does_not_end_a_cell(self):
        (head, _, row) = lines_of(markdown({"pendulum": [a_claim(text="a | b", condition="|{}|")]}))
        assert len(row) == len(head) and row[1] == "a \\| b"

    def test_the_estimates(self):
        (_, _, one), (_, _, two) = (
            lines_of(markdown({"pendulum": [a_claim(verdicts)]})) for verdicts in ((HOLDS,), (HOLDS, HOLDS))
        )
        assert one[-3:] == ["1 [0, 2]", "7", "none"]
        assert two[-3:] == ["00%: 1 [0, 2]; 10%: 1 [0, 2]", "7", "none"]

    @pytest.mark.parametrize(
        ("verdicts", "told"),
        [
            ((HOLDS, HOLDS), "holds"),
            ((REFUTED, REFUTED), "**refuted**"),
            ((NOT_SHOWN, NOT_SHOWN), "**not shown**"),
            ((HOLDS, NOT_SHOWN, HOLDS), "**holds at 00%, 20%; not shown at 10%**"),
            ((HOLDS,) * 6 + (REFUTED,) * 2, "**holds at 6 of 8; refuted at 60%, 70%**"),
            ((REFUTED,) * 6 + (HOLDS,) * 2, "**holds at 60%, 70%; refuted at 6 of 8**"),
            ((REFUTED,) * 8, "**refuted**"),
            ((HOLDS,) * 8, "holds"),
        ],
    )
    def test_a_verdict_is_short_and_stands_out_where_it_is_not_the_claimed_one(self, verdicts, told):
        (_, _, row) = lines_of(markdown({"pendulum": [a_claim(verdicts)]}))
        assert row[2] == told

    def test_numbers_of_runs_that_differ(self):
        tests = tuple(Outcome(f"{n}", Interval(1.0, 0.5, 1.5), n, ABOVE_ZERO) for n in (9, 12, 10))
        (_, _, row) = lines_of(markdown({"pendulum": [Claim("5", "so", "how", tests)]}))
        assert row[-2] == "9 to 12"

    def test_the_verdict_after_holm_stands_beside_the_plain_one(self):
        survives, falls = (
            replace(claim, tests=tuple(replace(test, adjusted=p) for test in claim.tests))
            for claim, p in ((a_claim(), 0.01), (a_claim(), 0.2))
        )
        (_, _, first, second) = lines_of(markdown({"pendulum": [survives, falls]}))
        assert first[2:4] == ["holds", "the same"] and second[2:4] == ["holds", "not shown"]

    def test_oracles_that_gpc_taught_are_named_next_to_every_result(self):
        (_, _, row) = lines_of(markdown({"pendulum": [a_claim(oracles=("gpc", "gpc-2", "lqr"))]}))
        assert row[-1] == "gpc (a circle), gpc-2 (a circle), lqr"
        text = page({"oracles": [a_claim(oracles=("gpc", "lqr", "mpc"))]}, {}, {}, {}, [], False)
        told = "\n".join(read(text).text)
        assert "Oracles that GPC itself taught: gpc. That is a circle" in told
        assert "Oracles that owe nothing to GPC: lqr, mpc." in told

    def test_the_whole_report(self, results, tested):
        picture = Picture(b"", 6.0, "Returns", "Fig. 5.1: what & how", "figures/fig5_1_returns.png")
        document = contents.page(tested, {"pendulum": [picture]}, {}, results, [COMMAND], brief=True)
        text = markdown_renderer.render(document)
        assert "![Returns](figures/fig5_1_returns.png)" in text and "Fig. 5.1: what & how" in text
        assert PARTS["pendulum"].title in text and PARTS["lander"].title not in text  # it has no figure
        assert "Not run: " in text and "of-somebody" not in text
        assert all(claim.text in text for part in tested.values() for claim in part)
        for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
            assert len({len(row) for row in lines_of(block)}) == 1
        assert f"    {COMMAND}\n" in text and all(f"| {name} |" in text for name in results)
