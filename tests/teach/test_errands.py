"""What can wait: in order, the newest of a name, never lost at the end."""

import threading

import pytest

from gpcjax.teach.errands import Errands

LONG = 60.0


@pytest.fixture
def busy():
    """Errands whose thread is busy until `go`, and what failed."""
    failed, go, begun = [], threading.Event(), threading.Event()
    errands = Errands(failed.append)

    def hold():
        begun.set()
        assert go.wait(LONG)

    errands.ask("hold", hold)
    assert begun.wait(LONG)
    yield errands, go, failed
    go.set()
    errands.close()


def test_one_after_the_other_in_a_thread_of_its_own(busy):
    errands, go, failed = busy
    done = []
    for name in "abc":
        errands.ask(name, lambda name=name: done.append((name, threading.current_thread().name)))
    go.set()
    errands.close()
    assert done == [("a", "errands"), ("b", "errands"), ("c", "errands")] and failed == []


def test_of_several_of_a_name_the_newest(busy):
    errands, go, _ = busy
    done = []
    for number in range(5):
        errands.ask("map", lambda number=number: done.append(number))
    go.set()
    errands.close()
    assert done == [4]


def test_what_fails_is_told_and_the_next_is_done(busy):
    errands, go, failed = busy
    done = threading.Event()
    errands.ask("bad", lambda: 1 // 0)
    errands.ask("good", done.set)
    go.set()
    assert done.wait(LONG)
    assert [type(error) for error in failed] == [ZeroDivisionError]


def test_a_pause_between_two_holds_up_no_other_and_not_the_end(busy):
    errands, go, _ = busy
    done, first, other = [], threading.Event(), threading.Event()
    go.set()
    errands.ask("keep", first.set, 3600.0)
    assert first.wait(LONG), "the first of a name waits for nothing"
    errands.ask("keep", lambda: done.append("keep"), 3600.0)
    errands.ask("map", other.set)
    assert other.wait(LONG) and done == []
    errands.close()
    assert done == ["keep"]


def test_one_that_is_asked_for_without_a_pause_does_not_wait_for_an_earlier_one_that_does(busy):
    errands, go, _ = busy
    first, second = threading.Event(), threading.Event()
    go.set()
    errands.ask("keep", first.set, 3600.0)
    assert first.wait(LONG)
    errands.ask("keep", lambda: None, 3600.0)
    errands.ask("keep", second.set, 0.0)
    assert second.wait(LONG)


def test_dropped_at_the_end_but_for_what_is_being_done(busy):
    errands, go, _ = busy
    done = []
    errands.ask("more", lambda: done.append("more"))
    ending = threading.Thread(target=lambda: errands.close(drop=True))
    ending.start()
    ending.join(0.05)
    assert ending.is_alive(), "what is being done is waited for"
    go.set()
    ending.join(LONG)
    assert not ending.is_alive() and done == []


def test_one_that_asks_for_itself_again_ends_with_the_others():
    errands = Errands(lambda error: None)
    begun, count = threading.Event(), []

    def again():
        count.append(1)
        begun.set()
        if len(count) < 3:
            errands.ask("flush", again, 3600.0)

    errands.ask("flush", again, 3600.0)
    assert begun.wait(LONG)
    errands.close()
    assert len(count) <= 2, "what is asked for after the end is not done"
