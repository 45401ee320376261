"""What a notebook shows while a sweep runs: one output that is replaced, with the table and the bar of a terminal."""

import sys
from types import SimpleNamespace

import pytest

from gpcjax.sweep import notebook
from gpcjax.sweep.notebook import Notebook, in_notebook, usual_watcher
from gpcjax.sweep.progress import Bar
from gpcjax.sweep.telling import State


class Display:
    def __init__(self):
        self.shown = []

    def display(self, what, display_id):
        assert display_id
        self.shown.append(what)
        return self

    def update(self, what):
        self.shown.append(what)


@pytest.fixture
def display(monkeypatch):
    made = Display()
    monkeypatch.setitem(sys.modules, "IPython.display", made)
    monkeypatch.setattr(notebook, "APART", 0.0)
    return made


def test_one_output_is_replaced(display):
    with Notebook("cartpole", 10, 2) as watcher:
        watcher.show(State(finished=3, steps=1000, compiling=True))
    first, during, last = map(repr, display.shown)
    assert first == "cartpole: 10 cells in 2 processes"
    assert "cartpole: 3/10 cells, " in during and "compiling" in during
    assert last.startswith("cartpole: 3/10 cells in 0:00, ") and "compiling" not in last
    assert display.shown[0]._repr_html_().startswith("<pre")


def test_markup_in_a_name_is_text(display):
    with Notebook("<b>task</b>", 1, 1):
        pass
    assert "&lt;b&gt;task" in display.shown[0]._repr_html_()


def test_pictures_are_apart(display, monkeypatch):
    monkeypatch.setattr(notebook, "APART", 1e6)
    with Notebook("cartpole", 10, 2) as watcher:
        watcher._shown = notebook.time.monotonic()
        for finished in range(10):
            watcher.show(State(finished=finished))
    assert len(display.shown) == 2


@pytest.mark.parametrize(
    ("shell", "expected"),
    [(None, False), (SimpleNamespace(), False), (SimpleNamespace(kernel=object()), True)],
)
def test_only_a_kernel_is_a_notebook(shell, expected, monkeypatch):
    """IPython in a terminal is one."""
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert in_notebook() == expected
    assert usual_watcher() is (Notebook if expected else Bar)


def test_without_ipython_there_is_none(monkeypatch):
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    assert not in_notebook()
