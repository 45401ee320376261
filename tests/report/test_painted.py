"""Figures that several processes paint."""

import os
import threading

import pytest

from gpcjax.report.figures import painted, style


@pytest.fixture
def three(monkeypatch):
    """Three cores, whatever the machine."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1, 2})


def figure(title):
    figure, (axis,) = style.panels(["$x$"])
    axis.set_title(title)
    axis.plot([0.0, 1.0, 0.5])
    return figure


def test_they_are_what_one_process_makes_of_them(three):
    titles = [f"title {number}" for number in range(5)]
    images = painted.painted([figure(title) for title in titles])
    for title, image in zip(titles, images, strict=True):
        alone = figure(title)
        assert image.files == {kind: style.image(alone, kind) for kind in ("png", "pdf")}
        assert image.svg == style.image(alone, "svg")


@pytest.mark.parametrize("number", [0, 1, 2, 7])
def test_each_item_is_done_once_and_by_as_many_as_there_are_cores(three, number):
    done = painted.spread(lambda item: (item, os.getpid()), range(number))
    assert [item for item, _ in done] == list(range(number))
    assert len({process for _, process in done}) == min(number, 3)


def test_what_a_copy_does_not_bring_back_is_done_here(three):
    parent = os.getpid()

    def mortal(item):
        if os.getpid() != parent and item == 1:
            os.kill(os.getpid(), 9)
        if os.getpid() != parent and item == 2:
            raise ValueError("as here, where it is told")
        return item, os.getpid()

    done = painted.spread(mortal, range(6))
    assert [item for item, _ in done] == list(range(6)) and {process for _, process in done} == {parent}


def test_an_error_is_an_error_and_no_copy_outlives_it(three):
    parent = os.getpid()

    def fails(item):
        if os.getpid() == parent:
            raise ValueError(f"item {item}")
        threading.Event().wait()

    with pytest.raises(ValueError, match="item 0"):
        painted.spread(fails, range(3))
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)


def test_where_other_threads_are_there_are_no_copies(three):
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    try:
        assert set(painted.spread(lambda item: os.getpid(), range(3))) == {os.getpid()}
    finally:
        over.set()
        thread.join()
