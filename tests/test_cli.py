"""The command line up to the point where something would compile; the engine is replaced by a recorder."""

import argparse
import errno
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

import gpcjax
from gpcjax import cli
from gpcjax.cli import running
from gpcjax.cli import words as grammar
from gpcjax.report import files
from gpcjax.report.live import Live
from gpcjax.sweep.jsonlines import JsonLines
from gpcjax.sweep.keeping import Keeping
from gpcjax.sweep.plan import specification_hash
from gpcjax.sweep.spec import spec_of
from tests.sweep.folders import begun


@pytest.fixture(autouse=True)
def calls(monkeypatch, tmp_path):
    """What the commands called, in a folder of their own. `fails` is raised by the run."""
    monkeypatch.chdir(tmp_path)
    record = SimpleNamespace(run=[], drawn=[], built=[], fails=None)

    def run(spec, out, jobs, **options):
        record.run.append((spec, out, jobs))
        record.options = options
        if record.fails:
            raise record.fails
        begun(out, spec)
        (out / "episodes").mkdir(exist_ok=True)
        (out / "episodes" / "0.parquet").touch()

    monkeypatch.setitem(sys.modules, "gpcjax.sweep.run", SimpleNamespace(run=run))

    def draw(out, anew=True):
        record.drawn.append(out)
        frame = pd.DataFrame({"algo": ["gpc"], "area": [1.5]})
        return SimpleNamespace(files=(out / "summary.csv", out / "report.html"), table=lambda: frame)

    monkeypatch.setitem(sys.modules, "gpcjax.report.run", SimpleNamespace(draw=draw))
    monkeypatch.setitem(
        sys.modules, "gpcjax.report.terminal", SimpleNamespace(render=lambda summary: "the table")
    )
    monkeypatch.setattr("gpcjax.sweep.executors.run_alone", lambda *words: record.built.append(words) or 0)
    return record


def fails(capsys, *words):
    """The one line that `gpcjax WORDS` complains with."""
    capsys.readouterr()
    assert cli.main(words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("gpcjax: error: ")
    assert printed.err.endswith("\n")
    assert len(printed.err.splitlines()) == 1
    return printed.err


def test_the_main_job(calls):
    words = "sweep --env cartpole --algo gpc,gpc-ns,coach --error 0,0.1,0.2 --seeds 100 --episodes 30"
    words += " --oracle gpc --delta 0.05 --rate 0.05 --out runs/here --jobs 1"
    assert cli.main(words.split()) == 0
    assert calls.run == [(spec_of(env="cartpole", error=[0, 0.1, 0.2]), Path("runs/here"), 1)]
    assert calls.drawn == [Path("runs/here")]


def test_defaults(calls):
    assert cli.main(["sweep", "--env", "pendulum"]) == 0
    spec = spec_of(env="pendulum")
    assert calls.run == [(spec, Path("runs", f"pendulum-{specification_hash(spec)}"), cli.usable_cores())]
    assert cli.usable_cores() >= 1


def test_a_finished_sweep_is_called_again(calls):
    words = ["sweep", "--env", "cartpole", "--seeds", "2"]
    assert [cli.main(words), cli.main(words)] == [0, 0]
    assert calls.run[0] == calls.run[1]


def test_flags_win_over_toml(calls):
    Path("a.toml").write_text('env = "cartpole"\nerror = [0, 0.1]\nseeds = 5\nout = "kept"\njobs = 2\n')
    for words in (["a.toml", "--seeds", "20", "--no-sparsify"], ["--seeds", "20", "--no-sparsify", "a.toml"]):
        assert cli.main(["sweep", *words]) == 0
    spec = spec_of(env="cartpole", error=[0, 0.1], seeds=20, sparsify=False)
    assert calls.run == [(spec, Path("kept"), 2)] * 2


def test_every_option_is_a_flag(calls):
    words = "sweep --env cartpole --on-full drop --max-capacity 64 --policy-length-scale 0.1,0.2 --policy-variance 1"
    words += (
        " --policy-nu 0.5,2.5 --human-length-scale 0.3 --human-variance 0.4 --constant-rate 0 --noise 1e-6"
    )
    words += " --active-gain 1 --beta 10 --magnitude 2 --coach-constant 1 --sparsify --seeds 1"
    assert cli.main(words.split()) == 0
    assert calls.run[0][0] == spec_of(
        env="cartpole",
        on_full="drop",
        max_capacity=64,
        policy_length_scale=[0.1, 0.2],
        policy_variance=1,
        policy_nu=[0.5, 2.5],
        human_length_scale=0.3,
        human_variance=0.4,
        constant_rate=0,
        noise=1e-6,
        active_gain=1,
        beta=10,
        magnitude=2,
        coach_constant=1,
        seeds=1,
    )


@pytest.mark.parametrize("empty", ["", " "])
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["report", "{}"], "OUT {!r}: an empty value, give the run folder"),
        (["report", "--", "{}"], "OUT {!r}: an empty value, give the run folder"),
        (["sweep", "{}"], "TOML {!r}: an empty value, give a file"),
        (["sweep", "--env=cartpole", "--out", "{}"], "--out {!r}: an empty value, give the path of a folder"),
        (["sweep", "--env={}"], "--env {!r}: an empty value, give cartpole"),
        (["reproduce", "--sweeps={}"], "--sweeps {!r}: an empty value, give the path of a folder"),
        (["reproduce", "--out={}"], "--out {!r}: an empty value, give the path of a folder"),
        (["reproduce", "--only={}"], "--only {!r}: an empty value, give illustrations"),
        (["reproduce", "--jobs={}"], "--jobs {!r}: an empty value, give a whole number"),
        (["oracles", "--env={}"], "--env {!r}: an empty value, give cartpole"),
    ],
    ids=str,
)
def test_an_empty_word_is_no_value(calls, capsys, words, message, empty):
    assert message.format(empty) in fails(capsys, *(word.format(empty) for word in words))
    assert not calls.run and not calls.drawn and not os.listdir()


def test_a_reproduction_goes_into_no_sweeps_folder(calls, capsys):
    assert cli.main(["sweep", "--env=cartpole", "--out=one"]) == 0
    assert "one: this is the run folder of a sweep" in fails(capsys, "reproduce", "--out=one", "--dry-run")
    Path("one/manifest.json").unlink()
    assert "one: this is the run folder of a sweep" in fails(capsys, "reproduce", "--out=one", "--dry-run")


def test_grid(calls, capsys):
    assert cli.main("grid --env cartpole --policy-length-scale 0.1,0.2".split()) == 0
    assert calls.run[0][0] == spec_of(env="cartpole", algo="gpc", policy_length_scale=[0.1, 0.2])
    Path("a.toml").write_text('env = "cartpole"\nalgo = ["gpc", "gpc-ns"]\n')
    assert cli.main("grid a.toml --noise 1e-7,1e-6".split()) == 0
    assert calls.run[1][0].algo == ("gpc", "gpc-ns")
    assert "no hyperparameter is a list: give one" in fails(
        capsys, "grid", "--env", "cartpole", "--noise", "1"
    )
    assert "--beta: with gpc alone it changes nothing" in fails(
        capsys, *"grid --env cartpole --beta 1,2".split()
    )


def test_dry_run_writes_nothing(calls, capsys):
    assert cli.main("sweep --env cartpole --seeds 3 --out new --jobs 1 --dry-run".split()) == 0
    assert capsys.readouterr().out == "9 cells of cartpole, 30 episodes each, in 1 processes, into new\n"
    assert not calls.run
    assert not list(Path.cwd().iterdir())


def test_report_and_oracles(calls, capsys):
    cli.main("sweep --env cartpole --out here".split())
    assert cli.main(["report", "here"]) == 0
    assert capsys.readouterr().out == "the table\nhere: summary.csv, report.html\n" * 2
    assert calls.drawn == [Path("here")] * 2
    assert cli.main(["oracles"]) == 0
    assert cli.main(["oracles", "--env", "pendulum,pendulum"]) == 0
    module = "gpcjax.sweep.oracles"
    assert calls.built == [
        (module, "cartpole", "pendulum", "lunarlander", "mountaincar"),
        (module, "pendulum"),
    ]


@pytest.mark.parametrize("words", [["--version"], ["version"]])
def test_version(words, capsys):
    try:
        assert cli.main(words) == 0
    except SystemExit as stop:
        assert stop.code == 0
    assert capsys.readouterr().out == f"gpcjax {gpcjax.__version__}\n"


@pytest.mark.parametrize(
    "words", [[], ["sweep"], ["grid"], ["report"], ["compare"], ["oracles"], ["reproduce"], ["version"]]
)
def test_help(words, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main([*words, "--help"])
    assert stop.value.code == 0
    assert "usage: gpcjax" in capsys.readouterr().out


def test_nothing_prints_the_help(capsys):
    assert cli.main([]) == 2
    assert "usage: gpcjax" in capsys.readouterr().err


ENVS = "cartpole, pendulum, lunarlander, mountaincar, module:NAME, gym:ID or brax:NAME"

BAD = [
    (
        "--env foo",
        f"--env 'foo': give {ENVS}",
    ),
    (
        "--env cartpol",
        f"--env 'cartpol': give {ENVS} (did you mean cartpole?)",
    ),
    (
        "--env=",
        f"--env '': an empty value, give {ENVS}",
    ),
    ("", f"no env: give {ENVS}"),
    ("--env cartpole --algo gcp", "--algo 'gcp': give gpc, gpc-ns, coach, d-coach or module:NAME"),
    ("--env cartpole --error 1.5", "--error 1.5: give a number from 0 to 1"),
    ("--env cartpole --error 0,nan", "--error nan: give a number from 0 to 1"),
    ("--env cartpole --error -inf", "--error -inf: give a number from 0 to 1"),
    ("--env cartpole --error -0.1,0.2", "--error -0.1: give a number from 0 to 1"),
    ("--env cartpole --error abc", "--error 'abc': give a number from 0 to 1"),
    ("--env cartpole --error 0,,1", "--error '0,,1': an empty value, give a number from 0 to 1"),
    ("--env cartpole --seeds 0", "--seeds 0: give a whole number from 1"),
    ("--env cartpole --seeds 2.5", "--seeds '2.5': give a whole number from 1"),
    ("--env cartpole --episodes -3", "--episodes -3: give a whole number from 1"),
    ("--env cartpole --jobs 0", "--jobs 0: give a whole number from 1 to 1,024"),
    (
        "--env cartpole --oracle energy",
        "--oracle 'energy': give gpc, gpc-2, gpc-3, lqr, network, mpc, the folder of a saved policy or module:function "
        "for cartpole",
    ),
    ("--env cartpole --beta 0", "--beta 0: give a number above 0"),
    ("--env cartpole --algo gpc --beta 3", "--beta: with gpc alone it changes nothing, give it with coach"),
    ("--env cartpole --seeds 1000000", "3,000,000 cells: give fewer seeds or values"),
    (
        "--env cartpole --erorr 0",
        "'--erorr' is no flag (did you mean --error?): give --env, --algo, --teacher, --error",
    ),
    ("--env cartpole --err 0", "'--err' is no flag"),
    ("--env cartpole --seeds", "--seeds has no value: give a whole number from 1"),
    ("--env cartpole --seeds --jobs 2", "--seeds has no value: give a whole number from 1"),
    ("--env cartpole a.toml b.toml", "'b.toml' is one value too many"),
    ("--env cartpole --credit-shape 3", "--credit-shape: without credit it changes nothing, give both"),
    ("--env cartpole --delay 0,0.2 --delay-longest 0.1", "--delay-longest 0.1: give at least --delay, 0.2"),
    ("none.toml", "none.toml: cannot be read (No such file or directory)"),
    (".", ".: cannot be read (Is a directory)"),
    ("a\0b", "a\\x00b: "),
    ("--env cart\npole", "--env 'cart\\npole': give cartpole"),
    ("--env \udcff", "--env '\\udcff': give cartpole"),
    ("--env cartpole --out a\nb\0", "a\\nb\\x00: no folder can be there"),
]


@pytest.mark.parametrize(("words", "message"), BAD, ids=[message for _, message in BAD])
def test_a_mistake_is_one_line(words, message, calls, capsys):
    line = fails(capsys, "sweep", *words.split(" ")) if words else fails(capsys, "sweep")
    assert line.startswith(f"gpcjax: error: {message}")
    assert not calls.run
    assert not list(Path.cwd().iterdir())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--", "COMMAND is missing: see gpcjax --help"),
        ("swep", "'swep' is no command (did you mean sweep?): give sweep, grid, tune, report"),
        ("report", "OUT is missing: see gpcjax report --help"),
        ("report none", "none: no such folder, give a folder that a sweep has made"),
        ("report .", "manifest.json: cannot be read (No such file or directory)"),
        ("report a b", "'b' is one value too many: see gpcjax report --help"),
        ("report --out a", "'--out' is no flag: give --json, --help"),
        ("compare", "FOLDER is missing: see gpcjax compare --help"),
        ("compare none other", "none: no such folder, give a folder that a sweep has made"),
        ("compare a --by", "--by has no value: give names of settings"),
        ("compare a --by x --by y", "--by is given twice: give it once"),
        (
            "oracles --env foo",
            f"--env 'foo': give {ENVS}",
        ),
        (
            "reproduce --only foo",
            "--only 'foo': give illustrations, pendulum, cartpole, active, oracles, lander",
        ),
        (
            "reproduce --only pendulm",
            "--only 'pendulm': give illustrations, pendulum, cartpole, active, oracles",
        ),
        ("reproduce --only=", "--only '': an empty value, give illustrations, pendulum"),
        ("reproduce --only", "--only has no value: give illustrations, pendulum"),
        ("reproduce --jobs 0", "--jobs 0: give a whole number from 1 to 1,024"),
        ("reproduce --seeds 3", "'--seeds' is no flag"),
        ("reproduce --sweeps none", "none/fig5_1_pendulum.toml: cannot be read (No such file or directory)"),
        ("reproduce a", "'a' is one value too many: see gpcjax reproduce --help"),
        ("oracles --evn foo", "'--evn' is no flag (did you mean --env?): give --env, --help"),
        ("--foo", "COMMAND is missing: see gpcjax --help"),
    ],
)
def test_a_mistake_with_another_command_is_one_line(words, message, calls, capsys):
    assert fails(capsys, *words.split()).startswith(f"gpcjax: error: {message}")
    assert not calls.drawn
    assert not calls.built


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("env = cartpole", "a.toml: this is not TOML: Invalid value (at line 1, column 7)"),
        (
            'env = "cartpole"\nseeds = 3\nseeds = 4\n',
            "a.toml: this is not TOML: Cannot overwrite a value (at line 3",
        ),
        (
            'env = "cartpole"\nerorr = 0',
            "a.toml: 'erorr' is no setting (did you mean error?): give env, algo, teacher, error",
        ),
        ('env = "cartpole"\nerror = [0, 1.5]', "a.toml: error 1.5: give a number from 0 to 1"),
        ('env = "cartpole"\nseeds = "3"', "a.toml: seeds '3': give a whole number from 1"),
        ('env = "cartpole"\nepisodes = nan', "a.toml: episodes nan: give a whole number"),
        ('env = "cartpole"\nalgo = []', "a.toml: algo []: the list is empty"),
        ('env = "cartpole"\nsparsify = 1', "a.toml: sparsify 1: give true or false"),
        (
            'env = "pendulum"\noracle = "lqr"',
            "a.toml: oracle 'lqr': give gpc, energy, network, mpc, the folder of a saved policy or "
            "module:function for pendulum",
        ),
        ('[sweep]\nenv = "pendulum"', "a.toml: 'sweep' is no setting"),
        (
            "[env]\na = 1",
            f"a.toml: env {{'a': 1}}: give {ENVS}",
        ),
        ("\udcff", "a.toml: this is not a text file in UTF-8"),
    ],
)
def test_a_mistake_in_toml_names_file_and_key(text, message, calls, capsys):
    Path("a.toml").write_bytes(text.encode(errors="surrogateescape"))
    assert fails(capsys, "sweep", "a.toml").startswith(f"gpcjax: error: {message}")
    assert not calls.run


def test_an_unusable_folder_is_refused_before_anything_runs(calls, capsys):
    Path("file").touch()
    for out, message in (
        ("file", "this is no folder"),
        ("file/below", "Not a directory"),
        (".", "it holds 'file'"),
    ):
        assert f"{out}: " in (line := fails(capsys, *f"sweep --env cartpole --out {out}".split()))
        assert message in line
    if Path("/proc/self").is_dir():  # where not even root can write
        assert "/proc/x: nothing can be written there" in fails(
            capsys, *"sweep --env cartpole --out /proc/x".split()
        )
    assert not calls.run


def test_the_folder_of_another_sweep_is_refused(calls, capsys):
    assert cli.main("sweep --env cartpole --out here".split()) == 0
    line = fails(capsys, *"sweep --env cartpole --out here --episodes 4".split())
    assert "here: it holds another specification (episodes 30, not 4): a folder grows by" in line
    Path("here/manifest.json").write_text("{")
    assert "here/manifest.json: cannot be read" in fails(capsys, *"sweep --env cartpole --out here".split())
    assert len(calls.run) == 1


def test_a_sweep_has_its_folder_until_its_report_is_written(calls, capsys, monkeypatch):
    """Whoever asks meanwhile, also from another thread, is refused in one line."""
    lines = []

    def draw(out, anew=True):
        with ThreadPoolExecutor() as pool:
            lines.append(pool.submit(fails, capsys, *"sweep --env cartpole --out here".split()).result())
        return SimpleNamespace(files=())

    monkeypatch.setitem(sys.modules, "gpcjax.report.run", SimpleNamespace(draw=draw))
    assert cli.main("sweep --env cartpole --out here".split()) == 0
    assert len(calls.run) == 1
    assert lines[0].startswith(f"gpcjax: error: here: another sweep writes there (process {os.getpid()} on ")
    assert not list(Path("here").glob(".*"))


def test_home_is_expanded(calls, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cli.main(["sweep", "--env", "cartpole", "--out=~/here"]) == 0
    assert calls.run[0][1] == tmp_path / "here"


def test_ctrl_c_says_how_to_go_on(calls, capsys):
    calls.fails = KeyboardInterrupt()
    assert cli.main("sweep --env cartpole --out here".split()) == 130
    message = "gpcjax: stopped: here keeps what is finished, the same command goes on from there\n"
    assert capsys.readouterr().err == message
    assert not calls.drawn


def test_a_full_disk_is_no_traceback(calls, capsys):
    calls.fails = OSError(errno.ENOSPC, "No space left on device", "here/x")
    assert cli.main("sweep --env cartpole --out here".split()) == 1
    assert capsys.readouterr().err.endswith("make room, then the same command goes on\n")


@pytest.mark.parametrize(
    ("number", "status"), [(errno.ENOSPC, 1), (errno.EROFS, 1), (errno.EDQUOT, 1), (errno.EACCES, 2)]
)
@pytest.mark.parametrize("what", ["the folder", "a file in it", "a file of the report"])
def test_a_disk_that_takes_no_more_is_no_mistake(calls, capsys, monkeypatch, number, status, what):
    """Nor is what cannot be written of a report; that somebody may not write there is."""

    def fail(*arguments, **options):
        raise OSError(number, os.strerror(number), "here/.hidden")

    def draw(*arguments, **options):
        files.write_files(Path("here"), {"report.html": "x"}, "make room")

    if what == "the folder":
        monkeypatch.setattr(Path, "mkdir", fail)
    elif what == "a file in it":
        monkeypatch.setattr(tempfile, "TemporaryFile", fail)
    else:
        monkeypatch.setattr(files, "write_atomic", fail)
        monkeypatch.setattr(running, "report", draw)
    assert cli.main("sweep --env cartpole --out here".split()) == status
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("gpcjax: error: here") and os.strerror(number) in line and ".hidden" not in line


def test_a_bug_is_a_traceback(calls):
    calls.fails = ValueError("ours")
    with pytest.raises(ValueError, match="ours"):
        cli.main("sweep --env cartpole --out here".split())


def test_a_reader_who_leaves_is_no_traceback():
    command = f"{sys.executable} -m gpcjax version | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, cwd=Path(gpcjax.__file__).parents[1]
    )
    assert (done.returncode in (0, cli.BROKEN_PIPE), done.stderr) == (True, "")


def test_the_module_is_the_command():
    command = [sys.executable, "-m", "gpcjax", "sweep", "--env", "foo"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(gpcjax.__file__).parents[1])
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"gpcjax: error: --env 'foo': give {ENVS}\n"


def test_argparse_gives_no_help_with_a_percent_sign():
    """Its formatter would fail on one, and only when somebody asks for help."""
    for action in grammar.build()._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                command.format_help()
                for own in command._actions:
                    if isinstance(own, argparse._SubParsersAction):
                        assert [part.format_help() for part in own.choices.values()]


def test_a_live_report_is_drawn_until_the_sweep_ends(calls):
    assert cli.main("sweep --env cartpole --out here --live".split()) == 0
    drawing = calls.options["meanwhile"].__self__
    assert isinstance(drawing, Live) and drawing._over.is_set()
    assert calls.drawn == [Path("here")]


def test_json_for_programs(calls, capsys):
    assert (
        cli.main("sweep --env cartpole --out here --json --keep states --keep-at 5 --checkpoint 0".split())
        == 0
    )
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line) == {
        "event": "report",
        "out": "here",
        "files": ["here/summary.csv", "here/report.html"],
        "rows": [{"algo": "gpc", "area": 1.5}],
    }
    assert calls.options == {
        "keeping": Keeping("states", every=5),
        "checkpoint": 0.0,
        "watcher": JsonLines,
        "meanwhile": cli.running._prepare_report,
        "executor": None,
        "shard": None,
    }
    assert cli.main("report here --json".split()) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(line)
