"""The marginal likelihood of many dictionaries at once, compared with scikit-learn's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from gpcjax.gp.kernels import SMOOTHNESSES, SQUARED_EXPONENTIAL
from gpcjax.gp.likelihood import Dictionaries, fit_dictionaries, log_likelihood

BOUNDS = np.array([[1e-2, 1e2], [1e-1, 10.0], [1e-1, 10.0], [1e-4, 1.0]])
STARTS = np.array([[1.0, 1.0, 1.0, 0.1], [0.3, 0.3, 3.0, 1e-3], [1.0, 3.0, 3.0, 0.5]])


def dictionaries(runs=1, each=1, n=24, seed=0):
    """Functions of the first input; beyond the counts lies what must not matter."""
    random = np.random.default_rng(seed)
    points = random.uniform(-2, 2, (runs, each, n, 2))
    targets = np.sin(2 * points[..., 0]) + 0.1 * random.normal(size=(runs, each, n))
    counts = random.integers(n // 2, n + 1, (runs, each))
    data = Dictionaries(points, targets, counts)
    points[~data.active], targets[~data.active] = np.nan, np.nan
    return data


def regressor(smoothness, numbers, **options):
    variance, *lengths, noise = numbers
    shape = (
        RBF(lengths, BOUNDS[1:3])
        if smoothness == SQUARED_EXPONENTIAL
        else Matern(lengths, BOUNDS[1:3], nu=smoothness)
    )
    kernel = ConstantKernel(variance, BOUNDS[0]) * shape + WhiteKernel(noise, BOUNDS[3])
    return GaussianProcessRegressor(kernel, alpha=0, **options)


def used(data, run=0, each=0):
    count = data.counts[run, each]
    return data.points[run, each, :count], data.targets[run, each, :count]


@pytest.mark.parametrize(
    "smoothness",
    [pytest.param(nu, marks=[pytest.mark.slow] if nu in (1.5, 2.5) else []) for nu in SMOOTHNESSES],
)
def test_value_and_slope_are_those_of_scikit_learn(smoothness):
    data = dictionaries()
    data.points[0, 0, 1] = data.points[0, 0, 0]  # a repeat, where a Matern kernel's root has no slope
    numbers = np.array([0.7, 0.5, 1.5, 0.02])
    points, targets, active = (jnp.asarray(leaf[0, 0]) for leaf in (data.points, data.targets, data.active))
    value, slope = jax.jit(
        jax.value_and_grad(lambda logs: log_likelihood(jnp.exp(logs), smoothness, points, targets, active))
    )(np.log(numbers))
    reference = regressor(smoothness, numbers, optimizer=None).fit(*used(data))
    expected, gradient = reference.log_marginal_likelihood(reference.kernel_.theta, eval_gradient=True)
    np.testing.assert_allclose(value, expected, rtol=1e-9)
    np.testing.assert_allclose(slope, gradient, rtol=1e-7, atol=1e-9)


class TestOptimum:
    @pytest.mark.filterwarnings(
        "ignore::sklearn.exceptions.ConvergenceWarning"
    )  # one ends at a bound, as ours does
    def test_it_is_scikit_learns(self):
        data = dictionaries()
        reference = regressor(2.5, STARTS[0], n_restarts_optimizer=4, random_state=0).fit(*used(data))
        found = fit_dictionaries(data, 2.5, BOUNDS, STARTS)
        assert found.log_likelihood[0] >= reference.log_marginal_likelihood_value_ - 1e-3
        np.testing.assert_allclose(np.log(found.numbers[0]), reference.kernel_.theta, atol=0.05)

    def test_that_of_all_runs_is_a_maximum_of_the_sum_and_that_of_each_a_maximum_of_its_own(self):
        data = dictionaries(runs=2, each=2, n=16)
        shared = fit_dictionaries(data, 2.5, BOUNDS, STARTS[:1])
        alone = fit_dictionaries(data, 2.5, BOUNDS, np.vstack([STARTS[:1], shared.numbers]), shared=False)
        assert shared.numbers.shape == (1, 4) and alone.numbers.shape == (2, 4)

        def summed(numbers, runs):
            return sum(
                regressor(2.5, numbers, optimizer=None)
                .fit(*used(data, run, each))
                .log_marginal_likelihood_value_
                for run in runs
                for each in range(2)
            )

        np.testing.assert_allclose(summed(shared.numbers[0], (0, 1)), shared.log_likelihood[0], rtol=1e-9)
        for run in (0, 1):
            np.testing.assert_allclose(
                summed(alone.numbers[run], [run]), alone.log_likelihood[run], rtol=1e-9
            )
            assert alone.log_likelihood[run] >= summed(shared.numbers[0], [run]) - 1e-9
        inside = np.flatnonzero(~shared.at_bound[0])
        for index, factor in ((i, f) for i in inside for f in (0.8, 1.25)):
            moved = shared.numbers[0].copy()
            moved[index] *= factor
            assert summed(moved, (0, 1)) < shared.log_likelihood[0]

    def test_an_input_that_does_not_matter_is_told_by_its_bound(self):
        found = fit_dictionaries(dictionaries(), 2.5, BOUNDS, STARTS)
        assert found.at_bound[0].tolist() == [False, False, True, False]
        assert found.length_scales[0, 1] <= BOUNDS[2, 1]

    def test_a_start_without_a_finite_likelihood_never_wins(self):
        """Repeats without noise: K is singular to rounding."""
        data = dictionaries()
        data.points[0, 0, :12] = data.points[0, 0, 0]
        bounds = BOUNDS.copy()
        bounds[3] = 1e-30, 1.0
        bad, good = np.array([[100.0, 10.0, 10.0, 1e-30], STARTS[0]])
        found = fit_dictionaries(data, 2.5, bounds, np.array([bad, good, bad]))
        alone = fit_dictionaries(data, 2.5, bounds, np.array([good] * 3))
        np.testing.assert_allclose(found.numbers, alone.numbers)
        with pytest.raises(ValueError, match="no start has a finite likelihood"):
            fit_dictionaries(data, 2.5, bounds, np.array([bad] * 3))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"smoothness": 1.0}, "smoothness nu = 1.0"),
        ({"bounds": BOUNDS[:2]}, r"bounds \(2, 2\)"),
        ({"bounds": BOUNDS[:, ::-1]}, "0 < least < largest"),
        ({"starts": -STARTS}, "starts"),
        ({"data": dictionaries()._replace(counts=np.ones((1, 1), int))}, "two points"),
        ({"data": dictionaries()._replace(targets=np.full((1, 1, 24), np.nan))}, "finite"),
    ],
)
def test_what_cannot_be_fitted_is_refused(change, message):
    given = {"data": dictionaries(), "smoothness": 1.5, "bounds": BOUNDS, "starts": STARTS}
    with pytest.raises(ValueError, match=message):
        fit_dictionaries(**given | change)
