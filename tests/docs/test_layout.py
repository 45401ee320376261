"""What looks like a block on a page is one: lines that are set off by spaces alone run together when it is shown."""

import re

import pytest

from tests.docs.pages import PAGES, name_of

_ITEM = re.compile(r"\s*([-*+]|\d+\.) ")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_lines_that_are_set_off_begin_a_block(page):
    is_code, before = False, ""
    for number, line in enumerate(page.read_text().splitlines(), 1):
        if line.lstrip().startswith("```"):
            is_code = not is_code
        elif not is_code and line.startswith("    "):
            goes_on = before.startswith(" ") or _ITEM.match(before) or before.startswith(":::")
            assert goes_on or not before.strip(), (
                f"{name_of(page)}:{number}: it runs into the line above, fence it"
            )
        before = line
    assert not is_code, f"{name_of(page)}: the last block has no end"
