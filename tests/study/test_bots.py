"""How scripted participants behave, without a server."""

import subprocess
import sys
from random import Random

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from benchmarks.advice import fall_of, falls, spreads
from gpcjax.errors import UserError
from gpcjax.study.bots import crowd
from gpcjax.study.bots.behaviour import KINDS, SILENT, Kind, Teacher, kind_of
from gpcjax.study.bots.experts import expert_of
from gpcjax.study.bots.place import Outcome

STEP = 0.02


def advices(kind, seed, steps=30_000, expert=lambda obs: [1.0], action=0.0, episode=0):
    """All that a teacher says in a run of an episode, as (step, advice)."""
    teacher = Teacher(kind, Random(seed), expert)
    frame = {"episode": episode, "obs": [0.0], "action": [action]}
    said = []
    for n in range(steps):
        teacher.looks_away(n * STEP)
        advice = teacher.sees({**frame, "n": n}, n * STEP)
        if advice is not None:
            said.append((n, advice))
    return teacher, said


def test_the_same_seed_teaches_the_same_and_others_otherwise():
    kind = KINDS[0]
    assert advices(kind, "a")[1] == advices(kind, "a")[1] != advices(kind, "b")[1]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_key_is_down_as_long_as_the_fitted_rate_says(seed):
    teacher, said = advices(Kind("always", 1.0, attends=1e9, wrong=0.0, reaction=0.1), seed)
    down = sum(advice.hold for _, advice in said) / (30_000 * STEP)
    assert down == pytest.approx(teacher.rate(0), rel=0.15)
    assert {advice.h for _, advice in said} == {1}


def test_it_is_silent_near_the_experts_action_and_late_in_a_run():
    kind = Kind("always", 1.0)
    assert advices(kind, 1, expert=lambda obs: [SILENT - 0.01])[1] == []
    assert advices(kind, 1, 2000, expert=lambda obs: [SILENT + 0.01])[1]
    assert advices(kind, 1, 2000, episode=100_000)[1] == []


def test_wrong_keys_late_ones_and_looking_away():
    _, said = advices(Kind("always", 1.0, wrong=0.2, reaction=0.7), 5)
    assert np.mean([advice.h < 0 for _, advice in said]) == pytest.approx(0.2, abs=0.07)
    assert np.mean([advice.wait for _, advice in said]) == pytest.approx(0.7, rel=0.15)
    _, fewer = advices(Kind("away", 1.0, attends=1.0, away=9.0), 5)
    assert 0 < len(fewer) < len(said) / 3
    teacher = Teacher(Kind("hides", 1.0, attends=1.0, away=2.0, hides=1.0), Random(1), lambda obs: [1.0])
    hidden = [each for n in range(30_000) if (each := teacher.looks_away(n * STEP)) is not None]
    assert np.mean(hidden) == pytest.approx(2.0, rel=0.25)


def test_the_shares_of_kinds_are_met():
    for seed in (0, 3):
        names = [kind_of(number, seed).name for number in range(1, 65)]
        assert [names.count(kind.name) for kind in KINDS] == pytest.approx(
            [64 * kind.share for kind in KINDS], abs=1
        )


@pytest.mark.parametrize("task", ["cartpole", "pendulum", "mountaincar", "lunarlander"])
def test_plain_experts_are_those_of_the_tasks(task):
    from gpcjax.envs.registry import make_env, make_expert

    names = {"pendulum": "energy", "mountaincar": "pump", "lunarlander": "heuristic", "cartpole": "gpc"}
    known, plain = make_expert(task, names[task]), expert_of(task)
    size, given = make_env(task).obs_size, jnp.asarray if task != "cartpole" else np.asarray
    for obs in np.random.default_rng(0).normal(0, 0.5, (20, size)):
        if task == "lunarlander":
            obs[6:] = obs[6:] > 0.4
        assert plain(obs.tolist()) == pytest.approx(np.asarray(known(given(obs))).tolist(), abs=1e-9)


def test_bots_load_no_jax():
    code = (
        "import sys, gpcjax.study.bots.crowd; from gpcjax.study.bots.experts import expert_of\n"
        "for task in ('cartpole', 'pendulum', 'mountaincar', 'lunarlander'): expert_of(task)\n"
        "assert 'jax' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


# --- what their numbers are fitted by


def test_the_fit_finds_the_curve_that_made_the_rates():
    episodes = np.arange(1, 201)
    rates = 0.6 / (1 + np.exp((episodes - 30) / 4))
    assert fall_of(rates) == pytest.approx((0.6, 30.0, 4.0), rel=1e-3)
    table = pd.DataFrame(
        {
            "task": "t",
            "algorithm": "a",
            "person": "P",
            "run": run,
            "episode": episodes,
            "advice_rate": scale * rates,
        }
        for run, scale in ((1, 0.5), (2, 1.0))
    ).explode(["episode", "advice_rate"])
    table = table.astype({"episode": int, "advice_rate": float}).sample(frac=1, random_state=0)
    assert [each.level for each in falls(table)] == pytest.approx([0.3, 0.6], rel=1e-3)
    assert spreads(falls(table))["level"] == pytest.approx((0.45, 0.3 / np.sqrt(2)), rel=1e-3)


# --- words


@pytest.mark.parametrize("address", ["runs/x", "ftp://a", "http://", "127.0.0.1:8765"])
def test_an_address_that_is_none(address):
    with pytest.raises(UserError, match="give the participants' address"):
        crowd.rehearse(address, 1)


def test_nobody_answers():
    with pytest.raises(UserError, match="no study answers there"):
        crowd.rehearse("http://127.0.0.1:1/", 1)


def test_the_table_of_outcomes():
    done = [Outcome("a", "late", "complete", runs=2, presses=5, learned=4)] * 2
    refused = Outcome("b", "attentive", "refused", "All places are taken.")
    lines = crowd.table([*done, refused]).splitlines()
    assert lines[1].split() == ["late", "complete", "2", "4", "10", "8"]
    assert lines[-1] == "b: refused: All places are taken."
