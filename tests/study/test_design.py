"""Orders and slots: balanced, deterministic, and given again."""

from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpcjax.errors import UserError
from gpcjax.study.design import Arm, base_seed, cells, free_slot, orders, slots

COUNTS = st.integers(2, 9)


@given(COUNTS)
def test_a_latin_square_is_balanced(count):
    square = orders(range(count), "latin")
    assert all(sorted(row) == list(range(count)) for row in square)
    places = Counter((place, thing) for row in square for place, thing in enumerate(row))
    follows = Counter(pair for row in square for pair in pairwise(row))
    assert len(places) == count * count and len(set(places.values())) == 1
    assert len(follows) == count * (count - 1) and len(set(follows.values())) == 1


def test_all_orders_or_one():
    assert len(orders("abcd", "complete")) == 24 and orders("abcd", "fixed") == (("a", "b", "c", "d"),)
    with pytest.raises(UserError, match="too many"):
        orders("abcdefg", "complete")


ARMS = st.lists(st.integers(1, 3), min_size=1, max_size=3).map(
    lambda sizes: [Arm(f"arm{k}", tuple("xyz"[:size])) for k, size in enumerate(sizes)]
)


@given(ARMS, st.booleans(), st.integers(0, 60), st.integers(0, 10**6))
def test_slots_are_balanced_at_any_number_of_participants(arms, within, participants, seed):
    every = cells(arms, within, ("s", "t"), "latin", "complete")
    given_ = slots(every, participants, seed, None, arms)
    assert len(given_) == participants and given_ == slots(every, participants, seed, None, arms)
    for end in range(participants + 1):
        of_arms = Counter(cell.arm for cell in given_[:end])
        counts = [of_arms[arm] for arm in {cell.arm for cell in every}]
        assert max(counts) - min(counts) <= 1
        for arm in of_arms:
            of_cells = Counter(cell for cell in given_[:end] if cell.arm == arm)
            counts = [of_cells[cell] for cell in every if cell.arm == arm]
            assert max(counts) - min(counts) <= 1


@given(ARMS, st.integers(1, 4), st.integers(1, 9), st.integers(0, 99))
def test_no_cap_is_exceeded(arms, most, of_first, seed):
    arms = [Arm("capped", arms[0].learners, most=of_first), *arms[1:]]
    every = cells(arms, False, ("s", "t"), "complete", "complete")
    given_ = slots(every, 10_000, seed, most, arms)
    assert max(Counter(given_).values()) <= most
    assert sum(cell.arm == "capped" for cell in given_) <= of_first
    room = sum(
        min(of_first if arm.name == "capped" else 10_000, most * sum(cell.arm == arm.name for cell in every))
        for arm in arms
    )
    assert len(given_) == room, "no room is left unused"


def test_seeds_shuffle():
    every = cells([Arm("all", ("x", "y", "z"))], False, ("s", "t"), "complete", "complete")
    assert len({slots(every, 12, seed, None, []) for seed in range(20)}) > 10


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 99)), max_size=60), st.integers(1, 8))
def test_a_slot_is_given_again_when_its_holder_drops_out(events, count):
    held = {}
    for number, (comes, who) in enumerate(events):
        if comes:
            slot = free_slot(count, held.values())
            assert (slot is None) == (len(held) == count)
            if slot is not None:
                assert slot not in held.values() and set(range(slot)) <= set(held.values())
                held[number] = slot
        elif held:
            del held[sorted(held)[who % len(held)]]


def test_seeds_of_runs_never_meet():
    seeds = {base_seed(5, number) + run for number in range(1, 50) for run in range(1, 81)}
    assert len(seeds) == 49 * 80
