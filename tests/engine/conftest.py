"""The pool of a class of tests, and what all its runs come to."""

import pytest

from tests.engine.tasks import TIERS, make_pool, run, starts


@pytest.fixture(scope="class")
def pool(request):
    """For the task `env` and the learner `algo` of the class."""
    algo = request.cls.algo
    return make_pool(request.cls.env, starts(algo)[0], TIERS[algo])


@pytest.fixture(scope="class")
def together(request, pool):
    """Every run of `starts`, side by side; more than the first block has places."""
    lanes = run(pool, starts(request.cls.algo))
    request.cls.compiled = pool.counters.compilations
    return lanes
