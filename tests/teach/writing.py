"""What lessons and halls have of Python's processes and memory, quicker, where a test is about neither."""

import pickle

import pytest


class WritesHere:
    """In place of the process that writes, which test_clerk.py has: what goes there is packed as for it."""

    @staticmethod
    def write(kept):
        parts = []
        pickle.loads(pickle.dumps(kept, protocol=5, buffer_callback=parts.append), buffers=parts).write()

    def close(self):
        pass


class Garbage:
    """In place of Python's gc: to look through all that tests hold takes longer than a lesson.

    Nor is given free what the tests had put aside, at which all that follow would have to look.
    """

    def __init__(self):
        self.done = []

    def collect(self):
        self.done.append("collect")

    def freeze(self):
        self.done.append("freeze")

    def unfreeze(self):
        self.done.append("unfreeze")


@pytest.fixture(scope="module")
def garbage_stays():
    """None is collected by lessons and halls; gives what they asked for."""
    garbage = Garbage()
    with pytest.MonkeyPatch.context() as patch:
        for module in ("gpcjax.teach.lesson", "gpcjax.study.hall"):
            patch.setattr(f"{module}.gc", garbage)
        yield garbage.done
