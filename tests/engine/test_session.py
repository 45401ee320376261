"""Teaching in a program of one's own: what is learned, kept, taken back, and made again from its record."""

import dataclasses
import json
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.engine.pool import Tier
from gpcjax.engine.session import Session
from gpcjax.errors import UserError
from gpcjax.learners.base import Status
from gpcjax.learners.saved import load_learner
from gpcjax.teachers.replay import described_record
from tests.engine.tasks import Drift, advance, learner, make_pool, reset, run, start, start_key
from tests.engine.test_late import Restless
from tests.trees import assert_close, assert_same_bits

LATE = {"credit": 0.1, "credit_longest": 0.3, "time_step": 0.1}
PLACE = np.array([0.3, -0.2])


@pytest.fixture(scope="module")
def coach():
    return learner("coach")


@pytest.fixture(scope="module")
def gpc():
    return learner("gpc", capacity=8)


def lesson(session, seed, steps=12):
    """Whatever may happen in a session, by the numbers of a seed."""
    draw = np.random.default_rng(seed)
    for _ in range(steps):
        action = session.propose(draw.uniform(-1.0, 1.0, 2))
        if draw.random() < 0.3:
            session.executed(np.clip(action + draw.normal(size=2), -1.0, 1.0))
        for _ in range(draw.integers(3)):
            session.advise(draw.integers(-1, 2, 2))
        if draw.random() < 0.2:
            session.undo()
        if draw.random() < 0.1:
            session.end_episode()
    return session


def assert_the_same(got, expected):
    """Now, and at the next advice, which is about steps that are kept."""
    for each in range(2):
        assert_same_bits(got.state, expected.state)
        now = [(session.episode, session.step, session.corrections) for session in (got, expected)]
        assert now[0] == now[1]
        if not each:
            np.testing.assert_array_equal(got.propose(PLACE), expected.propose(PLACE))
            assert_same_bits(got.advise([1, -1]), expected.advise([1, -1]))


class TestPlainly:
    """A session learns what `Learner.correct` does."""

    def test_about_the_latest_step(self, gpc):
        session, state = Session(gpc), gpc.init()
        for step, advice in enumerate(([1, 0], [0, 0], [-1, 1])):
            obs = PLACE * (step + 1)
            action = session.propose(obs)
            np.testing.assert_allclose(action, gpc.act(state, obs), rtol=0, atol=1e-12)
            assert (session.episode, session.step) == (0, step)
            info = session.advise(advice)
            state, expected = gpc.correct(state, obs, action, advice)
            given = np.array(advice) != 0
            for name, values in vars(info).items():
                wanted = np.asarray(getattr(expected, name))
                kept = (given, given) if wanted.ndim else ((), ())
                np.testing.assert_allclose(np.asarray(values)[kept[0]], wanted[kept[1]], atol=1e-12)
            assert not np.asarray(info.rate)[~given].any()
            assert_close(session.state, state, 1e-12)
        assert session.corrections == 3
        np.testing.assert_allclose(session.policy()(PLACE), gpc.act(state, PLACE), atol=1e-12)

    def test_what_was_executed_counts(self, gpc):
        session = Session(gpc)
        session.propose(PLACE)
        session.executed([0.5, -1.0])
        session.advise([1, 1])
        assert_close(session.state, gpc.correct(gpc.init(), PLACE, [0.5, -1.0], [1, 1])[0], 1e-12)

    def test_credit(self, coach):
        """Advice is about the step of two steps before, as it was executed; and never about another episode."""
        session, state = Session(coach, credit=0.2, time_step=0.1), coach.init()
        for episode in range(2):
            path = []
            for step in range(4):
                obs = PLACE * (step + 1) - episode
                path.append((obs, session.propose(obs)))
                if step == 1:
                    path[-1] = (obs, np.array([0.7, -0.1]))
                    session.executed(path[-1][1])
                advice = [1, -1] if step % 2 else [-1, 1]
                info = session.advise(advice)
                if step < 2:
                    assert info.status == Status.OK and not np.asarray(info.rate).any()
                else:
                    state, _ = coach.correct(state, *path[step - 2], advice)
                assert_close(session.state, state, 1e-12)
            session.end_episode()
        assert session.corrections == 8 and session.episode == 1

    @pytest.mark.slow
    def test_dictionaries_grow(self, gpc):
        small, large = Session(dataclasses.replace(gpc, policy_capacity=4, human_capacity=4)), Session(gpc)
        places = [[-0.9, -0.9], [0.9, -0.9], [-0.9, 0.9], [0.9, 0.9], [0.0, 0.0]]
        for place in places:
            for session in (small, large):
                session.propose(place)
                info = session.advise([1, -1])
                assert info.status == Status.OK and not np.asarray(info.full).any()
        assert small.state.policy.points.shape[1] == large.state.policy.points.shape[1] == 8
        np.testing.assert_array_equal(small.state.policy.count, [5, 5])
        np.testing.assert_allclose(small.policy()(PLACE), large.policy()(PLACE), rtol=0, atol=1e-12)
        assert small.undo() and small.state.policy.count.max() == 4


class TestUndo:
    def test_one_after_the_other(self, coach):
        session, states = Session(coach, undos=3), []
        session.propose(PLACE)
        for advice in ([1, 1], [0, 0], [-1, 0], [1, 0]):
            states.append((session.state, session.corrections))
            session.advise(advice)
        proposed = []
        for state, corrections in states[:0:-1]:
            assert session.undo()
            assert_same_bits(session.state, state)
            assert session.corrections == corrections
            proposed.append(session.propose(PLACE)[0])
        assert not session.undo() and session.corrections == 2
        assert_same_bits(session.state, states[1][0])
        assert proposed[0] != proposed[1] == proposed[2]

    def test_none_are_kept(self, coach):
        session = Session(coach, undos=0)
        session.propose(PLACE)
        session.advise([1, 1])
        assert not session.undo() and session.corrections == 2


@pytest.fixture(scope="module")
def recorded(coach, tmp_path_factory):
    """The lines of a record."""
    path = tmp_path_factory.mktemp("recorded") / "record"
    lesson(Session(coach, **LATE, record=path), 3, 4)
    return path.read_text().splitlines()


class TestRecord:
    def test_one_that_was_taken_away(self, coach, tmp_path):
        """Is not begun anew without its first lines."""
        session = Session(coach, record=tmp_path / "record")
        (tmp_path / "record").unlink()
        with pytest.raises(UserError, match=r"record: it cannot be written .No such file"):
            session.propose(PLACE)
        assert not (tmp_path / "record").exists()

    def test_made_again_to_the_bit(self, coach, tmp_path):
        """With more taken back than usual."""
        session = Session(coach, **LATE, undos=30, record=tmp_path / "record")
        lesson(session, 0, 26)
        taken = sum(session.undo() for _ in range(30))
        assert taken > 20 and session.episode > 0
        lesson(session, 1, 4)
        assert session.corrections > 0
        assert_the_same(Session.replay(tmp_path / "record", coach), session)

    def test_a_program_that_died_while_writing(self, coach, tmp_path):
        """The line that it did not finish is no event; what follows goes on behind the ones before it."""
        path = tmp_path / "record"
        lesson(Session(coach, **LATE, record=path), 1)
        whole = path.read_bytes()
        with path.open("ab") as file:
            file.write(b'{"event": "advise", "episode": 0, "st')
        session = Session.replay(path, coach)
        assert path.read_bytes() != whole
        again = Session.replay(path, coach, go_on=True)
        assert path.read_bytes() == whole
        lesson(session, 2)
        lesson(again, 2)
        assert path.read_bytes().startswith(whole) and len(path.read_bytes()) > len(whole)
        assert_same_bits(again.state, session.state)
        assert_the_same(Session.replay(path, coach), again)

    def test_what_is_there_is_kept(self, coach, tmp_path):
        path = tmp_path / "record"
        path.write_text("mine")
        with pytest.raises(UserError, match="it exists, give another path, or Session"):
            Session(coach, record=path)
        assert path.read_text() == "mine"
        with pytest.raises(UserError, match="it cannot be written"):
            Session(coach, record=tmp_path / "nowhere" / "record")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda lines: lines[:1] + lines[2:], r"line \d+: (no step|lines before it are missing)"),
            (
                lambda lines: [*lines, '{"event": "propose", "episode": 0, "step": 0}'],
                "no event of a session",
            ),
            (lambda lines: [lines[0], lines[1].replace("[", "[0.5, ")], r"line 2: obs has shape \(3,\)"),
            (lambda lines: [lines[0].replace("undos", "undo")], "its settings are those of another version"),
            (lambda lines: [lines[0].replace('"time_step": 0.1', '"time_step": 0')], "time_step 0: give a"),
            (
                lambda lines: [lines[0].replace('"history"', '"story"')],
                "this is no session of such a learner",
            ),
            (lambda lines: [lines[0].replace('"obs": [[', '"obs": [[[')], "this is no record of a session"),
            (lambda lines: [lines[0].replace('"place": {', '"place": {"a": {')], "no record of a session"),
            (lambda lines: lines[1:], "no record of a session"),
        ],
    )
    def test_another_file_is_refused(self, coach, recorded, tmp_path, change, message):
        path = tmp_path / "record"
        path.write_text("".join(f"{line}\n" for line in change(recorded)))
        with pytest.raises(UserError, match=message) as refused:
            Session.replay(path, coach)
        assert str(refused.value).startswith(str(path)) and "\n" not in str(refused.value)


class TestSaved:
    @pytest.mark.parametrize("ends", [False, pytest.param(True, marks=pytest.mark.slow)])
    def test_it_goes_on_to_the_bit(self, coach, tmp_path, ends):
        """Whoever loads it, and from its record too."""
        session = lesson(Session(coach, **LATE), 4)
        if ends:
            session.end_episode()
        session.save(tmp_path / "saved", teacher="Ada")
        with jax.enable_x64(False):
            loaded = Session.load(tmp_path / "saved", record=tmp_path / "record")
        assert loaded.episode == session.episode and loaded.step == session.step > 0
        loaded.undo()  # nothing: what could be undone is not kept
        for each in (session, loaded):
            lesson(each, 5, 4 if ends else 1)
        assert_the_same(Session.replay(tmp_path / "record", *load_learner(tmp_path / "saved")), loaded)

    def test_before_the_first_step(self, coach, tmp_path):
        Session(coach, seed=7).save(tmp_path / "saved")
        loaded = Session.load(tmp_path / "saved")
        assert (loaded.episode, loaded.step) == (0, -1)
        assert_the_same(lesson(loaded, 6), lesson(Session(coach, seed=7), 6))

    def test_a_learner_alone_is_no_session(self, coach, tmp_path):
        gpcjax.save_learner(tmp_path / "saved", coach, coach.init())
        with pytest.raises(UserError, match="this is a learner without a session: give it to"):
            Session.load(tmp_path / "saved")


def test_several_threads(coach, tmp_path):
    """One acts while two others advise, take back and look: nothing fails, and the record tells the order."""
    session, failed = Session(coach, **LATE, record=tmp_path / "record"), []
    session.propose(PLACE)

    def at_once(does, times=20):
        def run():
            try:
                for each in range(times):
                    does(each)
            except Exception as error:
                failed.append(error)

        return threading.Thread(target=run)

    threads = [
        at_once(lambda each: session.propose(PLACE * np.cos(each))),
        at_once(lambda each: session.advise([1, -1] if each % 3 else [-1, 1])),
        at_once(lambda each: session.undo() if each % 4 == 0 else session.policy()(PLACE)),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed and session.step == 20
    assert_the_same(Session.replay(tmp_path / "record", coach), session)
    kinds = [json.loads(line).get("event") for line in (tmp_path / "record").read_text().splitlines()]
    assert kinds.count("propose") == 21 + 1 and kinds.count("advise") == 20 + 1


@pytest.fixture(scope="module")
def begun(coach, tmp_path_factory):
    """A session at its first step, and its record."""
    path = tmp_path_factory.mktemp("begun") / "record"
    session = Session(coach, record=path)
    session.propose(PLACE)
    return session, path


@pytest.mark.parametrize(
    ("does", "message"),
    [
        (lambda session: session.propose([0.0]), r"obs has shape \(1,\), this learner takes \(2,\)"),
        (lambda session: session.propose([0.0, np.nan]), r"obs \[0.0, nan\]: each entry must be finite"),
        (lambda session: session.propose("ab"), r"obs 'ab': this learner takes 2 real numbers"),
        (lambda session: session.executed([0.0, 1.5]), "each entry must be from -1 to 1, as it was executed"),
        (lambda session: session.executed([0.0, np.nan]), r"action \[0.0, nan\]: each entry must be finite"),
        (lambda session: session.executed(0.0), r"action has shape \(\), this learner takes \(2,\)"),
        (lambda session: session.advise([0.5, 0.0]), r"advice \[0.5, 0.0\]: each entry must be -1, 0 or 1"),
        (lambda session: session.advise([np.nan, 0.0]), "each entry must be -1, 0 or 1"),
        (lambda session: session.advise(1), r"advice has shape \(1,\), this learner takes \(2,\)"),
    ],
)
def test_refused(begun, does, message):
    """With nothing changed, and nothing written."""
    session, record = begun
    before, written = session.state, record.read_bytes()
    with pytest.raises(ValueError, match=message) as refused:
        does(session)
    assert "\n" not in str(refused.value)
    assert_same_bits(session.state, before)
    assert session.step == 0 and record.read_bytes() == written


def test_nothing_is_said_before_a_step_begins(coach):
    session = Session(coach)
    for _ in range(2):
        for does in (lambda: session.advise([1, 1]), lambda: session.executed([0.0, 0.0])):
            with pytest.raises(UserError, match="no step of this episode has begun: call propose first"):
                does()
        session.propose(PLACE)
        session.end_episode()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"credit": -1}, "credit -1: give a number of at least 0"),
        ({"credit": True}, "credit True: give a number of at least 0"),
        ({"credit_shape": 3.0}, "credit_shape: without credit it changes nothing, give both"),
        ({"credit": 2000}, "credit: 2,000 steps of 1 s, 1,024 are kept at most"),
        ({"time_step": 0}, "time_step 0: give a number above 0"),
        ({"time_step": None}, "time_step None: give a number above 0"),
        ({"seed": 0.5}, "seed 0.5: give a whole number"),
        ({"undos": -1}, "undos -1: give a whole number"),
        ({"record": 5}, "record 5: give a path"),
        ({"state": 5}, "state 5: give a state of this learner"),
    ],
)
def test_arguments_are_refused(coach, given, message):
    with pytest.raises(ValueError, match=message):
        Session(coach, **given)


def test_a_learner_is_asked_for():
    with pytest.raises(UserError, match="learner 'gpc': give a learner, from make_learner"):
        Session("gpc")


def test_an_action_that_is_no_number(coach):
    """It is not acted, and the session stays where it was."""
    session = Session(coach, state=jax.tree.map(lambda leaf: leaf.at[:].set(jnp.nan), coach.init()))
    with pytest.raises(UserError, match=r"the policy's action at \[0.3, -0.2\] is no number"):
        session.propose(PLACE)
    assert session.step == -1


@pytest.mark.parametrize("algo", ["gpc", pytest.param("gpc-ns", marks=pytest.mark.slow)])
def test_far_out_it_is_what_its_learner_and_its_policy_are(algo):
    """Where squares would be infinite: it acts, proposes, learns and knows its uncertainty."""
    given = learner(algo, capacity=8)
    state, _ = given.correct(given.init(), PLACE, [0.0, 0.0], [1, 1])
    session, far = Session(given, state), [1e200, -0.2]
    for act in (session.act, session.propose, lambda obs: session.act_at(np.array([obs]).T)[:, 0]):
        np.testing.assert_array_equal(act(far), given.act(state, far))
    np.testing.assert_array_equal(session.policy()(far), given.act(state, far))
    np.testing.assert_array_equal(session.uncertainty(), given.uncertainty(state, far, [0.0, 0.0]))
    info = session.advise([1, 1])
    state, expected = given.correct(state, far, [0.0, 0.0], [1, 1])
    assert info.status == expected.status == 0 and (info.rate > 0).all()
    np.testing.assert_array_equal(info.rate, expected.rate)
    np.testing.assert_array_equal(session.act(far), given.act(state, far))
    assert (session.act(far) > 0).all()
    np.testing.assert_array_equal(session.obs, [1e60, -0.2])


def test_a_strangers_learner(monkeypatch):
    monkeypatch.syspath_prepend("tests/foreign")
    import drifting

    linear = drifting.Linear(obs_size=2, action_size=1)
    session, state = Session(linear), linear.init()
    for obs in ([0.5, 1.0], [0.2, -0.3]):
        action = session.propose(obs)
        info = session.advise(1)
        state, expected = linear.correct(state, obs, action, [1])
        assert_close((session.state, info.rate), (state, expected.rate), 1e-12)
    assert session.corrections == 2


def test_the_engine_does_what_a_session_did(tmp_path):
    """A recording as the teacher of a sweep: the same state, with what the learner drew and did by itself."""
    env, seed = Drift(force=0.0, max_steps=14), 5
    given = Restless(obs_size=2, action_size=2)
    path, draw = tmp_path / "record", np.random.default_rng(8)
    session = Session(given, seed=seed, record=path)
    for episode in range(2):
        at = reset(env, start_key(seed, episode))
        while not at.done:
            action = session.propose(at.obs)
            if draw.random() < 0.5:
                session.advise(draw.integers(-1, 2, 2))
            at = advance(env, at, action)
        session.end_episode()
    session.propose(PLACE)  # what the last step was to bring by itself
    each = start(0, given, described_record(str(path), "teacher").make(), seed)
    lane = run(make_pool(env, each, (Tier(1, 1, 8),), 2), [each])[0]
    assert lane.state["idled"] == session.state["idled"] > 4 and session.state["count"] > 8
    assert_close(lane.state, jax.tree.map(np.asarray, session.state), 1e-12)
    assert lane.rows.corrections.sum() == session.corrections
