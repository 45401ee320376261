"""Settings of a person's own learners and teachers: what of them is compiled in, and which names they may have."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.sweep.plan import plan, program_of
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import spec_of
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
