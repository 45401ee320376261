"""Calls from Python: compiled once for each structure, and what is given away is not copied."""

import contextlib
import os
import runpy
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import threadpoolctl
from jax._src import xla_bridge

import gpcjax
from gpcjax import _x64
from gpcjax.fixed import fixed
from gpcjax.gp.threads import one_thread
from gpcjax.learners import calls
from gpcjax.learners.base import Status
from gpcjax.learners.compiled import act
from gpcjax.learners.factory import make_learner
from gpcjax.policies import base
from tests.trees import assert_same_bits

COMPILED = "/jax/core/compile/backend_compile_duration"


@contextlib.contextmanager
def compilations():
    """How many programs are compiled meanwhile, as the length of a list."""
    heard = []
    hear = lambda event, seconds, **_: heard.append(seconds) if event == COMPILED else None  # noqa: E731
    jax.monitoring.register_event_duration_secs_listener(hear)
    try:
        yield heard
    finally:
        jax.monitoring.unregister_event_duration_listener(hear)


class Counting(gpcjax.Learner):
    """Adds up advice, and counts how often it is traced."""

    step_size: jax.Array = eqx.field(default=0.5, converter=gpcjax.parameter)
    traces: list = eqx.field(static=True, default_factory=list)

    def init(self, key=None):
        return {"total": jnp.zeros(self.action_size), "step_size": self.step_size}

    def propose(self, state, obs):
        self.traces.append("propose")
        return state["total"] + 0.0 * obs.sum()

    def learn(self, state, moment, advice, key):
        self.traces.append("learn")
        change = self.step_size * advice
        return {**state, "total": state["total"] + change}, gpcjax.Info.of(rate=jnp.abs(change))


def counting(**values):
    return Counting(obs_size=2, action_size=1, **values)


def teach(learner, state, times=3, **options):
    rng, infos = np.random.default_rng(0), []
    for _ in range(times):
        obs = rng.normal(size=learner.obs_size)
        state, info = learner.correct(
            state, obs, learner.act(state, obs), [1] * learner.action_size, **options
        )
        infos.append(info)
    return state, infos


def test_one_trace_for_each_structure():
    """Whatever the numbers are, and in any process of numpy's or of jax's."""
    learner = counting()
    state, _ = teach(learner, learner.init())
    assert learner.traces == ["propose", "learn"]
    again = jax.tree.map(lambda leaf: 2.0 * leaf, learner)
    assert again.traces is learner.traces
    found, _ = teach(again, jax.tree.map(np.asarray, state), 1)
    assert learner.traces == ["propose", "learn"] and found["total"] == state["total"] + 1.0
    # The step size is a number of the program, not of the state it was traced with.
    assert float(teach(again, again.init())[0]["total"][0]) == 3.0
    assert learner.traces == ["propose", "learn"]


def test_other_settings_are_other_programs():
    """Structures that differ in what is static, with states that do not."""

    class Signed(Linear):
        sign: float = eqx.field(default=1.0, static=True)

        def propose(self, state, obs):
            return self.sign * super().propose(state, obs)

        def learn(self, state, moment, advice, key):
            return super().learn(state, moment, self.sign * advice, key)

    state, obs = np.full((2, 3), 0.1), np.ones(3)
    for sign in (1.0, -1.0):
        learner = Signed(**SIZES, sign=sign)
        np.testing.assert_allclose(learner.act(state, obs), np.full(2, 0.3 * sign))
        after, _ = learner.correct(state, obs, np.zeros(2), [1, 1])
        np.testing.assert_allclose(after, state + 0.1 * sign)


@pytest.mark.slow
def test_other_settings_of_gpc_are_other_programs():
    for on_full, last in (("error", Status.FULL), ("replace-nearest", Status.OK)):
        learner = make_learner("gpc", obs_size=2, action_size=1, capacity=4, on_full=on_full)
        _, infos = teach(learner, learner.init(), 5)
        assert [int(info.status) for info in infos] == [0, 0, 0, 0, last]


@pytest.mark.slow
def test_inside_jit_it_is_what_it_is_outside():
    learner = make_learner("gpc", obs_size=2, action_size=2, capacity=8)
    state, _ = teach(learner, learner.init(), 2)
    arguments = state, np.array([0.3, -0.2]), np.zeros(2), np.array([1.0, -1.0])
    inside, outside = jax.jit(learner.correct)(*arguments), learner.correct(*arguments)
    for one, other in zip(jax.tree.leaves(inside), jax.tree.leaves(outside), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        jax.jit(learner.act)(state, arguments[1]), learner.act(state, arguments[1]), rtol=0, atol=1e-13
    )


@pytest.mark.parametrize("algo", ["gpc", pytest.param("coach", marks=pytest.mark.slow), "own"])
def test_what_is_given_away_is_learned_from_alike_and_gone(algo, capfd):
    options = {"capacity": 4} if algo == "gpc" else {"lower": -1, "upper": 1, "counts": (2, 3)}
    learner = counting() if algo == "own" else make_learner(algo, obs_size=2, action_size=1, **options)
    kept, infos = teach(learner, learner.init())
    given, others = teach(learner, learner.init(), donate=True)
    assert_same_bits((given, others), (kept, infos))
    learner.correct(given, np.zeros(2), [0.0], [1], donate=True)
    for use in (lambda: learner.act(given, [0, 0]), lambda: learner.correct(given, [0, 0], [0], [1])):
        with pytest.raises(
            ValueError, match=r"^state: it was given away \(donate\), use the one that came of it$"
        ):
            use()
    assert capfd.readouterr() == ("", "")
    assert_same_bits(
        learner.correct(kept, np.zeros(2), [0.0], [1])[0], learner.correct(kept, [0, 0], [0], [1])[0]
    )


@pytest.mark.parametrize("algo", ["gpc", "own"])
def test_what_is_given_away_is_refused_by_all_that_take_a_state(algo, tmp_path):
    learner = (
        Linear(obs_size=2, action_size=1)
        if algo == "own"
        else make_learner(algo, obs_size=2, action_size=1, capacity=4)
    )
    given = learner.init()
    state, _ = learner.correct(given, np.zeros(2), [0.0], [1], donate=True)
    uses = [
        lambda: learner.policy_of(given),
        lambda: learner.uncertainty(given, [0, 0], [0]),
        lambda: learner.warm_up(given),
        lambda: gpcjax.Session(learner, given),
        lambda: gpcjax.save_learner(tmp_path / "learner", learner, given),
        lambda: gpcjax.save_policy(tmp_path / "policy", learner, given),
    ]
    if algo == "own":
        uses += [lambda: learner.controller(given)]
    else:
        uses += [
            lambda: learner.controller(given),
            lambda: learner.grow(given),
            lambda: learner.resize(given, 8, 8),
            lambda: learner.points(given),
            lambda: learner.has_room(given),
        ]
    for use in uses:
        with pytest.raises(ValueError, match=r"^state: it was given away \(donate\), use the one that came"):
            use()
    assert learner.policy_of(state) and not list(tmp_path.iterdir())


def test_other_ways_in_are_told_what_was_given_away():
    """Within vmap, from `evaluate`, and of another kind of learner."""
    learner = make_learner("gpc", obs_size=2, action_size=1, capacity=4)
    coach = make_learner("d-coach", obs_size=2, action_size=1, width=2, buffer_size=2, batch_size=1)
    given, kept = learner.init(), coach.init()
    learner.correct(given, np.zeros(2), [0.0], [1], donate=True)
    for leaf in jax.tree.leaves(kept):
        leaf.delete()  # as it is gone then
    env = gpcjax.make_env("mountaincar")
    for use in (
        lambda: jax.vmap(lambda obs: learner.act(given, obs))(jnp.zeros((2, 2))),
        lambda: gpcjax.evaluate(env, lambda obs: learner.act(given, obs), 1),
        lambda: coach.measure(kept),
        lambda: coach.controller(kept),
        lambda: coach.idle(kept, jax.random.key(0)),
    ):
        with pytest.raises(ValueError, match=r"^state: it was given away \(donate\), use the one that came"):
            use()


@pytest.mark.parametrize(
    "says",
    [RuntimeError("Array has been deleted with shape=float64[1]."), ValueError("INVALID_ARGUMENT: gone")],
)
def test_what_another_thread_gives_away_meanwhile_is_told_too(says, monkeypatch):
    """Between the look at a state and the call with it, which jax then refuses in one of two ways."""
    learner, env = make_learner("gpc", obs_size=2, action_size=1, capacity=4), gpcjax.make_env("mountaincar")
    state = learner.init()
    monkeypatch.setattr(act, "_programs", type(act._programs)())
    learner.act(state, np.zeros(2))
    (key,) = act._programs

    def late(*_):
        for leaf in jax.tree.leaves(state):
            leaf.delete()
        raise says

    monkeypatch.setitem(act._programs, key, late)
    with pytest.raises(ValueError, match=r"^state: it was given away"):
        learner.act(state, np.zeros(2))
    state, policy = learner.init(), lambda obs: learner.act(state, obs)
    monkeypatch.setattr("gpcjax.engine.evaluate.program", lambda *_: late)
    with pytest.raises(ValueError, match=r"^state: it was given away"):
        gpcjax.evaluate(env, policy, 1)


def test_an_array_that_is_there_twice_is_not_given_away():
    learner = make_learner("coach", obs_size=2, action_size=1, lower=-1, upper=1, counts=(2, 3))
    start = learner.init()
    twice = eqx.tree_at(lambda state: state.human, start, start.policy)
    expected = learner.correct(start, [0.2, 0.1], [0.0], [1])
    assert_same_bits(learner.correct(twice, [0.2, 0.1], [0.0], [1], donate=True), expected)
    assert_same_bits(twice, start)


@pytest.mark.parametrize("state", [3, None, "state", {}, [np.zeros(3)]], ids=repr)
def test_what_is_no_state_is_refused(state):
    learner = make_learner("gpc", obs_size=2, action_size=1, capacity=8)
    for call in (
        lambda: learner.act(state, [0.0, 0.0]),
        lambda: learner.correct(state, [0.0, 0.0], [0.0], [1]),
        lambda: learner.correct(state, [0.0, 0.0], [0.0], [1], donate=True),
        lambda: learner.warm_up(state),
    ):
        with pytest.raises(ValueError, match=r"^state .*: give a state of this learner"):
            call()


def test_after_warming_up_nothing_is_compiled():
    learner = make_learner("gpc", obs_size=2, action_size=1, capacity=3, sparsify=False)
    state = learner.init()
    with compilations() as before:
        learner.warm_up(state, donate=True).join()
    assert len(before) > 3
    with compilations() as after:
        state, _ = teach(learner, state, 3, donate=True)
        while learner.has_room(state):
            state, _ = teach(learner, state, 1, donate=True)
        state, infos = teach(learner, learner.grow(state), 1, donate=True)
    assert not after and infos[0].appended.all()


def test_a_state_may_be_given_away_while_larger_ones_are_compiled(monkeypatch):
    learner = make_learner("gpc", obs_size=2, action_size=1, capacity=4)
    given, raised, ahead = threading.Event(), [], type(learner)._warm_up_larger

    def later(*arguments):
        try:
            assert given.wait(60)
            ahead(*arguments)
        except Exception as error:
            raised.append(error)

    monkeypatch.setattr(type(learner), "_warm_up_larger", later)
    state = learner.init()
    thread = learner.warm_up(state, donate=True)
    state, _ = learner.correct(state, [0.1, 0.2], [0.0], [1], donate=True)
    given.set()
    thread.join()
    assert not raised
    with compilations() as after:
        learner.correct(learner.grow(state), [0.3, 0.2], [0.0], [1], donate=True)
    assert not after


def test_programs_of_functions_made_anew_do_not_pile_up(monkeypatch):
    class Shaped(Linear):
        shape: Callable = jnp.tanh

        def propose(self, state, obs):
            return self.shape(state @ obs)

    monkeypatch.setattr(calls, "KEPT", 3)
    monkeypatch.setattr(act, "_programs", type(act._programs)())
    made = [Shaped(**SIZES, shape=lambda x, gain=gain: gain * x) for gain in (0.1, 0.2, 0.3, 0.4, 0.5)]
    learners = [fixed(each) for each in made]
    state, obs = np.ones((2, 3)), np.ones(3)
    for learner, gain in zip(learners, (0.1, 0.2, 0.3, 0.4, 0.5), strict=True):
        learners[0].act(state, obs)  # called in between: it stays
        np.testing.assert_allclose(learner.act(state, obs), np.full(2, min(1.0, 3 * gain)))
        assert len(act._programs) <= 3
    with compilations() as after:
        learners[0].act(state, obs)
    assert not after
    monkeypatch.setattr(base, "KEPT", 3)
    monkeypatch.setattr(base, "_programs", type(act._programs)())
    for learner in learners:
        np.testing.assert_array_equal(learner.policy_of(state)(obs), learner.act(state, obs))
    assert len(base._programs) == 3
    np.testing.assert_array_equal(jax.jit(learner.policy_of(state))(obs), learner.act(state, obs))
    assert len(base._programs) == 3


def test_numbers_of_pythons_are_no_programs_of_their_own():
    """In a field of a learner, and in a state, as a class written in a line has them."""

    class Gaining(Linear):
        gain: float = 0.1

        def propose(self, state, obs):
            return state["n"] * self.gain * (state["w"] @ obs)

        def init(self, key=None):
            return {"w": np.ones((self.action_size, self.obs_size)), "n": 1.0}

        def learn(self, state, moment, advice, key):
            return state, gpcjax.Info.of(rate=self.gain * jnp.abs(advice))

    def taught(gain, n):
        learner = Gaining(**SIZES, gain=gain)
        state = {**learner.init(), "n": n}
        return learner.act(state, np.ones(3)), learner.correct(state, np.ones(3), np.zeros(2), [1, 0])[1].rate

    taught(0.1, 1.0)
    with compilations() as after:
        for gain, n in ((0.2, 1.0), (np.float64(0.1), 2.0), (np.array(0.05), 3.0)):
            action, rate = taught(gain, n)
            np.testing.assert_allclose(action, np.full(2, 3 * gain * n))
            np.testing.assert_allclose(rate, [gain, 0.0])
    assert not after


def test_what_grows_wrongly_is_raised_where_somebody_waits_for_it():
    class Failing(Linear):
        def grow(self, state):
            raise KeyError("no room")

    learner = Failing(**SIZES)
    thread = learner.warm_up(learner.init())
    with pytest.raises(KeyError, match="no room"):
        thread.join()


def test_warming_up_learns_nothing_and_needs_no_room_to_grow():
    learner = counting()
    state = learner.init()
    learner.warm_up(state, donate=True).join()
    assert_same_bits(state, learner.init())
    assert learner.traces == ["propose", "learn"]


def test_lapack_has_one_thread_while_somebody_wants_it():
    def threads():
        found = threadpoolctl.ThreadpoolController().select(user_api="blas").info()
        return {each["num_threads"] for each in found}

    with one_thread():  # what jaxlib calls is loaded now, if it was not
        assert threads() == {1}
    with threadpoolctl.threadpool_limits(2, "blas"):
        with one_thread(), contextlib.suppress(KeyError):
            assert threads() == {1}
            with one_thread():
                assert threads() == {1}
            assert threads() == {1}
            raise KeyError
        assert threads() == {2}


def test_only_what_factorises_anew_asks_for_it():
    sizes = {"obs_size": 1, "action_size": 1}
    assert make_learner("gpc-ns", **sizes).factorises
    assert not make_learner("gpc", **sizes).factorises and not counting().factorises


def test_a_state_that_was_taken_apart_is_not_held():
    """Its arrays are remembered for the next call with it, and gone with it."""
    learner = make_learner("gpc", obs_size=2, action_size=1, capacity=4)
    states = [learner.init() for _ in range(2)]
    states[1], _ = learner.correct(states[1], np.zeros(2), [0.0], [1])
    for _ in range(3):  # one after the other and in turn, each acts as itself
        acts = [float(learner.act(state, np.zeros(2))[0]) for state in (*states, *states[::-1])]
        assert acts[0] == acts[3] == 0.0 and acts[1] == acts[2] > 0.0
    held = weakref.ref(states[0]), weakref.ref(jax.tree.leaves(states[0])[0])
    learner.act(states[0], np.zeros(2))
    del states[0]
    assert [each() for each in held] == [None, None]


def test_a_state_of_ones_own_may_change():
    """A dict is no value that stays: each call looks at it anew."""
    learner = Counting(obs_size=2, action_size=1)
    state = learner.init()
    assert float(learner.act(state, np.zeros(2))[0]) == 0.0
    state["total"] = jnp.full(1, 0.5)
    assert float(learner.act(state, np.zeros(2))[0]) == 0.5


def test_programs_are_run_by_who_calls_them_where_that_is_asked_for(monkeypatch):
    """jax has the setting, and does not look for its variable."""
    setting = xla_bridge._CPU_ENABLE_ASYNC_DISPATCH
    before = setting.value
    try:
        for value in (True, False):
            jax.config.update("jax_cpu_enable_async_dispatch", True)
            monkeypatch.setenv("JAX_CPU_ENABLE_ASYNC_DISPATCH", str(int(value)))
            runpy.run_path(_x64.__file__)  # as the first import of the package does
            assert setting.value == value
    finally:
        jax.config.update("jax_cpu_enable_async_dispatch", before)


@pytest.mark.slow
@pytest.mark.parametrize("value", ["0", "1"])
def test_so_they_are_in_another_process(value):
    code = (
        "import gpcjax._x64; from jax._src import xla_bridge as b; print(b._CPU_ENABLE_ASYNC_DISPATCH.value)"
    )
    environment = os.environ | {"JAX_CPU_ENABLE_ASYNC_DISPATCH": value}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == [str(value == "1")], done.stderr


def gpc(name="gpc", **options):
    return make_learner(name, **{"obs_size": 2, "action_size": 1, "capacity": 32} | options)


def coach(count):
    return make_learner("coach", obs_size=1, action_size=1, lower=-1, upper=1, counts=[count])


def dcoach(width):
    return make_learner("d-coach", obs_size=2, action_size=1, width=width, buffer_size=8)


def cut(state):
    return eqx.tree_at(lambda state: state.policy.targets, state, jnp.zeros((1, 16)))


PAIRS = {
    "observations": lambda: (gpc(obs_size=1), gpc().init()),
    "actions": lambda: (gpc(action_size=2), gpc().init()),
    "a kind of dictionary": lambda: (gpc(on_full="replace-nearest"), gpc("gpc-ns").init()),
    "another kind": lambda: (gpc("gpc-ns"), gpc().init()),
    "one room in two": lambda: (gpc(), cut(gpc().init())),
    "a grid": lambda: (coach(5), coach(9).init()),
    "a network": lambda: (dcoach(4), dcoach(6).init()),
    "ones own": lambda: (counting(), counting().init() | {"total": jnp.zeros(3)}),
}
"""A learner, and a state of another one that differs in this."""


@pytest.mark.parametrize(
    "differs",
    [
        *("observations", "a kind of dictionary", "one room in two", "a grid", "ones own"),
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("actions", "another kind", "a network")),
    ],
)
def test_a_state_of_another_learner_is_refused(differs):
    learner, state = PAIRS[differs]()
    obs, none = np.zeros(learner.obs_size), np.zeros(learner.action_size)
    for call in (
        lambda: learner.act(state, obs),
        lambda: learner.policy_of(state),
        lambda: learner.uncertainty(state, obs, none),
        lambda: learner.correct(state, obs, none, none),
        lambda: gpcjax.Session(learner, state),
    ):
        with pytest.raises(ValueError, match=r"^state .*: give a state of this learner"):
            call()


@pytest.mark.parametrize(
    "odd",
    [
        np.ma.array(np.zeros(1), mask=[True]),
        np.array(["a"]),
        np.zeros(1, ">f8"),
        np.array([None]),
        np.zeros(1, "M8[s]"),
    ],
    ids=["masked", "text", "bytes in the other order", "objects", "times"],
)
def test_arrays_that_jax_does_not_know_are_refused(odd):
    learner = counting()
    learner.act({**learner.init(), "total": np.zeros(1)}, np.zeros(2))  # compiled: jax looks less closely now
    state = {**learner.init(), "total": odd}
    for call in (
        lambda: learner.act(state, np.zeros(2)),
        lambda: learner.correct(state, np.zeros(2), [0.0], [1]),
        lambda: learner.policy_of(state),
        lambda: gpcjax.Session(learner, state),
    ):
        with pytest.raises(ValueError, match=r"^state: it holds .* give an array of plain numbers$"):
            call()


def test_a_state_with_a_function_in_it_is_told():
    class Netted(Linear):
        def init(self, key=None):
            return eqx.nn.MLP(self.obs_size, self.action_size, 2, 1, key=jax.random.key(0))

    learner = Netted(**SIZES)
    state = learner.init()
    for call in (
        lambda: learner.act(state, np.zeros(3)),
        lambda: learner.policy_of(state),
        lambda: gpcjax.Session(learner),
    ):
        with pytest.raises(
            ValueError, match=r"^Netted.init does not fit \(its state.activation is a custom_jvp"
        ):
            call()


def test_a_state_of_any_room_is_ones_own():
    learner = make_learner("gpc", obs_size=2, action_size=1, capacity=4)
    for state in (learner.grow(learner.init()), learner.resize(learner.init(), 32, 4)):
        assert learner.act(state, [0.1, 0.2]).shape == (1,) and learner.policy_of(state)


class Linear(gpcjax.Learner):
    def init(self, key=None):
        return jnp.zeros((self.action_size, self.obs_size))

    def propose(self, state, obs):
        return state @ obs

    def learn(self, state, moment, advice, key):
        return state + 0.1 * jnp.outer(advice, moment.obs), gpcjax.Info.of(rate=0.1 * jnp.abs(advice))


class Narrow(Linear):
    def init(self, key=None):
        return jnp.zeros((1, self.obs_size))


class Flat(Linear):
    def learn(self, state, moment, advice, key):
        return state, gpcjax.Info.of(rate=jnp.ones(1))


class Short(Linear):
    def init(self, key=None):
        return jnp.zeros((self.action_size, self.obs_size), jnp.float32)


class Told(Linear):
    def learn(self, state, moment, advice, key):
        return state


SIZES = {"obs_size": 3, "action_size": 2}


@pytest.mark.parametrize("own", [Flat, Short, Told])
def test_what_learning_gives_is_looked_at(own):
    learner = own(**SIZES)
    with pytest.raises(ValueError, match=rf"^{own.__name__}.learn does not fit \("):
        learner.correct(learner.init(), np.ones(3), np.zeros(2), [1, 0])
    with pytest.raises(ValueError, match=rf"^{own.__name__}.learn does not fit \("):
        gpcjax.Session(learner)


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        (
            "status",
            np.zeros(2, np.int32),
            r"Info.status is int32 of shape \(2,\), it should be one whole number",
        ),
        ("status", np.float64(0.5), r"Info.status is float64 of shape \(\)"),
        ("status", None, "Info.status is None"),
        (
            "appended",
            np.zeros(7, bool),
            r"Info.appended is bool of shape \(7,\), it should be bool of shape \(2,\)",
        ),
        ("replaced", np.zeros(2), "Info.replaced is float64"),
        ("full", np.bool_(False), r"Info.full is bool of shape \(\)"),
        ("sigma_policy", np.zeros(1), r"Info.sigma_policy is float64 of shape \(1,\)"),
        ("sigma_human", None, "Info.sigma_human is None"),
    ],
)
def test_every_part_of_an_info_is_looked_at(field, value, told):
    class Odd(Linear):
        def learn(self, state, moment, advice, key):
            new, info = super().learn(state, moment, advice, key)
            return new, eqx.tree_at(lambda info: getattr(info, field), info, value)

    learner = Odd(**SIZES)
    with pytest.raises(ValueError, match=rf"^Odd.learn does not fit \({told}"):
        learner.correct(learner.init(), np.ones(3), np.zeros(2), [1, 0])
    with pytest.raises(ValueError, match=r"^Odd.learn does not fit"):
        gpcjax.Session(learner)


@pytest.mark.parametrize("status", [0, gpcjax.Status.OK, np.int64(0)])
def test_an_info_of_pythons_numbers(status):
    class Plain(Linear):
        def learn(self, state, moment, advice, key):
            new, _ = super().learn(state, moment, advice, key)
            return new, eqx.tree_at(lambda info: info.status, gpcjax.Info.of([0.1] * 2), status)

    learner = Plain(**SIZES)
    _, info = learner.correct(learner.init(), np.ones(3), np.zeros(2), [1, 0])
    assert info.rate.tolist() == [0.1, 0.0] and info.status.dtype == np.int32


def test_an_action_of_another_size():
    learner = Narrow(**SIZES)
    state = learner.init()
    with pytest.raises(ValueError, match=r"^Narrow.propose does not fit \(an action is float64 of shape"):
        learner.act(state, np.ones(3))
    with pytest.raises(ValueError, match=r"^Narrow.propose does not fit"):
        gpcjax.Session(learner)
    with pytest.raises(
        ValueError, match=r"^the policy of Narrow does not fit \(an action is of shape \(1,\)"
    ):
        learner.policy_of(state)(np.ones(3))


def test_a_state_with_pythons_numbers():
    class Counted(Linear):
        def init(self, key=None):
            return {"weights": super().init(key), "n": 0}

        def propose(self, state, obs):
            return state["weights"] @ obs

        def learn(self, state, moment, advice, key):
            weights, info = super().learn(state["weights"], moment, advice, key)
            return {"weights": weights, "n": state["n"] + 1}, info

    learner = Counted(**SIZES)
    session, state = gpcjax.Session(learner), learner.init()
    for _ in range(3):
        action = learner.act(state, np.ones(3))
        np.testing.assert_array_equal(session.propose(np.ones(3)), action)
        np.testing.assert_array_equal(learner.policy_of(state)(np.ones(3)), action)
        session.advise([1, 0])
        state, _ = learner.correct(state, np.ones(3), action, [1, 0])
    assert state["n"] == session.state["n"] == 3
