"""The fast learners against the dense float64 reference, on generated sequences with repeats and near-repeats."""

import numpy as np
import pytest

from gpcjax.learners.factory import make_learner
from tests.reference.domains import DOMAINS, make_reference

TOLERANCE = 1e-8
"""What parity promises; measured differences are about 1e-12."""


def sequence(name: str, seed: int, length: int):
    """Observations and advice: fresh states, exact repeats, near-repeats (1e-6 and 1e-3 apart), jumps far out."""
    domain = DOMAINS[name]
    rng = np.random.default_rng(seed)
    visited: list[np.ndarray] = []
    for _ in range(length):
        kind = rng.choice(["fresh", "repeat", "near", "nearer", "far"], p=[0.5, 0.2, 0.15, 0.13, 0.02])
        obs = rng.normal(size=domain.obs_size) * np.asarray(domain.spread)
        if kind != "fresh" and kind != "far" and visited:
            shift = {"repeat": 0.0, "near": 1e-3, "nearer": 1e-6}[kind]
            obs = visited[rng.integers(len(visited))] + shift * obs
        elif kind == "far":
            obs = 5 * obs
        visited.append(obs)
        yield obs, rng.choice([-1.0, 0.0, 1.0], p=[0.45, 0.1, 0.45], size=domain.action_size)


def compare(learner, reference, items) -> int:
    """Runs both side by side; gives the number of replacements."""
    state, replaced = learner.init(), 0
    for step, (obs, advice) in enumerate(items):
        action = learner.act(state, obs)
        np.testing.assert_allclose(action, reference.act(obs), atol=TOLERANCE, rtol=0)
        if hasattr(reference, "uncertainty") and step % 4 == 0:  # it is the sigma of the correction, too
            sigma = np.asarray(learner.uncertainty(state, obs, action))
            np.testing.assert_allclose(
                sigma, reference.uncertainty(obs, np.asarray(action)), atol=TOLERANCE, rtol=0
            )
            assert (sigma <= learner.largest_sigma()).all()  # what thinning relies on
        state, info = learner.correct(state, obs, action, advice)
        expected = reference.correct(obs, np.asarray(action), advice)
        given = advice != 0
        for field in ("rate", "sigma_policy", "sigma_human"):
            np.testing.assert_allclose(
                np.asarray(getattr(info, field))[given],
                getattr(expected, field)[given],
                atol=TOLERANCE,
                rtol=0,
                err_msg=field,
            )
        assert info.status == 0
        np.testing.assert_array_equal(info.appended, expected.appended)
        np.testing.assert_array_equal(info.replaced, expected.replaced)
        replaced += int(expected.replaced.sum())
    return replaced


QUICKEST = ("gpc", "cartpole", 120), ("coach", "lunarlander", 80)
"""One action and two; that of GPC-NS is in test_scaling, with factors of its inputs."""


@pytest.mark.parametrize(
    ("algo", "name", "length"),
    [
        *QUICKEST,
        *(
            pytest.param(algo, name, 290 if name == "cartpole" else 120, marks=pytest.mark.slow)
            for algo in ("gpc", "gpc-ns", "coach")
            for name in DOMAINS
        ),
    ],
)
def test_parity_with_the_dense_reference(algo: str, name: str, length: int):
    """Over several hundred corrections for the cart-pole."""
    capacity = 290 if name == "cartpole" else 128
    options = {} if algo == "coach" else {"capacity": capacity}
    replaced = compare(
        make_learner(algo, name, **options), make_reference(algo, name), sequence(name, 1, length)
    )
    assert algo == "coach" or replaced > 10


@pytest.mark.slow
def test_parity_for_the_smoothness_of_no_table():
    """The tables have 0.5 (pendulum) and 1.5."""
    tables = {getattr(DOMAINS[name], algo)["policy_nu"] for name in DOMAINS for algo in ("gpc", "gpc_ns")}
    assert tables == {0.5, 1.5}
    learner = make_learner("gpc", "cartpole", capacity=64, policy_nu=2.5)
    compare(learner, make_reference("gpc", "cartpole", policy_nu=2.5), sequence("cartpole", 2, 50))


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["gpc", "gpc-ns"])
def test_parity_of_the_ablations(algo: str):
    """Without SPARS repeats pile up, and only the noise keeps the Gram matrix regular."""
    learner = make_learner(algo, "pendulum", capacity=64, sparsify=False, static_rate=0.04)
    reference = make_reference(algo, "pendulum", sparsify=False, static_rate=0.04)
    assert compare(learner, reference, sequence("pendulum", 3, 60)) == 0


@pytest.mark.parametrize("steps", [300, pytest.param(2200, marks=pytest.mark.slow)])
def test_parity_after_many_replacements(steps: int):
    """In one dictionary: the reflections lose no digits. H would grow without end: it keeps one point."""
    learner = make_learner(
        "gpc", "cartpole", policy_capacity=64, human_capacity=1, on_full="replace-nearest", static_rate=0.04
    )
    reference = make_reference("gpc", "cartpole", static_rate=0.04)
    for model in reference.humans:
        model.put = lambda *_: None
        model.train = lambda: None
    rng = np.random.default_rng(4)
    centres = rng.normal(size=(12, 4)) * np.array([1.0, 1.0, 0.13, 0.4])
    state, replaced = learner.init(), 0
    for step in range(steps):
        obs = centres[rng.integers(12)] * (1 + 0.02 * rng.normal(size=4))
        advice = rng.choice([-1.0, 1.0], size=1)
        state, info = learner.correct(state, obs, np.zeros(1), advice)
        expected = reference.correct(obs, np.zeros(1), advice)
        np.testing.assert_allclose(info.sigma_policy, expected.sigma_policy, atol=TOLERANCE, rtol=0)
        if step % 20 == 0:
            np.testing.assert_allclose(learner.act(state, obs), reference.act(obs), atol=TOLERANCE, rtol=0)
        replaced += int(info.replaced[0])
    assert replaced > 0.9 * steps
