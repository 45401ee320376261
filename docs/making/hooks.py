"""What `mkdocs build` does beside: pages that come from elsewhere in the repository, and links to its files.

A page keeps the links that work where its file lies. In the site, a link to a Markdown file that is a page there leads
to that page; one to a file of source leads to a page that shows the file.
"""

import posixpath
import re
from collections.abc import Callable
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from docs.making import columns, flags

ROOT = Path(__file__).parents[2]

FROM_ELSEWHERE = {
    "index.md": "README.md",
    "benchmark.md": "benchmarks/README.md",
    "changelog.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
}
"""Page of the site -> the file of the repository that it is."""

BESIDE = {"benchmarks": (".png",)}
"""Folder of the repository -> the endings of its files that pages from there show."""

WITHOUT = {
    "index.md": ["navigation"],
    "benchmark.md": ["navigation"],
    "reproduction/README.md": ["navigation"],
    "thesis.md": ["toc"],
}
"""Page of the site -> what is not beside it, so that its tables have room."""

MADE = {"reference/commands.md": flags.page, "reference/columns.md": columns.page}
"""Page of the site -> what writes it."""

_LINK = re.compile(r"(?<=\]\()([^)#\s:]+)(#[^)\s]*)?(?=\))")
"""The target of a link or a picture within the repository, and its anchor."""

_OUTWARD = re.compile(r'(?:href|src)="(https?://[^"]+)"')


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages of `FROM_ELSEWHERE` and `MADE`, their pictures, and a page for each file of source linked to."""

    def add(uri: str, **of: str) -> None:
        files.append(File.generated(config, uri, **of))

    for page, source in FROM_ELSEWHERE.items():
        add(page, content=(ROOT / source).read_text())
    for folder, endings in BESIDE.items():
        for path in sorted((ROOT / folder).iterdir()):
            if path.suffix in endings:
                add(f"{folder}/{path.name}", abs_src_path=str(path))
    for page, write in MADE.items():
        add(page, content=write())
    for file in [*files.documentation_pages()]:
        for path in linked(file.content_string, place_of(file.src_uri)):
            if (ROOT / path).is_file() and in_site(path, files) is None:
                add(_page_of(path), content=_as_page(path))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Each link as it is in the site; one that leads nowhere is left to mkdocs, which warns of it."""
    here, folder = place_of(page.file.src_uri), posixpath.dirname(page.file.src_uri) or "."
    if page.file.src_uri in WITHOUT:
        page.meta["hide"] = WITHOUT[page.file.src_uri]

    def within(link: re.Match[str]) -> str:
        target = in_site(_resolved(here, link[1]), files)
        return link[0] if target is None else posixpath.relpath(target, folder) + (link[2] or "")

    return outside_code(markdown, lambda text: _LINK.sub(within, text))


def on_post_build(config: MkDocsConfig) -> None:
    """Writes all addresses that lead out of the site to `links.txt`: they are listed, not fetched."""
    site = Path(config.site_dir)
    found = {
        address
        for page in site.rglob("*.html")
        for address in _OUTWARD.findall(page.read_text(encoding="utf-8"))
    }
    (site / "links.txt").write_text("\n".join(sorted(found)) + "\n")


def place_of(page: str) -> str:
    """The path in the repository of what a page is made from."""
    return FROM_ELSEWHERE.get(page, f"docs/{page}")


def linked(markdown: str, here: str) -> list[str]:
    """Paths in the repository of the files that a text at `here` links to."""
    paths: list[str] = []

    def keep(text: str) -> str:
        paths.extend(_resolved(here, link[1]) for link in _LINK.finditer(text))
        return text

    outside_code(markdown, keep)
    return paths


def outside_code(markdown: str, change: Callable[[str], str]) -> str:
    """The text with `change` applied to what is in no fenced block."""
    parts = re.split(r"(^```.*?^```[^\S\n]*$)", markdown, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if part.startswith("```") else change(part) for part in parts)


def _resolved(here: str, link: str) -> str:
    return posixpath.normpath(posixpath.join(posixpath.dirname(here), link))


def in_site(path: str, files: Files) -> str | None:
    """Where the site has a file of the repository; None where it has it not."""
    made = (page for page, source in FROM_ELSEWHERE.items() if source == path)
    for candidate in (*made, path.removeprefix("docs/"), _page_of(path)):
        if files.get_file_from_path(candidate):
            return candidate
    return None


def _page_of(path: str) -> str:
    return f"source/{path}.md"


_LANGUAGES = {".py": "python", ".sh": "sh", ".toml": "toml", ".yaml": "yaml", ".js": "js"}


def _as_page(path: str) -> str:
    text = (ROOT / path).read_text()
    language = _LANGUAGES.get(Path(path).suffix, "text")
    front = "---\nsearch:\n  exclude: true\nhide: [navigation, toc]\n---\n"
    return f"{front}# `{path}`\n\n````{language}\n{text}\n````\n"
