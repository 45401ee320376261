"""Sessions that share blocks: each is to the bit what its recording makes again, alone."""

import dataclasses
import json
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.engine.classroom import LEAST, MOST, Classroom, kind_of, lanes_for, rooms_of
from gpcjax.engine.course import credit_of
from gpcjax.engine.seated import in_classroom, leave, propose_together
from gpcjax.engine.session import Session
from gpcjax.engine.stepping import propose
from gpcjax.errors import UserError
from gpcjax.learners.factory import make_learner
from gpcjax.recording import Deferred, Recording
from tests.trees import assert_same_bits

ROOMS = ((4, 4), (8, 32))
PLAIN = {"credit": None, "credit_longest": None, "credit_shape": None, "time_step": 0.1}
LATE = {**PLAIN, "credit": 0.2, "credit_longest": 0.4}
SIZES = {"obs_size": 2, "action_size": 2}
COACH = {"lower": (-1.0, -1.0), "upper": (1.0, 1.0), "counts": (3, 3)}


def make(algo, **options):
    more = {"coach": COACH, "d-coach": {"width": 4, "batch_size": 2, "replay_every": 3}}
    small = {"policy_capacity": 4, "human_capacity": 4, "on_full": "replace-nearest", "constant_rate": 0.2}
    return make_learner(algo, **SIZES, **(small if algo.startswith("gpc") else more.get(algo, {})), **options)


def rooms_for(algo):
    return ROOMS if algo.startswith("gpc") else ()


class School:
    """So many sessions of one learner in a classroom, on a task that is a walk which the actions push."""

    def __init__(self, folder, algo, settings, places, count):
        self.folder, self.learner, self.settings = folder, make(algo), settings
        self.classroom = Classroom(self.learner, credit_of(settings), rooms_for(algo), places)
        self.sessions = [self.join(seed) for seed in range(count)]
        self.draws = [np.random.default_rng(seed) for seed in range(count)]
        self.at = [draw.uniform(-1.0, 1.0, 2) for draw in self.draws]

    def join(self, seed):
        settings = {**self.settings, "seed": seed}
        return in_classroom(self.classroom, self.learner, settings, self.folder / f"{seed}.jsonl")

    def step(self, chance=0.4):
        """Some of them step, some are advised, some begin anew; by the draws of each alone."""
        stepping = [index for index, draw in enumerate(self.draws) if draw.random() < 0.9]
        for index in stepping:
            if self.draws[index].random() < 0.05:
                self.sessions[index].end_episode()
                self.at[index] = self.draws[index].uniform(-1.0, 1.0, 2)
        chosen = [self.sessions[index] for index in stepping]
        if chosen:
            assert not any(propose_together(chosen, np.array([self.at[index] for index in stepping])))
        for index in stepping:
            session, draw = self.sessions[index], self.draws[index]
            self.at[index] = 0.95 * session.obs + 0.2 * session.action + draw.normal(size=2) * 0.1
            if draw.random() < chance:
                session.advise(draw.choice([-1, 0, 1], 2))

    def again(self, seed, **options):
        self.sessions[seed].flush()
        return Session.replay(self.folder / f"{seed}.jsonl", self.learner, **options)


def assert_the_same(got, expected):
    assert_same_bits(got.state, expected.state)
    assert (got.episode, got.step, got.corrections) == (expected.episode, expected.step, expected.corrections)
    assert (got.points, got.measure()) == (expected.points, expected.measure())
    np.testing.assert_array_equal(got.uncertainty(), expected.uncertainty())


@pytest.fixture(scope="module")
def school(tmp_path_factory):
    """Eight, with advice about several steps, until dictionaries have grown."""
    made = School(tmp_path_factory.mktemp("school"), "gpc", LATE, places=8, count=8)
    for _ in range(30):
        made.step()
    return made


def test_each_is_made_again_to_the_bit(school):
    assert {session._course.desk.bench.tier.human_capacity for session in school.sessions} == {32}
    for seed in (0, 7):
        assert_the_same(school.again(seed), school.sessions[seed])


def test_they_are_not_all_the_same(school):
    actions = {tuple(session.act([0.1, 0.2])) for session in school.sessions}
    assert len(actions) == len(school.sessions)


def test_what_was_recorded_within_bounds_is_taken_as_it_is(school):
    whole, quick = school.again(3), school.again(3, check_from=10**6)
    assert_the_same(quick, whole)


def test_it_goes_on_in_another_classroom(school, tmp_path):
    before = school.again(5)
    path = tmp_path / "moved.jsonl"
    path.write_bytes((school.folder / "5.jsonl").read_bytes() + b'{"event": "prop')
    other = Classroom(school.learner, credit_of(LATE), ROOMS, 3)
    moved = Session.replay(path, school.learner, go_on=True, check_from=10**6, classroom=other)
    for session in (before, moved):
        session.propose([0.3, -0.2])
        session.advise([1, -1])
    assert_the_same(moved, before)
    moved.flush()
    assert_the_same(Session.replay(path, school.learner), before)


def test_nobody_is_disturbed_who_steps_meanwhile(school):
    """Corrections in one thread and steps in another: each session is its own."""
    taught, walking = school.sessions[:4], school.sessions[4:]
    over = threading.Event()

    def correct():
        for round in range(20):
            for session in taught:
                session.advise([1, (-1) ** round])
        over.set()

    thread = threading.Thread(target=correct)
    thread.start()
    while not over.is_set():
        propose_together(walking, np.zeros((4, 2)))
    thread.join()
    for index in (0, 4):
        assert_the_same(school.again(index), school.sessions[index])


def test_places(tmp_path):
    school = School(tmp_path, "coach", PLAIN, places=2, count=2)
    with pytest.raises(UserError, match="all 2 places are taken"):
        school.join(2)
    assert not (tmp_path / "2.jsonl").exists()
    leave(school.sessions[0])
    school.join(2)
    assert (tmp_path / "2.jsonl").read_text().count("\n") == 1


def test_a_learner_of_ones_own_with_numbers_of_pythons(tmp_path):
    """And in a block that is wider than that in which a recording is made again."""
    school = School(tmp_path, "tests.teach.drifting:Turned", PLAIN, places=16, count=2)
    for _ in range(20):
        school.step()
    assert school.sessions[1].corrections > 0
    assert {bench.tier.lanes for benches in school.classroom._benches for bench in benches} == {16}
    assert_the_same(school.again(1), school.sessions[1])


def test_an_action_that_is_no_number_stops_one_alone(tmp_path):
    school = School(tmp_path, "coach", PLAIN, places=8, count=2)
    good, bad = school.sessions
    for value in (np.nan, np.inf):
        raised = propose_together([good, bad], np.array([[1e200, 0.1], [value, 0.0]]))
        assert raised[0] is None and "is no number" in str(raised[1])
    assert (good.step, bad.step) == (1, -1)
    np.testing.assert_array_equal(good.obs, [1e60, 0.1])


def test_what_is_no_list_of_rooms_is_refused(school, tmp_path):
    first, *events = (school.folder / "1.jsonl").read_text().splitlines()
    told = json.loads(first)
    for rooms in ([[8, 8], [4, 4]], [[4]], 7):
        told["settings"]["rooms"] = rooms
        path = tmp_path / "wrong.jsonl"
        path.write_text("\n".join([json.dumps(told), *events]) + "\n")
        with pytest.raises(UserError, match="this is no session of such a learner"):
            Session.replay(path, school.learner)


def test_widths():
    assert [lanes_for(places) for places in (1, 8, 9, 64, 65)] == [8, 8, 16, 64, 128]
    assert rooms_of([[4, 8], [8, 8]]) == ((4, 8), (8, 8))
    learner = make("gpc")
    widths = {Classroom(learner, None, [(64, 64)], places)._tiers[0].lanes for places in (1, 16, 64, 1000)}
    assert widths == {LEAST, MOST}
    other = dataclasses.replace(learner, constant_rate=learner.constant_rate + 1.0)
    assert kind_of(learner, None) == kind_of(other, None) != kind_of(make("gpc-ns"), None)


class TestDeferred:
    def test_lines_are_written_when_it_is_flushed(self, tmp_path):
        recording = Deferred.new(tmp_path / "record", {}, {})
        recording.append({"event": "end", "episode": 0, "step": -1})
        assert (tmp_path / "record").read_bytes() == b""
        recording.flush()
        assert len(Recording.read(tmp_path / "record")[1]) == 1

    def test_what_cannot_be_written_is_tried_again(self, tmp_path):
        path = tmp_path / "record"
        recording = Deferred.new(path, {}, {})
        path.rename(tmp_path / "away")
        with pytest.raises(UserError, match="it cannot be written"):
            recording.flush()
        recording.append({"event": "end", "episode": 0, "step": -1})
        (tmp_path / "away").rename(path)
        recording.flush()
        assert len(Recording.read(path)[1]) == 1

    def test_what_is_appended_while_it_is_flushed_comes_with_the_next(self, tmp_path):
        recording = Deferred.new(tmp_path / "record", {}, {})
        end = {"event": "end", "episode": 0, "step": -1}

        class Busy(type(recording._waiting)):
            def __getitem__(self, place):
                self.append(end)  # another thread does
                return super().__getitem__(place)

            def __iter__(self):
                raise RuntimeError("deque mutated during iteration")

        recording.flush()
        recording._waiting = Busy()
        recording.append(end)
        recording.append(end)
        recording.flush()
        assert len(Recording.read(tmp_path / "record")[1]) == 2 and len(recording._waiting) == 2


@pytest.mark.slow
def test_blocks_of_every_width_act_alike(compiled_as_shipped):
    """64 lanes did not: so no block is wider than the widest here."""
    learner, rng = make_learner("gpc", **SIZES, capacity=64), np.random.default_rng(0)
    # Any numbers will do: what counts is the room.
    shapes = jax.eval_shape(lambda: learner.controller(learner.init()))
    controller = jax.tree.map(lambda leaf: rng.uniform(0.5, 1.5, leaf.shape).astype(leaf.dtype), shapes)
    obs = 0.3 * rng.normal(size=(2, MOST))

    def acts(width):
        wide = jax.tree.map(lambda leaf: jnp.repeat(leaf[..., None], width, axis=-1), controller)
        act = jax.jit(lambda obs: propose(wide, obs, jnp.zeros(width))[0])
        return np.concatenate(
            [act(obs[:, place : place + width]) for place in range(0, MOST, width)], axis=-1
        )

    widths = {Classroom(learner, None, [(64, 64)], places)._tiers[0].lanes for places in (1, 16, 64, 1000)}
    assert widths == {LEAST, MOST} and len(set(acts(LEAST).ravel())) > MOST
    np.testing.assert_array_equal(acts(MOST), acts(LEAST))


@pytest.mark.slow
@pytest.mark.parametrize("settings", [PLAIN, LATE], ids=["plain", "late"])
@pytest.mark.parametrize("algo", ["gpc", "gpc-ns", "coach", "d-coach"])
def test_among_64_to_the_bit(tmp_path, compiled_as_shipped, algo, settings):
    school = School(tmp_path, algo, settings, places=64, count=64)
    for _ in range(100):
        school.step(chance=0.7)
    if rooms_for(algo):
        assert max(session.points[1] for session in school.sessions) >= 32  # one has replaced points
    for seed in (0, 31, 63):
        assert_the_same(school.again(seed), school.sessions[seed])
