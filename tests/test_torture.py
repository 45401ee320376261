"""A sample of `make torture`: every fault alone, and a few together."""

import pytest

from tests import torture


@pytest.mark.parametrize(
    ("sealed", "cases"),
    [
        (True, len(torture.FAULTS)),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((True, 42), (False, len(torture.FAULTS)))),
    ],
)
def test_every_fault_is_found(sealed, cases):
    judged = list(torture.torture(cases, seed=1, sealed=sealed))
    wrong = [f"{name}\n{why}" for name, status, why in judged if status is None]
    assert not wrong, "\n".join(wrong)
    # And what could be mended was: of a store with sums only another's manifest stands in the way.
    refused = {name.partition(": ")[2] for name, status, _ in judged if status == "refused"}
    assert all("manifest: " in name for name in refused)
    if sealed:
        assert all("manifest: of another sweep" in name for name in refused)
        assert sum(status == "computed again" for _, status, _ in judged) > cases / 2
