import itertools
import subprocess
import sys

import pytest

from gpcjax.errors import UserError
from gpcjax.sweep.plan import count, default_out, plan, specification_hash, varying
from gpcjax.sweep.spec import spec_of


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
    assert printed.strip() == specification_hash(spec_of(env="cartpole", error=[0, 0.1])) == "aa09ff4b5f19"


def test_default_folder():
    spec = spec_of(env="pendulum")
    assert str(default_out(spec)) == f"runs/pendulum-{specification_hash(spec)}"
