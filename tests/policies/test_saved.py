"""Policies on disk: whole or absent, the same to the bit, and refused with a reason."""

import json
import logging
import shutil
import sys
import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax.envs.registry import env_names, make_env, shipped
from gpcjax.learners.factory import make_learner
from gpcjax.policies.base import Controller, Policy
from gpcjax.policies.saved import load_card, load_policy, save_controller, shipped_path
from tests.trees import assert_same_bits

COACH = {"lower": (-1, -1, -1), "upper": (1, 1, 1), "counts": (2, 3, 4)}


def taught(algo, corrections=5):
    """A learner of two actions and three observations, and a state."""
    options = COACH if algo == "coach" else {"capacity": 16, "policy": {"nu": 2.5}}
    learner = make_learner(algo, obs_size=3, action_size=2, **options)
    rng, state = np.random.default_rng(0), learner.init()
    for step in range(corrections):
        # The second dimension holds fewer points than the first.
        state, _ = learner.correct(state, rng.normal(size=3), np.zeros(2), [1, -1 if step < 2 else 0])
    return learner, state


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """One policy on disk, not to be changed: copy it."""
    path = tmp_path_factory.mktemp("policies") / "mine"
    learner, state = taught("gpc")
    gpcjax.save_policy(path, learner, state, env="balance", teacher="Ada")
    return path


@pytest.mark.parametrize("algo", ["gpc", pytest.param("gpc-ns", marks=pytest.mark.slow), "coach"])
def test_what_is_saved_is_loaded_to_the_bit(tmp_path, algo):
    learner, state = taught(algo)
    gpcjax.save_policy(tmp_path / "deep" / "policy", learner, state)
    policy = gpcjax.load_policy(tmp_path / "deep" / "policy")
    controller = learner.controller(state)
    if algo != "coach":  # the points in use, five in the first dictionary
        trim = {name: getattr(controller, name)[:, :5] for name in ("points", "weights")}
        controller = type(controller)(**(vars(controller) | trim))
    assert_same_bits(policy.controller, controller)
    for obs in np.random.default_rng(1).normal(size=(5, 3)):
        obs = jnp.asarray(obs)
        assert policy(obs).shape == (2,)
        np.testing.assert_allclose(policy(obs), learner.act(state, obs), atol=1e-14)
        np.testing.assert_array_equal(policy(obs), Policy(controller)(obs))


def test_a_policy_works_in_jit_and_vmap_and_is_clipped(saved):
    policy = gpcjax.load_policy(saved)
    batch = jnp.asarray(np.random.default_rng(2).normal(size=(7, 3)))
    together = jax.jit(jax.vmap(policy))(batch)
    np.testing.assert_allclose(together, np.stack([policy(obs) for obs in batch]), atol=1e-14)
    loud = eqx.tree_at(lambda policy: policy.controller.weights, policy, 1e9 * policy.controller.weights)
    assert set(np.abs(np.asarray(jax.vmap(loud)(batch))).ravel()) == {1.0}


def test_an_idle_policy_can_be_saved(tmp_path):
    """No point is in use: one unused one stands for them."""
    learner, state = taught("gpc", corrections=0)
    gpcjax.save_policy(tmp_path / "idle", learner, state)
    policy = gpcjax.load_policy(str(tmp_path / "idle"))
    assert policy.controller.points.shape == (2, 1, 3)
    np.testing.assert_array_equal(policy(jnp.ones(3)), 0.0)


def test_the_card_says_what_it_is(saved):
    card = load_card(saved)
    assert card["format"] == 2 and card["kind"] == "kernel" and card["smoothness"] == 2.5
    assert card["arrays"] == {"points": [2, 5, 3], "weights": [2, 5], "scale": [2, 3]}
    expected = {"learner": "GPC", "obs_size": 3, "action_size": 2, "env": "balance", "teacher": "Ada"}
    assert card["provenance"] == expected


class TestSaving:
    def test_what_is_there_is_kept(self, tmp_path):
        learner, state = taught("coach")
        for name in ("file", "empty", "policy"):
            path = tmp_path / name
            path.write_text("precious") if name == "file" else path.mkdir()
            with pytest.raises(
                FileExistsError, match=f"{path} exists: choose another path, or remove it first"
            ):
                gpcjax.save_policy(path, learner, state)
        assert (tmp_path / "file").read_text() == "precious"
        assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "file", "policy"]

    def test_nothing_half_written_is_seen(self, tmp_path, monkeypatch):
        """Whichever step fails, there is no folder, not even a hidden one."""
        learner, state = taught("coach")
        with pytest.raises(TypeError):
            gpcjax.save_policy(tmp_path / "policy", learner, state, teacher=object())
        assert not list(tmp_path.iterdir())
        import orbax.checkpoint

        def fail(*_):
            assert [path.name[0] for path in tmp_path.iterdir()] == ["."]
            raise KeyboardInterrupt

        monkeypatch.setattr(orbax.checkpoint.StandardCheckpointer, "save", fail)
        with pytest.raises(KeyboardInterrupt):
            gpcjax.save_policy(tmp_path / "policy", learner, state)
        assert not list(tmp_path.iterdir())

    def test_threads_that_save_at_once_do_so_one_after_the_other(self, tmp_path, monkeypatch, caplog):
        """What saves is of the whole process: its words are silenced for one, and heard again after the last.

        Nobody else's are.
        """
        import orbax.checkpoint

        learner, state = taught("coach")
        before = logging.getLogger("absl").disabled, sys.unraisablehook
        inside, met, raised = [], threading.Event(), []
        saving = orbax.checkpoint.StandardCheckpointer.save

        def save(checkpointer, *arguments):
            inside.append(threading.current_thread())
            if len(inside) > 1:
                met.set()
            logging.getLogger("absl").error("not heard")
            logging.getLogger("robot").error("heard")
            met.wait(0.2)  # gives the other one time to come where it should not
            saving(checkpointer, *arguments)
            inside.pop()

        def run(name):
            try:
                gpcjax.save_learner(tmp_path / name, learner, state)
            except Exception as error:
                raised.append(error)

        monkeypatch.setattr(orbax.checkpoint.StandardCheckpointer, "save", save)
        threads = [threading.Thread(target=run, args=(name,), daemon=True) for name in "ab"]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60)
        assert not met.is_set() and not raised
        assert (logging.getLogger("absl").disabled, sys.unraisablehook) == before
        assert caplog.messages == ["heard"] * 2
        for name in "ab":
            assert_same_bits(gpcjax.load_learner(tmp_path / name)[1], state)

    def test_others_may_read_it(self, saved):
        assert saved.stat().st_mode & 0o777 == 0o755

    def test_no_pickle(self, saved):
        """Numbers and JSON only: a policy from a stranger runs no code."""
        for path in saved.rglob("*"):
            assert path.suffix not in (".pkl", ".pickle")
            assert not path.is_file() or not path.read_bytes().startswith(b"\x80")

    def test_only_controllers_have_a_format(self, tmp_path):
        class Other(Controller):
            obs_size = action_size = 1

            def __call__(self, obs):
                return obs

        with pytest.raises(TypeError, match="no format for a Other"):
            save_controller(tmp_path / "other", Other(), {})


class TestLoading:
    @pytest.fixture
    def broken(self, saved, tmp_path):
        """A copy whose card is replaced, without the sums that would tell."""

        def make(text):
            path = shutil.copytree(saved, tmp_path / "broken")
            (path / "SHA256SUMS").unlink()
            (path / "card.json").write_text(text if isinstance(text, str) else json.dumps(text))
            return path

        return make

    def test_nothing_there(self, tmp_path):
        for path in (tmp_path, tmp_path / "none"):
            with pytest.raises(ValueError, match=rf"{path}: no policy here \(card.json is missing\)"):
                gpcjax.load_policy(path)

    @pytest.mark.parametrize(
        "text",
        [
            "",
            "{",
            "[]",
            "3",
            "null",
            "{}",
            {"kind": "kernel"},
            {"format": 1},
            {"format": 1, "kind": "kernel"},
            "[" * 100_000,
            "9" * 5000,
            '{"format": 1, "format": 1}',
        ],
        ids=str,
    )
    def test_a_broken_card(self, broken, text):
        path = broken(text)
        with pytest.raises(ValueError, match=rf"{path / 'card.json'}: this is not a policy's card"):
            gpcjax.load_policy(path)

    def test_another_format(self, broken, saved):
        path = broken(load_card(saved) | {"format": 3})
        with pytest.raises(ValueError, match=r"card.json: format 3 is not known, this version reads 1 and 2"):
            gpcjax.load_policy(path)

    def test_another_kind(self, broken, saved):
        path = broken(load_card(saved) | {"format": 1, "kind": "forest"})
        with pytest.raises(ValueError, match=rf"{path / 'card.json'}: this is not a policy's card"):
            gpcjax.load_policy(path)

    def test_arrays_that_are_missing(self, broken, saved):
        path = broken(load_card(saved) | {"format": 1})
        shutil.rmtree(path / "arrays")
        with pytest.raises(ValueError, match=rf"{path / 'arrays'}: the arrays of this policy cannot be read"):
            gpcjax.load_policy(path)


def test_the_first_oracle_is_shipped_wherever_a_task_ships_some():
    names = {env: tuple(shipped(env).values()) for env in env_names()}
    assert names == {
        "cartpole": ("cartpole", "cartpole-2", "cartpole-3", "cartpole-network"),
        "pendulum": ("pendulum", "pendulum-network"),
        "lunarlander": (),
        "mountaincar": (),
    }


@pytest.mark.parametrize(
    ("task", "name"), [(env, name) for env in env_names() for name in shipped(env).values()]
)
def test_a_shipped_oracle_is_a_good_policy(task, name):
    """With a card that says where it comes from."""
    path, env = shipped_path(name), make_env(task)
    policy = gpcjax.load_policy(path)
    assert policy(env.reset(jax.random.key(0)).obs).shape == (env.action_size,)
    provenance = load_card(path)["provenance"]
    assert provenance["env"] == task
    if name.endswith("-network"):  # it learned without a teacher, and is measured by the same expert
        who = "expert"
        assert provenance["learner"] == "ppo" and provenance["optimiser"] == "adam"
        training = provenance["training"]
        assert provenance["steps"] == training["updates"] * training["lanes"] * training["unroll"] > 100_000
    else:
        who = "teacher"
        assert provenance["learner"] == "gpc" and provenance["teacher"] != "gpc"
    spread = provenance[f"{who}_return_std"] / np.sqrt(provenance["starts"])
    assert provenance["return_mean"] >= provenance[f"{who}_return_mean"] - spread
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    assert size < 200_000


def test_a_folder_does_not_say_where_it_was_written(tmp_path):
    folders = [shipped_path(name) for name in ("cartpole", "pendulum-network", "brax-reacher")]
    save_controller(tmp_path / "mine", load_policy(folders[0]).controller, {})
    for folder in [*folders, tmp_path / "mine"]:
        files = [path for path in folder.rglob("*") if path.is_file()]
        assert len(files) > 5
        for path in files:
            assert not any(
                word in path.read_bytes() for word in (b"/work", b"/tmp", b"/home", str(tmp_path).encode())
            )
        load_policy(folder)
