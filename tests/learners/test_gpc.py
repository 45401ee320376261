"""What a GPC learner promises beside its numbers, which test_parity compares."""

import dataclasses
import math
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.learners.base import Status
from gpcjax.learners.factory import make_learner
from gpcjax.learners.gpc import GPC
from tests.reference.domains import make_reference
from tests.trees import assert_close, assert_same_bits

ROOT = Path(__file__).parents[2]
gpc_first = pytest.mark.parametrize("algo", ["gpc", pytest.param("gpc-ns", marks=pytest.mark.slow)])
"""For what both have from the code that they share."""


def taught(learner, count=12, seed=0):
    """A state after some corrections on all dimensions, with replacements among them."""
    rng, state = np.random.default_rng(seed), learner.init()
    for _ in range(count):
        obs = rng.choice([0.4, 1.0]) * rng.normal(size=learner.obs_size)
        state, _ = learner.correct(
            state, obs, learner.act(state, obs), rng.choice([-1.0, 1.0], learner.action_size)
        )
    return state


def dimension(state, i):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[i], state)


class TestWithoutAdvice:
    @gpc_first
    @pytest.mark.parametrize(
        "count", [*(pytest.param(count, marks=pytest.mark.slow) for count in (0, 16)), 12]
    )
    def test_a_dimension_is_untouched_to_the_bit(self, algo, count):
        """Be it empty, half full or full; the other dimension learns as ever."""
        learner = make_learner(
            algo, "lunarlander", capacity=16, **({"sparsify": False} if count == 16 else {})
        )
        state, obs = taught(learner, count), np.linspace(-1, 1, 8)
        action = learner.act(state, obs)
        for advised, other in ((0, 1), (1, 0)):
            advice = np.zeros(2)
            advice[advised] = 1.0
            after, info = learner.correct(state, obs, action, advice)
            assert_same_bits(dimension(after, other), dimension(state, other))
            assert info.rate[other] == 0 and not (info.appended | info.replaced | info.full)[other]
            if count < 16:
                assert info.status == Status.OK and info.appended[advised]
                both, _ = learner.correct(state, obs, action, np.ones(2))
                assert_close(dimension(after, advised), dimension(both, advised), 1e-9)

    @gpc_first
    def test_no_advice_at_all_changes_nothing(self, algo):
        learner = make_learner(algo, "lunarlander", capacity=16)
        state = taught(learner)
        for obs in (np.zeros(8), np.full(8, np.nan)):
            after, info = learner.correct(state, obs, np.zeros(2), np.zeros(2))
            assert_same_bits(after, state)
            assert info.status == Status.OK and not info.rate.any()

    @pytest.mark.slow
    @pytest.mark.parametrize("algo", ["gpc", "gpc-ns"])
    def test_even_in_a_state_that_was_grown(self, algo):
        learner = make_learner(algo, "lunarlander", capacity=16)
        state = learner.grow(taught(learner))
        after, _ = learner.correct(state, np.zeros(8), np.zeros(2), np.array([0.0, 1.0]))
        assert_same_bits(dimension(after, 0), dimension(state, 0))


@gpc_first
class TestFull:
    """Both dictionaries have four places, and the fifth correction is far from the others.

    With `repeat` the fourth repeats the third, whose place it takes in the policy: that one has room.
    """

    def correct(self, algo, on_full, repeat=False, human=4):
        learner = make_learner(algo, "cartpole", policy_capacity=4, human_capacity=human, on_full=on_full)
        state = learner.init()
        for step in (0, 1, 2, 2) if repeat else range(4):
            obs = 3.0 * np.eye(4)[step]
            state, info = learner.correct(state, obs, learner.act(state, obs), [1])
            assert info.status == Status.OK and not info.full
        assert state.policy.count == (3 if repeat else 4) and state.human.count == 4
        return learner, state, *learner.correct(state, np.array([2.5, 0, 0, -0.5]), [0.1], [-1])

    def test_error_refuses(self, algo):
        """Also where the policy alone has no room."""
        _, before, after, info = self.correct(algo, "error", human=8)
        assert_same_bits(after, before)
        assert info.status == Status.FULL and info.full and info.rate == 0
        assert not info.appended and not info.replaced

    def test_replace_nearest_replaces_in_both(self, algo):
        """The first point is the nearest, and keeps its place."""
        _, before, after, info = self.correct(algo, "replace-nearest")
        assert info.status == Status.OK and info.full and info.replaced and not info.appended
        for model in ("policy", "human"):
            old, new = getattr(before, model), getattr(after, model)
            assert new.count == old.count == 4
            np.testing.assert_array_equal(new.points[0, 0, :4], [2.5, 0, 0, -0.5])
            np.testing.assert_array_equal(new.points[:, 1:], old.points[:, 1:])
        assert after.human.targets[0, 0] == -1
        assert after.policy.targets[0, 0] == pytest.approx(0.1 - info.rate[0])

    @pytest.mark.parametrize(
        "room", [{}, {"repeat": True}, pytest.param({"human": 8}, marks=pytest.mark.slow)]
    )
    def test_drop_refuses_for_both_models(self, algo, room):
        """Whichever has no room: neither learns, and the answer says so."""
        _, before, after, info = self.correct(algo, "drop", **room)
        assert_same_bits(after, before)
        assert info.status == Status.FULL and info.full and info.rate == 0
        assert not info.appended and not info.replaced

    def test_replace_nearest_leaves_a_model_with_room_alone(self, algo):
        _, _, after, info = self.correct(algo, "replace-nearest", repeat=True)
        assert after.policy.count == 4 and after.human.count == 4 and info.appended and info.full

    def test_a_replacement_needs_no_room_in_the_policy(self, algo):
        """SPARS puts a repeat in the place of an old point: a full policy alone refuses nothing."""
        learner, state, _, _ = self.correct(algo, "error", human=8)
        obs = 3.0 * np.eye(4)[2]
        after, info = learner.correct(state, obs, learner.act(state, obs), [1])
        assert info.status == Status.OK and info.replaced and not info.full
        assert after.policy.count == 4 and after.human.count == 5


@pytest.mark.parametrize("algo", ["gpc", pytest.param("gpc-ns", marks=pytest.mark.slow), "coach"])
@pytest.mark.parametrize("count", [0, pytest.param(1, marks=pytest.mark.slow), 10])
def test_what_is_not_finite_never_enters_a_state(algo, count):
    """Nor what makes other numbers infinite, be the dictionary empty or not."""
    learner = make_learner(algo, "cartpole", **({"capacity": 16} if algo != "coach" else {}))
    state = taught(learner, count)
    for value in (np.nan, np.inf, -np.inf, 1e200):
        for obs, action in ((np.array([0, 0, 0, value]), [0.0]), (np.zeros(4), [value])):
            if action == [1e200]:  # a number, but no executed action
                continue
            after, info = learner.correct(state, obs, action, [1])
            assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(after))
            assert np.isfinite(learner.act(after, np.array([0.1, 0.0, 0.02, -0.1]))).all()
            if np.isfinite(value):
                continue
            assert_same_bits(after, state)
            assert info.status == Status.NON_FINITE and info.rate == 0
            assert not info.appended and not info.replaced


def test_every_status_has_a_word_and_a_message():
    assert [status.label for status in Status] == ["ok", "full", "non-finite", "invalid"]
    assert len({status.message for status in Status}) == 4


@gpc_first
class TestOneCodePath:
    @pytest.mark.slow
    def test_direct_jitted_and_batched_calls_agree(self, algo):
        """Three corrections of three learners at once, with hyperparameters of their own."""
        learners = [
            make_learner(algo, "lunarlander", capacity=16, constant_rate=0.01 * (1 + i)) for i in range(3)
        ]
        rng = np.random.default_rng(1)
        observations, advice = rng.normal(size=(3, 3, 8)), rng.choice([-1.0, 0.0, 1.0], size=(3, 3, 2))
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *learners)
        step = lambda learner, state, obs, h: learner.correct(state, obs, learner.act(state, obs), h)  # noqa: E731
        together, jitted = jax.jit(jax.vmap(step)), jax.jit(step)
        batch = jax.vmap(lambda learner: learner.init())(stacked)
        for round in range(3):
            # Each round starts from one state: differences of the last digits must not add up.
            before = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], batch) for i in range(2)]
            batch, batch_info = together(
                stacked, batch, jnp.asarray(observations[round]), jnp.asarray(advice[round])
            )
            for i, learner in enumerate(learners[:2]):
                obs, h = observations[round, i], advice[round, i]
                direct, info = step(learner, before[i], obs, h)
                compiled, compiled_info = jitted(learner, before[i], jnp.asarray(obs), jnp.asarray(h))
                member, member_info = jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], (batch, batch_info))
                for other, other_info in ((compiled, compiled_info), (member, member_info)):
                    assert_close(other_info, info, 1e-12)
                    probe = observations[0, i]
                    np.testing.assert_allclose(
                        learner.act(other, probe), learner.act(direct, probe), atol=1e-12
                    )
                    action = np.zeros(2)
                    np.testing.assert_allclose(
                        learner.uncertainty(other, probe, action),
                        learner.uncertainty(direct, probe, action),
                        atol=1e-12,
                    )

    def test_the_same_call_gives_the_same_bits(self, algo):
        learner = make_learner(algo, "cartpole", capacity=16)
        assert_same_bits(taught(learner), taught(learner))
        twin = make_learner(algo, "cartpole", capacity=16)
        assert_same_bits(taught(twin), taught(learner))

    @pytest.mark.slow
    def test_inside_scan(self, algo):
        learner = make_learner(algo, "cartpole", capacity=16)
        rng = np.random.default_rng(2)
        items = jnp.asarray(rng.normal(size=(10, 4))), jnp.asarray(rng.choice([-1.0, 1.0], size=(10, 1)))
        step = lambda state, item: learner.correct(state, item[0], learner.act(state, item[0]), item[1])  # noqa: E731
        last, infos = jax.lax.scan(step, learner.init(), items)
        state = learner.init()
        for obs, h, rate in zip(*items, infos.rate, strict=True):
            state, info = step(state, (obs, h))
            np.testing.assert_allclose(info.rate, rate, atol=1e-12)
        np.testing.assert_allclose(
            learner.act(last, items[0][0]), learner.act(state, items[0][0]), atol=1e-12
        )

    @pytest.mark.slow
    def test_one_trace_for_each_shape(self, algo, monkeypatch):
        """Values, hyperparameters and states are no reason to compile again; another capacity is."""
        traces = []
        original = GPC._correct
        monkeypatch.setattr(GPC, "_correct", lambda self, *rest: traces.append(self) or original(self, *rest))
        sizes = {"obs_size": 5, "action_size": 1, "capacity": 17}
        for rate in (0.01, 0.02):
            learner = make_learner(algo, **sizes, constant_rate=rate)
            state = learner.init()
            for step in range(3):
                state, _ = learner.correct(state, np.full(5, step), [0.1 * step], [1])
        assert len(traces) == 1
        learner.correct(learner.grow(state), np.zeros(5), [0.0], [1])
        assert len(traces) == 2


@gpc_first
def test_plain_numbers_of_any_kind_are_taken(algo):
    """Lists, float32 and integers: all are computed in float64."""
    learner = make_learner(algo, "cartpole", capacity=16)
    state, values = taught(learner), [0.5, -0.25, 0.125, 1.0]
    kinds = (
        values,
        np.asarray(values),
        np.asarray(values, np.float32),
        jnp.asarray(values),
        jnp.asarray(values, jnp.float32),
    )
    expected = learner.correct(state, jnp.asarray(values), jnp.zeros(1), jnp.ones(1))
    for obs in kinds:
        for advice in (
            [1],
            [1.0],
            np.ones(1, int),
            np.ones(1, np.float32),
            np.ones(1, np.int8),
            jnp.ones(1, jnp.int32),
        ):
            after = learner.correct(state, obs, [0], advice)
            assert_same_bits(after, expected)
        assert learner.act(state, obs).dtype == jnp.float64
        assert_same_bits(learner.act(state, obs), learner.act(state, values))
        assert_same_bits(learner.uncertainty(state, obs, [0]), learner.uncertainty(state, values, [0.0]))


class TestErrors:
    learner = make_learner("gpc", "lunarlander", capacity=4)

    @pytest.mark.parametrize(
        ("obs", "action", "advice", "message"),
        [
            (np.zeros(4), np.zeros(2), np.zeros(2), r"obs has shape \(4,\), this learner takes \(8,\)"),
            (np.zeros(8), [0, 0, 0], np.zeros(2), r"action has shape \(3,\), this learner takes \(2,\)"),
            (np.zeros(8), np.zeros(2), [1], r"advice has shape \(1,\), this learner takes \(2,\)"),
            (np.zeros(8), np.zeros(2), [1.0, 0.5], r"advice \[1.0, 0.5\]: each entry must be -1, 0 or 1"),
            (np.zeros(8), np.zeros(2), [2, 0], r"advice \[2.0, 0.0\]: each entry must be -1, 0 or 1"),
            (np.zeros(8), np.zeros(2), [np.nan, 0], r"advice \[nan, 0.0\]: each entry must be -1, 0 or 1"),
        ],
    )
    def test_correct_names_what_does_not_fit(self, obs, action, advice, message):
        with pytest.raises(ValueError, match=message):
            self.learner.correct(self.learner.init(), obs, action, advice)

    def test_so_do_act_and_uncertainty(self):
        state = self.learner.init()
        with pytest.raises(ValueError, match=r"obs has shape \(1,\), this learner takes \(8,\)"):
            self.learner.act(state, [0.0])
        with pytest.raises(ValueError, match=r"action has shape \(8,\), this learner takes \(2,\)"):
            self.learner.uncertainty(state, np.zeros(8), np.zeros(8))

    def test_inside_jit_shapes_are_still_checked(self):
        with pytest.raises(ValueError, match=r"obs has shape \(3,\)"):
            jax.jit(self.learner.act)(self.learner.init(), jnp.zeros(3))


def at(place):
    """An observation on a line."""
    return [place, 0.0, 0.0, 0.0]


class TestSparsification:
    def learner(self, **options):
        return make_learner(
            "gpc",
            obs_size=4,
            action_size=1,
            capacity=16,
            policy_variance=1.0,
            policy_length_scale=1.0,
            **options,
        )

    @pytest.mark.parametrize("order", [(-1, 1), pytest.param((1, -1), marks=pytest.mark.slow)])
    def test_a_tie_goes_to_the_lowest_index(self, order):
        """Two points at the same distance on both sides."""
        learner = self.learner()
        state = learner.init()
        for side in order:
            state, info = learner.correct(state, at(0.25 * side), [0.0], [1])
            assert info.appended
        covariances = jax.jit(type(learner.policy).covariances)(
            learner.policy, state.policy, (jnp.int32(0),), jnp.zeros(4)
        )
        assert covariances[0] == covariances[1]
        state, info = learner.correct(state, at(0.0), [0.0], [1])
        assert info.replaced and state.policy.count == 2
        np.testing.assert_array_equal(state.policy.points[0, :2, 0], [0.0, 0.25 * order[1]])

    def test_the_threshold_is_half_of_the_prior_deviation(self):
        """With one point and Matern 1.5 the deviation is known in closed form."""
        deviation = lambda r: math.sqrt(1 - ((1 + math.sqrt(3) * r) * math.exp(-math.sqrt(3) * r)) ** 2)  # noqa: E731
        learner = self.learner()
        first, _ = learner.correct(learner.init(), at(0.0), [0.0], [1])
        for distance in np.linspace(0.05, 1.0, 20):
            _, info = learner.correct(first, at(distance), [0.0], [1])
            assert info.sigma_policy == pytest.approx(deviation(distance), abs=1e-5)
            assert info.replaced == (deviation(distance) < 0.5)
            assert info.appended != info.replaced

    def test_the_first_correction_of_a_policy_without_uncertainty_is_appended(self):
        """A prior below the threshold cannot be, but noise alone can: there is nothing to replace yet."""
        learner = self.learner(noise=0.5)
        _, info = learner.correct(learner.init(), at(0.0), [0.0], [1])
        assert info.appended and not info.replaced

    def test_switched_off(self):
        learner = self.learner(sparsify=False)
        state = learner.init()
        for _ in range(3):
            state, info = learner.correct(state, at(0.0), [0.0], [1])
            assert info.appended
        assert state.policy.count == 3


class TestRate:
    def test_adaptive(self):
        """(3.5): r = sigma_p + sigma_h + c_r, before the correction."""
        learner = make_learner("gpc", "cartpole", capacity=16)
        state, info = learner.correct(learner.init(), np.zeros(4), [0.0], [1])
        prior = math.sqrt(0.01 + 1e-7)
        assert info.sigma_policy == info.sigma_human == prior
        assert info.rate == pytest.approx(2 * prior + 0.02, rel=1e-15)
        assert state.policy.targets[0, 0] == info.rate[0]
        _, again = learner.correct(state, np.zeros(4), [0.0], [1])
        assert again.rate < 0.1 * info.rate

    @pytest.mark.slow
    def test_the_target_is_not_clipped_and_starts_from_the_executed_action(self):
        learner = make_learner("gpc", "cartpole", capacity=16, static_rate=0.04)
        state, info = learner.correct(learner.init(), np.zeros(4), [0.99], [1])
        assert info.rate == 0.04
        assert state.policy.targets[0, 0] == pytest.approx(1.03)
        # What is executed is clipped.
        state, _ = learner.correct(state, np.zeros(4), [1.0], [1])
        assert learner.act(state, np.zeros(4)) == 1.0
        assert learner.controller(state)(jnp.zeros(4)) > 1.03

    def test_advice_raises_and_lowers_the_action(self):
        learner = make_learner("gpc", "cartpole", capacity=16)
        for sign in (-1, 1):
            state, _ = learner.correct(learner.init(), np.zeros(4), [0.0], [sign])
            assert sign * learner.act(state, np.zeros(4)) > 0.1


@gpc_first
@pytest.mark.slow
def test_growing_keeps_the_policy_and_learns_on(algo):
    """As if there had been room from the start."""
    small = make_learner(algo, "cartpole", capacity=8, sparsify=False)
    roomy = make_learner(algo, "cartpole", capacity=16, sparsify=False)
    state, full, probe = taught(small, 8), taught(roomy, 8), np.array([0.3, -0.2, 0.1, 0.0])
    assert not small.has_room(state) and roomy.has_room(full)
    grown = small.grow(state)
    assert small.has_room(grown) and grown.policy.points.shape == (1, 16, 4)
    np.testing.assert_allclose(small.act(grown, probe), small.act(state, probe), atol=1e-12)
    np.testing.assert_allclose(
        small.uncertainty(grown, probe, [0.1]), small.uncertainty(state, probe, [0.1]), atol=1e-12
    )
    for step in range(6):
        obs = 0.1 * step * np.ones(4)
        grown, info = small.correct(grown, obs, [0.0], [1])
        full, expected = roomy.correct(full, obs, [0.0], [1])
        assert info.appended and info.status == Status.OK
        np.testing.assert_allclose(info.rate, expected.rate, atol=1e-10)
    assert small.points(grown) == roomy.points(full) == (14, 14)
    np.testing.assert_allclose(small.act(grown, probe), roomy.act(full, probe), atol=1e-10)


@gpc_first
def test_the_controller_is_the_policy_before_clipping(algo):
    learner = make_learner(algo, "lunarlander", capacity=16)
    state, obs = taught(learner), np.random.default_rng(3).normal(size=(6, 8))
    controller, call = learner.controller(state), jax.jit(lambda controller, obs: controller(obs))
    proposed = np.stack([call(controller, each) for each in obs], -1)
    for each, action in zip(obs, proposed.T, strict=True):
        np.testing.assert_allclose(np.clip(action, -1, 1), learner.act(state, each), atol=1e-14)
    # With lanes on the last axis, as the engine keeps them.
    lanes = jax.tree.map(lambda leaf: np.stack([leaf] * 6, -1), controller)
    np.testing.assert_allclose(call(lanes, obs.T), proposed, atol=1e-14)


@pytest.mark.parametrize(
    ("algo", "task"), [("gpc", "lunarlander"), pytest.param("gpc-ns", "cartpole", marks=pytest.mark.slow)]
)
def test_uncertainty_is_bounded_by_the_prior(algo, task):
    """What thinning relies on."""
    learner = make_learner(algo, task, capacity=16)
    rng, sizes = np.random.default_rng(4), (learner.obs_size, learner.action_size)
    for count in (0, 3, 12):
        state = taught(learner, count)
        for obs in rng.normal(size=(20, sizes[0])):
            sigma = learner.uncertainty(state, obs, rng.uniform(-1, 1, sizes[1]))
            assert (sigma <= learner.largest_sigma()).all()


@pytest.mark.slow
def test_a_fresh_process_without_any_flag_computes_in_float64():
    """And with the threads that the machine gives: no setting of this suite is passed on."""
    script = """
import numpy as np, gpcjax
learner = gpcjax.make_learner("gpc", "cartpole")
state = learner.init()
rng = np.random.default_rng(0)
for _ in range(20):
    obs = rng.normal(size=4) * [1, 1, .13, .4]
    state, info = learner.correct(state, obs, learner.act(state, obs), rng.choice([-1, 1], 1))
    print(repr(float(info.rate[0])), repr(float(learner.act(state, np.zeros(4))[0])))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT, env={}
    )
    got = np.array([line.split() for line in done.stdout.splitlines()], float)
    reference, rng, expected = make_reference("gpc", "cartpole"), np.random.default_rng(0), []
    for _ in range(20):
        obs = rng.normal(size=4) * [1, 1, 0.13, 0.4]
        info = reference.correct(obs, reference.act(obs), rng.choice([-1, 1], 1))
        expected.append([info.rate[0], reference.act(np.zeros(4))[0]])
    np.testing.assert_allclose(got, expected, atol=1e-8)


def test_learners_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        make_learner("gpc", "cartpole").sparsify = False
