"""Scripted participants go the whole way of a real study: consent, trial, runs, questions, code, report."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import pandas as pd
import pytest

from gpcjax.study.bots import behaviour, crowd
from gpcjax.study.bots.behaviour import KINDS, Kind
from gpcjax.study.hall import Hall
from gpcjax.study.register import Register
from gpcjax.study.report.run import draw
from gpcjax.study.server import Serving
from gpcjax.teach.taught import Taught
from tests.study.example import study_with

TINY = """
title = "Tiny"
participants = 2
tasks = ["cartpole"]

[[learners]]
algo = "coach"
name = "one"

[[learners]]
algo = "coach"
name = "two"
magnitude = 0.3

[runs]
dummy = 0
recorded = 1
episodes = 4
minutes = 0.03
rest = 0

[consent]
text = "You may leave at any time."

[instructions]
text = "Press a key."

[trial]
task = "cartpole"
presses = 1
attempts = 9
minutes = 0.1

[[questions]]
name = "easy"
when = "learner"
kind = "scale"
text = "How easy was it?"

[[questions]]
name = "preferred"
kind = "choice"
text = "Which one?"
options = ["A", "B", "no difference"]

[completed]
text = "Done."
code = "C0FFEE"
"""
LONG = 60.0


def runs_of(out):
    return sorted(path.parent for path in out.glob("participants/*/runs/*/course.json"))


@contextlib.contextmanager
def served(out, study, places=4):
    """A study with a hall that teaches, in this process; gives the address."""
    told = []
    hall = Hall(study.every_course(), places, told.append)
    serving = Serving(Register(out, study), hall, places, "127.0.0.1", 0, None)
    hall.start()
    thread = threading.Thread(target=serving.run, daemon=True)
    thread.start()
    try:
        yield serving.address
    finally:
        serving.server.should_exit = True
        thread.join(LONG)
        hall.close()
    assert not thread.is_alive() and told == []


@pytest.mark.slow
def test_from_consent_to_the_figures(tmp_path, monkeypatch):
    monkeypatch.setattr(behaviour, "LEVEL", (0.9, 0.0))
    out, study = study_with(tmp_path, text=TINY)
    kinds = (Kind("quick", 1.0, reaction=0.05, wrong=0.0),)
    with served(out, study) as address:
        outcomes = crowd.rehearse(address, 3, reading=0.1, kinds=kinds)
    complete, (refused,) = (
        [each for each in outcomes if (each.ended == end)] for end in ("complete", "refused")
    )
    assert len(complete) == 2 and {each.completion for each in complete} == {"C0FFEE"}
    assert all(each.runs == 2 and each.learned for each in complete) and "All places" in refused.text
    draw(out, pytest.fail)
    runs = pd.read_parquet(out / "analysis" / "runs.parquet")
    assert len(runs) == 4 and runs["complete"].all() and runs["corrections"].sum() > 0
    assert len(pd.read_parquet(out / "analysis" / "answers.parquet")) == 2 * 3
    assert (out / "analysis" / "figures" / "curves.png").stat().st_size > 5000
    for folder in runs_of(out):
        Taught.resume(folder, lambda line: None, whole=True)  # raises where it comes to something else


@pytest.mark.slow
def test_all_sorts_of_participants_and_a_server_that_is_killed(tmp_path):
    """Late, inattentive and giving up ones; kill -9 in the middle; what was done is there, and replays to the bit."""
    text = TINY.replace("participants = 2", "participants = 10")
    text = text.replace('algo = "coach"\nname = "one"', 'algo = "gpc"\nname = "one"').replace(
        "dummy = 0", "dummy = 1"
    )
    spec, out = tmp_path / "tiny.toml", tmp_path / "out"
    spec.write_text(text.replace("minutes = 0.03", "minutes = 0.2"))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [
        sys.executable,
        "-u",
        "-m",
        "gpcjax",
        "study",
        str(spec),
        "--out",
        str(out),
        "--port",
        str(port),
    ]

    def begin():
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        assert any(line.startswith("participants:") for line in process.stdout)
        return process

    server, outcomes = begin(), []
    kinds = (*KINDS[:3], Kind("comes back", 0.2, gives_up=1.0, returns=1.0), Kind("goes", 0.2, gives_up=1.0))
    going = threading.Thread(
        target=lambda: outcomes.extend(
            crowd.rehearse(f"http://127.0.0.1:{port}/", 8, 1, reading=0.3, kinds=kinds)
        )
    )
    try:
        going.start()
        end = time.monotonic() + LONG
        while len(runs_of(out)) < 12:
            assert time.monotonic() < end
            time.sleep(0.1)
        os.kill(server.pid, signal.SIGKILL)
        server.communicate()
        server = begin()
        going.join(2 * LONG)
        assert not going.is_alive()
    finally:
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=LONG)
    ends = {each.kind: set() for each in outcomes}
    for each in outcomes:
        ends[each.kind].add(each.ended)
    assert ends.pop("goes") <= {"gave up", "declined"}
    assert set.union(*ends.values()) == {"complete"}, outcomes
    assert all(each.connections >= 2 for each in outcomes if each.kind == "comes back")
    code = "import sys; from pathlib import Path; from gpcjax.teach.run import replay\n"
    code += "for folder in sys.argv[1:]: replay(Path(folder))"  # in a process like the study's own, not one of tests
    said = subprocess.run(
        [sys.executable, "-c", code, *map(str, runs_of(out))], capture_output=True, text=True, timeout=LONG
    )
    assert said.returncode == 0, said.stderr
    assert said.stdout.count("the same to the bit") == len(runs_of(out)) >= 12
    draw(out, pytest.fail)
    cards = [json.loads(path.read_bytes()) for path in out.glob("participants/*/participant.json")]
    people = pd.read_parquet(out / "analysis" / "participants.parquet")
    assert people["state"].tolist() == [
        each["state"] for each in sorted(cards, key=lambda card: card["number"])
    ]
    assert people["came_back"].sum() >= 8
