"""Settings of a person's own learners and teachers: what of them is compiled in, and which names they may have."""

import dataclasses
import inspect
import pickle
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

import gpcjax
from gpcjax.allowed import Numbers
from gpcjax.cli.words import parse_words, settings
from gpcjax.describe import Setting
from gpcjax.errors import ForeignError, UserError
from gpcjax.fixed import fixed
from gpcjax.own_settings import check_name
from gpcjax.registry import find
from gpcjax.sweep.build import start_of
from gpcjax.sweep.given import Given, Unchecked
from gpcjax.sweep.options import EXPERIMENT, OF_CREDIT, RUNNING, VARIANTS
from gpcjax.sweep.plan import plan, program_of
from gpcjax.sweep.points import POINTS
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.rehearsal import check_alike
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import QUICK, make_spec, read_toml, spec_of
from gpcjax.teach.course import Course
from tests.foreign.drifting import Linear, Loud

HERE = __name__
USUAL = {"env": "tests.foreign.drifting:Drift", "oracle": "tests.foreign.drifting:expert", "rate": 0.3}


class Gaining(Linear):
    gain: float = eqx.field(default=1.0, static=True)
    share: jax.Array = eqx.field(default=1.0, converter=gpcjax.parameter)

    def learn(self, state, moment, advice, key):
        change = self.gain * self.share * jnp.outer(advice, moment.obs)
        return state + change, gpcjax.Info.of(rate=jnp.abs(change @ moment.obs))


def gaining(obs_size, action_size, gain=1.0, share=0.5):
    """A function has no fields: what it makes says what is compiled in."""
    return Gaining(obs_size=obs_size, action_size=action_size, gain=gain, share=share)


class Sized(Linear):
    """A shape follows from a number that is no whole one; it is at its upper bound."""

    span: float = 1.0
    grid: jax.Array | None = None

    def __init__(self, obs_size, action_size, span=1.0):
        if span > 1:
            raise UserError(f"span {span}: give at most 1")
        self.obs_size, self.action_size, self.step_size = obs_size, action_size, jnp.array(0.5)
        self.span, self.grid = jnp.array(span), jnp.zeros(int(span * 10))


class Still(Loud):
    calm: float = eqx.field(default=0.5, static=True)


class Whole(Linear):
    """Of whole numbers follow shapes, of truth values conditions; a function and a text are no numbers at all."""

    units: int = 3
    clips: bool = True
    how: str = "tanh"
    activation: Callable = jnp.tanh

    def init(self, key=None):
        return {"weights": super().init(), "more": jnp.zeros(self.units)}

    def propose(self, state, obs):
        action = getattr(jnp, self.how)(self.activation(state["weights"] @ obs))
        return jnp.clip(action, -1.0, 1.0) if self.clips else action

    def learn(self, state, moment, advice, key):
        weights, info = super().learn(state["weights"], moment, advice, key)
        return {"weights": weights, "more": state["more"] + self.units}, info

    def measure(self, state):
        return {"weight": state["more"].sum()}


class Netted(Linear):
    net: eqx.nn.MLP = eqx.field(kw_only=True)


class Patient(Loud):
    patience: int = 2

    def advise(self, coins, moment):
        return jnp.zeros(self.patience).sum() + jnp.sign(moment.target - moment.action)


def anew(obs_size, action_size, step_size=0.5):
    return Whole(
        obs_size=obs_size, action_size=action_size, step_size=step_size, activation=lambda x: jnp.tanh(x)
    )


SPEC = gpcjax.LearnerSpec(
    name=f"{HERE}:SPEC", make=Whole, settings=(Setting("units", "", Numbers(1, 9, whole=True), "units"),)
)
GAIN = gpcjax.LearnerSpec(
    name=f"{HERE}:GAIN", make=Gaining, settings=(Setting("gain", "", Numbers(), "said wrongly"),)
)


def test_what_is_no_number_to_trace_is_compiled_in(tmp_path, workers_in_process):
    settings = {**USUAL, "algo": f"{HERE}:Whole", "teacher": f"{HERE}:Patient", "seeds": 1, "episodes": 2}
    rows = read_episodes(sweep(tmp_path / "out", **settings))
    assert (rows["corrections"] > 0).all() and (rows["weight"] == 9 * rows["corrections"].cumsum()).all()


def test_a_session_has_them_compiled_in_too():
    session = gpcjax.Session(Whole(obs_size=2, action_size=1))
    session.propose([0.1, 0.2])
    session.advise([1])
    assert session.corrections == 1 and session.learner.units == 3


def test_fixed_things_are_what_they_were():
    given = Whole(obs_size=2, action_size=1, units=4)
    one, other = fixed(given), fixed(Whole(obs_size=2, action_size=1, units=4))
    assert jax.tree.structure(one) == jax.tree.structure(other) != jax.tree.structure(given)
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(one))
    patient = fixed(Patient())
    again = pickle.loads(pickle.dumps(patient))
    assert type(again) is type(patient) is not Patient
    assert dataclasses.replace(again, patience=4).patience == 4
    assert isinstance(one, Whole) and (type(one).__name__, type(one).__module__) == ("Whole", HERE)
    assert fixed(one) is one and fixed(linear := Linear(obs_size=2, action_size=1)) is linear
    nested = fixed(Netted(obs_size=2, action_size=1, net=eqx.nn.MLP(2, 1, 4, 1, key=jax.random.key(0))))
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(nested))


def test_whole_numbers_of_a_description_are_programs_of_their_own():
    assert [each.compiled for each in find("learner", f"{HERE}:SPEC").settings] == ["value"]


@pytest.mark.parametrize(("algo", "settings"), [("GAIN", {"gain": [1, 2]}), ("anew", {"rate": [0.1, 0.2]})])
def test_runs_of_another_structure_are_refused(algo, settings):
    first, second = plan(spec_of(**{**USUAL, "algo": f"{HERE}:{algo}", "seeds": 1} | settings))
    if algo == "GAIN":
        assert program_of(first) == program_of(second)
    check_alike(first, start_of(first), start_of(first))
    with pytest.raises(
        UserError, match=f"algo {HERE}:{algo}: what it is made of is another with each run: give"
    ):
        check_alike(second, start_of(second), start_of(first))


@pytest.mark.parametrize(
    ("kind", "name", "compiled"),
    [
        ("learner", "Gaining", {"step_size": "no", "gain": "value", "share": "no"}),
        ("learner", "gaining", {"gain": "value", "share": "no"}),
        ("learner", "Sized", {"span": "value"}),
        ("teacher", "Still", {"loudness": "no", "calm": "value"}),
    ],
)
def test_what_is_compiled_in_is_told_apart_by_program(kind, name, compiled):
    assert {each.name: each.compiled for each in find(kind, f"{HERE}:{name}").settings} == compiled


def test_values_of_a_static_field_are_programs_of_their_own():
    spec = spec_of(**USUAL, algo=f"{HERE}:Gaining", gain=[0.5, 2], share=[0.1, 0.2], seeds=1)
    assert len({program_of(cell) for cell in plan(spec)}) == 2


@pytest.mark.slow
def test_a_static_field_in_a_grid(tmp_path, workers_in_process):
    """Each value with rows of its own, which it has alone, too."""
    settings = {**USUAL, "algo": f"{HERE}:Gaining", "seeds": 1, "episodes": 2}
    rows = read_episodes(sweep(tmp_path / "both", **settings, gain=[0.5, 2]))
    alone = read_episodes(sweep(tmp_path / "alone", **settings, gain=2))
    both = {gain: rows["return"][rows["gain"] == gain].tolist() for gain in (0.5, 2.0)}
    assert both[2.0] == alone["return"].tolist() != both[0.5]


class Shadowing(Linear):
    """Its settings have the names of built-in ones: a whole number there is none here, and the other way round."""

    width: float = 0.3
    noise: int = 2


@pytest.mark.parametrize(
    ("width", "noise", "both"), [(0.2, 3, False), ([0.2, 0.4], [2, 3], False), (-1, -5, False), (2, 3, True)]
)
def test_a_setting_may_have_a_name_of_a_built_in_one(width, noise, both, tmp_path):
    """With the bounds that it has here, however it is given; those of all who have it, where there are several."""
    algo = [f"{HERE}:Shadowing", *(["d-coach"] if both else [])]
    spec = spec_of(**USUAL, algo=algo, width=width, noise=noise, seeds=1)
    words = {
        name: str(value).strip("[]").replace(" ", "") for name, value in (("width", width), ("noise", noise))
    }
    command = [
        "sweep",
        *(f"--{name}={value}" for name, value in USUAL.items()),
        f"--algo={','.join(algo)}",
        "--seeds=1",
    ]
    for flags in (
        [f"--width={words['width']}", f"--noise={words['noise']}"],
        [f"--set=width={words['width']}", f"--set=noise={words['noise']}"],
    ):
        assert make_spec(settings(parse_words([*command, *flags]))) == spec
    (tmp_path / "own.toml").write_text(f"width = {width}\nnoise = {noise}\n")
    given = read_toml(tmp_path / "own.toml") | settings(parse_words(command))
    assert make_spec(given) == spec
    made = start_of(plan(spec)[0]).learner
    assert isinstance(made.noise, int) and made.width.dtype == float
    assert program_of(plan(spec)[0]).compiled[0] == ("noise", made.noise)


@pytest.mark.parametrize(
    ("algo", "given", "message"),
    [
        ("Shadowing", {"noise": 0.5}, r"noise 0.5: give a whole number"),
        ("Shadowing", {"width": "0.5"}, r"width '0.5': give a finite number"),
        ("Linear", {"width": 0.5}, r"width 0.5: give a whole number from 1 to"),
        ("Linear", {"width": 5}, r"width: with .*Linear alone it changes nothing"),
        ("Linear", {"step_size": "0.5"}, r"step_size '0.5': give a finite number"),
    ],
)
def test_what_is_refused_of_them(algo, given, message):
    with pytest.raises(UserError, match=message):
        spec_of(**USUAL, algo=f"{HERE}:{algo}", **given)
    with pytest.raises(UserError, match=r"--width '0.5': give a whole number from 1 to"):
        make_spec(settings(parse_words(["sweep", "--env=cartpole", "--algo=d-coach", "--width=0.5"])))


def test_what_means_something_else_is_no_name_of_a_setting():
    """Whatever a sweep takes beside the settings of learners and teachers: by flags, in TOML, and in Python."""
    taken = {option.name for option in EXPERIMENT + VARIANTS + OF_CREDIT + RUNNING} | {POINTS, QUICK, "seed"}
    taken |= {name for name in inspect.signature(sweep).parameters if name != "settings"}
    for name in taken:
        with pytest.raises(UserError, match=r"^it is a (setting|column) of every sweep"):
            check_name("it", name)


def test_one_person_teaches_one_learner():
    given = {"env": Given("cartpole", "env"), "algo": Given((f"{HERE}:Shadowing",), "algo")}
    several = Unchecked("0.1,0.2", "--set width", "width", is_word=True)
    with pytest.raises(
        UserError, match="--set width: one person teaches one learner at a time, give one value"
    ):
        Course.of(given | {"width": several})


def needs(obs_size, action_size, step_size=0.5):
    """Differences of neighbours, of which there must be some."""
    if obs_size < 2:
        raise ValueError("no neighbours")
    return Linear(obs_size=obs_size, action_size=action_size, step_size=step_size)


def only_three(obs_size, action_size):
    if obs_size != 3:
        raise ValueError("three sensors, or none")
    return Linear(obs_size=3, action_size=action_size)


def its_own_size(obs_size, action_size):
    return Linear(obs_size=3, action_size=action_size)


def more_than_sizes(obs_size, action_size, budget):
    return Linear(obs_size=obs_size, action_size=action_size)


def test_a_learner_that_needs_other_sizes_than_one():
    """It is seen what it is where it can be made: for some small sizes, or for those of the task."""
    (setting,) = find("learner", f"{HERE}:needs").settings
    assert setting.compiled == "no"
    assert spec_of(env="cartpole", algo=f"{HERE}:needs", seeds=1)
    assert spec_of(env="pendulum", algo=f"{HERE}:only_three", seeds=1)
    with pytest.raises(
        ForeignError, match=r"only_three: it cannot be made \(ValueError: three sensors, or none\)"
    ):
        spec_of(env="mountaincar", algo=f"{HERE}:only_three")
    with pytest.raises(ForeignError, match=r"more_than_sizes: it cannot be made \(TypeError: .*'budget'\)"):
        find("learner", f"{HERE}:more_than_sizes")


def test_a_learner_has_the_sizes_that_were_asked_for():
    with pytest.raises(UserError, match="its_own_size: it makes a learner of obs_size 3 where 4 is needed"):
        gpcjax.make_learner(f"{HERE}:its_own_size", "cartpole")
    with pytest.raises(UserError, match="its_own_size: it makes a learner of obs_size 3 where 4 is needed"):
        spec_of(env="cartpole", algo=f"{HERE}:its_own_size")
    assert spec_of(env="pendulum", algo=f"{HERE}:its_own_size")


class Doubled(Linear):
    def measure(self, state):
        return {"step_size": self.step_size}


@pytest.mark.parametrize(
    ("algo", "settings", "message"),
    [
        (
            "Doubled",
            {"step_size": [0.1, 0.2]},
            r"Doubled.measure: step_size is a setting of this learner that varies",
        ),
        (
            "GAIN",
            {"gain": [1, 2]},
            r"GAIN: what it is made of is another with each run: give its Setting compiled=",
        ),
    ],
)
def test_a_sweep_says_it_as_a_mistake(algo, settings, message, tmp_path, workers_in_process):
    """Of the person's, with status 2: what a worker refuses is no fault of gpcjax."""
    with pytest.raises(UserError, match=message):
        sweep(tmp_path / "out", **USUAL, algo=f"{HERE}:{algo}", seeds=1, episodes=1, **settings)
