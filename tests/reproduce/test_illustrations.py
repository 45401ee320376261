"""What the illustrations claim holds in their numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from gpcjax.learners.factory import make_learner
from gpcjax.reproduce import illustrations, probing, records, repetitions
from gpcjax.reproduce.illustrations import erroneous, hyperparameters, plane_of, situations, sparsification
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of
from tests.reproduce.illustrated import repetitions as repeated

ANGLES = 33
"""How many the tests look at: a program for any other number would be another one."""


@pytest.fixture(scope="module")
def fig2_2():
    return hyperparameters()


@pytest.fixture(scope="module")
def fig3_2():
    return situations()


@pytest.fixture(scope="module")
def taught_cell():
    """One run of an episode on the pendulum."""
    (cell,), (lane,) = probing.taught(1, [0])
    return cell, lane


@pytest.fixture(scope="module")
def taught_once(taught_cell):
    return taught_cell[1]


@pytest.fixture(scope="module")
def corrected():
    """GPC on the pendulum after some advice at places that `plane_of` looks at below."""
    learner = make_learner("gpc", "pendulum", capacity=16)
    state = learner.init()
    for angle, velocity, advice in (
        (-0.5, 3.0, 1), (-0.5, 3.0, 1), (-0.25, 1.0, -1), (0.0, -2.0, 1), (0.25, 0.0, -1), (0.5, 4.0, -1)
    ):  # fmt: skip
        obs = np.array([np.cos(angle * np.pi), np.sin(angle * np.pi), velocity])
        state, _ = learner.correct(state, obs, learner.act(state, obs), [float(advice)])
    return learner, state


@pytest.fixture(scope="module", params=["corrected", pytest.param("taught", marks=pytest.mark.slow)])
def fig3_3(request):
    """Of what was learned from a few corrections, or in an episode."""
    if request.param == "taught":
        cell, lane = request.getfixturevalue("taught_cell")
    else:
        learner, state = request.getfixturevalue("corrected")
        (cell,) = plan(spec_of(env="pendulum", algo="gpc", episodes=1, seeds=1))
        rows = SimpleNamespace(returns=np.array([-1000.0]))
        lane = SimpleNamespace(learner=learner, state=state, rows=rows)
    return plane_of(cell, lane, angles=ANGLES, velocities=17)


@pytest.fixture(scope="module")
def fig3_4():
    return sparsification(8)


@pytest.fixture(scope="module")
def fig5_9():
    return erroneous()


class TestHyperparameters:
    def test_the_fitted_explain_the_data_better(self, fig2_2):
        assert fig2_2.log_likelihood[1] > fig2_2.log_likelihood[0] + 5.0
        errors = np.abs(fig2_2.mean - fig2_2.truth)[:, np.abs(fig2_2.x) < 4.0]
        assert errors[1].max() < 0.5 * errors[0].max()

    def test_the_true_noise_is_found(self, fig2_2):
        assert 0.05 < np.sqrt(fig2_2.noise[1]) < 0.3  # 0.15

    @pytest.mark.parametrize("which", [pytest.param(0, marks=pytest.mark.slow), 1])
    def test_curves_and_likelihoods_are_scikit_learns(self, fig2_2, which):
        variance, scale, noise = fig2_2.variance[which], fig2_2.length_scale[which], fig2_2.noise[which]
        kernel = ConstantKernel(variance) * RBF(scale) + WhiteKernel(noise)
        reference = GaussianProcessRegressor(kernel, alpha=0, optimizer=None)
        reference.fit(fig2_2.points[:, None], fig2_2.targets)
        mean, deviation = reference.predict(fig2_2.x[:, None], return_std=True)
        np.testing.assert_allclose(fig2_2.mean[which], mean, atol=1e-8)
        np.testing.assert_allclose(fig2_2.deviation[which], deviation, atol=1e-8)
        expected = reference.log_marginal_likelihood_value_
        np.testing.assert_allclose(fig2_2.log_likelihood[which], expected, rtol=1e-8)


class TestSituations:
    def test_advice_moves_the_action_by_its_rate(self, fig3_2):
        steps = np.diff(fig3_2.action)
        np.testing.assert_allclose(steps, (fig3_2.rate * fig3_2.advice)[:-1], atol=1e-5)
        assert (steps[:2] > 0).all()

    def test_sigma_h_falls_where_advice_was_given_and_stays_high_at_the_new_action(self, fig3_2):
        for before in (0, 1):
            curves = [
                np.interp(fig3_2.action[before], fig3_2.actions, fig3_2.sigma_human[i])
                for i in (before, before + 1)
            ]
            assert curves[1] < 0.1 * curves[0]
            assert fig3_2.sigma_human_there[before + 1] > 4 * curves[1]

    def test_without_advice_nothing_changes(self, fig3_2):
        for name in ("policy", "sigma_policy", "sigma_human", "action"):
            values = getattr(fig3_2, name)
            np.testing.assert_array_equal(values[2], values[3])
        assert not fig3_2.rate[2:].any()

    def test_the_policy_is_sure_at_the_place_of_advice_alone(self, fig3_2):
        np.testing.assert_allclose(fig3_2.sigma_policy[0], 0.1, rtol=1e-4)
        middle = fig3_2.x.size // 2
        assert fig3_2.x[middle] == 0.0
        assert fig3_2.sigma_policy[1].argmin() == middle
        assert fig3_2.sigma_policy[1, middle] < 0.01 < 0.09 < fig3_2.sigma_policy[1, 0]


class TestPlane:
    def test_maps_are_periodic_in_the_angle(self, fig3_3):
        """A point is stored as (cos, sin, velocity), so both edges are the same place."""
        for name in ("policy", "sigma_policy", "sigma_human", "rate"):
            values = getattr(fig3_3, name)
            assert values.shape == (17, ANGLES)
            np.testing.assert_allclose(values[:, 0], values[:, -1], atol=1e-8)

    def test_places_are_angles_and_velocities(self, fig3_3):
        for places in (fig3_3.dictionary, fig3_3.advised):
            assert (np.abs(places) <= [np.pi, 8.0]).all() and np.abs(places[:, 1]).max() > 1.5
        assert {tuple(place) for place in fig3_3.dictionary} <= {tuple(place) for place in fig3_3.advised}

    def test_the_policy_is_surer_near_its_points(self, fig3_3):
        theta, theta_dot = np.meshgrid(fig3_3.theta, fig3_3.theta_dot)
        here = np.stack([np.cos(theta), np.sin(theta), theta_dot / 6], -1)[:, :, None]
        angle, velocity = fig3_3.dictionary.T
        distance = np.linalg.norm(here - np.stack([np.cos(angle), np.sin(angle), velocity / 6], -1), axis=-1)
        nearest = distance.min(-1)
        near, far = (
            fig3_3.sigma_policy[nearest < 0.15],
            fig3_3.sigma_policy[nearest > np.quantile(nearest, 0.9)],
        )
        assert near.size and near.max() < far.min()

    def test_the_rate_is_the_sum_of_its_parts(self, fig3_3):
        assert "c_r = 0.01" in fig3_3.parameters
        np.testing.assert_allclose(fig3_3.rate, fig3_3.sigma_policy + fig3_3.sigma_human + 0.01)

    def test_it_tells_its_settings(self, fig3_3):
        assert {"env = pendulum", "error = 0.0", "episodes = 1", "seed = 0"} <= set(fig3_3.settings)
        assert fig3_3.returns.shape == (1,) and (fig3_3.returns < 0).all()


def test_what_maps_show_is_what_a_correction_meets(corrected):
    learner, state = corrected
    angles = np.linspace(-3.0, 3.0, ANGLES)
    places = np.stack([np.cos(angles), np.sin(angles), 2.0 * angles], -1)
    seen = probing.look(learner, state, places)
    for i in range(0, ANGLES, 7):
        action = learner.act(state, places[i])
        _, info = learner.correct(state, places[i], action, [1.0])
        np.testing.assert_allclose(seen["policy"][i], action[0], rtol=1e-9)
        np.testing.assert_allclose(seen["sigma_policy"][i], info.sigma_policy[0], rtol=1e-9)
        np.testing.assert_allclose(seen["sigma_human"][i], info.sigma_human[0], rtol=1e-9)
        total = seen["sigma_policy"][i] + seen["sigma_human"][i] + learner.constant_rate
        np.testing.assert_allclose(total, info.rate[0], rtol=1e-9)


def test_who_is_taught_is_told_by_seed(monkeypatch):
    """Whoever is finished first."""

    class Backwards:
        def run(self, next_start, deliver):
            for start in [*iter(next_start, None)][::-1]:
                deliver(SimpleNamespace(name=start.name, lane=start))

    monkeypatch.setattr(probing, "make_pool", lambda cell, programs: Backwards())
    cells, lanes = probing.taught(3, [0, 2])
    assert [(cell.env, cell.algo, cell.error, cell.episodes, cell.seed) for cell in cells] == [
        ("pendulum", "gpc", 0.0, 3, seed) for seed in (0, 2)
    ]
    assert [lane.name for lane in lanes] == cells


class TestSparsification:
    def test_plain_appending_averages_all_targets(self, fig3_4):
        average = fig3_4.target[0].cumsum() / np.arange(1, 9)
        np.testing.assert_allclose(fig3_4.after[0], average, atol=1e-5)
        np.testing.assert_array_equal(fig3_4.points[0], np.arange(1, 9))

    def test_spars_follows_each_target(self, fig3_4):
        np.testing.assert_allclose(fig3_4.after[1], fig3_4.target[1], rtol=1e-4)
        np.testing.assert_array_equal(fig3_4.points[1], 1)

    def test_both_begin_alike_and_part_at_the_second_advice(self, fig3_4):
        np.testing.assert_allclose(fig3_4.after[0, 0], fig3_4.after[1, 0], rtol=1e-9)
        assert (fig3_4.after[1, 1:] > fig3_4.after[0, 1:] + 0.03).all()
        np.testing.assert_array_equal(fig3_4.action[:, 1:], fig3_4.after[:, :-1])


class TestErroneous:
    def test_one_advice_is_wrong(self, fig5_9):
        given = np.isfinite(fig5_9.advice)
        assert ((fig5_9.advice == -1).sum(-1) == 1).all()
        assert (fig5_9.advice[..., fig5_9.wrong - 1] == -1).all()
        assert (given == np.isfinite(fig5_9.rate)).all()

    def test_the_teacher_is_silent_at_its_target(self, fig5_9):
        met = fig5_9.action[..., :-1]
        np.testing.assert_array_equal(np.isfinite(fig5_9.advice), fig5_9.target - met >= fig5_9.tolerance)

    def test_samples_count_advices_until_the_action_is_back(self, fig5_9):
        wrong = int(fig5_9.wrong)
        for samples, action in zip(fig5_9.samples.ravel(), fig5_9.action.reshape(4, -1), strict=True):
            after = action[wrong:]
            assert after[0] < action[wrong - 1]
            assert after[int(samples)] >= action[wrong - 1] > after[1 : int(samples)].max(initial=-1.0)

    def test_the_scan_holds_the_runs_shown(self, fig5_9):
        columns = [int(np.flatnonzero(fig5_9.scanned_length_scales == each)[0]) for each in (0.1, 1.0)]
        (wrong,) = np.flatnonzero(fig5_9.scanned_wrong == fig5_9.wrong)
        np.testing.assert_array_equal(fig5_9.scanned_samples[:, columns, wrong], fig5_9.samples)

    def test_rates_are_made_of_the_tables_parameters(self, fig5_9):
        for i, constant in enumerate((0.02, 0.05)):
            assert f"c_r = {constant:g}" in fig5_9.parameters[i]
            total = fig5_9.sigma_policy[i] + fig5_9.sigma_human[i] + constant
            np.testing.assert_allclose(fig5_9.rate[i], total, rtol=1e-9)
        np.testing.assert_array_equal(fig5_9.thesis_length_scales, [0.2, 0.5])

    def test_the_thesis_claim_shows_with_gpc_ns_alone(self, fig5_9):
        """A long l_h needs more samples than a short one in GPC-NS, fewer in GPC."""
        gpc, gpc_ns = fig5_9.samples
        assert gpc_ns[1] > gpc_ns[0] and gpc[1] < gpc[0]


@pytest.mark.slow
class TestRepetitions:
    SEEDS = np.arange(4)

    @pytest.mark.parametrize("sparsify", [False, True])
    def test_the_action_follows_what_the_figure_says(self, sparsify):
        found = repetitions._behind(sparsify, self.SEEDS)
        assert found.shape == (4,) and (found < 1e-4).all()

    @pytest.mark.parametrize("algo", ["gpc", "coach"])
    def test_both_kinds_of_advice_meet_the_same_first_rate(self, algo):
        """They have the same past, and part after the first advice."""
        same, alternating = repetitions._consistent(algo, self.SEEDS)
        assert same.shape == (4, repetitions.ADVICES)
        np.testing.assert_array_equal(same[:, 0], alternating[:, 0])
        assert (same[:, 2:] != alternating[:, 2:]).any(axis=1).all() and (same > 0).all()

    def test_samples_are_what_a_loop_counts(self):
        """Against the class itself, one advice after the other."""
        samples = repetitions._samples("gpc", 0.2, self.SEEDS[:2])
        for seed, expected in zip(self.SEEDS[:2], samples, strict=True):
            random = np.random.default_rng([seed, 2])
            target, wrong = random.uniform(0.8, 1.0), int(random.integers(1, 4))
            learner = make_learner("gpc", "cartpole", capacity=40, human_length_scale=0.2)
            state, obs, actions = learner.init(), np.zeros(4), []
            for place in range(40):
                actions.append(float(learner.act(state, obs)[0]))
                if place > wrong + 1 and actions[-1] >= actions[wrong]:
                    break
                assert target - actions[-1] >= 0.05
                state, _ = learner.correct(state, obs, [actions[-1]], [-1.0 if place == wrong else 1.0])
            assert expected == len(actions) - 1 - (wrong + 1)

    def test_what_a_taught_learner_holds(self, taught_once):
        (rest, elsewhere), (advised, everywhere) = repetitions._over_plane(taught_once)
        assert 0 < advised < everywhere <= np.sqrt(0.01 + 1e-7) + 1e-9
        assert max(rest, elsewhere) <= np.sqrt(0.7 + 1e-7) + 1e-9
        far, near = repetitions._unconverged(taught_once)
        assert 0 < far <= np.sqrt(0.7 + 1e-7) + 1e-9 and (np.isnan(near) or near > 0)


class TestFile:
    def test_a_round_trip(self, fig2_2, fig3_2, fig3_3, fig3_4, fig5_9, monkeypatch, tmp_path):
        for name, value in (
            ("hyperparameters", fig2_2),
            ("situations", fig3_2),
            ("sparsification", fig3_4),
            ("erroneous", fig5_9),
        ):
            monkeypatch.setattr(illustrations, name, lambda value=value: value)
        made = repeated()
        monkeypatch.setattr(illustrations, "taught", lambda episodes, seeds: ([None], [None]))
        monkeypatch.setattr(illustrations, "plane_of", lambda cell, lane: fig3_3)
        monkeypatch.setattr(illustrations, "repetitions", lambda early, late, scales: made)
        path = tmp_path / "out.npz"
        illustrations.compute(path)
        assert [each.name for each in tmp_path.iterdir()] == ["out.npz"]
        found = illustrations.read(path)
        for record, expected in zip(
            found, (fig2_2, fig3_2, fig3_3, fig3_4, fig3_3, fig5_9, made), strict=True
        ):
            assert type(record) is type(expected)
            for name in expected._fields:
                np.testing.assert_array_equal(getattr(record, name), getattr(expected, name), err_msg=name)

    def test_another_file_is_refused(self, tmp_path):
        path = tmp_path / "other.npz"
        for write in (lambda: path.write_bytes(b"no zip"), lambda: np.savez(path, x=np.zeros(2))):
            write()
            with pytest.raises(ValueError, match=r"other.npz does not hold these illustrations: compute"):
                records.read(path)
        with pytest.raises(FileNotFoundError):
            records.read(tmp_path / "missing.npz")
