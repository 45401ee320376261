"""Nothing on a page leads nowhere: links, anchors, pictures, commands, flags and public names."""

import re
import tomllib

import pytest

import gpcjax
from gpcjax.cli.commands import COMMANDS
from tests.docs.pages import PAGES, ROOT, anchors, inline_code, links, name_of

MADE = ("docs/reference/commands.md", "docs/reference/columns.md")
"""Pages that `mkdocs build` writes."""

BY_NAME = {name_of(page): page for page in PAGES}


@pytest.mark.parametrize("page", BY_NAME)
def test_links_lead_somewhere(page):
    for path, anchor in links(BY_NAME[page]):
        target = (BY_NAME[page].parent / path).resolve() if path else BY_NAME[page]
        if target.is_relative_to(ROOT) and target.relative_to(ROOT).as_posix() in MADE:
            continue
        assert target.is_relative_to(ROOT) and target.exists(), f"{page}: {path}"
        if anchor:
            assert anchor in anchors(target), f"{page}: {path}#{anchor}"
        if target.suffix in (".png", ".gif"):
            assert target.stat().st_size > 1000, path


@pytest.mark.parametrize("page", BY_NAME)
def test_commands_and_flags_in_a_sentence_exist(page):
    """Of `gpcjax WORDS`, `make WORDS` and `--flag` between backticks."""
    commands = [each for one in COMMANDS.values() for each in (one, *one.parts.values())]
    flags = {name for command in commands for name in command.names} | {"--version"}
    targets = {*re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)}
    for code in inline_code(BY_NAME[page]):
        match code.removeprefix(".venv/bin/").split():
            case ["gpcjax", command, *words] if not command.isupper():
                assert command in COMMANDS, f"{page}: {code}"
                known = [COMMANDS[command]]
                if known[0].parts and words:  # `eval|gif` are both
                    assert {*words[0].split("|")} <= {*known[0].parts}, f"{page}: {code}"
                    known = [known[0].parts[word] for word in words[0].split("|")]
                for word in words:
                    if word.startswith("--"):
                        assert all(word.partition("=")[0] in each.names for each in known), f"{page}: {code}"
            case ["make", target, *_] if not target.isupper():
                assert target in targets, f"{page}: {code}"
            case [flag, *_] if re.fullmatch(r"--[a-z][a-z-]+", flag) and page != "benchmarks/README.md":
                assert flag in flags, f"{page}: {code}"


def test_public_names_in_a_sentence_exist():
    for page in BY_NAME.values():
        for code in inline_code(page):
            for name in re.findall(r"^gpcjax\.([a-zA-Z_]\w*)$", code):
                module = ROOT / "gpcjax" / name
                known = name in gpcjax.__all__ or module.is_dir() or module.with_suffix(".py").is_file()
                assert known, f"{page}: {code}"


def test_the_reference_has_each_public_name_once():
    """So have the docs all names, and name none that there is not."""
    text = "".join(page.read_text() for page in (ROOT / "docs" / "reference").glob("*.md"))
    named = re.findall(r"^::: gpcjax\.([\w.]+)", text, re.MULTILINE)
    public = [name for name in named if "." not in name]
    assert sorted(public) == sorted(gpcjax.__all__)


def test_every_page_is_in_the_navigation():
    nav = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2].partition("\ntheme:\n")[0]
    pages = re.findall(r"(?:- |: )([\w/]+\.md)$", nav, re.MULTILINE)
    assert len({*pages}) == len(pages)
    ours = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert ours - {"reproduction/claims.md"} <= {*pages}


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


def test_the_claims_are_those_of_the_reproduction():
    shown = re.search(
        r"<!-- claims -->\n(.*?)<!-- /claims -->", (ROOT / "docs/thesis.md").read_text(), re.DOTALL
    )
    assert shown and shown[1] == (ROOT / "docs" / "reproduction" / "claims.md").read_text()
    assert shown[1].count("\n") > 30


def test_the_docs_group_is_locked():
    """Each package of the group has its version in the lock, and none has another one in the lock of all else."""
    group = tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"]["docs"]
    pins = [
        dict(re.findall(r"^([\w.-]+)==([^\s;]+)", (ROOT / name).read_text(), re.MULTILINE))
        for name in ("requirements-docs.lock", "requirements.lock")
    ]
    assert {re.match(r"[\w-]+", package)[0] for package in group} <= {*pins[0]}
    assert not {name for name in pins[0].keys() & pins[1].keys() if pins[0][name] != pins[1][name]}
