"""Small real sweeps: a cell's rows are the same bits however they came about."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from gpcjax.engine import streams
from gpcjax.engine.evaluate import evaluate, idle
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.sweep import run as run_module
from gpcjax.sweep.build import start_of
from gpcjax.sweep.executables import Executables
from gpcjax.sweep.executors import InProcess
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_corrections, read_episodes
from gpcjax.sweep.run import sweep
from gpcjax.sweep.spec import spec_of
from tests.golden import CASES, differences, incomparable
from tests.sweep.processes import PATIENCE, ROOT, alive, process, wait_for, workers_of
from tests.sweep.threads import Threads

TWO = CASES["swept"]
"""With dictionaries that do not grow: a program of each learner is enough."""
SETTINGS = TWO | {"algo": ["gpc", "gpc-ns", "coach"]}
COACH = {name: value for name, value in TWO.items() if name not in ("max_capacity", "on_full")}
COACH |= {"algo": "coach"}
KEYS = ["algo", "error", "seed", "episode"]
GOLDEN = {
    "gpc": {
        "steps": [3, 8, 9, 11, 19, 20, 21, 30],
        "rates": [0.220000999998, 0.215964781034, 0.129158048481, 0.202741283929, 0.207988592502, 0.125863793006,
                  0.157742761577, 0.202347188185],
        "length": 69,
    },
    "coach": {
        "steps": [3, 8, 9, 11, 19, 20, 21, 30],
        "rates": [0.076471475611, 0.100004106578, 0.118651539425, 0.126774702896, 0.0952357901785, 0.103461429463,
                  0.101266844561, 0.091238937188],
        "length": 85,
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def two_learners(tmp_path_factory):
    """The sweep in one process, never interrupted; without GPC-NS, whose programs take longest to trace."""
    return sweep(tmp_path_factory.mktemp("two") / "out", jobs=1, **TWO)


@pytest.fixture(scope="module", params=["two", pytest.param("three", marks=pytest.mark.slow)])
def reference(request, tmp_path_factory):
    """That of two learners, and that of all."""
    if request.param == "two":
        return request.getfixturevalue("two_learners")
    return sweep(tmp_path_factory.mktemp("three") / "out", jobs=1, **SETTINGS)


def settings_of(reference: Path) -> dict:
    """What made it."""
    algos = json.loads((reference / "manifest.json").read_text())["specification"]["algo"]
    return SETTINGS | {"algo": list(algos)}


def assert_the_same_rows(got: Path, expected: Path, query: str = "seed >= 0") -> None:
    for read in (read_episodes, read_corrections):
        frame = read(expected).query(query).reset_index(drop=True)
        pd.testing.assert_frame_equal(read(got), frame, check_exact=True)


def kill_and_resume(
    settings: dict, reference: Path, folder: Path, query: str = "seed >= 0", jobs: int = 1
) -> None:
    """kill -9 of a sweep after its first rows.

    No worker outlives it; what is missing runs later, and what was there stays as it was.
    """
    out = folder / "out"
    asked = f"run.sweep({str(out)!r}, jobs=1, **{settings!r})"
    script = f"from gpcjax.sweep import going, run; going.FLUSH_SECONDS = 0.0; {asked}"
    with process(["-c", script], folder) as running:
        wait_for(lambda: list(out.glob("episodes/*.parquet")) or running.poll() is not None)
        workers = workers_of(running.pid)
        running.kill()
        assert running.wait() == -signal.SIGKILL, (folder / "stderr").read_text()
        wait_for(lambda: not any(map(alive, workers)))
    assert len(workers) == 1
    before = {path: path.read_bytes() for path in out.glob("episodes/*.parquet")}
    assert 0 < len(read_episodes(out)) < len(read_episodes(reference).query(query))
    assert not json.loads((out / "manifest.json").read_text())["complete"]
    sweep(out, jobs=jobs, **settings)
    assert_the_same_rows(out, reference, query)
    assert all(path.read_bytes() == content for path, content in before.items())


def test_what_it_holds(reference):
    frame, corrections = read_episodes(reference), read_corrections(reference)
    algos = settings_of(reference)["algo"]
    assert len(frame) == len(algos) * 2 * 2 * 3 and (frame["status"] == "ok").all()
    assert frame[KEYS].values.tolist() == [
        [algo, error, seed, episode]
        for algo in algos
        for error in SETTINGS["error"]
        for seed in (0, 1)
        for episode in (1, 2, 3)
    ]
    # A cart-pole's return is its length.
    assert (frame["return"] == frame["length"]).all() and frame["length"].between(1, 2500).all()
    # The log holds the first 200 corrections: where it holds all of an episode, both tables tell the same.
    logged = corrections.groupby(KEYS)["rate"].agg(["size", "mean"]).reset_index()
    both = frame.merge(logged, on=KEYS, how="left").fillna({"size": 0})
    assert (
        both.groupby(KEYS[:3])["size"].sum() == both.groupby(KEYS[:3])["corrections"].sum().clip(upper=200)
    ).all()
    whole = both[(both["size"] == both["corrections"]) & (both["size"] > 0)]
    assert len(whole) > 2 * len(algos)
    np.testing.assert_allclose(whole["mean_rate"], whole["mean"], rtol=1e-12)


def test_seeds_and_errors_differ(reference):
    for algo, part in read_episodes(reference).groupby("algo"):
        runs = part.groupby(["error", "seed"])[["return", "corrections", "mean_rate"]].agg(tuple)
        assert len(runs.drop_duplicates()) == 4, algo


def test_every_learner_of_a_seed_begins_alike(reference):
    """The idle policy from the same start, hearing the same coins: the first correction comes at the same step."""
    first = read_corrections(reference).groupby(["algo", "error", "seed"]).first()[["episode", "step"]]
    for error in SETTINGS["error"]:
        for algo in settings_of(reference)["algo"]:
            assert first.loc["gpc", error].equals(first.loc[algo, error])


@pytest.mark.slow
def test_against_a_plain_loop(reference):
    """The first episode of a cell of each learner, step by step with itself: its return and its corrections."""
    frame, corrections = read_episodes(reference), read_corrections(reference)
    env, expert = make_env("cartpole"), make_expert("cartpole", "lqr")

    @eqx.filter_jit
    def step(cell, learner, teacher, state, at):
        """Act, and hear what the oracle says (Alg. 4); then the task's next state."""
        action = learner.act(state, at.obs)
        coins = streams.coins(cell.seed, 0, at.time, 1)
        gap = expert(at.obs) - action
        advice = jnp.where(jnp.abs(gap) > cell.delta, jnp.sign(gap), 0.0) * (coins < cell.rate)
        return action, jnp.where(coins < cell.rate * cell.error, -advice, advice), env.step(at, action)

    for cell in plan(spec_of(**settings_of(reference)))[::5]:
        start, rates = start_of(cell), []
        learner = jax.tree.map(jnp.asarray, start.learner)
        state, at = learner.init(), env.reset(streams.start_key(cell.seed, 0))
        while not at.done and len(rates) < 20:
            action, advice, after = step(cell, learner, start.teacher, state, at)
            if advice.any():
                state, info = learner.correct(state, at.obs, action, advice)
                rates.append(info.rate[0])
            at = after
        where = (corrections[["algo", "error", "seed"]] == [cell.algo, cell.error, cell.seed]).all(axis=1)
        logged = corrections[where & (corrections["episode"] == 1)]["rate"]
        np.testing.assert_allclose(logged[: len(rates)], rates, rtol=1e-9)
        assert rates
        if at.done:
            row = frame[(frame[KEYS] == [cell.algo, cell.error, cell.seed, 1]).all(axis=1)]
            assert row["length"].item() == at.time and len(logged) == len(rates)


def test_golden_run(reference):
    """Numbers of one cell of each learner, pinned: they change only if the science or the random streams do.

    Few corrections in, so that the last bits of another processor do not show.
    """
    frame, corrections = read_episodes(reference), read_corrections(reference)
    for algo, golden in GOLDEN.items():
        query = f"algo == '{algo}' and error == 0.2 and seed == 1"
        first = corrections.query(query).head(len(golden["rates"]))
        assert first["step"].tolist() == golden["steps"]
        np.testing.assert_allclose(first["rate"], golden["rates"], rtol=1e-7)
        assert frame.query(query)["length"].iloc[0] == golden["length"]


def test_rows_keep_their_bits(two_learners):
    """Those that tests/golden keeps, to the last: where the machine is of the kind that made them."""
    if other := incomparable(two_learners):
        pytest.skip(f"the kept rows were made with another {other}")
    assert not list(differences(two_learners, "swept"))


def test_the_manifest(reference):
    manifest = json.loads((reference / "manifest.json").read_text())
    assert manifest["complete"] and manifest["cells"] == 4 * len(settings_of(reference)["algo"])
    assert manifest["env_steps"] == read_episodes(reference)["length"].sum()
    assert 0 < manifest["compile_time_s"] < manifest["wall_time_s"]
    env = make_env("cartpole")
    for numbers, policy in (
        (manifest["baselines"]["idle"], idle(env)),
        (manifest["baselines"]["oracles"]["lqr"], make_expert("cartpole", "lqr")),
    ):
        returns = np.asarray(evaluate(env, policy, 100).returns)
        assert numbers == {"mean": returns.mean(), "std": returns.std(ddof=1), "n": 100}


def test_a_second_call_starts_no_worker(two_learners, monkeypatch):
    monkeypatch.setattr(run_module, "Processes", None)
    before = {path: path.stat().st_mtime_ns for path in two_learners.rglob("*")}
    sweep(two_learners, jobs=2, **TWO)
    assert before == {path: path.stat().st_mtime_ns for path in two_learners.rglob("*")}


@pytest.mark.slow
def test_a_cell_alone(two_learners, tmp_path):
    alone = COACH | {"error": 0.2, "seeds": 1}
    assert_the_same_rows(
        sweep(tmp_path / "out", **alone), two_learners, "algo == 'coach' and error == 0.2 and seed == 0"
    )


@pytest.mark.slow
def test_late_advice_is_varied_and_resumed(tmp_path, monkeypatch):
    """A delay is a column like any other setting, though what is compiled differs; the learner reckons with another."""
    settings = COACH | {"error": 0.0, "delay": [0.0, 0.2], "credit": 0.1}
    out = sweep(tmp_path / "out", executor=InProcess(), **settings)
    rows = read_episodes(out)
    assert rows.groupby("delay").size().to_dict() == {0.0: 6, 0.2: 6}
    assert (rows["corrections"] > 0).any()
    steps = read_corrections(out).groupby("delay")["step"].min()
    assert steps[0.2] >= 10 > steps[0.0] >= 5  # steps of 0.02 s; none before is advised, nor learned from
    monkeypatch.setattr(run_module, "Processes", None)
    sweep(out, jobs=1, **settings)


@pytest.mark.slow
def test_a_full_dictionary_ends_the_run_with_a_status(tmp_path):
    settings = SETTINGS | {"algo": "gpc", "error": 0.0, "seeds": 1, "max_capacity": 3, "on_full": "error"}
    out = sweep(tmp_path / "out", executor=InProcess(), **settings)
    frame, corrections = read_episodes(out), read_corrections(out)
    assert (
        len(frame) <= 3 and frame["status"].iloc[-1] == "full" and (frame["status"].iloc[:-1] == "ok").all()
    )
    assert frame["full"].iloc[-1] == corrections["full"].sum() == 1
    assert len(corrections) == frame["corrections"].sum() + 1
    assert frame["human_points"].iloc[-1] == 3


@pytest.mark.slow
def test_killed_and_resumed(two_learners, tmp_path):
    """As test_underway.py has it, of what was saved of runs; and the rows that were there stay."""
    kill_and_resume(TWO, two_learners, tmp_path)


def test_the_rows_of_every_executor_are_the_same_bits(
    two_learners, tmp_path, monkeypatch, compiled_as_shipped
):
    """Those of processes, that of this one, and its threads; and of programs that were kept, also for less episodes."""
    monkeypatch.setattr(Executables, "compiled", None)  # which would be called
    for name, executor, episodes in (("inprocess", InProcess(), 3), ("threads", Threads(2), 2)):
        out = sweep(tmp_path / name, executor=executor, **COACH | {"error": 0.0, "episodes": episodes})
        assert_the_same_rows(out, two_learners, f"algo == 'coach' and error == 0 and episode <= {episodes}")


@pytest.mark.slow
def test_stopped_with_control_c_and_resumed_by_two_in_another_order(two_learners, tmp_path):
    """Ctrl-C goes to the whole group, here while the workers are still starting up."""
    out = tmp_path / "out"
    words = [
        "-m",
        "gpcjax",
        "sweep",
        "--env=cartpole",
        "--algo=coach",
        "--error=0.2,0",
        "--seeds=2",
        "--episodes=3",
    ]
    words += ["--oracle=lqr", "--rate=0.2", f"--out={out}", "--jobs=2"]
    with process(words, tmp_path) as running:
        wait_for(lambda: len(workers_of(running.pid)) == 2 or running.poll() is not None)
        time.sleep(0.6)
        os.killpg(running.pid, signal.SIGINT)
        status = running.wait(PATIENCE)
        said = (tmp_path / "stderr").read_text()
        assert status == 130, said
    assert "Traceback" not in said
    line = said.splitlines()[-1]
    assert line == f"gpcjax: stopped: {out} keeps what is finished, the same command goes on from there"
    assert not list(out.rglob("*.tmp"))
    subprocess.run([sys.executable, *words], cwd=ROOT, check=True, capture_output=True)
    assert_the_same_rows(out, two_learners, "algo == 'coach'")
    assert (out / "report.html").exists() and (out / "summary.csv").exists()
