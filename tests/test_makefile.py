"""The Makefile with a recorder in the place of .venv: what it refuses, and which words reach the command line."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gpcjax.envs.registry import env_names
from gpcjax.sweep.options import OPTIONS
from gpcjax.sweep.spec import as_dict, spec_of
from tests.called import RECORDER, calls

ROOT = Path(__file__).parents[1]
VARIABLES = (
    "ENV ERR ALGO SEEDS EPISODES TEACHER ORACLE DELTA RATE SET LP LH CREDIT KEEP START OUT JOBS ENGINE ADDRESS SHARD "
    "SPEC ARGS"
).split()


@pytest.fixture
def folder(tmp_path):
    """A project that is set up already, with nothing but the Makefile in it."""
    shutil.copy(ROOT / "Makefile", tmp_path)
    for name in ("requirements.lock", "requirements-docs.lock", "pyproject.toml"):
        (tmp_path / name).touch()
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(RECORDER)
    python.chmod(0o755)
    for made in (".ready", ".browser", ".docs"):
        (tmp_path / ".venv" / made).touch()
    return tmp_path


def make(folder, *words, **environment):
    """Run make, without what an outer make has told us."""
    outer = {"MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES", "GNUMAKEFLAGS"}
    clean = {name: value for name, value in os.environ.items() if name not in outer}
    return subprocess.run(
        ["make", *words], cwd=folder, env=clean | environment, capture_output=True, text=True
    )


def called(folder):
    """The words of each call of .venv's python."""
    return calls(folder / "called")


def test_sweep_is_a_thin_line(folder):
    assert make(folder, "sweep", "ENV=cartpole", "ERR=0,0.1,0.2").returncode == 0
    assert called(folder) == [["-m", "gpcjax", "sweep", "--env=cartpole", "--error=0,0.1,0.2"]]


def test_every_variable_becomes_its_flag(folder):
    given = [f"{name}={name.lower()}" for name in VARIABLES if name not in ("SPEC", "ARGS")]
    assert make(folder, "grid", *given, "SPEC=a.toml", "ARGS=--beta 1,2 --no-sparsify").returncode == 0
    words = called(folder)[0]
    assert words[:4] == ["-m", "gpcjax", "grid", "a.toml"]
    assert words[-3:] == ["--beta", "1,2", "--no-sparsify"]
    flags = dict(word[2:].split("=") for word in words[4:-3])
    assert {"policy-length-scale": "lp", "human-length-scale": "lh", "error": "err"}.items() <= flags.items()
    assert all(name.replace("-", "_") in OPTIONS for name in flags if name != "set")
    assert len(flags) == len(VARIABLES) - 2


def test_other_targets(folder):
    assert make(folder, "report", "OUT=runs/my run").returncode == 0
    assert make(folder, "compare", "ARGS=runs/a 'runs/b c' --by algo", "OUT=c").returncode == 0
    assert (
        make(folder, "study", "SPEC=sweeps/study_thesis.toml", "OUT=runs/s", "ARGS=--places 8").returncode
        == 0
    )
    assert make(folder, "oracles").returncode == 0
    assert make(folder, "oracles", "ENV=pendulum").returncode == 0
    assert make(folder, "test", "ARGS=-k 'two words'").returncode == 0
    assert make(folder, "test-all", "ARGS=-x").returncode == 0
    assert make(folder, "teach", "ENV=pendulum", "CREDIT=0.2", "ARGS=--speed 0.5").returncode == 0
    assert make(folder, "bench-teach").returncode == 0
    assert make(folder, "docs").returncode == 0
    assert called(folder) == [
        ["-m", "gpcjax", "report", "--", "runs/my run"],
        ["-m", "gpcjax", "compare", "--out=c", "runs/a", "runs/b c", "--by", "algo"],
        ["-m", "gpcjax", "study", "sweeps/study_thesis.toml", "--out=runs/s", "--places", "8"],
        ["-m", "gpcjax", "oracles"],
        ["-m", "gpcjax", "oracles", "--env=pendulum"],
        ["-m", "pytest", "-n", "2", "-k", "two words"],
        ["-m", "pytest", "-n", "2", "--all", "-x"],
        ["-m", "gpcjax", "teach", "--env=pendulum", "--credit=0.2", "--speed", "0.5"],
        ["-m", "benchmarks.teaching"],
        ["-m", "mkdocs", "build", "--strict"],
    ]


def test_reproduce(folder):
    assert make(folder, "reproduce").returncode == 0
    assert make(folder, "reproduce", "QUICK=0", "JOBS=2").returncode == 0
    words = "QUICK=1", "ONLY=pendulum,active", "OUT=my runs"
    assert make(folder, "reproduce", *words).returncode == 0
    start = ["-m", "gpcjax", "reproduce"]
    assert called(folder) == [
        start,
        [*start, "--jobs=2"],
        [*start, "--quick", "--only=pendulum,active", "--out=my runs"],
    ]


@pytest.mark.parametrize("value", ["no", "yes", "false", "2", "01", "1 0", "1\n1", "-", "$(shell echo 1)"])
def test_quick_is_one_or_nothing(folder, value):
    shutil.rmtree(folder / ".venv")
    done = make(folder, "reproduce", f"QUICK={value}")
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "give 1, or nothing for all of it" in done.stderr and "QUICK='" in done.stderr
    assert not (folder / ".venv").exists()


def test_quick_of_nothing_is_nothing(folder):
    for words in (["QUICK="], ["QUICK= "], ["QUICK=0"]):
        assert make(folder, "reproduce", *words).returncode == 0
    assert called(folder) == [["-m", "gpcjax", "reproduce"]] * 3


PROGRAMS = [
    "$(shell touch bad)",
    "${shell touch bad}",
    "$(error bad)",
    "$(file >bad)",
    "$(eval $(shell touch bad))",
    "$(info $(shell touch bad))x",
    "$(touch bad)",
    "`touch bad`",
    "a; touch bad",
    "a & touch bad",
    "a | touch bad",
    "a > bad",
    "' touch bad '",
    '"; touch bad; "',
    "a' ; touch bad ; '",
    "#",
    "$HOME",
    "$$",
]
"""Texts that make or a shell would run or fill in; a file named bad shows that one did."""

TELLING = "$(shell touch bad)", "`touch bad`", "a; touch bad", "' touch bad '"
"""One for make, one for the shell, one for each way out of a word."""


@pytest.mark.parametrize("value", ["it's", "a b", "a ", '"', "*", "", "\\", "%s", *PROGRAMS])
def test_a_value_is_one_word_whatever_it_holds(folder, value):
    done = make(folder, "sweep", f"OUT={value}")
    assert (done.returncode, called(folder)) == (0, [["-m", "gpcjax", "sweep", f"--out={value}"]])
    assert not (folder / "bad").exists()


@pytest.mark.parametrize(
    "value",
    [value if value in TELLING else pytest.param(value, marks=pytest.mark.slow) for value in PROGRAMS],
)
def test_no_variable_of_any_target_is_a_program(folder, value):
    """Also with `make -e`, where those of the environment count, and where .venv is still to be made."""
    every = [f"{name}={value}" for name in VARIABLES if name != "ARGS"]
    for target, words in (
        ("sweep", every),
        ("grid", every),
        ("report", [f"OUT={value}"]),
        ("oracles", [f"ENV={value}"]),
        ("reproduce", [f"{name}={value}" for name in ("QUICK", "ONLY", "OUT", "JOBS")]),
        ("help", []),
    ):
        # A program is no switch, and refused as a text.
        assert make(folder, target, *words).returncode == (2 if target == "reproduce" else 0), target
        make(folder, "-e", target, **dict(word.split("=", 1) for word in words))
        make(folder, target, **dict(word.split("=", 1) for word in words))
    (folder / ".venv" / ".ready").unlink()
    make(folder, "report", f"PYTHON={value}")
    assert not (folder / "bad").exists()


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("--beta 1,2 --out 'a b'", ["--beta", "1,2", "--out", "a b"]),
        ('--out "it\'s"  --x', ["--out", "it's", "--x"]),
        ("a\\ b", ["a b"]),
        ("$HOME *", ["$HOME", "*"]),
        ("  ", []),
        ("%s -n", ["%s", "-n"]),
        ("a\ntouch bad", ["a", "touch", "bad"]),
        *(
            pytest.param(value, value.split(), marks=[] if value in TELLING else [pytest.mark.slow])
            for value in PROGRAMS
            if not set(value) & set("'\"")
        ),
    ],
)
def test_args_are_words_by_their_quotes_and_nothing_more(folder, value, words):
    for target, start in (("sweep", ["-m", "gpcjax", "sweep"]), ("test", ["-m", "pytest", "-n", "2"])):
        assert make(folder, target, f"ARGS={value}").returncode == 0
        assert called(folder)[-1] == [*start, *words]
    assert not (folder / "bad").exists()


def test_a_quote_that_never_ends_is_refused(folder):
    done = make(folder, "sweep", "ARGS=--out 'a")
    assert done.returncode == 2 and "quote" in done.stderr
    assert not called(folder)


def test_a_line_break_starts_no_command(folder):
    assert make(folder, "sweep", "OUT=a\ntouch bad").returncode == 0
    assert called(folder) == [["-m", "gpcjax", "sweep", "--out=a touch bad"]]


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["sweep", "EVN=cartpole"], "EVN"),
        (["sweep", "ENV=cartpole", "err=0"], "err"),
        (["EVN=cartpole"], "EVN"),
        (["report", "ERR=0"], "ERR"),
        (["test", "OUT=a"], "OUT"),
        (["sweep", "QUICK=1"], "QUICK"),
        (["reproduce", "SEEDS=3"], "SEEDS"),
        (["lint", "ARGS=a"], "ARGS"),
    ],
)
def test_an_unknown_variable_is_refused_before_anything_is_set_up(folder, words, name):
    shutil.rmtree(folder / ".venv")
    done = make(folder, *words)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert f"'{name}' is no variable of make" in done.stderr
    assert "PYTHON" in done.stderr
    assert not (folder / ".venv").exists()


def test_the_environment_is_not_asked(folder):
    assert (
        make(folder, "sweep", "ENV=cartpole", OUT="a", ERR="1", SPEC="b", ARGS="c", JOBS="3").returncode == 0
    )
    assert called(folder) == [["-m", "gpcjax", "sweep", "--env=cartpole"]]


def test_help_lists_every_target_and_variable(folder):
    listed = make(folder)
    assert listed.stdout == make(folder, "help").stdout
    targets = (
        "help sweep grid report compare reproduce oracles teach bench bench-teach docs test test-all torture"
    )
    for target in [*targets.split(), "lint", "format", "lock", "clean"]:
        assert re.search(rf"^make {target}  +\S", listed.stdout, re.MULTILINE)
    for name in [*VARIABLES, "QUICK", "ONLY", "PYTHON"]:
        assert re.search(rf"^  (\w+, )?{name}\b", listed.stdout, re.MULTILINE)
    assert not called(folder)


def test_help_tells_the_defaults_of_the_command_line():
    text = (ROOT / "Makefile").read_text()
    pairs = [
        pair.split(":") for pair in re.search(r"FLAGS := ((?:.*\\\n)*.*)", text)[1].replace("\\", "").split()
    ]
    assert {variable for variable, _ in pairs} == set(VARIABLES) - {"SPEC", "ARGS"}
    for variable, flag in pairs:
        if flag == "set":
            continue
        option = OPTIONS[flag.replace("-", "_")]
        line = re.search(rf"^#:   (?:\w+, )?{variable}\b.*$", text, re.MULTILINE)[0]
        if option.name in ("episodes", "oracle"):
            told = re.search(r"\((.*)\)", line)[1].replace(", ", "; ").split("; ")
            defaults = dict(reversed(entry.split(" for ")) for entry in told if " for " in entry)
            elsewhere = [entry for entry in told if " for " not in entry]
            for env in env_names():
                value = as_dict(spec_of(env=env))[option.name]
                value = value[0] if isinstance(value, list) else value
                assert [str(value)] == ([defaults[env]] if env in defaults else elsewhere)
        elif option.otherwise:
            assert f"({option.otherwise})" in line
        elif option.default is not None and variable != "ALGO":
            value = option.default[0] if isinstance(option.default, tuple) else option.default
            assert f"({str(value).removesuffix('.0')})" in line


def fake_python(folder, code):
    """A python3 for PYTHON= that prints how it was called, after `code`."""
    path = folder / "python"
    path.write_text(f'#!/bin/sh\n{code}\necho "python $*"\n')
    path.chmod(0o755)
    return f"PYTHON={path}"


def test_an_old_python_or_one_without_venv_is_refused_in_one_sentence(folder):
    shutil.rmtree(folder / ".venv")
    done = make(
        folder, "sweep", "ENV=cartpole", fake_python(folder, "echo No module named ensurepip >&2; exit 1")
    )
    assert done.returncode == 2
    assert done.stderr.startswith("gpcjax needs Python 3.11 or newer with venv and pip")
    assert "No module" not in done.stderr


@pytest.mark.parametrize("words", [("sweep", "ENV=foo"), ("reproduce", "ONLY=foo")], ids=" ".join)
def test_a_mistake_is_told_before_the_setting_up(folder, words):
    shutil.rmtree(folder / ".venv")
    done = make(folder, *words, fake_python(folder, 'case "$*" in *--dry-run*) exit 2;; esac'))
    assert done.returncode == 2
    assert "setting up" not in done.stdout
    assert not (folder / ".venv").exists()


BARE = f'exec {sys.executable} -S "$@"'
"""A Python of 3.11 or newer in which nothing is installed; of a command only what checks it."""


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(words, id=" ".join(words), marks=marks)
        for marks, *words in (
            ((), "sweep", "ENV=mytask:Drift", "ORACLE=mytask:expert"),
            (pytest.mark.slow, "sweep", "ENV=cartpole", "ORACLE=mytask:expert"),
            ((), "sweep", "ENV=gym:Pendulum-v1"),
            (pytest.mark.slow, "sweep", "ENV=brax:reacher"),
            (pytest.mark.slow, "sweep", "ENV=cartpole", "ALGO=mylearner:Linear"),
            ((), "sweep", "ENV=cartpole", "TEACHER=replay:a.jsonl"),
            ((), "sweep", "ENV=cartpole", "ENGINE=ray"),
            (pytest.mark.slow, "sweep", "SPEC=own.toml"),
            (pytest.mark.slow, "grid", "ENV=mytask:Drift", "LP=0.1,0.2"),
            ((), "tune", "ENV=cartpole", "ARGS=--search policy-length-scale=0.1:1"),
        )
    ],
)
def test_what_needs_a_module_is_no_mistake_before_the_setting_up(folder, words):
    """With a Python that has nothing: the check says that it looks later, and the setting up begins."""
    shutil.rmtree(folder / ".venv")
    (folder / "own.toml").write_text('env = "mytask:Drift"\n')
    (folder / "mytask.py").write_text("import gpcjax\n\n\nclass Drift(gpcjax.Env):\n    pass\n")
    python = fake_python(folder, f'case "$*" in *--dry-run*) {BARE};; *"-m venv"*) echo began; exit 3;; esac')
    done = make(folder, *words, python, PYTHONPATH=str(ROOT))
    assert "setting up .venv" in done.stdout and "began" in done.stdout, done.stderr
    told = "gpcjax: what this names is looked at once gpcjax is set up (No module named "
    assert told in done.stderr and "Traceback" not in done.stderr


def test_a_mistake_that_needs_no_module_is_told_by_such_a_python(folder):
    shutil.rmtree(folder / ".venv")
    python = fake_python(folder, f'case "$*" in *--dry-run*) {BARE};; esac')
    done = make(folder, "sweep", "ENV=cartpole", "ERR=2", python, PYTHONPATH=str(ROOT))
    assert done.returncode == 2 and "--error 2" in done.stderr and "setting up" not in done.stdout


@pytest.mark.parametrize("change", ["nothing", "requirements.lock", "pyproject.toml", ".venv/bin/python"])
def test_what_sets_up_again(folder, change):
    assert make(folder, "sweep").returncode == 0
    if change == ".venv/bin/python":
        (folder / change).unlink()
    elif change != "nothing":
        os.utime(folder / change, (2**31, 2**31))
    done = make(folder, "-n", "sweep")
    assert ("setting up" in done.stdout) == (change != "nothing")


@pytest.mark.parametrize("name", ["requirements.lock", "requirements-docs.lock"])
def test_set_up_needs_no_index_address(name):
    lock = (ROOT / name).read_text()
    assert lock.startswith("# This file was autogenerated by uv via the following command:\n#    make lock\n")
    assert not re.search(r"https?:|file:|--index|--find-links|--extra", lock)
    pins = re.findall(r"^[\w.-]+==\S+.*\\$", lock, re.MULTILINE)
    assert len(pins) > 30
    assert lock.count("--hash=sha256:") >= len(pins)
