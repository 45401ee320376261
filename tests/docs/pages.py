"""What the pages of the documentation hold: their fenced blocks, each with how it is tested, their links and headings.

A comment in the line above a block says how it is tested; readers do not see it.

| `<!-- test: ... -->` | |
|---|---|
| `run` | commands are run; Python is run, with what the blocks before it left (its default) |
| `slow` | as `run` where all tests are asked for, else as `check`; with `slow, words` as that |
| `check` | commands as far as can be without running, by --dry-run (their default); Python is compiled; TOML is |
|         | parsed, and checked where it is a file of settings (its default) |
|         | C is compiled and run where there is a compiler (its default) |
| `words` | words of commands are understood; what they name need not be there |
| `not` | nothing is tested: its page says so |

A block with a title is a file, which lies in the folder of the page's commands from the start. `text` and blocks
without a language are no code.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    ROOT / "benchmarks" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
"""All of them, but for those that `mkdocs build` writes itself."""

DEFAULTS = {"sh": "check", "python": "run", "toml": "check", "c": "run"}
WAYS = {"run", "slow", "check", "words", "not"}
NO_CODE = {"", "text"}

_FENCED = re.compile(
    r"^(?:<!-- test: (?P<way>\w+)(?:, (?P<otherwise>\w+))? -->\n)?"
    r"(?P<fence>```+)(?P<language>[\w-]*)(?P<more>[^\n]*)\n(?P<text>.*?)^(?P=fence)[^\S\n]*$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    line: int
    language: str
    title: str
    way: str
    otherwise: str
    """Where it is slow, and not all tests are asked for."""
    text: str

    @property
    def place(self) -> str:
        """For messages."""
        return f"{self.page}:{self.line}"

    @property
    def commands(self) -> list[str]:
        """The lines of a block of commands; one that ends in a backslash goes on."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


def name_of(page: Path) -> str:
    """The path within the repository."""
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path) -> list[Block]:
    """Those of a page that are code, in their order."""
    text = page.read_text()
    found = []
    for fenced in _FENCED.finditer(text):
        title = re.search(r'title="([^"]*)"', fenced["more"])
        way = fenced["way"] or DEFAULTS.get(fenced["language"], "")
        line = text.count("\n", 0, fenced.start("fence")) + 1
        if fenced["language"] not in NO_CODE:
            name = title[1] if title else ""
            otherwise = fenced["otherwise"] or "check"
            found.append(Block(name_of(page), line, fenced["language"], name, way, otherwise, fenced["text"]))
    return found


def prose(page: Path) -> str:
    """A page without its blocks and its comments."""
    return re.sub(r"<!--.*?-->", "", _FENCED.sub("", page.read_text()), flags=re.DOTALL)


def links(page: Path) -> list[tuple[str, str]]:
    """The path of the file and the anchor of each link and picture within the repository."""
    text = re.sub(r"`[^`\n]*`", "", prose(page))
    found = re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", text)
    return [(path, anchor) for path, anchor in found if not re.match(r"\w+:", path)]


def anchors(page: Path) -> set[str]:
    """Those that the headings of a page have, as Python-Markdown and GitHub make them."""
    return {*_slugs(re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE))}


def _slugs(headings: list[str]) -> Iterator[str]:
    for heading in headings:
        plain = re.sub(r"[^\w\s-]", "", heading).strip().lower()
        yield re.sub(r"\s", "-", plain)


def inline_code(page: Path) -> list[str]:
    """What stands between single backticks."""
    return re.findall(r"`([^`\n]+)`", prose(page))
