"""The site as `make docs` builds it: without a warning, nothing loaded from elsewhere, search from a disk."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.pages import ROOT

pytestmark = pytest.mark.slow
CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs")
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0 and "WARNING" not in done.stderr, done.stderr
    return out


def test_nothing_is_loaded_from_elsewhere(site):
    """Links lead out, and are listed; styles, scripts, fonts and pictures are here."""
    assert len(list(site.rglob("*.html"))) > 25
    outward = set()
    for page in site.rglob("*.html"):
        text = page.read_text()
        outward |= {*re.findall(r'<a [^>]*href="(https?://[^"]+)"', text)}
        tags = "".join(re.findall(r"<(?:script|link|img|iframe|source)\b[^>]*>", text))
        assert not re.search(r'(?:src|href)="(?:https?:)?//', tags), page
    listed = {*(site / "links.txt").read_text().split()}
    assert outward and outward <= listed
    for style in site.rglob("*.css"):
        assert not re.search(r"url\((?:https?:)?//|@import", style.read_text()), style


def test_each_public_name_has_its_place(site):
    import gpcjax

    text = "".join(page.read_text() for page in (site / "reference").glob("*.html"))
    for name in gpcjax.__all__:
        assert re.search(rf'id="gpcjax\.{name}"', text), name


@pytest.mark.skipif(not CHROMIUM.exists(), reason="no Chromium here")
def test_search_works_from_a_disk(site):
    """In a browser without a network, and no page is wider than a phone."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 800})
        asked, failed = [], []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: failed.append(str(error)))
        page.goto((site / "reference" / "commands.html").as_uri())
        page.keyboard.press("/")
        page.keyboard.type("sparsify")
        page.wait_for_selector(".md-search-result__link", timeout=20_000)
        found = page.locator(".md-search-result__link").evaluate_all("links => links.map(link => link.href)")
        assert any("commands.html" in link for link in found)
        assert all(url.startswith(("file:", "data:", "blob:")) for url in asked) and not failed
        page.set_viewport_size({"width": 390, "height": 844})
        for name in ("index", "concepts", "results", "reference/making"):
            page.goto((site / f"{name}.html").as_uri())
            assert page.evaluate("document.documentElement.scrollWidth") <= 390, name
        browser.close()
