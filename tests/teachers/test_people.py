"""What people do that an oracle does not: they are late, look away, tire, err as a whole; and what one of them did."""

import dataclasses
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.errors import UserError
from gpcjax.lateness import DELAY, lateness
from gpcjax.moment import Moment
from gpcjax.teachers.oracle import Memory, synthesised
from gpcjax.teachers.replay import Replay, described_record, read_advice
from tests.teachers.test_oracle import near

DRAWS = 100_000
STEP = 0.02


def person(**changes):
    return synthesised(**{"rate": 0.3, "error": 0.0, "delta": 0.05, "time_step": STEP, **changes})


def moment(seed=0, lanes=DRAWS, **changes):
    """The present step of many lanes, whose target is above the action in all of two dimensions."""
    none, draws = np.zeros(lanes, np.int32), np.random.default_rng(seed).random((3, lanes))
    action = np.zeros((2, lanes))
    fields = {"action": action, "episode": none, "step": none, "target": action + 1.0, "sigma_human": action}
    values = {"obs": action[:1], **fields, "draws": draws, **changes}
    return Moment(**{name: None if value is None else jnp.asarray(value) for name, value in values.items()})


def in_lanes(teacher, lanes=DRAWS):
    """The same one in each of many lanes."""
    many = lambda leaf: jnp.asarray(np.broadcast_to(np.asarray(leaf)[..., None], (*leaf.shape, lanes)))  # noqa: E731
    return jax.tree.map(many, teacher)


def remembering(steps, attending=True):
    """What every lane has seen."""
    return Memory(jnp.asarray(np.full(DRAWS, attending)), jnp.asarray(np.full(DRAWS, steps, np.int32)))


COINS = np.random.default_rng(100).random((2, DRAWS))


@eqx.filter_jit
def _advice(teacher, memory, coins, moment):
    return teacher.recalling(memory).advise(coins, moment)


def advice_of(teacher, memory=(), here=None):
    """Of a teacher in all lanes, with these memories: (2, lanes)."""
    return np.asarray(
        _advice(in_lanes(teacher), memory, jnp.asarray(COINS), moment() if here is None else here)
    )


about = eqx.filter_jit(lambda teacher, moment: teacher.about(moment))
may_advise = eqx.filter_jit(lambda teacher, *given: teacher.may_advise(*given))
chance_of = eqx.filter_jit(lambda teacher, memory, sigma: teacher.recalling(memory).chance(sigma))


class TestLateness:
    @pytest.mark.parametrize(
        "delay", [{"delay": 0.1}, {"delay": 0.02, "delay_longest": 0.1}, {"delay": 0.05, "delay_shape": 2.0}]
    )
    def test_frequencies(self, delay):
        teacher = person(**delay)
        chances = lateness(DELAY, *map(delay.get, DELAY), STEP)
        assert teacher.reach == len(chances) - 1 and teacher.draws and not teacher.watches
        steps = np.asarray(about(in_lanes(teacher), moment()))
        counts = np.bincount(steps, minlength=len(chances))
        assert len(counts) == len(chances)
        for count, chance in zip(counts, chances, strict=True):
            near(count, chance, DRAWS)

    def test_one_lane_is_as_many(self):
        teacher = person(delay=0.05, delay_shape=2.0)
        alone = jax.jit(jax.vmap(lambda moment: teacher.about(moment), in_axes=-1))(moment())
        np.testing.assert_array_equal(about(in_lanes(teacher), moment()), alone)

    def test_at_once(self):
        """A teacher that is not late draws nothing and keeps nothing."""
        for teacher in (person(), person(delay=0.0), person(delay=0.009)):
            assert teacher.reach == 0 and not teacher.draws and teacher.init() == ()
            assert not np.asarray(teacher.about(moment(lanes=3, draws=None))).any()


@eqx.filter_jit
def _walk(teacher, memory, here, draws):
    def step(memory, draws):
        memory = teacher.watch(memory, dataclasses.replace(here, draws=draws))
        return memory, memory

    return jax.lax.scan(step, memory, draws)[1]


def walk(teacher, steps, lanes=8):
    """Its memory after each of many steps: each field (steps, lanes)."""
    draws = jnp.asarray(np.random.default_rng(2).random((steps, 3, lanes)))
    many = in_lanes(teacher, lanes), in_lanes(teacher.init(), lanes), moment(lanes=lanes)
    return jax.tree.map(np.asarray, _walk(*many, draws))


class TestAttention:
    @pytest.mark.parametrize(
        ("attention", "distraction"), [(0.5, 0.25), (0.1, 0.4), (0.2, None), (0.02, 0.06)]
    )
    def test_spells(self, attention, distraction):
        """Both kinds last as long as was said, in the mean: so this share of the time is attended."""
        teacher = person(attention=attention, distraction=distraction)
        attending = walk(teacher, 20_000).attending
        means = attention / STEP, (distraction or attention) / STEP
        changes = np.diff(attending.astype(int), axis=0)
        for mean, share, ends in zip(means, (attending, ~attending), (-1, 1), strict=True):
            spells = (changes == ends).sum()
            assert share[:-1].sum() / spells == pytest.approx(mean, rel=0.05 if mean > 1 else 1e-9)
        assert attending.mean() == pytest.approx(means[0] / sum(means), rel=0.05)

    def test_it_is_silent_when_it_looks_away(self):
        """And looks before its first step."""
        teacher = person(rate=1.0, attention=0.1)
        assert teacher.watches and teacher.draws and bool(teacher.init().attending)
        looks = np.arange(DRAWS) % 3 > 0
        advice = advice_of(teacher, remembering(5, looks))
        np.testing.assert_array_equal(advice, [looks, looks])

    def test_a_spell_shorter_than_a_step_lasts_one(self):
        attending = walk(person(attention=1e-9, distraction=1e-9), 10).attending
        assert not attending[::2].any() and attending[1::2].all()


class TestFading:
    @pytest.mark.parametrize("seen", [0, 1, 50, 500])
    def test_the_chance_dies(self, seen):
        """As rate * exp(-tau * steps), of the steps seen before this one."""
        teacher, memory = person(fading=0.01), remembering(seen + 1)
        chance = 0.3 * np.exp(-0.01 * seen)
        here = chance_of(in_lanes(teacher), memory, np.zeros((2, DRAWS)))
        np.testing.assert_allclose(here, chance, rtol=1e-12)
        near((advice_of(teacher, memory) != 0).sum(), chance, 2 * DRAWS)

    def test_steps_are_counted(self):
        teacher = person(fading=0.01)
        assert teacher.watches
        np.testing.assert_array_equal(walk(teacher, 30).steps[:, 0], np.arange(1, 31))

    def test_with_errors(self):
        """The share of wrong advice is the same however seldom it comes."""
        advice, chance = advice_of(person(rate=1.0, error=0.2, fading=0.05), remembering(10)), np.exp(-0.45)
        near((advice != 0).sum(), chance, 2 * DRAWS)
        near((advice < 0).sum(), 0.2 * chance, 2 * DRAWS)


class TestWhole:
    def test_all_signs_are_wrong_together(self):
        teacher = person(rate=1.0, error=0.2, whole_error=1)
        assert teacher.whole and teacher.draws and not teacher.watches
        advice = advice_of(teacher)
        assert (advice[0] == advice[1]).all() and (advice != 0).all()
        near((advice[0] == -1).sum(), 0.2, DRAWS)

    def test_without_it_more_vectors_are_wrong(self):
        """36% of those of two dimensions, with a chance of 20% for each."""
        advice = advice_of(person(rate=1.0, error=0.2))
        near((advice == -1).any(0).sum(), 0.36, DRAWS)
        near((advice == -1).all(0).sum(), 0.04, DRAWS)

    def test_a_rare_teacher_errs_as_often(self):
        advice = advice_of(person(rate=0.1, error=0.2, whole_error=1))
        near((advice != 0).sum(), 0.1, 2 * DRAWS)
        near((advice == -1).sum(), 0.02, 2 * DRAWS)
        assert not (advice[0] * advice[1] == -1).any()


@pytest.mark.parametrize("active_gain", [0.0, 2.0])
def test_may_advise_refuses_nothing_that_is_given(active_gain):
    """Whatever the teacher remembers and wherever sigma_h lies: it only thins out what cannot be."""
    largest = 0.2
    teacher = person(
        active_gain=active_gain, attention=0.1, fading=0.003, delay=0.1, whole_error=1, error=0.3
    )
    sigma = largest * np.random.default_rng(3).random((2, DRAWS))
    sigma[:, :1000] = largest
    here = moment(sigma_human=sigma)
    may = np.asarray(may_advise(in_lanes(teacher), COINS, np.full(DRAWS, largest), here.step))
    for seen, attending in ((1, True), (5, np.arange(DRAWS) % 2 > 0), (200, True)):
        given = advice_of(teacher, remembering(seen, attending), here) != 0
        assert given.any() and not (given & ~may).any()
        assert seen > 1 or (given.sum() < may.sum()) == (active_gain > 0)
    assert 0 < may.mean() < 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"distraction": 1.0}, "distraction: without attention it changes nothing, give both"),
        ({"delay_shape": 3.0}, "delay_shape: without delay it changes nothing, give both"),
        ({"delay": 1.0, "delay_longest": 0.5}, "delay_longest 0.5: give at least delay, 1"),
    ],
)
def test_refused(given, message):
    with pytest.raises(UserError) as refused:
        person(**given)
    assert str(refused.value) == message


FIRST = {"format": 1, "settings": {}, "place": {}}


def written(folder, *events):
    """A record of a session with these events."""
    path = folder / "record.jsonl"
    path.write_text("".join(json.dumps(each) + "\n" for each in (FIRST, *events)))
    return str(path)


def advised(episode, step, *advice):
    return {"event": "advise", "episode": episode, "step": step, "advice": list(advice)}


UNDO = {"event": "undo", "episode": 0, "step": 9}


class TestReplay:
    def test_the_table(self, tmp_path):
        """Of several at a step the last one of each dimension holds; what was undone was not given."""
        path = written(
            tmp_path,
            {"event": "propose", "episode": 0, "step": 0, "obs": [0.5]},
            advised(0, 0, 1, -1),
            advised(0, 2, 1, 0),
            UNDO,
            advised(0, 3, 0, 1),
            advised(0, 3, -1, 0),
            advised(0, 4, 1, 1),
            advised(0, 4, -1, 0),
            {"event": "end", "episode": 0, "step": 4},
            advised(2, 1, -1, 0),
            advised(2, 1, 1, 1),
            advised(2, 1, 1, 1),
            UNDO,
            UNDO,
        )
        recorded = read_advice(path)
        assert recorded.longest == 5
        np.testing.assert_array_equal(recorded.moments, [0, 3, 4, 11])
        np.testing.assert_array_equal(recorded.given, [(1, -1), (-1, 1), (-1, 1), (-1, 0)])

    def test_it_is_given_at_its_steps_whatever_the_coins(self, tmp_path):
        spec = described_record(written(tmp_path, advised(0, 1, 1, -1), advised(1, 0, 0, 1)), "teacher")
        assert (spec.action_size, spec.needs_expert, spec.label) == (2, False, "recording record.jsonl")
        teacher = spec.make()
        assert isinstance(teacher, Replay) and not teacher.draws and teacher.reach == 0
        late = 2**30
        """An episode, or a step, whose number would be another's in 32 bits."""
        places = np.array(
            [(0, 0), (0, 1), (1, 0), (1, 1), (0, 7), (5, 0), (0, 2), (late, 0), (0, late), (2 * late - 1, 0)],
            np.int32,
        ).T
        expected = np.array([[0, 0], [1, -1], [0, 1], *[[0, 0]] * 7]).T
        lanes = places.shape[1]
        many = jax.jit(Replay.during)(in_lanes(teacher, lanes), places[0])
        here = moment(lanes=lanes, episode=places[0], step=places[1])
        for drawn in (np.zeros((2, lanes)), np.ones((2, lanes))):
            np.testing.assert_array_equal(jax.jit(Replay.advise)(many, drawn, here), expected)
            np.testing.assert_array_equal(may_advise(many, drawn, np.zeros(lanes), here.step), expected != 0)

        def alone(episode, step):
            return teacher.during(episode).may_advise(jnp.zeros(2), jnp.zeros(()), step)

        np.testing.assert_array_equal(jax.jit(jax.vmap(alone))(*places), expected.T != 0)
        np.testing.assert_array_equal(many.chance(jnp.zeros((2, 6))), 1.0)

    @pytest.mark.parametrize(
        ("events", "message"),
        [
            ([], "nobody gave advice in this session"),
            ([advised(0, 0, 1), UNDO], "nobody gave advice in this session"),
            ([advised(0, 0, 1), advised(0, 1, 1, 1)], "its advice has different sizes"),
            ([advised(50000, 0, 1), advised(0, 50000, 1)], "50,001 episodes of 50,001 steps are too many"),
            ([advised(0, 0, 2)], ", line 2: this is no event of a session"),
            ([advised(0, 0, 1), advised(0, -1, 1)], ", line 3: this is no event of a session"),
            ([advised(0, 0, [1])], ", line 2: this is no event of a session"),
            ([advised(0, 0, 0.5)], ", line 2: this is no event of a session"),
            ([{"event": "advise", "episode": 0, "step": 0}], ", line 2: this is no event of a session"),
            ([{"event": "dance", "episode": 0, "step": 0}], ", line 2: this is no event of a session"),
            ([{"event": "undo", "episode": 0}], ", line 2: this is no event of a session"),
        ],
    )
    def test_refused(self, tmp_path, events, message):
        with pytest.raises(UserError) as refused:
            described_record(written(tmp_path, *events), "teacher")
        told = str(refused.value)
        assert told.startswith("teacher replay:") and message in told and "\n" not in told

    def test_what_is_no_record_is_refused(self, tmp_path):
        path = tmp_path / "other"
        with pytest.raises(UserError, match=r"teacher replay:.*other: it cannot be read \(No such file"):
            described_record(str(path), "teacher")
        for content, message in (
            (b"", "this is no record of a session"),
            (b"[1]\n", "line 1: this is no record"),
            (b'{"format": 2, "settings": {}, "place": {}}\n', "or one of another format"),
            (b"{" * 100_000 + b"\n", "line 1: this is no record"),
            (b"\xff\xfe\n", "this is no text"),
        ):
            path.write_bytes(content)
            with pytest.raises(UserError, match=message):
                read_advice(str(path))
