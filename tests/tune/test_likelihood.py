"""Settings by marginal likelihood, from states that were kept without any engine."""

import contextlib
import dataclasses
import functools
import math
import os

import numpy as np
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.gp.likelihood import Optima
from gpcjax.learners.carried import carried
from gpcjax.learners.factory import make_learner
from gpcjax.learners.packed import pack_learner
from gpcjax.registry import find
from gpcjax.sweep import run as run_module
from gpcjax.sweep.keeping import KeptRow
from gpcjax.sweep.packing import packed
from gpcjax.sweep.run import sweep
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import make_spec, read_toml
from gpcjax.tune import carrying_out, likelihood
from gpcjax.tune.dictionaries import chosen_runs, held_by
from gpcjax.tune.likelihood import by_likelihood
from tests.sweep.pretended import Pretended, rows

TASK = find("task", "pendulum")


@functools.cache
def learned(algo, corrections):
    """A learner and what it learned from advice that only the first number of an observation tells.

    GPC-NS knows what GPC learned: how it came to that is of no matter here.
    """
    learner = make_learner(algo, "pendulum", capacity=16, sparsify=False)
    if algo == "gpc-ns":
        return learner, carried(*learned("gpc", corrections), learner, (16, 16))
    random, state = np.random.default_rng(corrections), learner.init()
    for _ in range(corrections):
        obs = random.normal(size=3)
        state, _ = learner.correct(state, obs, learner.act(state, obs), np.sign([obs[0]]))
    return learner, state


class Kept(Pretended):
    """Hands in a state of each cell, of 8 corrections or, of the second seed, of 12."""

    def _work(self, cells, baselines, on_rows, on_baseline, on_progress):
        def with_state(given):
            cell = given.cell
            card, arrays = packed(*pack_learner(*learned(cell.algo, 8 + 4 * (cell.seed % 2))))
            return dataclasses.replace(rows(cell), kept=(KeptRow(3, 1.0, "state", card, arrays),))

        super()._work(cells, baselines, lambda given: on_rows(with_state(given)), on_baseline, on_progress)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder of two seeds of GPC and GPC-NS."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_module, "Processes", Kept())
        out = tmp_path_factory.mktemp("runs") / "kept"
        settings = {"env": "pendulum", "algo": ["gpc", "gpc-ns"], "error": 0.1, "seeds": 2, "episodes": 3}
        return sweep(out=out, jobs=1, keep="states", **settings)


@pytest.mark.parametrize("algo", ["gpc", "gpc-ns"])
@pytest.mark.parametrize("ard", [True, False])
def test_inputs_are_what_the_kernel_sees_divided_by_what_is_fitted(folder, algo, ard):
    """So the numbers that they were taught with explain them as the models did: K of both is the same."""
    held = held_by(folder, chosen_runs(folder, algo, {}), "human", TASK, ard, 256, 0)
    learner, state = learned(algo, 12)
    count = int(held.data.counts[1, 0])
    assert held.data.counts.tolist() == [[8], [12]] and count == state.human.count[0]
    lengths = held.taught[1:-1]
    gram = learner.human.kernel.gram(state.human.points[0, :count], state.human.scale[0])
    scaled = held.data.points[1, 0, :count] / lengths
    squared = ((scaled[:, None] - scaled[None]) ** 2).sum(-1)
    np.testing.assert_allclose(held.taught[0] * np.exp(-0.5 * squared), gram, rtol=1e-9, atol=1e-300)
    assert len(held.inputs) == len(lengths) == (4 if ard else 1) and held.smoothness == math.inf
    assert (held.bounds[:, 0] < held.bounds[:, 1]).all()


def test_of_a_large_dictionary_the_same_points_count_each_time(folder):
    first, second = (
        held_by(folder, chosen_runs(folder, "gpc", {}), "policy", TASK, True, 5, 0) for _ in range(2)
    )
    assert first.data.counts.tolist() == [[5], [5]]
    np.testing.assert_array_equal(first.data.points, second.data.points)


@pytest.fixture
def fits(monkeypatch):
    """Fits that were made elsewhere: length-scales 1, 2, 4 (and 8 of the action)."""

    def fit(data, smoothness, bounds, starts, shared=True):
        lengths = 2.0 ** np.arange(len(bounds) - 2)
        count = 1 if shared else len(data.counts)
        every = lambda numbers: np.tile(numbers, (count, 1))  # noqa: E731
        at_bound = every(np.arange(len(bounds)) == 2)
        return Optima(np.full(count, 0.5), every(lengths), np.full(count, 0.03), np.zeros(count), at_bound)

    monkeypatch.setattr(likelihood, "fit_dictionaries", fit)


def test_the_file_is_a_sweep_of_the_folder_with_them_and_other_seeds(folder, tmp_path, fits):
    found = by_likelihood(folder, tmp_path / "out", algo="gpc", take=likelihood.TAKEN)
    spec = make_spec(read_toml(found.best))
    assert spec == found.spec
    assert found.usual == dataclasses.replace(spec, hyperparameters={}, scaling=(), human_scaling=())
    assert (spec.algo, spec.error, spec.episodes) == (("gpc",), (0.1,), 3)
    assert spec.seeds == Seeds(((2, 101),))
    middle = 2.0
    assert found.settings["policy_length_scale"] == middle
    np.testing.assert_allclose(spec.scaling, middle / np.array([1.0, 2.0, 4.0]))
    np.testing.assert_allclose(spec.human_scaling, 8**0.5 / np.array([1.0, 2.0, 4.0, 8.0]), rtol=1e-3)
    assert spec.hyperparameters["noise"] == spec.hyperparameters["human_noise"] == (0.03,)
    assert found.fits[0].at_bound == ("length-scale: sin of the angle",)
    (row,) = [row for row in found.sheet.rows if row[:2] == ("policy", "length-scale: sin of the angle")]
    assert row[2:] == ("0.7", "2", "[2, 2]", "yes")
    assert "# policy  length-scale: sin of the angle" in found.best.read_text()


def test_what_is_not_fitted_stays_as_it_was(folder, tmp_path, fits):
    """The human model would take w and the noise over from the policy."""
    found = by_likelihood(folder, tmp_path, algo="gpc", models=["policy"], take=["length_scale", "noise"])
    assert found.settings["human_scaling"] == pytest.approx([1, 1, 1 / 6, 1])
    assert found.settings["human_noise"] == 1e-7
    assert not {"policy_variance", "human_variance", "human_length_scale"} & found.settings.keys()
    alone = by_likelihood(folder, tmp_path, where={"algo": "gpc-ns"}, ard=False, take=["length_scale"])
    assert alone.settings == {"policy_length_scale": 1.0, "human_length_scale": 1.0}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "there are runs of gpc, gpc-ns, give one of them"),
        ({"algo": "coach"}, "no state of such runs was kept, there are gpc, gpc-ns"),
        ({"algo": "gpc", "seeds": Seeds(((1, 5),))}, "seeds: 1 was fitted on"),
        ({"algo": "gpc", "take": ["nu"]}, "take.*give length_scale, variance, noise"),
    ],
)
def test_what_cannot_be_done_is_refused(folder, tmp_path, given, message):
    with pytest.raises(UserError, match=message):
        by_likelihood(folder, tmp_path, **given)


def test_from_python_the_callers_process_stays_as_it_is(folder, tmp_path, monkeypatch, figures_unpainted):
    """The command computes as workers do; whoever calls it from a program of their own has settings of their own."""
    monkeypatch.setattr(carrying_out, "Processes", lambda jobs: contextlib.nullcontext(Pretended()(jobs)))
    # One of the two models says it: each has programs of its own.
    monkeypatch.setattr(likelihood, "by_likelihood", functools.partial(by_likelihood, models=["policy"]))
    monkeypatch.setenv("JAX_LOG_COMPILES", "0")
    before = dict(os.environ)
    found = gpcjax.run_tuning(method="mll", runs=folder, algo="gpc", out=tmp_path / "o", jobs=1)
    assert dict(os.environ) == before and (found.folder / "best.toml").exists()
