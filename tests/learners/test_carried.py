"""What a learner has learned, as the state of another one."""

import jax
import numpy as np
import pytest

from gpcjax.errors import UserError
from gpcjax.learners.carried import carried, points_of
from gpcjax.learners.factory import make_learner
from gpcjax.learners.packed import compact
from tests.trees import assert_close, assert_same_bits

ROOM = (48, 64)
OBS, ACTION = np.array([0.3, -0.2]), np.array([0.1, 0.0])


def learner_of(algo, **options):
    if algo == "d-coach":
        return make_learner(algo, obs_size=2, action_size=2, **{"width": 4, "buffer_size": 8} | options)
    if algo == "coach":
        grid = {"lower": (-1, -1), "upper": (1, 1), "counts": (2, 3)}
        return make_learner(algo, obs_size=2, action_size=2, **grid | options)
    return make_learner(algo, obs_size=2, action_size=2, **{"capacity": 32} | options)


def taught(learner, corrections=20):
    rng, state = np.random.default_rng(0), learner.init()
    for _ in range(corrections):
        obs, action = rng.normal(size=2), rng.uniform(-0.5, 0.5, size=2)
        state, _ = learner.correct(state, obs, action, rng.choice([-1, 0, 1], size=2))
    return state


@jax.jit
def _dense(process, points, query, scale):
    return process.kernel.gram(points, scale), process.kernel.covariances(points, query, scale)


@jax.jit
def _explained(process, posterior, place):
    return process.explained(posterior, (), process.covariances(posterior, (), place))


def dense_of(*given):
    """The Gram matrix of all places of a dictionary, and their covariances with a query."""
    return map(np.asarray, _dense(*given))


def on_host(learner):
    """As a sweep has it."""
    return jax.tree.map(np.asarray, learner)


@pytest.mark.parametrize("algo", ["gpc", pytest.param("gpc-ns", marks=pytest.mark.slow)])
def test_the_same_learner_has_the_same_state_in_other_room(algo):
    learner = learner_of(algo)
    state = taught(learner)
    policy, human = points_of(learner, state)
    assert 0 < policy <= human < 32
    for given in (state, compact(learner, state)):
        got = carried(learner, given, on_host(learner_of(algo, constant_rate=0.3)), ROOM)
        # Beyond its points a matrix may hold minus zeros, which `compact` cuts off.
        assert_close(got, learner.resize(state, *ROOM), atol=0)


@pytest.mark.parametrize(
    ("algo", "target"),
    [
        ("gpc", "gpc-ns"),
        ("gpc", "gpc"),
        *(pytest.param("gpc-ns", algo, marks=pytest.mark.slow) for algo in ("gpc", "gpc-ns")),
    ],
)
def test_other_hyperparameters_and_relatives_keep_points_and_targets(algo, target):
    """All else is what a dense computation makes of them."""
    learner = learner_of(algo)
    state = taught(learner)
    other = learner_of(target, policy={"length_scale": 0.9}, human={"variance": 0.4}, scaling=(2.0, 0.5))
    got = carried(learner, state, on_host(other), ROOM)
    uncertain, acts = np.asarray(other.uncertainty(got, OBS, ACTION)), np.asarray(other.act(got, OBS))
    for dimension in range(2):
        dense = {}
        for name, query in (("policy", OBS), ("human", np.append(OBS, ACTION[dimension]))):
            held, process = getattr(state, name), getattr(other, name)
            count = int(held.count[dimension])
            points, targets = (np.asarray(leaf)[dimension, :count] for leaf in (held.points, held.targets))
            after = jax.tree.map(
                lambda leaf, dimension=dimension: np.asarray(leaf)[dimension], getattr(got, name)
            )
            assert_same_bits((after.points[:count], after.targets[:count]), (points, targets))
            assert after.count == count and not after.points[count:].any()
            gram, k = dense_of(process, after.points, query, after.scale)
            gram, k = gram[:count, :count] + float(process.noise) * np.eye(count), k[:count]
            weights = np.linalg.solve(gram, k)
            dense[name] = weights @ targets, np.sqrt(float(process.prior) - weights @ k)
        np.testing.assert_allclose(acts[dimension], np.clip(dense["policy"][0], -1, 1), rtol=0, atol=1e-8)
        np.testing.assert_allclose(uncertain[dimension], dense["human"][1], rtol=0, atol=1e-8)


@pytest.mark.parametrize("on_full", ["error", pytest.param("replace-nearest", marks=pytest.mark.slow)])
def test_computed_anew_is_what_one_point_after_the_other_came_to(on_full):
    """Of the models that do not compute it anew at each point, and in room beyond one tile."""
    learner = learner_of("gpc", on_full=on_full)
    state = learner.resize(taught(learner), 140, 140)
    for process, held in ((learner.policy, state.policy), (learner.human, state.human)):
        one = jax.tree.map(lambda leaf: np.asarray(leaf)[1], held)
        again = jax.jit(lambda data, process=process: process.renewed(data))(one)
        place = np.ones(one.points.shape[1])
        explained = [(_explained(process, each, place), each.weights) for each in (again, one)]
        assert_close(*explained, atol=1e-8)


@pytest.mark.parametrize("algo", ["coach", pytest.param("d-coach", marks=pytest.mark.slow)])
def test_weights_go_to_their_own_kind(algo):
    learner = learner_of(algo)
    state = taught(learner)
    assert carried(learner, state, learner_of(algo, magnitude=0.7), ROOM) is state


@pytest.mark.parametrize(
    ("source", "target", "options", "line"),
    [
        ("coach", "gpc", {}, "of a COACH of another kind"),
        ("gpc", "d-coach", {}, "of a GPC of another kind"),
        ("coach", "coach", {"upper": (2, 2)}, "of a COACH of another size and another grid"),
        ("coach", "coach", {"counts": (3, 3)}, "of a COACH of another size and another grid"),
        ("d-coach", "d-coach", {"width": 5}, "of a DCoach of another size and another scaling"),
        ("d-coach", "d-coach", {"scaling": (2.0, 1.0)}, "of another size and another scaling"),
    ],
)
def test_what_means_nothing_is_refused(source, target, options, line):
    learner = learner_of(source)
    with pytest.raises(UserError, match=f"start x: .*{line}"):
        carried(learner, learner.init(), learner_of(target, **options), ROOM, "start x")


def test_sizes_and_room_are_named():
    learner = learner_of("gpc")
    wider = make_learner("gpc", obs_size=3, action_size=2)
    with pytest.raises(UserError, match="it was learned with 2 numbers of an observation, the task has 3"):
        carried(learner, learner.init(), wider, ROOM)
    with pytest.raises(UserError, match=r"points, here is room for \(4, 4\)"):
        carried(learner, taught(learner), learner_of("gpc"), (4, 4))
