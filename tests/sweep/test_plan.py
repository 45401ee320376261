import itertools
import subprocess
import sys

import jax
import pytest

from gpcjax.engine.lanes import room_for
from gpcjax.errors import UserError
from gpcjax.sweep.build import start_of
from gpcjax.sweep.plan import (
    canonical,
    count,
    default_out,
    plan,
    program_of,
    specification_hash,
    varying,
)
from gpcjax.sweep.spec import as_dict, spec_of


def test_the_main_job():
    spec = spec_of(env="cartpole", error=[0, 0.1, 0.2])
    cells = plan(spec)
    assert len(cells) == count(spec) == 900
    assert len(set(cells)) == 900
    assert {cell.episodes for cell in cells} == {30}
    assert varying(spec) == []


def test_order():
    cells = plan(
        spec_of(
            env="cartpole",
            algo="gpc,coach",
            oracle="lqr,gpc",
            error=[0.1, 0],
            delta=[0.1, 0.05],
            rate=[0.2, 0.1],
            seeds=2,
            policy_length_scale=[0.3, 0.2],
        )
    )
    gpc = [cell for cell in cells if cell.algo == "gpc"]
    assert cells[: len(gpc)] == gpc
    values = [
        (
            cell.oracle,
            dict(cell.hyperparameters)["policy_length_scale"],
            cell.error,
            cell.delta,
            cell.rate,
            cell.seed,
        )
        for cell in gpc
    ]
    assert values == list(
        itertools.product(("lqr", "gpc"), (0.3, 0.2), (0.1, 0.0), (0.1, 0.05), (0.2, 0.1), (0, 1))
    )


def test_a_cell_has_only_the_hyperparameters_of_its_algorithm():
    spec = spec_of(env="cartpole", seeds=1, noise=[1e-7, 1e-6], human_variance=0.1, beta=[10, 20, 30])
    points = {cell.algo: set() for cell in plan(spec)}
    for cell in plan(spec):
        points[cell.algo].add(cell.hyperparameters)
    gp = {(("human_variance", 0.1), ("noise", noise)) for noise in (1e-7, 1e-6)}
    assert points == {"gpc": gp, "gpc-ns": gp, "coach": {(("beta", beta),) for beta in (10.0, 20.0, 30.0)}}
    assert len(plan(spec)) == count(spec) == 2 + 2 + 3
    assert varying(spec) == ["noise", "beta"]


def test_varying_names_delta_and_rate_too():
    assert varying(spec_of(env="cartpole", delta=[0, 0.1], rate=[0.1, 0.2], error=[0, 0.1])) == [
        "delta",
        "rate",
    ]


def test_too_many_cells_are_refused():
    spec = spec_of(env="cartpole", seeds=10**6)
    with pytest.raises(UserError, match="3,000,000 cells: give fewer"):
        plan(spec)


def test_hash_does_not_see_order_or_repeats():
    one = spec_of(env="cartpole", algo="gpc,coach", error=[0, 0.1, 0], noise=[1, 2])
    two = spec_of(env="cartpole", algo="coach,gpc", error=[0.1, 0.0], noise=[2, 1])
    assert one != two
    assert specification_hash(one) == specification_hash(two)


@pytest.mark.parametrize(
    "change",
    [
        {"env": "pendulum"},
        {"algo": "gpc"},
        {"error": 0.1},
        {"seeds": 99},
        {"episodes": 29},
        {"oracle": "lqr"},
        {"delta": 0.1},
        {"rate": 0.1},
        {"rate_schedule": [0.05]},
        {"noise": 1e-7},
        {"sparsify": False},
        {"on_full": "drop"},
        {"max_capacity": 512},
    ],
    ids=lambda change: next(iter(change)),
)
def test_hash_sees_every_setting(change):
    base = {"env": "cartpole", "episodes": 30}
    assert specification_hash(spec_of(**base)) != specification_hash(spec_of(**base | change))


def test_hash_is_the_same_in_another_process():
    code = (
        "from gpcjax.sweep.plan import specification_hash\nfrom gpcjax.sweep.spec import spec_of\n"
        "print(specification_hash(spec_of(env='cartpole', error=[0, 0.1])))"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == specification_hash(spec_of(env="cartpole", error=[0, 0.1])) == "daa42ad33b9f"


@pytest.mark.parametrize("algo", ["gpc", "gpc-ns"])
def test_the_adaptive_rate_and_the_static_one_share_a_program(algo):
    static, adaptive = (
        plan(spec_of(env="cartpole", algo=algo, seeds=1, **rates))[0] for rates in ({"static_rate": 0.04}, {})
    )
    assert static != adaptive and program_of(static) == program_of(adaptive)
    one, other = start_of(static), start_of(adaptive)
    assert shapes(one.learner) == shapes(other.learner)


def shapes(tree):
    return jax.tree.structure(tree), [(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(tree)]


class TestRateSchedule:
    """One value for all cells, however long: its order is its meaning."""

    def test_its_order_and_repeats_are_kept_and_count(self):
        falling, rising, shorter = (
            spec_of(env="cartpole", rate_schedule=rates)
            for rates in ([0.5, 0.1, 0.1], [0.1, 0.1, 0.5], [0.5, 0.1])
        )
        assert falling.rate_schedule == (0.5, 0.1, 0.1)
        assert len({specification_hash(spec) for spec in (falling, rising, shorter)}) == 3
        assert canonical(as_dict(falling))["rate_schedule"] == [0.5, 0.1, 0.1]

    def test_it_makes_no_more_cells(self):
        spec = spec_of(env="cartpole", algo="gpc,coach", seeds=2, rate_schedule=[0.5, 0.1])
        cells = plan(spec)
        assert len(cells) == count(spec) == 4 and varying(spec) == []
        assert {cell.rate_schedule for cell in cells} == {(0.5, 0.1)}

    def test_it_has_the_program_of_a_constant_rate(self):
        one, other, none = (
            plan(spec_of(env="cartpole", algo="gpc", seeds=1, **settings))[0]
            for settings in ({"rate_schedule": 0.5}, {"rate_schedule": [0.2, 0.1]}, {"rate": 0.3})
        )
        assert program_of(one) == program_of(other) == program_of(none)
        teachers = [start_of(cell).teacher for cell in (one, other, none)]
        assert shapes(teachers[0]) == shapes(teachers[1]) == shapes(teachers[2])
        assert set(teachers[2].schedule.tolist()) == {0.3}

    @pytest.mark.parametrize(
        ("rates", "expected"),
        [([0.5], [0.5] * 4), ([0.5, 0.1], [0.5, 0.1, 0.1, 0.1]), ([0.5, 0.1, 0.2, 0.3, 0.9], [0.5, 0.1, 0.2, 0.3])],
        ids=["one", "shorter", "longer"],
    )  # fmt: skip
    def test_the_teacher_has_a_chance_for_each_episode(self, rates, expected):
        """The last one from then on; what no episode needs is left out."""
        cell = plan(spec_of(env="cartpole", algo="coach", seeds=1, episodes=4, rate_schedule=rates))[0]
        schedule = start_of(cell).teacher.schedule.tolist()
        assert schedule == expected + expected[-1:] * (room_for(4) - 4)

    def test_sweeps_of_other_lengths_have_the_same_arrays(self):
        """So that they share what is compiled."""
        few, many = (
            start_of(plan(spec_of(env="cartpole", seeds=1, episodes=episodes, rate_schedule=0.1))[0])
            for episodes in (10, 30)
        )
        assert shapes(few.teacher) == shapes(many.teacher)


def test_default_folder():
    spec = spec_of(env="pendulum")
    assert str(default_out(spec)) == f"runs/pendulum-{specification_hash(spec)}"
