"""The dense reference against scikit-learn and against values worked out by hand, and the peers against it."""

from __future__ import annotations

import itertools
import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from benchmarks.peers import numpy_loop, sklearn_loop
from benchmarks.peers.tasks import TASKS
from tests.reference.dense import DenseCOACH, DenseGP, DenseGPC, kernel
from tests.reference.domains import DOMAINS, Domain, make_reference


class SklearnModel:
    """A dictionary and the regressor fitted to it; the scaling sits in anisotropic length-scales."""

    def __init__(self, size: int, variance: float, length_scale: float, nu: float | None, weights=None):
        self.variance, self.length_scale, self.nu = variance, length_scale, nu
        self.inputs, self.targets = np.zeros((0, size)), np.zeros(0)
        self.fit(np.ones(size) if weights is None else 1 / np.asarray(weights))

    def fit(self, widths: np.ndarray) -> None:
        lengths: Any = self.length_scale * widths
        shape = RBF(lengths) if self.nu is None else Matern(lengths, nu=self.nu)
        self.signal = ConstantKernel(self.variance) * shape
        total = self.signal + WhiteKernel(1e-7)
        fixed: Any = None
        self.model = GaussianProcessRegressor(total, alpha=0.0, optimizer=fixed, normalize_y=False)
        if len(self.inputs):
            self.model.fit(self.inputs, self.targets)
        self.widths = widths

    def predict(self, x: np.ndarray) -> tuple[float, float]:
        prediction: Any = self.model.predict(x[None], return_std=True)
        return prediction[0].item(), prediction[1].item()

    def learn(self, index: int | None, x: np.ndarray, target: float, normalise: bool) -> None:
        keep = np.arange(len(self.inputs)) if index is None else np.delete(np.arange(len(self.inputs)), index)
        at = len(keep) if index is None else index
        self.inputs = np.insert(self.inputs[keep], at, x, axis=0)
        self.targets = np.insert(self.targets[keep], at, target)
        std = np.std(self.inputs, axis=0)
        self.fit(np.where(std < 1e-6, 1.0, std) if normalise else self.widths)


class SklearnGPC:
    """Alg. 2 and 3 for one action dimension."""

    def __init__(self, domain: Domain, normalise: bool):
        v = domain.gpc_ns if normalise else domain.gpc
        w = v.get("weights")
        size = domain.obs_size
        self.policy = SklearnModel(size, v["policy_variance"], v["policy_length_scale"], v["policy_nu"], w)
        z_weights = None if w is None else (*w, 1.0)
        self.human = SklearnModel(size + 1, v["human_variance"], v["human_length_scale"], None, z_weights)
        self.threshold = math.sqrt(v["policy_variance"]) / 2
        self.constant, self.normalise = v["constant_rate"], normalise

    def correct(self, obs: np.ndarray, action: float, h: float) -> tuple[float, float, float, bool]:
        z = np.concatenate([obs, [action]])
        sigma_p, sigma_h = self.policy.predict(obs)[1], self.human.predict(z)[1]
        rate = sigma_p + sigma_h + self.constant
        index = None
        if sigma_p < self.threshold:
            index = int(np.argmax(self.policy.signal(self.policy.inputs, obs[None])))
        self.policy.learn(index, obs, action + rate * h, self.normalise)
        self.human.learn(None, z, h, self.normalise)
        return rate, sigma_p, sigma_h, index is not None


def sequence(domain: Domain, length: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Observations and advice: new places, exact repeats, and near-repeats (1e-3 and 0.1 of the spread)."""
    rng = np.random.default_rng(seed)
    spread = np.array(domain.spread)
    steps: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(length):
        obs = rng.uniform(-1, 1, domain.obs_size) * spread
        if steps and rng.random() < 0.6:
            shift = rng.choice([0.0, 1e-3, 0.1]) * rng.standard_normal(domain.obs_size) * spread
            obs = steps[rng.integers(len(steps))][0] + shift
        steps.append((obs, rng.integers(-1, 2, domain.action_size).astype(float)))
    return steps


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name", [name if name == "pendulum" else pytest.param(name, marks=pytest.mark.slow) for name in DOMAINS]
)
@pytest.mark.parametrize("algo", ["gpc", "gpc-ns"])
def test_agrees_with_scikit_learn(algo: str, name: str, seed: int) -> None:
    domain = DOMAINS[name]
    dense = make_reference(algo, name)
    assert isinstance(dense, DenseGPC)
    peers = [SklearnGPC(domain, algo == "gpc-ns") for _ in range(domain.action_size)]
    replaced = 0
    for obs, h in sequence(domain, 60, seed):
        action = dense.act(obs)
        expected_action = np.clip([peer.policy.predict(obs)[0] for peer in peers], -1, 1)
        np.testing.assert_allclose(action, expected_action, atol=1e-9, rtol=0)
        sigma_h = dense.uncertainty(obs, action)
        info = dense.correct(obs, action, h)
        for i in np.flatnonzero(h):
            rate, sigma_p, own_sigma_h, own_replaced = peers[i].correct(obs, action[i], h[i])
            expected = rate, sigma_p, own_sigma_h, own_sigma_h
            given = info.rate[i], info.sigma_policy[i], info.sigma_human[i], sigma_h[i]
            np.testing.assert_allclose(given, expected, atol=1e-9, rtol=0)
            assert (info.replaced[i], info.appended[i]) == (own_replaced, not own_replaced)
            replaced += own_replaced
        assert np.isnan(info.rate[h == 0]).all() and not (info.appended | info.replaced)[h == 0].any()
    assert replaced > 0


@pytest.mark.parametrize("nu", [0.5, 1.5, 2.5, math.inf])
def test_kernel_agrees_with_scikit_learn(nu: float) -> None:
    x, y = np.random.default_rng(3).standard_normal((2, 20, 3))
    expected = (ConstantKernel(0.3) * Matern(0.7, nu=nu))(x, y)
    np.testing.assert_allclose(kernel(x, y, 0.3, 0.7, nu), expected, rtol=1e-12)


def test_empty_models_and_first_correction() -> None:
    learner = make_reference("gpc", "cartpole")
    assert isinstance(learner, DenseGPC)
    obs, prior = np.zeros(4), math.sqrt(0.01 + 1e-7)
    assert learner.act(obs) == [0.0] and learner.uncertainty(obs, np.zeros(1)) == [prior]
    info = learner.correct(obs, np.array([0.9]), np.array([1.0]))
    assert info.rate[0] == pytest.approx(2 * prior + 0.02, abs=1e-15) and info.appended[0]
    # The target is stored unclipped; the action is clipped.
    assert learner.policies[0].targets[0] == pytest.approx(0.9 + info.rate[0])
    assert learner.act(obs) == [1.0]
    after = 0.01 + 1e-7 - 0.01**2 / (0.01 + 1e-7)  # the variance at a point seen once
    assert learner.policies[0].predict(obs)[1] == pytest.approx(math.sqrt(after), rel=1e-9)


def test_static_rate_and_sparsification_can_be_set() -> None:
    learner = make_reference("gpc", "cartpole", static_rate=0.04, sparsify=False)
    for _ in range(3):
        info = learner.correct(np.zeros(4), np.zeros(1), np.array([-1.0]))
        assert info.rate[0] == 0.04 and info.appended[0]
    assert isinstance(learner, DenseGPC) and len(learner.policies[0].targets) == 3


def test_normalising_divides_by_the_standard_deviation_except_of_constant_columns() -> None:
    model = DenseGP(np.ones(3), 1.0, 1.0, 1.5, 1e-7)
    model.put(np.array([1.0, 5.0, 0.0]), 0.0)
    model.normalise()
    np.testing.assert_array_equal(model.scale, [1, 1, 1])
    model.put(np.array([5.0, 5.0, 1e-7]), 0.0)
    model.normalise()
    np.testing.assert_array_equal(model.scale, [0.5, 1, 1])  # population deviation of 1 and 5 is 2


def test_coach_by_hand() -> None:
    learner = DenseCOACH(grid=((-1, 3, 1),), beta=(30.0,), magnitude=(5.0,), coach_constant=(1.8,))
    obs, action, more = np.zeros(1), np.zeros(1), np.ones(1)
    side = math.exp(-0.5)  # the neighbours' value: one spacing away
    phi = np.array([side, 1, side]) / (1 + 2 * side)
    square = (1 + 2 * math.exp(-1)) / (1 + 2 * side) ** 2
    np.testing.assert_allclose(learner.features(obs), phi, rtol=1e-15)

    info = learner.correct(obs, action, more)  # psi = 0: the rate is c_c * e * (phi . phi)
    assert info.rate[0] == pytest.approx(1.8 * 5 * square, rel=1e-14)
    np.testing.assert_allclose(learner.theta[0], 9 * phi, rtol=1e-14)
    np.testing.assert_allclose(learner.psi[0], 30 * phi, rtol=1e-14)
    assert learner.act(obs) == [1.0]  # 9 * square = 3.3, clipped

    info = learner.correct(obs, action, -more)  # H(s) = 30 * square, before this update
    human = 30 * square
    assert info.rate[0] == pytest.approx((human + 1.8) * 5 * square, rel=1e-14)
    np.testing.assert_allclose(learner.theta[0], (9 - 5 * (human + 1.8)) * phi, rtol=1e-12)
    np.testing.assert_allclose(learner.psi[0], (30 + 30 * (-1 - human)) * phi, rtol=1e-12)

    human = (30 + 30 * (-1 - human)) * square  # now negative: the rate takes its size
    assert human < 0
    info = learner.correct(obs, action, more)
    assert info.rate[0] == pytest.approx((-human + 1.8) * 5 * square, rel=1e-12)


def test_coach_features_of_a_product_grid() -> None:
    obs = np.array([0.3, -2.0, 0.02, 0.5])
    axes = [np.linspace(-b, b, 4) for b in (1.44, 0.12, 0.126, 0.4)]
    values = []
    for centre in itertools.product(*axes):
        widths = [axis[1] - axis[0] for axis in axes]
        values.append(
            math.exp(-sum(((s - c) / w) ** 2 for s, c, w in zip(obs, centre, widths, strict=True)) / 2)
        )
    learner = make_reference("coach", "cartpole")
    assert isinstance(learner, DenseCOACH)
    np.testing.assert_allclose(learner.features(obs), np.array(values) / sum(values), rtol=1e-11)


def test_coach_grids() -> None:
    """One feature for each point of the product of the axes, and no 0/0 far from all of them."""
    sizes = {"pendulum": 6 * 6 * 7, "cartpole": 4**4, "lunarlander": 3 * 2**7}
    for name, size in sizes.items():
        learner = make_reference("coach", name)
        assert isinstance(learner, DenseCOACH) and len(learner.centres) == size
        far = learner.features(np.full(DOMAINS[name].obs_size, 1e4))
        assert np.isfinite(far).all() and far.sum() == pytest.approx(1)


def test_coach_leaves_the_dimension_without_advice_alone() -> None:
    learner = make_reference("coach", "lunarlander")
    assert isinstance(learner, DenseCOACH)
    info = learner.correct(np.zeros(8), np.zeros(2), np.array([0.0, 1.0]))
    assert not learner.theta[0].any() and np.isnan(info.rate[0])
    phi = learner.features(np.zeros(8))
    assert info.rate[1] == pytest.approx(20 * 1 * phi @ phi)


@pytest.mark.parametrize("name", [pytest.param("cartpole", marks=pytest.mark.slow), "pendulum"])
@pytest.mark.parametrize("algo", ["gpc", pytest.param("gpc-ns", marks=pytest.mark.slow), "coach"])
def test_peers_agree_with_the_reference(algo: str, name: str) -> None:
    """What the benchmark times is the same computation."""
    dense: Any = make_reference(algo, name)
    peers: list[Any] = [numpy_loop.LEARNERS[algo](name)]
    if algo != "coach":
        peers.append(sklearn_loop.SklearnGPC(algo, name))
    for obs, h in sequence(DOMAINS[name], 120, seed=2):
        action, floats = dense.act(obs), tuple(obs.tolist())
        for peer in peers:
            assert peer.act(floats) == pytest.approx(action[0], abs=1e-6)
        if not h[0]:
            continue
        info = dense.correct(obs, action, h)
        for peer in peers:
            given = peer.correct(floats, action[0], int(h[0]))
            if algo == "coach":
                assert given == pytest.approx(info.rate[0], abs=1e-9)
            else:
                expected = info.rate[0], info.sigma_policy[0], info.sigma_human[0], float(info.replaced[0])
                assert given == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("name", "gym_name"), [("cartpole", "CartPole-v1"), ("pendulum", "Pendulum-v1")])
def test_peers_step_like_gymnasium(name: str, gym_name: str) -> None:
    task: Any = TASKS[name]()
    theirs: Any = gymnasium.make(gym_name).unwrapped
    rng = np.random.default_rng(0)
    for _ in range(50):
        theirs.reset()
        state = tuple(4 * x for x in task.reset(rng))
        theirs.state = np.array(state)
        # The cart-pole of gymnasium only knows pushes of +-10 N.
        action = rng.choice([-1.0, 1.0]) if name == "cartpole" else rng.uniform(-1, 1)
        their_action = int(action > 0) if name == "cartpole" else np.array([2 * action])
        _, their_reward, terminated, _, _ = theirs.step(their_action)
        state, reward, ended = task.step(state, float(action))
        np.testing.assert_allclose(state, theirs.state, rtol=1e-12)
        assert reward == pytest.approx(float(their_reward)) and ended == terminated


def test_peers_repeat_a_seed_and_differ_between_seeds() -> None:
    first, again, other = (
        numpy_loop.run("gpc", "cartpole", steps=1500, seed=seed, error=0.1, rate=0.05, delta=0.05)
        for seed in (0, 0, 1)
    )
    assert (first.returns, first.corrections) == (again.returns, again.corrections)
    assert first.env_steps == 1500 and first.returns != other.returns
    fit = sklearn_loop.run("gpc", "cartpole", steps=300, seed=0, error=0.1, rate=0.05, delta=0.05)
    assert fit.returns == first.returns[: len(fit.returns)]
