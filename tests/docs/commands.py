"""Takes the commands of a page as a reader would type them: understood, checked, or run, in the folder of the page."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

from gpcjax import cli
from gpcjax.cli.words import parse_words, settings
from gpcjax.sweep.spec import make_spec
from tests.called import RECORDER, calls
from tests.docs.pages import ROOT

DRY = ("sweep", "grid", "tune", "reproduce")
"""Commands that check all and run nothing, if they are asked to."""

ON_ONE_CORE = ("sweep", "grid", "tune")


class Typist:
    """Types the commands of one page; `project` is an empty folder, in which make has all that it needs."""

    def __init__(self, project: Path):
        self._project = project

    def type(self, line: str, way: str) -> None:
        """Takes one line; `way` is that of `tests.docs.pages`, without `slow` and `not`."""
        words = shlex.split(line, comments=True)
        match words:
            case ["make", *rest]:
                for called in self._make(rest):
                    if called[:2] == ["-m", "gpcjax"]:
                        self._gpcjax(called[2:], "check" if way == "run" else way)
                    elif called[:1] == ["-m"]:
                        assert _module(called[1]), f"{line}: there is no module {called[1]}"
            case ["gpcjax" | ".venv/bin/gpcjax", *rest]:
                self._gpcjax(rest, way)
            case ["python" | ".venv/bin/python", *rest]:
                self._python(rest, way)
            case ["pip", "install", wanted]:
                extras = re.fullmatch(r"gpcjax\[([\w,]+)\]", wanted)
                assert extras and {*extras[1].split(",")} <= _extras(), f"{line}: no such extra"
            case ["sbatch", *rest]:
                script = next(place for place, word in enumerate(rest) if not word.startswith("-"))
                assert (ROOT / rest[script]).is_file()
                make_spec(settings(parse_words(["sweep", *rest[script + 1 :]])))
            case [script, *_]:
                assert (ROOT / script).is_file() and os.access(ROOT / script, os.X_OK), f"{line}: {script}"

    def _gpcjax(self, words: Sequence[str], way: str) -> None:
        command = words[0]
        understood = parse_words(words)
        if way == "words" or (way == "check" and command not in DRY):
            if command in ON_ONE_CORE and "replay:" not in str(words):  # a record is read at once
                settings(understood)
            return
        more = ["--jobs=1"] if command in ON_ONE_CORE else []
        more += ["--dry-run"] if way == "check" else []
        more += ["--seconds=0.5"] if "play" in words[:1] or words[:2] == ["policy", "gif"] else []
        assert cli.main([*words, *more]) == 0, " ".join(words)

    def _python(self, words: Sequence[str], way: str) -> None:
        if way == "run":
            ours = os.environ | {"PYTHONPATH": str(ROOT)}
            done = subprocess.run(
                [sys.executable, *words], env=ours, capture_output=True, text=True, check=False, timeout=300
            )
            assert done.returncode == 0, done.stderr
        elif words[0] == "-m":
            assert _module(words[1]), f"there is no module {words[1]}"
        else:
            assert Path(words[0]).is_file() or (ROOT / words[0]).is_file(), words[0]

    def _make(self, words: Sequence[str]) -> list[list[str]]:
        """How make calls .venv's python, in a project that is set up already."""
        called = self._project / "called"
        if not (self._project / "Makefile").exists():
            _set_up(self._project)
        called.unlink(missing_ok=True)
        clean = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
        done = subprocess.run(
            ["make", *words], cwd=self._project, env=clean, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return calls(called)


def _set_up(project: Path) -> None:
    shutil.copy(ROOT / "Makefile", project)
    for name in ("requirements.lock", "requirements-docs.lock", "pyproject.toml"):
        (project / name).touch()
    bin_folder = project / ".venv" / "bin"
    bin_folder.mkdir(parents=True)
    for name in ("python", "ruff", "basedpyright", "lint-imports", "uv"):
        program = bin_folder / name
        program.write_text(RECORDER)
        program.chmod(0o755)
    for made in (".ready", ".browser", ".docs"):
        (project / ".venv" / made).touch()


def _module(name: str) -> bool:
    """Whether `python -m NAME` finds it here, or it is an installed one's that we ask for."""
    path = ROOT / name.replace(".", "/")
    return path.with_suffix(".py").is_file() or path.is_dir() or name in ("pytest", "mkdocs", "pip")


def _extras() -> set[str]:
    return {*tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]}
