"""Batches of models that are factorised: no kernel waits for other threads, and lanes keep their numbers."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend import core
from jax.test_util import check_grads

from gpcjax.gp import cholesky
from gpcjax.gp.fit import log_marginal_likelihood
from gpcjax.gp.kernels import Kernel
from gpcjax.gp.leading import leading_sizes
from gpcjax.learners.factory import make_learner
from tests.trees import assert_same_bits

ROOT = Path(__file__).parents[2]
LANES = 16

CAPACITY = 1536
"""Of dictionaries of which some are factorised tile by tile, and large ones by LAPACK."""


def equations(jaxpr):
    """Of a program and of all that it calls."""
    for equation in jaxpr.eqns:
        yield equation
        for value in jax.tree.leaves(
            list(equation.params.values()),
            is_leaf=lambda leaf: isinstance(leaf, core.Jaxpr | core.ClosedJaxpr),
        ):
            if isinstance(value, core.ClosedJaxpr):
                value = value.jaxpr
            if isinstance(value, core.Jaxpr):
                yield from equations(value)


def stacked(tree, *shape):
    return jax.tree.map(lambda leaf: jnp.asarray(np.broadcast_to(leaf, (*shape, *leaf.shape))), tree)


def programs():
    """What is batched, by name: the function of one lane and its arguments."""
    learner = make_learner("gpc-ns", "cartpole", capacity=CAPACITY)
    state, obs, one = learner.init(), jnp.zeros(4), jnp.ones(1)
    points, targets = jnp.arange(12.0).reshape(6, 2), jnp.arange(6.0)

    def likelihood(numbers):
        kernel = Kernel(numbers[0], numbers[1], 2.5)
        return log_marginal_likelihood(kernel, numbers[2], points, targets)

    def scanned(state, obs):
        return jax.lax.scan(lambda state, _: (learner.correct(state, obs, one, one)[0], 0), state, length=2)

    def of_learner(noise):
        """Hyperparameters are leaves: a grid of them is a batch too."""
        process = make_learner("gpc-ns", "cartpole", capacity=CAPACITY).policy
        process = jax.tree.map(lambda leaf: leaf * noise, process)
        posterior = process.init(CAPACITY, jnp.ones(4))
        index = jnp.zeros((), jnp.int32)
        reading = process.read(posterior, (), process.covariances(posterior, (), obs))
        return process.put(posterior, (), reading, obs, noise, index, jnp.array(True))

    return {
        "correct": (learner.correct, (state, obs, one, one)),
        "uncertainty": (learner.uncertainty, (state, obs, one)),
        "scan": (scanned, (state, obs)),
        "hyperparameters": (of_learner, (jnp.ones(()),)),
        "likelihood": (likelihood, (jnp.ones(3),)),
        "gradient": (jax.grad(likelihood), (jnp.ones(3),)),
        "hessian": (jax.hessian(likelihood), (jnp.ones(3),)),
    }


@pytest.mark.parametrize(
    ("name", "axes"),
    [
        *(("uncertainty", 2), ("hyperparameters", 2), ("gradient", 2)),
        pytest.param("correct", 2, marks=pytest.mark.slow),
        *(pytest.param(name, 1, marks=pytest.mark.slow) for name in ("scan", "likelihood", "hessian")),
    ],
)
def test_no_kernel_is_given_a_batch(name, axes):
    """In any nesting of vmap; and a choice of leading sizes stays a choice, of one for each lane."""
    function, arguments = programs()[name]
    for _ in range(axes):
        function = jax.jit(jax.vmap(function))
    shapes = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct((*[LANES] * axes, *leaf.shape), leaf.dtype), arguments
    )
    found = list(equations(jax.make_jaxpr(function)(*shapes).jaxpr))
    kernels = [each for each in found if each.primitive.name in ("cholesky", "triangular_solve")]
    assert kernels and all(variable.aval.ndim == 2 for each in kernels for variable in each.invars)
    if name in ("correct", "uncertainty", "scan", "hyperparameters"):
        sizes = [len(each.params["branches"]) for each in found if each.primitive.name == "cond"]
        assert max(sizes) == len(leading_sizes(CAPACITY, True)) > 2


@pytest.mark.slow
def test_lanes_have_the_bits_that_they_have_alone():
    """With dictionaries of different lengths, so that they are factorised at different sizes."""
    learner, rng = make_learner("gpc-ns", "cartpole", capacity=32), np.random.default_rng(0)
    given = lambda *shape: (  # noqa: E731
        rng.normal(size=(*shape, 4)),
        rng.uniform(-1, 1, (*shape, 1)),
        rng.choice([-1.0, 1.0], (*shape, 1)),
    )
    states = []
    for count in (0, 7, 15, 20):
        state = learner.init()
        for _ in range(count):
            state, _ = learner.correct(state, *given())
        states.append(state)
    corrections = given(4)
    alone = [
        learner.correct(state, *each)
        for state, each in zip(states, zip(*corrections, strict=True), strict=True)
    ]
    together = jax.tree.map(lambda *leaves: np.stack(leaves), *states)
    pairs = jax.tree.map(lambda leaf: leaf.reshape(2, 2, *leaf.shape[1:]), (together, *corrections))
    in_pairs = jax.vmap(jax.vmap(learner.correct))(*pairs)
    flat = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(4, *leaf.shape[2:]), in_pairs)
    assert_same_bits(flat, jax.tree.map(lambda *leaves: np.stack(leaves), *alone))


@pytest.mark.slow
def test_derivatives_of_either_mode():
    rng = np.random.default_rng(0)
    matrix, vector = jnp.asarray(np.cov(rng.normal(size=(4, 50)))), jnp.asarray(rng.normal(size=4))
    active = jnp.array([True, True, True, False])

    def both(matrix, vector):
        lower = cholesky.factor((matrix + matrix.T) / 2, active, jnp.array(0.1))
        return cholesky.solve(lower, cholesky.solve(lower, vector), transpose=True), lower

    check_grads(jax.jit(both), (matrix, vector), order=1, modes=("fwd", "rev"))
    batch = (stacked(matrix, 3), stacked(vector, 3))
    jacobian = jax.jacrev(both, (0, 1))
    for got, expected in zip(
        jax.tree.leaves(jax.vmap(jacobian)(*batch)), jax.tree.leaves(jacobian(matrix, vector)), strict=True
    ):
        np.testing.assert_allclose(got[1], expected, atol=1e-12)


USERS_PROCESS = """
import threading
import jax, jax.numpy as jnp, numpy as np
import gpcjax
from gpcjax.gp import cholesky

rng = np.random.default_rng(0)
learner = gpcjax.make_learner("gpc-ns", "cartpole", capacity=64)
states = jax.tree.map(lambda leaf: jnp.stack([leaf] * 64), learner.init())
step = jax.jit(jax.vmap(learner.correct))
for _ in range(30):
    given = rng.normal(size=(64, 4)), rng.uniform(-1, 1, (64, 1)), rng.choice([-1.0, 1.0], (64, 1))
    states, info = step(states, *given)
assert not np.asarray(info.status).any() and np.isfinite(states.policy.weights).all()

def several(gram, noise, vector):
    lowers = [cholesky.factor(gram, jnp.ones(64, bool), noise + i) for i in range(4)]
    return sum(cholesky.solve(lower, vector) for lower in lowers)

together = jax.jit(jax.vmap(several, (None, 0, None)))
gram, vector = jnp.exp(-jnp.abs(jnp.arange(64.0)[:, None] - jnp.arange(64.0))), jnp.ones(64)
print("alone", flush=True)

def often():
    for _ in range(10):
        jax.block_until_ready(together(gram, jnp.ones(16), vector))

threads = [threading.Thread(target=often) for _ in range(4)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
"""


@pytest.mark.slow
def test_a_process_with_default_settings_comes_to_an_end():
    """A pool of threads for each core, several factorisations at a time, from several threads of Python."""
    ours = ("JAX_", "XLA_", "NPROC", "OMP_", "OPENBLAS_", "MKL_")
    env = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    done = subprocess.run(
        [sys.executable, "-c", USERS_PROCESS], cwd=ROOT, env=env, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
