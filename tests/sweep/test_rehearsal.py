"""What a learner or a teacher of a person's own gets wrong is told before a program is made, in its own words."""

import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.errors import ForeignError, UserError
from gpcjax.sweep.build import start_of
from gpcjax.sweep.executors.base import Orders
from gpcjax.sweep.plan import plan
from gpcjax.sweep.rehearsal import check_columns, rehearse_learner, rehearse_task, rehearse_teacher
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.worker import work
from tests.foreign.drifting import Drift, Linear, Loud

ARRAY = r"float64 of shape \(1, 2\)"


class Raises(Linear):
    def learn(self, state, moment, advice, key):
        raise RuntimeError("no learning today")


class Flat(Linear):
    def learn(self, state, moment, advice, key):
        return state[0], gpcjax.Info.of(rate=jnp.zeros(1))


class Short(Linear):
    """Of fewer digits, which is as good."""

    def learn(self, state, moment, advice, key):
        return state.astype(jnp.float32), gpcjax.Info.of(rate=jnp.zeros(1))


class Bare(Linear):
    def learn(self, state, moment, advice, key):
        return state


class Wide(Linear):
    def propose(self, state, obs):
        return jnp.zeros(4)


class Locked(Linear):
    def init(self, key=None):
        return threading.Lock()


class Branching(Linear):
    """On a number that is data of a program."""

    def learn(self, state, moment, advice, key):
        return (state if self.step_size > 0.3 else 2 * state), gpcjax.Info.of(rate=jnp.zeros(1))


class Wordy(Linear):
    words: tuple = ("more", 0.5)


class Measuring(Linear):
    def measure(self, state):
        return {"weights": state}


@pytest.mark.parametrize(
    ("learner", "message"),
    [
        (Raises, r"Raises.learn fails \(RuntimeError: no learning today\)"),
        (Flat, rf"Flat.learn .* the new state is float64 of shape \(2,\), it should be {ARRAY}\)"),
        (Bare, rf"Bare.learn .* it gives {ARRAY}, it should give the new state and a gpcjax.Info\)"),
        (
            Wide,
            r"Wide.propose .* an action is float64 of shape \(4,\), it should be float64 of shape \(1,\)\)",
        ),
        (Locked, r"Locked.init .* the state is a lock, it should be made of arrays\)"),
        (Branching, r"Branching.learn fails \(TracerBoolConversionError: Attempted boolean"),
        (Wordy, r"Wordy .* its words\[0\] is a str, it should be of numbers\)"),
        (Measuring, rf"Measuring.measure .* it gives {{'weights': {ARRAY}}}, it should give a number"),
    ],
)
def test_learners(learner, message):
    with pytest.raises(
        ForeignError, match=f"^algo mine:it: {message}".replace(" .* ", r" does not fit \(")
    ) as told:
        rehearse_learner("mine:it", learner(obs_size=2, action_size=1))
    assert ("RuntimeError: no learning today" in told.value.details) == (learner is Raises)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("return", "return is a column of every sweep, give it another name"),
        ("seed", "seed is a column"),
        ("error", "error is a setting of every sweep"),
        ("mean weight", "'mean weight' can be no column, give a name"),
        (3, "3 can be no column"),
    ],
)
def test_a_measurement_has_a_column_of_its_own(name, message):
    class Named(Linear):
        def measure(self, state):
            return {name: state.sum()}

    with pytest.raises(UserError, match=f"^algo mine:it: Named.measure: {message}"):
        rehearse_learner("mine:it", Named(obs_size=2, action_size=1))


class Measured(Linear):
    beta: float = 0.5

    def measure(self, state):
        return {"step_size": self.step_size, "magnitude": state.sum()}


def test_a_measurement_beside_what_varies():
    """What does not vary is no column: nothing clashes with it, not even a setting of its own."""
    algo = f"{__name__}:Measured"
    cell, *_ = plan(spec_of(env="cartpole", algo=algo, step_size=[0.1, 0.2], seeds=1))
    learner = Measured(obs_size=4, action_size=1)
    check_columns(cell, learner, ["beta", "rate"])
    with pytest.raises(
        UserError, match=f"algo {algo}: Measured.measure: step_size is a setting of this learner that"
    ):
        check_columns(cell, learner, ["step_size"])
    with pytest.raises(
        UserError, match=r"Measured.measure: magnitude is a column of this sweep, give it another"
    ):
        check_columns(cell, learner, ["magnitude"])
    buffered, *_ = plan(spec_of(env="cartpole", algo="d-coach", seeds=1))
    with pytest.raises(
        UserError, match=r"algo d-coach: DCoach.measure: replay_loss is a column of this sweep"
    ):
        check_columns(buffered, start_of(buffered).learner, ["replay_loss"])


def test_a_worker_looks_at_them(monkeypatch):
    """Before it runs anything, whatever it ran before."""
    cell, *_ = plan(spec_of(env="cartpole", algo=f"{__name__}:Measured", step_size=[0.1, 0.2], seeds=1))
    monkeypatch.setattr("gpcjax.sweep.worker.refuse_another_environment", lambda: None)
    said = []

    def say(message):
        said.append(message)
        return ("program", cell, Orders(varying=("step_size",)))

    assert not work(say)
    assert said[0] == ("ready",) and "step_size is a setting of this learner" in said[-1][1]
    assert "next" not in {message[0] for message in said}


class Tired(Loud):
    def advise(self, coins, moment):
        raise ZeroDivisionError("tired")


class Mute(Loud):
    def advise(self, coins, moment):
        pass


class Choosy(Loud):
    def advise(self, coins, moment):
        return coins if self.loudness > 1 else -coins


class Unsure(Loud):
    def may_advise(self, coins, largest_sigma, step):
        return coins


class Forgetful(Loud):
    def init(self):
        return jnp.zeros(3)

    def watch(self, memory, moment):
        return memory[0]


class Worried(Loud):
    """Begins with Python's numbers, which become arrays; the other watches nothing, and so remembers nothing."""

    def init(self):
        return {"distance": jnp.inf, "worse": 0}

    def watch(self, memory, moment):
        distance = jnp.abs(moment.obs).sum(0)
        worse = jnp.where(distance > memory["distance"], memory["worse"] + 1, 0)
        return {"distance": distance, "worse": worse}

    def recalling(self, memory):
        assert memory["worse"].shape == ()
        return self


class Blind(Loud):
    def init(self):
        return {"worse": "nobody asks"}

    def recalling(self, memory):
        assert memory == ()
        return self


@pytest.mark.parametrize(
    ("teacher", "message"),
    [
        (Tired, r"Tired.advise fails \(ZeroDivisionError: tired\)"),
        (Choosy, r"Choosy.advise fails \(TracerBoolConversionError: Attempted boolean"),
        (Mute, "Mute.advise .* it gives None, it should give -1, 0 or 1 for each action dimension"),
        (Unsure, r"Unsure.may_advise .* it gives float64 of shape \(1,\), it should give a truth value"),
        (
            Forgetful,
            r"Forgetful.watch .* the memory is float64 of shape \(\), it should be float64 of shape \(3,\)",
        ),
    ],
)
def test_teachers(teacher, message):
    with pytest.raises(
        ForeignError, match=f"^teacher mine:it: {message}".replace(" .* ", r" does not fit \(")
    ):
        rehearse_teacher("mine:it", teacher(), 2, 1)


class Watchful(Loud):
    """Looks at every step for what is known only where it is asked."""

    def init(self):
        return jnp.zeros(1)

    def watch(self, memory, moment):
        return memory + moment.target


class Doubting(Loud):
    def advise(self, coins, moment):
        return jnp.where(moment.sigma_human > 0.1, 1.0, 0.0)


class Telling(Loud):
    def chance(self, sigma_human):
        return 0.5 * sigma_human


class Shaped(Loud):
    def advise(self, coins, moment):
        return jnp.zeros_like(moment.sigma_human)


def test_a_teacher_that_uses_what_it_is_not_shown():
    """sigma_h is zero for one that does not say that it needs it; its shape is no use of it."""
    for teacher, method in ((Doubting, "advise"), (Telling, "chance")):
        with pytest.raises(
            UserError, match=rf"^teacher it: {teacher.__name__}.{method} uses sigma_human.* active = True"
        ):
            rehearse_teacher("it", teacher(), 2, 1)
        rehearse_teacher("it", type("Active", (teacher,), {"active": True})(), 2, 1)
    rehearse_teacher("it", Shaped(), 2, 1)
    with pytest.raises(ForeignError, match=r"^teacher it: Watchful.watch fails \(TypeError"):
        rehearse_teacher("it", Watchful(), 2, 1)


class Drawing(Linear):
    def init(self, key=None):
        return {"weights": super().init(), "key": jax.random.key(0)}


class Keyed(Linear):
    drawn: jax.Array = eqx.field(kw_only=True)


class Remembering(Loud):
    def init(self):
        return (jax.random.key(0),)

    def watch(self, memory, moment):
        return memory


class Windy(Drift):
    def reset(self, key):
        return self.begin({"key": key}, jnp.zeros(2))


def test_random_keys_of_jaxs_own_type():
    """No block of lanes holds them: the line says what to keep."""
    sizes, keep = {"obs_size": 2, "action_size": 1}, r"is a random key: keep jax.random.key_data\(key\)"
    with pytest.raises(UserError, match=rf"^algo it: Drawing.init: state\['key'\] {keep}"):
        rehearse_learner("it", Drawing(**sizes))
    with pytest.raises(UserError, match=rf"^algo it: Keyed: its drawn {keep}"):
        rehearse_learner("it", Keyed(**sizes, drawn=jax.random.key(0)))
    with pytest.raises(UserError, match=rf"^teacher it: Remembering.init: memory\[0\] {keep}"):
        rehearse_teacher("it", Remembering(), 2, 1)
    with pytest.raises(UserError, match=rf"^env it: Windy.reset: its physics\['key'\] {keep}"):
        rehearse_task("it", Windy())
    rehearse_task("it", Drift())


def test_what_is_right():
    for learner in (Linear, Short):
        rehearse_learner("mine:it", learner(obs_size=2, action_size=1))
    for teacher in (Loud, Worried, Blind):
        rehearse_teacher("mine:it", teacher(), 2, 1)


def test_a_worker_says_whose_it_is(monkeypatch):
    """And the desk raises it again."""
    error = ForeignError("algo mine:it: It.learn fails", ValueError("its own"))
    monkeypatch.setattr("gpcjax.sweep.worker.refuse_another_environment", lambda: None)
    said = []

    def say(message):
        said.append(message)
        if message[0] != "theirs":
            raise AssertionError(message)

    def fails(self):
        raise error

    monkeypatch.setattr("gpcjax.sweep.worker._Worker.run", fails)
    assert not work(say)
    ((kind, *arguments),) = said
    again = ForeignError(*arguments)
    assert kind == "theirs" and str(again) == str(error) and again.details == error.details
    assert np.all([isinstance(each, str) for each in arguments])
