"""A report that is not drawn twice, and one that is drawn while its sweep runs."""

import shutil
import threading
import time

import pytest

from gpcjax.errors import UserError
from gpcjax.report import live
from gpcjax.report.figures import drawing
from gpcjax.report.live import Live
from gpcjax.report.run import draw
from tests.report import synthetic

PATIENCE = 120.0
pytestmark = pytest.mark.usefixtures("figures_unpainted")


@pytest.fixture
def store(out):
    frame = synthetic.episodes(seeds=3, errors=(0.0,), length=6)
    return synthetic.write(
        out, frame, synthetic.corrections(seeds=3, errors=(0.0,)), synthetic.manifest(frame)
    )


def drawn(out, monkeypatch, **options):
    """Whether anything was drawn; the summary is the same."""
    calls = []

    def write(*arguments):
        calls.append(arguments)
        return whole(*arguments)

    whole = drawing.write
    with monkeypatch.context() as patched:
        patched.setattr(drawing, "write", write)
        summary = draw(out, **options)
    assert summary.files and all(path.exists() for path in summary.files)
    return bool(calls), summary


def test_what_was_drawn_of_the_same_rows_is_left_as_it_is(store, monkeypatch):
    done, first = drawn(store, monkeypatch, anew=False)
    assert done
    done, again = drawn(store, monkeypatch, anew=False)
    assert not done
    assert sorted(again.files) == sorted(first.files) and again.table().equals(first.table())
    assert drawn(store, monkeypatch)[0]  # as `gpcjax report` does


def test_it_is_drawn_where_anything_differs(store, monkeypatch):
    draw(store)
    (store / "curves.pdf").unlink()
    assert drawn(store, monkeypatch, anew=False)[0]
    (store / "curves.png").write_bytes(b"somebody's own")
    assert drawn(store, monkeypatch, anew=False)[0]
    page = store / "report.html"
    page.write_text(page.read_text().replace("gpcjax-drawn", "gpcjax-drew"))
    assert drawn(store, monkeypatch, anew=False)[0]
    page.write_bytes(b"\xff" * 100)
    assert drawn(store, monkeypatch, anew=False)[0]
    frame = synthetic.episodes(seeds=4, errors=(0.0,), length=6)
    for folder in ("episodes", "corrections"):
        shutil.rmtree(store / folder)
    synthetic.write(store, frame, synthetic.corrections(seeds=4, errors=(0.0,)), synthetic.manifest(frame))
    assert drawn(store, monkeypatch, anew=False)[0]
    assert not drawn(store, monkeypatch, anew=False)[0]


def test_a_page_that_a_browser_loads_anew(store, monkeypatch):
    draw(store, refresh=5)
    assert '<meta http-equiv="refresh" content="5">' in (store / "report.html").read_text()
    assert drawn(store, monkeypatch, anew=False)[0]  # the last one stands still
    assert "http-equiv" not in (store / "report.html").read_text()


@pytest.mark.parametrize("options", [{"anew": "no"}, {"refresh": -1}, {"refresh": True}, {"refresh": 0.5}])
def test_other_values_are_refused(store, options):
    with pytest.raises(UserError, match=next(iter(options))):
        draw(store, **options)


def test_it_is_drawn_while_the_sweep_runs_and_no_longer(out, monkeypatch):
    frame = synthetic.episodes(algos=("coach",), seeds=2, errors=(0.0,), length=3)
    rows = synthetic.corrections(algos=("coach",), seeds=2, errors=(0.0,)).iloc[:0]
    store = synthetic.write(out, frame, rows, synthetic.manifest(frame))
    monkeypatch.setattr(live, "FIRST_SECONDS", 0.01)
    drawing_ = Live(store)
    thread = threading.Thread(target=drawing_.run)
    thread.start()
    limit = time.monotonic() + PATIENCE
    while not (store / "report.html").exists() and time.monotonic() < limit and thread.is_alive():
        time.sleep(0.05)
    drawing_.stop()
    thread.join(PATIENCE)
    assert not thread.is_alive()
    assert 'http-equiv="refresh"' in (store / "report.html").read_text()
    assert not list(store.glob(".gpcjax*.html*"))


def test_without_rows_nothing_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(live, "FIRST_SECONDS", 0.001)
    drawing_ = Live(tmp_path)
    thread = threading.Thread(target=drawing_.run)
    thread.start()
    time.sleep(0.05)
    drawing_.stop()
    thread.join(PATIENCE)
    assert not thread.is_alive() and drawing_._drawing is None
