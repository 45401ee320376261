"""Every command prints what it can to whatever stdout and stderr are."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import gpcjax

ROOT = Path(gpcjax.__file__).parents[1]
PRINTS = """
import sys
from types import SimpleNamespace
from gpcjax import cli
from gpcjax.cli import entry
entry._run = lambda words: print({text!r}) or 0
sys.argv = ["gpcjax"]
raise SystemExit(cli.main())
"""


def run(code, redirection="", **environment):
    clean = {"PATH": os.environ["PATH"], "HOME": "/none", "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        ["sh", "-c", f'exec "$0" "$@" {redirection}', sys.executable, *code],
        env=clean | environment,
        capture_output=True,
        cwd=ROOT,
    )


@pytest.mark.parametrize(
    ("encoding", "expected"),
    [
        ("utf-8", "1 ± 2 \u2212 3 é ★ ━ 中 \\udcff".encode()),
        pytest.param("ascii", b"1 +/- 2 - 3 \\xe9 * - \\u4e2d \\udcff", marks=pytest.mark.slow),
        ("ascii:strict", b"1 +/- 2 - 3 \\xe9 * - \\u4e2d \\udcff"),
        pytest.param("latin-1", b"1 \xb1 2 - 3 \xe9 * - \\u4e2d \\udcff", marks=pytest.mark.slow),
        pytest.param("cp437", b"1 \xf1 2 - 3 \x82 * - \\u4e2d \\udcff", marks=pytest.mark.slow),
    ],
)
def test_characters_that_an_encoding_lacks(encoding, expected):
    code = ["-c", PRINTS.format(text="1 ± 2 \u2212 3 é ★ ━ 中 \udcff")]
    done = run(code, PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stdout, done.stderr) == (0, expected + b"\n", b"")


@pytest.mark.parametrize(
    "environment",
    [
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        *(
            pytest.param({name: value}, marks=pytest.mark.slow)
            for name, value in (("LC_ALL", "C"), ("LC_ALL", "POSIX"), ("LANG", "junk"))
        ),
    ],
    ids=str,
)
def test_any_locale(environment):
    done = run(["-m", "gpcjax", "sweep", "--env", "café"], **environment)
    assert (
        done.returncode == 2
        and done.stderr.startswith(b"gpcjax: error: --env 'caf")
        and b"Traceback" not in done.stderr
    )


@pytest.mark.parametrize(
    "columns", ["1", "junk", *(pytest.param(each, marks=pytest.mark.slow) for each in ("0", "12", "100000"))]
)
def test_any_width(columns):
    done = run(["-m", "gpcjax", "sweep", "--help"], COLUMNS=columns)
    assert done.returncode == 0 and done.stderr == b"" and b"usage" in done.stdout


@pytest.mark.parametrize(
    ("redirection", "words", "status", "said"),
    [
        pytest.param(">&-", "version", 0, b"", marks=pytest.mark.slow),
        (">&- 2>&- <&-", "version", 0, b""),
        ("2>&-", "sweep --env foo", 2, b""),
        (">/dev/full", "version", 1, b"gpcjax: error: [Errno 28] No space left on device: make room, then"),
        pytest.param(
            ">/dev/full",
            "sweep --help",
            1,
            b"gpcjax: error: [Errno 28] No space left on device: make room, then",
            marks=pytest.mark.slow,
        ),
        pytest.param("2>/dev/full", "sweep --env foo", 2, b"", marks=pytest.mark.slow),
        (">/dev/full 2>/dev/full", "version", 1, b""),
    ],
)
def test_streams_that_are_closed_or_full(redirection, words, status, said):
    done = run(["-m", "gpcjax", *words.split()], redirection)
    assert (done.returncode, done.stdout) == (status, b"")
    assert done.stderr.startswith(said) and done.stderr.count(b"\n") == bool(said)


def test_a_closed_stream_is_not_the_next_file(tmp_path):
    """Its descriptor would be given to the first file that is opened, and that would get what is printed."""
    code = PRINTS.format(text="x").replace(
        "lambda words:", f"lambda words: open({str(tmp_path / 'file')!r}, 'w').write('kept') and"
    )
    run(["-c", code], ">&-")
    assert (tmp_path / "file").read_text() == "kept"


def test_warnings_are_no_errors():
    """Libraries warn, also where the environment makes errors of it."""
    code = "import sys, warnings\nfrom gpcjax import cli\nfrom gpcjax.cli import entry\n"
    code += "entry._run = lambda words: warnings.warn('old', DeprecationWarning) or 0\n"
    done = run(["-c", code + "sys.argv = ['gpcjax']\nraise SystemExit(cli.main())"], PYTHONWARNINGS="error")
    assert (done.returncode, done.stderr) == (0, b"")
