"""Tasks of a person's own, of gymnasium and of other shapes: what is taken of them, and what is refused in a line."""

import functools

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gpcjax
from gpcjax import registry
from gpcjax.engine.evaluate import evaluate
from gpcjax.envs import base
from gpcjax.envs.cartpole import CartPole
from gpcjax.envs.views import check_view
from gpcjax.errors import ForeignError, UserError

STILL = {"terminated": jnp.array(False), "truncated": jnp.array(False)}


class Slide(gpcjax.Env):
    """A place that each action moves."""

    obs_size, action_size, max_steps = 2, 1, 15

    def reset(self, key):
        return self.begin(jax.random.uniform(key, (2,)))

    def step(self, state, action):
        return self.advance(state, state.physics + 0.1 * action, reward=1.0)


class Scaled(Slide):
    obs_size, time_step, obs_scale = np.int64(2), np.float32(0.5), np.array([10.0, 0.1])


class Parametrised(Slide):
    time_step: jax.Array = base.eqx.field(default=0.25, converter=gpcjax.parameter)


class Plain:
    """No `gpcjax.Env`, and it ends nothing: neither counts its steps nor says that they are enough."""

    obs_size, action_size, time_step, obs_scale = 2, 1, 0.01, 2.0

    def reset(self, key):
        start = jax.random.uniform(key, (2,))
        return gpcjax.State(start, start, jnp.zeros(()), **STILL, time=jnp.int32(0))

    def step(self, state, action):
        return gpcjax.State(state.obs, state.obs, jnp.ones(()), **STILL, time=state.time)


class Short(Plain):
    max_steps = 7


class Goal(gpcjax.State):
    goal: jax.Array


class Seeking(Slide):
    """Its state has a field of its own; its rewards are numbers of Python, and it ends nothing."""

    def reset(self, key):
        start = jax.random.uniform(key, (2,))
        return Goal(start, start, 0.0, **STILL, time=jnp.int32(0), goal=jnp.full(2, 3.0))

    def step(self, state, action):
        return Goal(state.physics, state.goal, 1.0, **STILL, time=state.time + 1, goal=state.goal)


class Changing(Seeking):
    def step(self, state, action):
        return Goal(state.physics, state.obs, 1.0, **STILL, time=state.time, goal=jnp.zeros(3))


class Walk(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gymnasium.spaces.Box(-2.0, 2.0, (1,), np.float64)
    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012

    def __init__(self, size=1.0):
        self.size, self.time = size, 0

    def reset(self, *, seed=None, options=None):
        self.time = 0
        return np.zeros(2), {}

    def step(self, action):
        self.time += 1
        return np.zeros(2), self.size, False, False, {}


class Falling(Walk):
    def step(self, action):
        if self.time == 3:
            raise IndexError("it fell over")
        return super().step(action)


class Discrete(Walk):
    action_space = gymnasium.spaces.Discrete(2)


class Broken(Walk):
    def __init__(self):
        raise RuntimeError("no licence")


class Sized(Walk):
    def __init__(self, size):
        super().__init__(size)


ALWAYS_THE_SAME = Walk()
OF = functools.partial(registry.described, "task", "mine:It")


def zeros(obs):
    return np.zeros(1)


def made(found, **values):
    return OF(found).make(**values)


@pytest.mark.parametrize(
    ("found", "time_step", "obs_scale"),
    [
        (Slide, None, None),
        (Scaled, 0.5, (10.0, 0.1)),
        (Parametrised, 0.25, None),
        (Plain, 0.01, (2.0, 2.0)),
        (Walk, None, None),
        (gpcjax.TaskSpec(name="it", make=Scaled, time_step=0.1, obs_scale=(1.0, 2.0)), 0.1, (1.0, 2.0)),
    ],
)
def test_what_a_class_says_of_itself(found, time_step, obs_scale):
    spec = OF(found)
    assert (spec.sizes, spec.time_step, spec.obs_scale) == ((2, 1), time_step, obs_scale)
    assert all(type(size) is int for size in spec.sizes)


def test_its_scale_reaches_gpc(monkeypatch):
    monkeypatch.setitem(registry._FOUND, ("task", "mine:It"), (OF(Scaled), None))
    np.testing.assert_allclose(gpcjax.make_learner("gpc", "mine:It").scaling, [0.1, 10.0])


@pytest.mark.parametrize(
    ("found", "steps"),
    [(Plain, 1000), (Short, 7), (Seeking, 15), pytest.param(Slide, 15, marks=pytest.mark.slow)],
)
def test_an_episode_ends_after_max_steps_whatever_its_state_says(found, steps):
    assert evaluate(made(found), lambda obs: jnp.zeros(1), 2).length.tolist() == [steps, steps]


def test_a_state_keeps_fields_of_its_own():
    env = made(Seeking)
    state = base.stepped(env, base.started(env, jax.random.key(0)), jnp.zeros(1))
    assert isinstance(state, Goal) and state.reward.dtype == jnp.float64 and int(state.time) == 1
    np.testing.assert_array_equal(state.goal, state.obs)
    with pytest.raises(UserError, match=r"Changing.step: goal becomes .float64 of shape \(3,\)., it was "):
        OF(Changing)


def test_built_in_ones_count_by_themselves():
    """Nothing is added to their programs."""
    assert base._counts(CartPole()) and not base._counts(Slide())


@pytest.mark.parametrize(
    ("found", "values", "size", "steps"),
    [
        (Walk, {}, 1.0, 1000),
        (Walk, {"size": 7.0}, 7.0, 1000),
        (lambda: Walk(size=5.0), {}, 5.0, 1000),
        (lambda: Sized(3.0), {}, 3.0, 1000),
        (lambda: gymnasium.wrappers.TimeLimit(Walk(2.0), 15), {}, 2.0, 15),
        (lambda: gymnasium.wrappers.TimeLimit(Walk(), 1200), {}, 1.0, 1200),
        (gpcjax.TaskSpec(name="it", make=Walk, sizes=(2, 1)), {"size": 4.0}, 4.0, 1000),
    ],
    ids=[
        "class",
        "its argument",
        "function",
        "that gives an argument",
        "a wrapper",
        "a long one",
        "description",
    ],
)
def test_gymnasium_is_simulated_as_it_was_made(found, values, size, steps):
    spec = OF(found)
    assert spec.on_host
    env = spec.make(**values)
    assert evaluate(env, zeros, 2).returns.tolist() == [size * steps] * 2
    assert env == spec.make(**values) and not env.makes_pictures


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (Discrete, r"env mine:It: its actions are Discrete\(2\), a bounded flat Box is supported"),
        (lambda: ALWAYS_THE_SAME, "env mine:It: it gives the same object twice"),
        (gpcjax.TaskSpec(name="it", make=Slide, sizes=(3, 1)), r"env mine:It: its description has sizes \(3, 1\)"),
        (gpcjax.TaskSpec(name="it", make="nowhere:It"), "env mine:It: there is no module nowhere"),
        (gpcjax.TaskSpec(name="it", make=lambda: 3), "env mine:It: 3 is no task, give a class with reset and step"),
        (gpcjax.TaskSpec(name="it", make=Slide, presets={"gpc": 3}), "env mine:It: experts, presets and each of"),
        (gpcjax.TaskSpec(name="it", make=Slide, obs_scale=(0, 1)), r"env mine:It: obs_scale \(0, 1\): give"),
    ],
)  # fmt: skip
def test_refused(found, message):
    with pytest.raises(UserError, match=f"^{message}"):
        OF(found)


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (
            {"observed": (("place", -2, 2),)},
            "its view names 1 numbers of an observation, its task has 2: give all",
        ),
        ({"observed": (("place", -2, 2), ("speed", 2, 2))}, "observed speed: 2 must be below 2"),
        (
            {"observed": (("place", -2, 2), ("speed", -2, float("inf")))},
            "observed speed inf: give a finite number",
        ),
        ({"observed": ("place", "speed")}, "observed 'place': give a name, the lowest and the highest value"),
        (
            {"controls": (gpcjax.Control(("left", "l"), ("right", "r")),) * 2},
            "its view has 2 controls, an action of",
        ),
        ({"controls": (gpcjax.Control(("a", "l"), ("right", "r")),)}, "controls Control"),
        ({"scene": "cartpole"}, "scene 'cartpole': give none, or the one of its 2 numbers: cartpole [(]4"),
        ({"scene": "lander"}, "scene 'lander': give none"),
        ({"scene": ["pendulum"]}, "scene ['[]+pendulum'[]]: give none"),
        ({"axes": (0, -1)}, "axes [(]0, -1[)]: give the places of two numbers"),
        ({"axes": (0, True)}, "axes [(]0, True[)]: give the places of two numbers"),
        ({"axes": (0, 2)}, "axes [(]0, 2[)]: give two of the 2 numbers of an observation, from 0"),
        ({"axes": np.arange(1, 2)}, "axes array"),
        ({"axes": (1, 1)}, "axes [(]1, 1[)]: give two of the 2 numbers of an observation, from 0"),
        ({"hint": 3}, "hint 3: give a sentence"),
    ],
)
def test_a_view_that_does_not_fit_is_refused_once(view, message):
    """Before anybody teaches, plays or draws it."""
    with pytest.raises(UserError, match=f"^env mine:It: {message}"):
        OF(gpcjax.TaskSpec(name="it", make=Slide, view=gpcjax.View(**view)))


def test_a_view_that_fits():
    view = gpcjax.View(
        (("place", -2, np.float32(2)), ("speed", -1, 1)), (gpcjax.Control(("left", "less"), ("right", "more")),),
        "mountaincar", axes=(np.int64(1), np.int8(0)), hint="Go.",
    )  # fmt: skip
    assert OF(gpcjax.TaskSpec(name="it", make=Slide, view=view)).view == view


def test_views_of_the_built_in_tasks_fit():
    for name in registry.built_in("task"):
        spec = registry.find("task", name)
        check_view(name, spec.view, spec.sizes)


@pytest.mark.parametrize("found", [Broken, gpcjax.TaskSpec(name="it", make=Broken), lambda: Broken()])
def test_what_fails_as_it_is_made_is_theirs(found):
    with pytest.raises(
        ForeignError, match=r"^env mine:It: it cannot be made \(RuntimeError: no licence\)$"
    ) as told:
        OF(found)
    assert "test_foreign_tasks.py" in told.value.details and "host.py" not in told.value.details


def test_a_registered_one_too():
    gymnasium.register("BrokenWalk-v0", entry_point=Broken)
    with pytest.raises(
        ForeignError, match=r"^env gym:BrokenWalk-v0: it cannot be made \(RuntimeError: no licence\)$"
    ):
        registry.find("task", "gym:BrokenWalk-v0")


def test_what_fails_in_a_step_is_theirs():
    with pytest.raises(
        ForeignError, match=r"^env mine:It: its step fails \(IndexError: it fell over\)$"
    ) as told:
        evaluate(made(Falling), zeros, 2)
    assert "test_foreign_tasks.py" in told.value.details and "host.py" not in told.value.details


def test_a_description_has_the_name_by_which_it_is_asked_for():
    """Also those of learners and teachers, whose makers are looked at as classes are."""
    assert OF(gpcjax.TaskSpec(name="other", make=Slide, label="Slide")).title == "Slide"
    for kind, spec in (
        ("task", gpcjax.TaskSpec),
        ("learner", gpcjax.LearnerSpec),
        ("teacher", gpcjax.TeacherSpec),
    ):
        make = Slide if kind == "task" else lambda: {}
        told = registry.described(kind, "mine:It", spec(name="other", make=make))
        assert told.name == "mine:It"
    with pytest.raises(
        UserError, match=r"^teacher mine:It: \{\} is no teacher, give a subclass of gpcjax.Teacher"
    ):
        told.make()
