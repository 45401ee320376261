"""What a pool hands out of runs that ended, where nobody wants what they learned."""

import dataclasses

from gpcjax.engine.pool import Pool
from tests.engine.tasks import EPISODES, TIERS, Drift, expert, kept, run, starts
from tests.trees import assert_same_bits


def test_rows_come_without_what_was_learned():
    some = starts("coach")[:3]
    whole, bare = (
        run(Pool(Drift(), expert, EPISODES, some[0], TIERS["coach"], learned=learned), some)
        for learned in (True, False)
    )
    for name, lane in bare.items():
        assert lane.state is None and whole[name].state is not None
        without = dataclasses.replace(whole[name], state=None, controller=None)
        assert_same_bits(kept(lane), kept(without))
