"""A factor for each input: GPC, GPC-NS and their human models against the dense reference, and what stays without."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gpcjax.describe import TaskSpec
from gpcjax.errors import UserError
from gpcjax.learners.carried import carried
from gpcjax.learners.factory import make_learner
from gpcjax.learners.packed import pack_learner, unpack_learner
from gpcjax.sweep.build import learner_of
from gpcjax.sweep.checkpoints import cell_as_json, cell_of
from gpcjax.sweep.plan import plan, program_of, specification_hash
from gpcjax.sweep.spec import as_dict, from_dict, make_spec, read_toml, spec_of
from tests.learners.test_parity import compare, sequence
from tests.reference.domains import make_reference
from tests.trees import assert_same_bits

MINE = TaskSpec("mine", "gpcjax.envs.pendulum:Pendulum", sizes=(3, 1), obs_scale=(1.0, 2.0, 4.0))
W, PAIR = (1.5, 0.7, 0.2), (0.6, 2.0, 0.3, 4.0)
each_learner = pytest.mark.parametrize("algo", ["gpc", "gpc-ns"])


@pytest.mark.parametrize(
    ("algo", "given"),
    [
        pytest.param("gpc-ns", {"scaling": W}, marks=pytest.mark.slow),
        ("gpc-ns", {"scaling": W, "human_scaling": PAIR, "human_noise": 0.01}),
        pytest.param("gpc", {"human_scaling": PAIR, "human_noise": 0.01}, marks=pytest.mark.slow),
    ],
)
def test_parity_with_the_dense_reference(algo, given):
    learner = make_learner(algo, "pendulum", capacity=64, **given)
    names = {"scaling": "weights", "human_scaling": "human_weights"}
    reference = make_reference(
        algo, "pendulum", **{names.get(name, name): value for name, value in given.items()}
    )
    assert compare(learner, reference, sequence("pendulum", 5, 40)) > 0


def taught(learner):
    rng, state = np.random.default_rng(0), learner.init()
    for _ in range(6):
        obs = rng.normal(size=learner.obs_size)
        state, _ = learner.correct(state, obs, learner.act(state, obs), rng.choice([-1.0, 1.0], 1))
    return state


@pytest.mark.parametrize(
    "learned", [lambda learner: learner.init(), pytest.param(taught, marks=pytest.mark.slow)]
)
def test_what_is_given_as_it_was_changes_no_bit(learned):
    """A state has the factors of its inputs, so that they are the same in all that is learned."""
    usual = make_learner("gpc", "pendulum", capacity=16)
    given = make_learner("gpc", "pendulum", capacity=16, human_scaling=(*usual.scaling, 1.0))
    assert_same_bits(learned(given), learned(usual))


def test_without_them_gpc_ns_has_no_array_of_them():
    """So that its programs are what they were."""
    usual, given = (make_learner("gpc-ns", "pendulum", **each) for each in ({}, {"scaling": W}))
    assert len(jax.tree.leaves(given)) == len(jax.tree.leaves(usual)) + 2
    assert usual.policy.scaling is None and usual.human.scaling is None
    np.testing.assert_allclose(given.human.scaling, [*W, 1.0])


def test_gpc_ns_finds_out_by_itself_how_large_a_task_says_its_observations_are():
    mine = f"{__name__}:MINE"
    assert make_learner("gpc-ns", mine).policy.scaling is None
    np.testing.assert_allclose(make_learner("gpc", mine).scaling, [1.0, 0.5, 0.25])


@pytest.mark.parametrize("algo", [pytest.param("gpc", marks=pytest.mark.slow), "gpc-ns"])
def test_a_learner_that_has_them_is_kept_and_carried_over(algo):
    learner = make_learner(algo, "pendulum", capacity=64, scaling=W, human_scaling=PAIR)
    state = taught(learner)
    again, kept = unpack_learner(*pack_learner(learner, state))
    assert_same_bits((again, kept), (learner, state))
    other = make_learner(algo, "pendulum", capacity=64, scaling=W)
    host = jax.tree.map(np.asarray, other)
    moved = jax.tree.map(jnp.asarray, carried(learner, state, host, (64, 64)))
    np.testing.assert_allclose(moved.human.scale / state.human.scale, [np.array([*W, 1.0]) / PAIR])
    obs = np.array([0.3, -0.2, 0.5])
    np.testing.assert_allclose(other.act(moved, obs), learner.act(state, obs), rtol=1e-9)


class TestInASweep:
    def test_a_series_is_one_value_in_its_order(self, tmp_path):
        file = tmp_path / "a.toml"
        file.write_text('env = "pendulum"\nalgo = ["gpc", "coach"]\nscaling = [1, 2, 1]\nseeds = 2\n')
        spec = make_spec(read_toml(file))
        assert spec.scaling == (1.0, 2.0, 1.0) and spec.human_scaling == ()
        scales = {cell.algo: cell.scaling for cell in plan(spec)}
        assert scales == {"gpc": (1.0, 2.0, 1.0), "coach": ()}
        assert from_dict(as_dict(spec)) == spec

    def test_where_they_are_not_given_a_specification_is_what_it_was(self):
        spec = spec_of(env="pendulum", algo="gpc")
        assert not {"scaling", "human_scaling"} & as_dict(spec).keys()
        hashes = {
            specification_hash(spec_of(env="pendulum", algo="gpc", **given))
            for given in ({}, {"scaling": W}, {"scaling": W[::-1]}, {"human_scaling": PAIR})
        }
        assert len(hashes) == 4

    @each_learner
    def test_they_reach_the_learner_and_its_program(self, algo):
        usual, given = (
            plan(spec_of(env="pendulum", algo=algo, seeds=1, **each))[0]
            for each in ({}, {"scaling": W, "human_scaling": PAIR})
        )
        learner = learner_of(given, 8)
        np.testing.assert_allclose(learner.scaling, W)
        state = learner.init()
        np.testing.assert_allclose(state.policy.scale[0], W)
        np.testing.assert_allclose(state.human.scale[0], PAIR)
        assert program_of(given) != program_of(usual)
        assert cell_of(cell_as_json(given)) == given

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"scaling": [1, 2]}, "scaling: of pendulum it has 3 factors.*not 2"),
            ({"human_scaling": W}, "human_scaling: of pendulum it has 4 factors.*action, not 3"),
            ({"scaling": [1, 0, 1]}, "scaling 0: give a number above 0"),
            ({"algo": "d-coach", "human_scaling": PAIR}, "with d-coach alone it changes nothing"),
        ],
    )
    def test_what_does_not_fit_is_refused(self, given, message):
        with pytest.raises(UserError, match=message):
            spec_of(env="pendulum", **{"algo": "gpc", **given})
