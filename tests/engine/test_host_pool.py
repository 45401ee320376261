"""Runs of a task on the host: their bits depend on nothing but themselves either."""

import pytest

from tests.engine.host_tasks import host_drift
from tests.engine.test_pool import Bits


class OnHost(Bits):
    env = host_drift()


@pytest.mark.slow
class TestGPC(OnHost):
    algo = "gpc"


@pytest.mark.slow
class TestGPCNS(OnHost):
    algo = "gpc-ns"


class TestCOACH(OnHost):
    algo = "coach"

    @pytest.mark.slow
    def test_against_a_plain_loop(self, pool, together):
        super().test_against_a_plain_loop(pool, together)
