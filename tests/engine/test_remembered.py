"""What a policy remembers and what others change meanwhile, when `evaluate` has it traced."""

import collections
import contextvars
import itertools
import queue
import sys
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.engine import referred
from gpcjax.engine.evaluate import evaluate
from gpcjax.engine.remembered import Remembered
from gpcjax.engine.writes import Writes, writes
from tests.engine import helpers_with_memory as helpers
from tests.engine.helpers_with_memory import Filter
from tests.engine.host_tasks import host_drift
from tests.engine.tasks import Drift

TASK = host_drift()
"""Whether jax can trace a policy is found out alike for all tasks, and this one has no program of its own."""

taught = jnp.ones(2)
"""What somebody else teaches while a policy reads it."""


def teach(value):
    global taught
    taught = value


def importing(obs):
    import tests.engine.helpers_with_memory

    return tests.engine.helpers_with_memory.smooth(obs)


class Robot:
    """Read by its policy, and written into by the loop that drives it."""

    def __init__(self):
        self.log, self.count, self.sensors, self.speed = [], 0, np.zeros(2), 0.0

    def __call__(self, obs):
        return -0.1 * obs + self.speed

    def drive(self):
        """The loop's."""
        self.log.append(self.count)
        self.count += 1
        self.sensors[0] += 1.0


class TestWhatOthersDoMeanwhile:
    """Another thread goes on while a function is traced; here it acts at a moment that is known."""

    def test_before_the_next_look(self):
        before = Remembered(lambda obs: taught * obs)
        before.look_again()
        later = jnp.full(2, 3.0)
        teach(later)
        assert before.is_disturbed and not before.is_changed
        before.put_back()
        assert taught is later

    def test_during_the_call(self):
        """A name that none of the function's code writes is somebody else's."""
        before = Remembered(lambda obs: taught * obs)
        later = jnp.full(2, 4.0)
        teach(later)
        before.look_again()
        assert before.is_disturbed and not before.is_changed
        before.put_back()
        assert taught is later

    def test_after_what_the_function_has_changed(self):
        robot = Robot()

        def policy(obs):
            robot.speed = robot.speed + 1.0
            robot.log.append(obs)
            return obs

        before = Remembered(policy)
        policy(0.0)
        before.look_again()
        robot.drive()
        robot.speed = 7.0
        before.put_back()
        assert robot.speed == 7.0 and robot.log == [0.0, 0]

    def test_what_jax_traces_with_goes_from_what_others_filled(self):
        log, table = [], {}

        def policy(obs):
            log.append(obs)
            table["last"] = {"obs": obs}
            return obs

        before = Remembered(policy)
        jax.make_jaxpr(lambda obs: (policy(obs), before.look_again())[0])(1.0)
        log.append("somebody's")
        table["other"] = 1
        before.put_back()
        assert log == ["somebody's"] and table == {"other": 1}

    def test_a_state_that_is_taught_stays_the_newest_and_its_policy_compiled(self, monkeypatch):
        look, asked = Remembered.look_again, queue.SimpleQueue()

        def looked(self):
            look(self)
            teach(taught + 1.0)

        def policy(obs):
            asked.put(isinstance(obs, jax.core.Tracer))
            return -0.01 * taught * obs

        teach(np.ones(2))
        monkeypatch.setattr(Remembered, "look_again", looked)
        evaluate(Drift(), policy, 2)
        np.testing.assert_array_equal(taught, [4.0, 4.0])
        assert all(asked.get() for _ in range(asked.qsize()))

    def test_of_an_object_that_is_read_only_here(self, monkeypatch):
        robot, look = Robot(), Remembered.look_again

        def looked(self):
            robot.drive()  # during the call
            look(self)

        monkeypatch.setattr(Remembered, "look_again", looked)
        evaluate(TASK, robot, 2)
        assert robot.log == [*range(robot.count)] and robot.sensors[0] == robot.count > 0


@pytest.mark.parametrize(
    "policy",
    [
        lambda obs: helpers.smooth(obs),
        lambda obs: Filter.smooth(obs),
        lambda obs: helpers.by_name(obs),
        helpers.by_name,
        pytest.param(lambda obs: importing(obs), id="imported"),
        pytest.param(lambda obs: helpers.Inner.Filter.smooth(obs), id="nested"),
    ],
)
def test_memory_of_modules_and_classes(policy):
    """As without jax: asked at each step, and nothing that jax traces with is left."""

    def begin():
        helpers.last, helpers.asked, Filter.value = None, 0, jnp.zeros(2)

    begin()
    got = evaluate(TASK, policy, 2)
    left = helpers.last, helpers.asked, Filter.value
    begin()
    expected = evaluate(TASK, lambda obs: np.asarray(policy(obs)), 2)
    np.testing.assert_allclose(got.returns, expected.returns)
    assert not any(isinstance(each, jax.core.Tracer) for each in left)
    jax.tree.map(np.testing.assert_array_equal, left, (helpers.last, helpers.asked, Filter.value))


class Hidden:
    """With a name that Python keeps with its class's."""

    __slots__ = ("__last",)

    def __init__(self):
        self.__last = np.zeros(2)

    def __call__(self, obs):
        self.__last = 0.9 * self.__last + 0.1 * obs
        return -self.__last


class Kept:
    last = np.zeros(2)


def entries(*shape):
    """An array of objects, one of which is a filter's last value."""
    array = np.empty(shape, object)
    array[(0,) * len(shape)] = np.zeros(2)
    return array


def in_an_array(*shape):
    last = entries(*shape)

    def policy(obs):
        last[(0,) * len(shape)] = 0.9 * last[(0,) * len(shape)] + 0.1 * obs
        return -last[(0,) * len(shape)]

    return policy


def in_a_context():
    last = contextvars.ContextVar("last")

    def policy(obs):
        last.set(0.9 * last.get(np.zeros(2)) + 0.1 * obs)
        return -last.get()

    return policy


HELD = [Kept()]


def by_reference():
    HELD[:] = [Kept()]
    refer = weakref.ref(HELD[0])

    def policy(obs):
        refer().last = 0.9 * refer().last + 0.1 * obs
        return -refer().last

    return policy


def by_proxy():
    HELD[:] = [Kept()]
    proxy = weakref.proxy(HELD[0])

    def policy(obs):
        proxy.last = 0.9 * proxy.last + 0.1 * obs
        return -proxy.last

    return policy


def by_value():
    HELD[:] = [Kept()]
    table = weakref.WeakValueDictionary({"it": HELD[0]})

    def policy(obs):
        table["it"].last = 0.9 * table["it"].last + 0.1 * obs
        return -table["it"].last

    return policy


@pytest.mark.parametrize(
    "begin",
    [
        Hidden,
        lambda: in_an_array(1),
        lambda: in_an_array(2, 3),
        in_a_context,
        by_reference,
        by_proxy,
        by_value,
    ],
    ids=["a hidden slot", "objects", "rows of objects", "a context", "weakly", "by a proxy", "a weak table"],
)
def test_memory_that_is_hard_to_see(begin):
    policy, filtered = begin(), begin()
    expected = evaluate(TASK, lambda obs: filtered(np.asarray(obs)), 2)
    policy = begin()
    np.testing.assert_allclose(evaluate(TASK, policy, 2).returns, expected.returns)
    assert not isinstance(policy(np.ones(2)), jax.core.Tracer)


class Refusing:
    """Nothing of it can be looked at."""

    def __getattribute__(self, name):
        raise RuntimeError(name)


def test_what_refuses_to_be_looked_at_is_let_be():
    """An object of that kind, and what stands for one that is gone, beside what is remembered."""
    gone, refusing, last = weakref.proxy(Kept()), Refusing(), [np.zeros(2)]

    def policy(obs, beside=(gone, refusing)):
        last[0] = 0.9 * last[0] + 0.1 * obs
        return -last[0]

    got = evaluate(TASK, policy, 2)
    assert isinstance(last[0], np.ndarray)
    last[0] = np.zeros(2)
    np.testing.assert_allclose(got.returns, evaluate(TASK, lambda obs: policy(np.asarray(obs)), 2).returns)


def test_memory_that_nobody_sees_is_told(monkeypatch):
    """Where no module of a person's has it; called on the host from the first line on, it is not traced."""
    monkeypatch.setattr(np, "last", np.zeros(2), raising=False)

    def policy(obs):
        np.last = 0.9 * np.last + 0.1 * obs
        return -np.last

    with pytest.raises(
        ValueError, match=r"^the policy remembers something out of sight, which jax traced: make it"
    ):
        evaluate(Drift(), policy, 2)
    with pytest.raises(ValueError, match=r"^the policy remembers something"):
        evaluate(TASK, lambda obs: np.last, 2)
    np.last = np.zeros(2)
    evaluate(TASK, lambda obs: policy(np.asarray(obs)), 2)
    assert isinstance(np.last, np.ndarray)


def test_long_lists_of_numbers_cost_no_look_at_each(monkeypatch):
    """They refer to nothing: how often Python calls something says that it passes them by."""
    calls, numbers = [], [float(each) for each in range(100_000)]
    table, more = dict(enumerate(numbers)), (*numbers,)

    def policy(obs):
        return obs * numbers[0] * table[0] * more[0]

    sys.setprofile(lambda frame, event, argument: calls.append(event))
    try:
        seen = Remembered(policy)
        seen.look_again()
        assert not seen.is_changed and not seen.is_disturbed
    finally:
        sys.setprofile(None)
    assert len(calls) < 50_000  # of which most are checks of types, where tests have these
    numbers[-1] = 2.0
    assert seen.is_disturbed
    monkeypatch.setattr(referred, "LARGEST", 1_000)
    assert not Remembered(policy)._contents


def test_memory_of_a_method():
    """What a method has in its module's names, not in its object."""

    class Reads:
        def __call__(self, obs):
            teach(0.9 * taught + 0.1 * obs)
            return taught

    teach(jnp.ones(2))
    got = evaluate(TASK, Reads(), 2)
    assert not isinstance(taught, jax.core.Tracer)
    teach(jnp.ones(2))
    np.testing.assert_allclose(got.returns, evaluate(TASK, lambda obs: np.asarray(Reads()(obs)), 2).returns)


class Counter(collections.UserDict):
    """Of an installed class, which calls its methods and writes into it."""

    def __init__(self):
        super().__init__()
        self.asked = 0

    def __setitem__(self, name, value):
        self.asked += 1
        super().__setitem__(name, value)


def test_what_installed_code_writes_is_put_back():
    """Its code is not looked at: whatever has changed during the call counts as changed by it."""
    counter, plain = Counter(), Counter()

    def policy(obs, counter=counter):
        counter.update(last=obs)
        return jnp.tanh(obs) * (counter.asked % 3)

    got = evaluate(TASK, policy, 2)
    expected = evaluate(TASK, lambda obs: np.asarray(policy(obs, plain)), 2)
    np.testing.assert_allclose(got.returns, expected.returns)
    assert counter.asked == plain.asked and not isinstance(counter["last"], jax.core.Tracer)


def counted():
    yield from itertools.count(1)


@pytest.mark.parametrize(
    "begin",
    [lambda: itertools.count(1), lambda: iter([*range(1, 300)]), counted, lambda: map(float, counted())],
    ids=["count", "list", "generator", "map"],
)
@pytest.mark.parametrize("library", [np, jnp])
def test_an_iterator_loses_none_of_what_it_gives(begin, library):
    numbers, taken = begin(), []

    def policy(obs):
        taken.append(float(next(numbers)))
        return library.asarray([0.001, 0.0]) * taken[-1]

    evaluate(TASK, policy, 1)
    assert taken[:3] == [1.0, 2.0, 3.0] and len(taken) > 3


def test_a_file_loses_no_line(tmp_path):
    (tmp_path / "actions").write_text("".join(f"{each}\n" for each in range(1, 300)))
    taken = []
    with open(tmp_path / "actions") as file:

        def policy(obs):
            taken.append(int(file.readline()))
            return 0.001 * jnp.ones(2) * taken[-1]

        evaluate(TASK, policy, 1)
    assert taken[:3] == [1, 2, 3]


def test_what_code_writes():
    def reading(obs):
        return helpers.last * obs + Filter.value[0]

    def writing(obs):
        global taught
        taught = helpers.last = obs
        return [inner for inner in obs]

    def around(obs):
        def inner(table):
            table[0] = obs

        return inner

    assert writes(reading.__code__) == Writes()
    assert writes(writing.__code__) == Writes(frozenset({"taught", "last"}))
    assert writes(around.__code__).content
    assert writes((lambda obs: np.add(obs, 1, out=obs)).__code__).content
    assert writes((lambda obs: setattr(Filter, "value", obs)).__code__).reaches("whatever")
