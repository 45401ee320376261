"""docs/extending.md, as a reader would follow it: its files are written, its commands typed, its loop run."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import pytest

import gpcjax
from gpcjax import cli, registry
from gpcjax.sweep.reading import read_episodes
from gpcjax.teachers.replay import read_advice

PAGE = (Path(__file__).parent.parent / "docs" / "extending.md").read_text()
FILES = dict(re.findall(r"```python file=(\S+)\n(.*?)```", PAGE, re.DOTALL))
COMMANDS = re.findall(r"```sh\n(.*?)\n```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, workers_in_process, figures_unpainted):
    """The files of the page, in the present folder; afterwards nobody knows them any more."""
    folder = tmp_path_factory.mktemp("extending")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path])
        patch.chdir(folder)
        # Nothing of ours: a reader's own arrays are broadcast as jax does it.
        jax.config.update("jax_numpy_rank_promotion", "allow")
        yield folder
    jax.config.update("jax_numpy_rank_promotion", "raise")
    for name in FILES:
        sys.modules.pop(name.removesuffix(".py"), None)
    for kind, name in [key for key in registry._FOUND if key[1] not in registry.built_in(key[0])]:
        del registry._FOUND[kind, name]


def run(folder, *words):
    ours = os.environ | {"PYTHONPATH": str(Path(gpcjax.__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=ours,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_words_are_understood_and_the_last_are_run(folder):
    """Each command with the files that it names; the last in full, in this process."""
    session = gpcjax.Session(
        gpcjax.make_learner(
            "coach", **{"obs_size": 2, "action_size": 1, "lower": -1.0, "upper": 1.0, "counts": (2, 2)}
        ),
        record=folder / "robot.jsonl",
    )
    session.propose([0.1, 0.0])
    session.advise(1)
    for command in COMMANDS:
        program, *words = shlex.split(command)
        assert program == "gpcjax" and cli.main([*words, "--jobs=1", "--dry-run"]) == 0
    (folder / "robot.jsonl").unlink()
    words = shlex.split(COMMANDS[-1])[1:]
    assert cli.main([*words, "--jobs=1"]) == 0
    out = folder / words[words.index("--out") + 1]
    assert (read_episodes(out)["status"] == "ok").all() and (out / "report.html").exists()
    shutil.rmtree(out)


@pytest.mark.slow
def test_the_page(folder):
    """Every file and every command; a session first, whose record a command replays.

    The last command is a process, as a reader's; for the others it is enough that the same words are understood.
    """
    said = run(folder, "robot.py")
    corrections, same = re.fullmatch(r"(\d+) corrections, angle .* rad\n(\w+)\n", said).groups()
    assert int(corrections) > 0 and same == "True"
    for command in COMMANDS:
        program, *words = shlex.split(command)
        assert program == "gpcjax"
        words.append("--jobs=1")
        if command == COMMANDS[-1]:
            run(folder, "-m", "gpcjax", *words)
        else:
            assert cli.main(words) == 0
    outs = {re.search(r"--out runs/(\w+)", command)[1] for command in COMMANDS}
    rows = {out: read_episodes(folder / "runs" / out) for out in outs}
    assert {(frame["status"] == "ok").all() for frame in rows.values()} == {True}
    assert set(rows["linear"]["algo"]) == {"gpc-ns", "mylearner:Linear"}
    assert rows["late"].groupby("delay")["corrections"].sum().gt(0).all()
    # What was said about a step that the sweep's episode has, is learned there; the robot's went on for longer.
    length = rows["replayed"]["length"].item()
    given = (read_advice("robot.jsonl")[0] != 0).any(axis=-1)
    assert rows["replayed"]["corrections"].sum() == given[:length].sum() and given.sum() > 0


def test_no_file_is_long():
    """What is said to be 25 lines and 50 is no more."""
    code = {name: [line for line in text.splitlines() if line.strip()] for name, text in FILES.items()}
    assert len(code["mytask.py"]) <= 25 and len(code["mylearner.py"]) <= 25 and len(code["robot.py"]) <= 50
