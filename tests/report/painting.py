"""What `test_painted` asks of a process of its own, as there must be no jax in it: of three cores."""

import json
import os
import threading
import traceback

from gpcjax.report.figures import painted, style


def figure(title):
    figure, (axis,) = style.panels(["$x$"])
    axis.set_title(title)
    axis.plot([0.0, 1.0, 0.5])
    return figure


def they_are_what_one_process_makes_of_them():
    titles = [f"title {number}" for number in range(4)]
    images = painted.painted([figure(title) for title in titles])
    for title, image in zip(titles, images, strict=True):
        alone = figure(title)
        assert image.files == {kind: style.image(alone, kind) for kind in ("png", "pdf")}
        assert image.svg == style.image(alone, "svg")


def each_is_done_once_and_by_as_many_as_there_are_cores():
    for number in (0, 1, 2, 7):
        done = painted.spread(lambda item: (item, os.getpid()), range(number))
        assert [item for item, _ in done] == list(range(number))
        assert len({process for _, process in done}) == min(number, 3)


def what_a_copy_does_not_bring_back_is_done_here():
    parent = os.getpid()

    def mortal(item):
        if os.getpid() != parent and item == 1:
            os.kill(os.getpid(), 9)
        if os.getpid() != parent and item == 2:
            raise ValueError("as here, where it is told")
        return item, os.getpid()

    done = painted.spread(mortal, range(6))
    assert [item for item, _ in done] == list(range(6)) and {process for _, process in done} == {parent}


def an_error_is_an_error_and_no_copy_outlives_it():
    parent = os.getpid()

    def fails(item):
        if os.getpid() == parent:
            raise ValueError(f"item {item}")
        threading.Event().wait()

    try:
        painted.spread(fails, range(3))
    except ValueError as error:
        assert str(error) == "item 0"
    else:
        raise AssertionError("no error")
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return
    raise AssertionError("a copy is there")


def where_other_threads_are_there_are_no_copies():
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    try:
        assert set(painted.spread(lambda item: os.getpid(), range(3))) == {os.getpid()}
    finally:
        over.set()
        thread.join()


ASKED = (
    they_are_what_one_process_makes_of_them,
    each_is_done_once_and_by_as_many_as_there_are_cores,
    what_a_copy_does_not_bring_back_is_done_here,
    an_error_is_an_error_and_no_copy_outlives_it,
    where_other_threads_are_there_are_no_copies,
)

if __name__ == "__main__":
    os.sched_getaffinity = lambda process: {0, 1, 2}
    for function in ASKED:
        try:
            function()
            wrong = ""
        except Exception:
            wrong = traceback.format_exc()
        print(json.dumps([function.__name__, wrong]), flush=True)
