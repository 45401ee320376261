"""What a pool hands out of runs that ended, where nobody wants what they learned."""

import jax

from gpcjax.engine.lanes import LEARNED
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
        learned = (lane.state, lane.controller), (whole[name].state, whole[name].controller)
        assert [bool(jax.tree.leaves(each)) for each in learned] == [False, True]
        rest = {field: value for field, value in kept(whole[name]).items() if field not in LEARNED}
        assert_same_bits({field: kept(lane)[field] for field in rest}, rest)
