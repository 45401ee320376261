"""The return of a fixed policy."""

import collections
import queue
import random

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.engine import programs
from gpcjax.engine.evaluate import evaluate, idle
from gpcjax.engine.remembered import Remembered
from gpcjax.envs.cartpole import CartPole
from gpcjax.envs.host import HostEnv
from tests.engine.host_tasks import host_drift
from tests.engine.tasks import Drift, advance, expert, reset, start_key


def weakly(obs):
    """Less than the expert would do: some episodes end early."""
    return 0.05 * expert(obs)


@pytest.fixture(scope="module")
def many():
    """What comes of ten starts."""
    return evaluate(Drift(), weakly, starts=10)


def test_against_a_plain_loop(many):
    """One episode each, from the first start of seeds 0, 1, ...; steps after its end count for nothing."""
    act = jax.jit(weakly)
    for seed in range(4):
        at, total = reset(Drift(), start_key(seed, 0)), 0.0
        while not at.done:
            at = advance(Drift(), at, act(at.obs))
            total += at.reward
        np.testing.assert_allclose(many.returns[seed], total, rtol=1e-12)
        assert many.length[seed] == at.time
    assert len(set(np.asarray(many.returns))) == 10 and len(set(np.asarray(many.length[:4]))) > 1


def test_the_number_of_starts_changes_none_of_them(many):
    few = evaluate(Drift(), weakly, starts=3)
    np.testing.assert_allclose(many.returns[:3], few.returns, rtol=1e-12)


def in_turn(env, policy, starts):
    """The returns of a policy that is asked at each step, once for each start, in their order: plainly."""
    states, returns = [reset(env, start_key(seed, 0)) for seed in range(starts)], np.zeros(starts)
    while going := [place for place, at in enumerate(states) if not at.done]:
        for place, action in [(place, np.asarray(policy(states[place].obs))) for place in going]:
            states[place] = advance(env, states[place], np.clip(action, -1.0, 1.0))
            returns[place] += states[place].reward
    return returns


@pytest.mark.parametrize(
    ("library", "on_host"),
    [
        (jnp, False),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((np, False), (jnp, True), (np, True))),
    ],
)
def test_starts_from_another_seed_on(on_host, library):
    env = host_drift() if on_host else Drift()
    policy = lambda obs: -0.3 * library.asarray(obs[:2])  # noqa: E731
    later, all_of_them = evaluate(env, policy, 3, seed=4), evaluate(env, policy, 7)
    np.testing.assert_allclose(later.returns, all_of_them.returns[4:], rtol=1e-12)
    np.testing.assert_array_equal(later.length, all_of_them.length[4:])
    assert len(set(np.asarray(all_of_them.returns))) == 7
    with pytest.raises(ValueError, match=r"seed -1: give a whole number from 0 to 1,000,000,000"):
        evaluate(env, policy, 3, seed=-1)


def test_idle_does_nothing():
    env = CartPole()
    assert idle(env)(jnp.ones(4)).tolist() == [0.0]
    returns = evaluate(env, idle(env), starts=20)
    assert returns.returns.shape == (20,)
    np.testing.assert_array_equal(returns.returns, returns.length)
    assert 20 < returns.returns.mean() < 80


@pytest.fixture(
    scope="module", params=[CartPole(max_steps=30), HostEnv("p", "Pendulum-v1", 30)], ids=["compiled", "host"]
)
def env(request):
    return request.param


@pytest.fixture(scope="module")
def idly(env):
    """What comes of doing nothing."""
    return evaluate(env, idle(env), 6)


class TestWhatIsNotFinite:
    """Its episode ends with no return, after the steps taken until then; the others go on."""

    @pytest.mark.parametrize(
        "value", [np.nan, *(pytest.param(value, marks=pytest.mark.slow) for value in (np.inf, -np.inf))]
    )
    @pytest.mark.parametrize("library", [jnp, pytest.param(np, marks=pytest.mark.slow)])
    def test_an_action(self, env, idly, library, value):
        def policy(obs):
            return library.where(obs[:1] > 0, value, 0.0 * library.asarray(obs[:1]))

        got = evaluate(env, policy, 6)
        lost = np.isnan(np.asarray(got.returns))
        assert lost.any() and (np.asarray(got.length)[lost] < np.asarray(idly.length)[lost]).any()
        np.testing.assert_allclose(np.asarray(got.returns)[~lost], np.asarray(idly.returns)[~lost])

    def test_from_the_start(self, env):
        got = evaluate(env, lambda obs: obs[:1] * np.nan, 3)
        assert np.isnan(np.asarray(got.returns)).all() and not got.length.any()


class Exploding(CartPole):
    """Its position is no number from the third step on; the limits, compared with it, would never end it."""

    def step(self, state, action):
        after = super().step(state, action)
        return eqx.tree_at(lambda state: state.obs, after, jnp.where(after.time < 3, after.obs, jnp.nan))


def test_an_observation_that_is_not_finite_is_the_last():
    got = evaluate(Exploding(), idle(Exploding()), 3)
    assert np.isnan(np.asarray(got.returns)).all() and got.length.tolist() == [3, 3, 3]


@pytest.mark.parametrize("starts", [0, 1.5, 2.0, True, "3", None, 10**9])
def test_starts_is_a_whole_number(starts):
    with pytest.raises(ValueError, match=r"starts .*: give a whole number from 1 to 1,000,000"):
        evaluate(CartPole(), lambda obs: obs[:1], starts)


def test_starts_may_be_a_whole_number_of_numpy():
    assert evaluate(Drift(), weakly, np.int64(3)).returns.shape == (3,)


@pytest.mark.parametrize(
    "env", [CartPole(max_steps=5), HostEnv("p", "Pendulum-v1", 5)], ids=["compiled", "host"]
)
@pytest.mark.parametrize(
    "policy",
    [
        lambda obs: obs,
        pytest.param(lambda obs: obs[0], marks=pytest.mark.slow),
        lambda obs: obs[:1] * 1j,
        lambda obs: obs[:1] > 0,
        lambda obs: 0.5,
        pytest.param(lambda obs: np.zeros(2), marks=pytest.mark.slow),
        lambda obs: None,
        lambda obs: "left",
        3,
    ],
)
def test_actions_of_another_size_or_type(env, policy):
    with pytest.raises(ValueError, match=r"the policy's action .* takes|policy 3: give a function"):
        evaluate(env, policy, 2)


def test_a_policy_of_numpy_gives_what_one_of_jax_does():
    env = CartPole(max_steps=20)
    ours = evaluate(env, lambda obs: jnp.tanh(9.0 * obs[2:3] + obs[3:]), 2)
    plain = evaluate(env, lambda obs: np.tanh(9.0 * np.asarray(obs)[2:3] + float(obs[3])), 2)
    np.testing.assert_allclose(plain.returns, ours.returns)
    draws = np.random.default_rng(0)
    asked = []
    evaluate(env, lambda obs: asked.append(1) or draws.uniform(-1, 1, size=1), 2)
    assert len(asked) > 10, "a result that is not jax's may be another one each time"


def test_one_program_for_functions_that_do_the_same(monkeypatch):
    """Whatever their numbers and arrays are; what they refer to is taken as it is now."""
    compiled = []
    compile_ = jax.stages.Lowered.compile
    monkeypatch.setattr(jax.stages.Lowered, "compile", lambda self: compiled.append(1) or compile_(self))
    env, gains = CartPole(max_steps=40), jnp.array([0.0, 0.0, 9.0, 1.0])
    returns = []
    for factor in (1.0, -1.0, 0.5):
        policy = lambda obs, gains=gains * factor, bias=factor / 7: (gains @ obs + bias)[None]  # noqa: E731
        returns.append(float(evaluate(env, policy, 3).returns.mean()))
    assert len(compiled) == 1 and len(set(returns)) > 1
    sign = 1.0

    def changing(obs):
        return sign * jnp.tanh(9.0 * obs[2:3])

    before = evaluate(env, changing, 3).returns
    sign = -1.0
    assert (evaluate(env, changing, 3).returns < before).all() and len(compiled) == 2
    monkeypatch.setattr(programs, "KEPT", 2)
    evaluate(CartPole(max_steps=1), lambda obs: jnp.roll(obs, 1)[:1], 1)
    assert len(programs._programs) == 2


@pytest.mark.slow
def test_large_constants_are_told_apart():
    """Of functions that a person has compiled: their arrays are part of the program."""
    env, weights = CartPole(max_steps=40), np.random.default_rng(0).normal(size=(300, 4))
    one, other = (
        evaluate(env, jax.jit(lambda obs, w=w: jnp.tanh((jnp.asarray(w) @ obs).sum())[None]), 4).returns
        for w in (weights, -weights)
    )
    assert (np.asarray(one) != np.asarray(other)).any()


@pytest.mark.slow
def test_inside_jit():
    """As part of a larger program, also for several values at once."""
    env = CartPole(max_steps=40)
    score = lambda gain: evaluate(env, lambda obs: jnp.tanh(gain * obs[2:3]), 3).returns.mean()  # noqa: E731
    together = jax.jit(jax.vmap(score))(jnp.array([9.0, -9.0]))
    np.testing.assert_allclose(together, [score(9.0), score(-9.0)])


class Remembering:
    """What a person writes who filters, counts or keeps what was seen."""

    def __init__(self):
        self.last, self.asked, self.seen = jnp.zeros(2), 0, []

    def filtered(self, obs):
        self.last = 0.9 * self.last + 0.1 * obs
        return self.last

    def counted(self, obs):
        self.asked += 1
        return jnp.where(self.asked <= 5, 1.0, jnp.tanh(obs))

    def kept(self, obs):
        self.seen.append(obs)
        return jnp.tanh(obs)

    def branched(self, obs):
        self.asked += 1
        return jnp.ones(2) if self.asked % 7 == 0 else jnp.tanh(obs)


def drawing(how):
    """Policies that draw numbers, each from a generator of its own that begins at the same place."""
    rng, plain = np.random.default_rng(3), random.Random(3)
    return {
        "added": lambda obs: jnp.tanh(obs) + rng.normal(0, 0.3),
        "float": lambda obs: jnp.tanh(obs) + float(rng.normal(0, 0.3)),
        "array": lambda obs: jnp.tanh(obs) + jnp.asarray(rng.normal(0, 0.3, 2)),
        "index": lambda obs: jnp.full(2, obs[int(rng.integers(2))]),
        "everybody's": lambda obs: jnp.tanh(obs) + np.random.normal(0, 0.3),
        "seldom": lambda obs: jnp.ones(2) if plain.random() < 0.05 else jnp.tanh(obs),
    }[how]


@pytest.mark.parametrize("env", [Drift(max_steps=12), host_drift(max_steps=12)], ids=["compiled", "host"])
class TestAnotherFunctionAtEachCall:
    """It is asked at each step, as one is whose result comes from numpy; tracing leaves nothing behind."""

    @pytest.mark.parametrize(
        "how",
        [
            *("added", "index", "everybody's"),
            *(pytest.param(how, marks=pytest.mark.slow) for how in ("float", "array", "seldom")),
        ],
    )
    def test_that_draws(self, env, how):
        drawn, plain = drawing(how), drawing(how)
        np.random.seed(4)
        got = evaluate(env, drawn, 2)
        np.random.seed(4)
        np.testing.assert_allclose(got.returns, in_turn(env, plain, 2))

    @pytest.mark.parametrize(
        "how",
        ["filtered", "kept", *(pytest.param(how, marks=pytest.mark.slow) for how in ("counted", "branched"))],
    )
    def test_that_remembers(self, env, how):
        ours, plain = Remembering(), Remembering()
        got = evaluate(env, getattr(ours, how), 2)
        np.testing.assert_allclose(got.returns, in_turn(env, getattr(plain, how), 2))
        assert not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(vars(ours)))
        np.testing.assert_array_equal(ours.last, plain.last)
        assert ours.asked == plain.asked and len(ours.seen) == len(plain.seen)


def test_what_is_made_at_the_first_call_and_kept_is_no_memory():
    asked = queue.SimpleQueue()

    class Lazy:
        scale = None

        def __call__(self, obs):
            asked.put(isinstance(obs, jax.core.Tracer))
            self.scale = 0.3 if self.scale is None else self.scale
            return -self.scale * obs

    evaluate(Drift(), Lazy(), 2)
    assert all(asked.get() for _ in range(asked.qsize()))


def test_what_a_function_refers_to_is_put_back():
    draws, table, line = np.random.default_rng(1), {"a": 1}, collections.deque([1])
    numbers, count = np.zeros(3), 0

    def changing(obs):
        nonlocal count
        count += 1
        table.update(a=2, b=obs)
        line.append(obs)
        numbers[1] = 4
        return obs * draws.normal() + np.random.normal()

    def state():
        kept = (draws.bit_generator.state, np.random.get_state())
        return repr((table, line, numbers, count, kept))

    was, before = state(), Remembered(changing)
    assert not before.is_changed
    changing(1.0)
    before.look_again()
    assert before.is_changed and not before.is_disturbed and state() != was
    before.put_back()
    assert state() == was and before.is_disturbed


@pytest.mark.parametrize("library", [jnp, np])
def test_an_action_beyond_the_bounds_is_clipped(library):
    """As in a sweep: a task of one's own need not do it."""

    class Told(Drift):
        def step(self, state, action):
            return self.advance(state, state.physics, obs=state.obs, reward=action[0] - 0.25 * action[1])

    got = evaluate(Told(max_steps=8), lambda obs: library.asarray([7.0, -3.0]) + 0 * obs, 2)
    np.testing.assert_allclose(got.returns, 8 * 1.25)
