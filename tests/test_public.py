"""The public names together, as a person with a task of their own uses them."""

from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import pytest

import gpcjax
from gpcjax.errors import UserError


@pytest.mark.slow
def test_teaching_by_hand(tmp_path):
    """A loop of one's own with a shipped task, an oracle, and the policy kept for later."""
    env = gpcjax.make_env("cartpole", max_steps=80)
    learner = gpcjax.make_learner("gpc", "cartpole", capacity=64)
    oracle = gpcjax.make_oracle("cartpole", "lqr", rate=0.4)
    state, heard = learner.init(), 0
    step, advise = jax.jit(env.step), jax.jit(oracle.advise)
    for episode in range(2):
        at = env.reset(jax.random.key(episode))
        for time in range(env.max_steps):
            action = learner.act(state, at.obs)
            assert action.shape == (1,) and abs(action[0]) <= 1
            h = advise(jax.random.key(100 + 1000 * episode + time), at.obs, action)
            if h.any():
                state, info = learner.correct(state, at.obs, action, h)
                heard += 1
                for value in (
                    info.rate,
                    info.sigma_policy,
                    info.sigma_human,
                    learner.uncertainty(state, at.obs, action),
                ):
                    assert value.shape == (1,) and 0 < value[0] < 1
            at = step(at, action)
            if at.done:
                break
    assert heard > 10

    gpcjax.save_policy(tmp_path / "policy", learner, state, env="cartpole")
    policy = gpcjax.load_policy(tmp_path / "policy")
    expert = gpcjax.make_expert("cartpole", "lqr")
    idle = gpcjax.evaluate(env, lambda obs: 0.0 * expert(obs), starts=20).returns.mean()
    taught, best = (gpcjax.evaluate(env, each, starts=20).returns.mean() for each in (policy, expert))
    assert idle < 50 < taught <= best == 80


def test_a_task_of_ones_own():
    """Only observations, actions and advice: no environment of ours. Two actions learn different things."""
    learner = gpcjax.make_learner(
        "gpc-ns",
        obs_size=2,
        action_size=2,
        capacity=64,
        policy={"variance": 0.01, "length_scale": 0.5},
        human={"variance": 0.05, "length_scale": 0.2},
    )
    rng, state = np.random.default_rng(0), learner.init()
    target = lambda obs: np.array([0.5 * np.sign(obs[0]), 0.3])  # noqa: E731
    for _ in range(60):
        obs = rng.normal(size=2)
        action = np.asarray(learner.act(state, obs))
        gap = target(obs) - action
        state, info = learner.correct(state, obs, action, np.where(np.abs(gap) > 0.1, np.sign(gap), 0.0))
        assert info.status == 0 and learner.has_room(state)
    errors = [np.abs(target(obs) - np.asarray(learner.act(state, obs))) for obs in rng.normal(size=(50, 2))]
    assert np.mean(errors) < 0.2


@pytest.mark.slow
def test_a_sweep_and_its_report(tmp_path):
    out = gpcjax.run_sweep(
        tmp_path / "out", env="cartpole", algo="coach", seeds=2, episodes=3, oracle="lqr", rate=0.3
    )
    frame = gpcjax.load(out)
    assert len(frame) == 6
    gpcjax.draw_report(out)
    for name in ("summary.csv", "curves.png", "curves.pdf", "report.html"):
        assert (out / name).stat().st_size > 100


@pytest.mark.slow
def test_sweeps_and_reports_from_threads(tmp_path):
    """Several at once, in a program whose main thread does something else."""

    def one(seed):
        out = gpcjax.run_sweep(
            tmp_path / str(seed), env="pendulum", algo="coach", seeds=[seed], episodes=2, oracle="energy"
        )
        return gpcjax.load(out)["return"].tolist(), gpcjax.draw_report(out)

    with ThreadPoolExecutor(2) as threads:
        (first, report), (second, _) = threads.map(one, (0, 1))
    assert len(first) == len(second) == 2 and first != second
    assert report._repr_html_().count("data:image/png;base64,") == len(report.figures) == 2
    with pytest.raises(UserError), ThreadPoolExecutor(1) as threads:
        threads.submit(gpcjax.run_sweep, tmp_path / "0", env="pendulum", algo="coach", seeds=0).result()


def test_learners_of_every_table_say_what_they_take():
    sizes = {"cartpole": (4, 1), "pendulum": (3, 1), "lunarlander": (8, 2), "mountaincar": (2, 1)}
    for env, (obs_size, action_size) in sizes.items():
        for algo in ("gpc", "gpc-ns", "coach"):
            learner = gpcjax.make_learner(algo, env)
            assert (learner.obs_size, learner.action_size) == (obs_size, action_size)


def test_mistakes_are_value_errors():
    for call in (
        lambda: gpcjax.make_learner("gpc", "cartpol"),
        lambda: gpcjax.make_env("cartpol"),
        lambda: gpcjax.make_expert("cartpole", "energy"),
        lambda: gpcjax.make_oracle("cartpole", "lqr", rate=2.0),
        lambda: gpcjax.run_sweep(env="cartpole", seeds=0),
        lambda: gpcjax.load("there-is-none"),
        lambda: gpcjax.load_policy("there-is-none"),
        lambda: gpcjax.draw_report("there-is-none"),
    ):
        with pytest.raises(ValueError, match=r"cartpol|energy|rate 2.0|seeds 0|there-is-none"):
            call()


def test_names_of_tasks_and_experts():
    """Each can be made, and any other is refused."""
    assert gpcjax.env_names() == ("cartpole", "pendulum", "lunarlander", "mountaincar")
    for env in gpcjax.env_names():
        assert all(callable(gpcjax.make_expert(env, name)) for name in gpcjax.expert_names(env))
    with pytest.raises(ValueError, match=r"env 'cartpol': give cartpole, pendulum, .*did you mean cartpole"):
        gpcjax.expert_names("cartpol")


@pytest.mark.parametrize("path", [None, 3, "", "a\0b", b"x", True], ids=repr)
def test_what_is_no_path(path):
    learner = gpcjax.make_learner("coach", "pendulum")
    calls = [gpcjax.load, gpcjax.draw_report, gpcjax.load_policy, gpcjax.load_learner]
    calls += [lambda path: gpcjax.save_policy(path, learner, learner.init())]
    for call in calls:
        with pytest.raises(ValueError, match=r"(path|out) .*: give a path"):
            call(path)


@pytest.mark.parametrize("jobs", [0, -1, 1.5, True, "2", None], ids=repr)
def test_jobs_are_those_of_the_command_line(jobs, tmp_path):
    with pytest.raises(ValueError, match=r"jobs .*: give a whole number from 1 to 1,024"):
        gpcjax.run_sweep(tmp_path / "out", jobs=jobs, env="cartpole")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "parameters",
    [
        *({"max_steps": value} for value in (0, 1.5, True, "8", None, 10**12, float("nan"))),
        *({"gravity": value} for value in ("x", None, True, 1j, float("nan"), 10**400, b"9", [1, 2])),
    ],
    ids=repr,
)
def test_parameters_of_a_task_are_numbers(parameters):
    with pytest.raises(ValueError, match=r"cartpole: (max_steps|gravity) .*: give a"):
        gpcjax.make_env("cartpole", **parameters)


@pytest.mark.parametrize("value", [True, "0.5", None, 1j, b"1", float("nan"), [0.5]], ids=repr)
@pytest.mark.parametrize("name", ["rate", "error", "delta", "active_gain"])
def test_numbers_of_an_oracle_are_numbers(name, value):
    with pytest.raises(ValueError, match=rf"{name} .*: give a number"):
        gpcjax.make_oracle("pendulum", "energy", **{name: value})
