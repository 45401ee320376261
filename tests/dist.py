"""What a stranger gets, built and tried: `make dist`, and with ARGS=--lowest the oldest versions that we say we take.

dist/ holds the source distribution and the wheel afterwards. Both are compared with the repository and with each other,
and the wheel is installed in an environment that has nothing else: first alone, where each extra is missing, then with
all of them. This asks PyPI, and takes minutes: no test does it.
"""

import argparse
import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import urllib.request
import venv
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
DIST = ROOT / "dist"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EXTRAS = tuple(PROJECT["project"]["optional-dependencies"])
UV = Path(sys.executable).with_name("uv")

BUILD = "import sys; from flit_core import buildapi; print(getattr(buildapi, sys.argv[1])(sys.argv[2]))"

LOWEST_TESTS = """
    tests/deploy/test_export.py tests/deploy/test_policies_page.py tests/policies/test_plain.py
    tests/policies/test_saved.py
    tests/engine/test_evaluate.py tests/envs/test_host.py tests/envs/test_brax_adapter.py
    tests/learners/test_dcoach.py tests/report/test_statistics.py tests/report/test_figures.py tests/sweep/test_store.py
    tests/sweep/test_executables.py tests/teach/test_server.py tests/tune/test_tuning.py tests/cluster/test_ray.py
""".split()
"""Some for each library: what reads, draws, compiles, simulates, serves, tunes and distributes."""

TESTING = ("pytest", "pytest-xdist", "hypothesis", "beartype", "scikit-learn", "flit_core")


class Try(NamedTuple):
    """A command of the wheel, how it ends, and what it says on either stream."""

    words: str
    says: str
    status: int = 0


ALONE = (
    Try("version", r"^gpcjax [0-9.]+$"),
    Try(
        "sweep --env mountaincar --algo coach --seeds 2 --episodes 2 --jobs 1 --keep policies --out runs/tiny",
        "report.html",
    ),
    Try("report runs/tiny", "report.html"),
    Try("reproduce --dry-run", ""),
    Try("oracles --help", "usage: gpcjax oracles"),
    Try("teach --help", "usage: gpcjax teach"),
    Try("policy info cartpole:gpc", "Matern 1.5"),
    Try("policy eval cartpole:gpc --episodes 3", "2500 .2500, 2500."),
    Try("policy eval runs/tiny --episodes 2 --json", '"mean": '),
    Try("policy export cartpole:gpc --out runs/pole.h", "pole_act"),
    Try("play mountaincar:pump --gif runs/pump.gif --seconds 0.2", "runs/pump.gif: "),
    Try("teach --env mountaincar", r"pip install 'gpcjax\[teach\]'", 2),
    Try("sweep --env mountaincar --seeds 1 --engine ray", r"pip install 'gpcjax\[cluster\]'", 2),
    Try("tune --env mountaincar --method tpe --search noise=1e-8:1e-6", r"pip install 'gpcjax\[tune\]'", 2),
    Try("sweep --env gym:HalfCheetah-v5 --algo gpc-ns --dry-run", r"pip install 'gpcjax\[mujoco\]'", 2),
    Try("policy export cartpole:gpc --to onnx", r"pip install 'gpcjax\[onnx\]'", 2),
)
WITH_EXTRAS = (
    Try("policy export cartpole:gpc --out runs/pole.onnx", "action .batch, 1."),
    Try(
        "tune --env mountaincar --algo coach --method tpe --search beta=1:100 --dry-run --out runs/tuned",
        "runs/tuned",
    ),
    Try("policy eval runs/tiny --env gym:InvertedPendulum-v5", "gym:InvertedPendulum-v5 has 4 and 1", 2),
)


def main() -> int:
    """Builds and tries; the status is 1 where something is wrong."""
    parser = argparse.ArgumentParser(prog="make dist", description=__doc__)
    parser.add_argument(
        "--lowest", action="store_true", help="run some tests with the oldest versions of all libraries"
    )
    arguments = parser.parse_args()
    try:
        lowest() if arguments.lowest else distributions()
    except Wrong as wrong:
        print(f"make dist: {wrong}", file=sys.stderr)
        return 1
    return 0


class Wrong(Exception):
    """What is wrong, in a line or with what was printed."""


def distributions() -> None:
    """Builds both, compares them, and tries the wheel."""
    shutil.rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    source, wheel = (DIST / _built(ROOT, kind, DIST) for kind in ("build_sdist", "build_wheel"))
    for each in (source, wheel):
        print(f"{each.relative_to(ROOT)}: {each.stat().st_size:,} bytes")
    check_wheel(wheel)
    check_source(source, wheel)
    with _scratch() as place:
        python = _environment(place / "alone", [str(wheel)])
        print(f"installed alone: {_size(place / 'alone')}")
        _try_all(python, place, ALONE)
        _acts_in_python(python, place)
        extras = ",".join(EXTRAS)
        _install(python, [f"gpcjax[{extras}] @ {wheel.as_uri()}"])
        print(f"installed with {extras}: {_size(place / 'alone')}")
        _try_all(python, place, WITH_EXTRAS)
        _serves(python, place)
    print("the wheel and the source distribution are as they should be")


def check_wheel(wheel: Path) -> None:
    """It holds the package as git has it, and nothing else; its card names each extra. Raises `Wrong`."""
    content = _content(wheel)
    kept = _kept()
    if missing := sorted(kept - content.keys()):
        raise Wrong(f"{wheel.name} lacks {', '.join(missing[:5])}")
    card_of_it = re.compile(r"gpcjax-[0-9.]+\.dist-info/")
    if odd := sorted(name for name in content.keys() - kept if not card_of_it.match(name)):
        raise Wrong(f"{wheel.name} holds {', '.join(odd[:5])}")
    for name in (
        "gpcjax/py.typed",
        "gpcjax/reproduce/sweeps/fig5_4_cartpole.toml",
        "gpcjax/teach/page/index.html",
    ):
        if name not in content:
            raise Wrong(f"{wheel.name} lacks {name}")
    card = next(text.decode() for name, text in content.items() if name.endswith("/METADATA"))
    told = re.findall(r"^Provides-Extra: (\S+)$", card, re.MULTILINE)
    if sorted(told) != sorted(EXTRAS):
        raise Wrong(f"{wheel.name} names the extras {', '.join(told)}, not {', '.join(EXTRAS)}")


def check_source(source: Path, wheel: Path) -> None:
    """A wheel that is built from it is the same file by file. Raises `Wrong`."""
    with _scratch() as place:
        with tarfile.open(source) as archive:
            archive.extractall(place, filter="data")
        (tree,) = place.iterdir()
        for name in ("README.md", "LICENSE", "CHANGELOG.md", "pyproject.toml"):
            if not (tree / name).is_file():
                raise Wrong(f"{source.name} lacks {name}")
        again = _content(place / _built(tree, "build_wheel", place))
    first = _content(wheel)
    other = sorted(name for name in first.keys() | again.keys() if first.get(name) != again.get(name))
    if other:
        raise Wrong(f"a wheel from {source.name} differs in {', '.join(other[:5])}")


def lowest() -> None:
    """Runs some tests with the oldest versions that pyproject.toml allows; says which ones those are."""
    with _scratch() as place:
        python = _python(place / "lowest")
        extras = [word for extra in EXTRAS for word in ("--extra", extra)]
        wanted = ["-r", str(ROOT / "pyproject.toml"), *extras]
        _install(python, wanted, "--resolution", "lowest-direct", "--only-binary", ":all:")
        frozen = place / "frozen.txt"
        frozen.write_text(_ran([str(UV), "pip", "freeze", "--python", str(python)]).stdout)
        _install(python, TESTING, "--constraint", str(frozen))
        named = re.findall(
            r'"([A-Za-z0-9_-]+)(?:\[[^]]*\])? >=([0-9.]+)', (ROOT / "pyproject.toml").read_text()
        )
        versions = dict(line.split("==") for line in frozen.read_text().splitlines() if "==" in line)
        for name, bound in dict(named).items():
            if name in versions:
                print(f"{name} >={bound}: {versions[name]}")
        # Old libraries say of newer ones that something there is deprecated.
        words = ["-m", "pytest", "-n0", "-q", "-W", "ignore::DeprecationWarning", *LOWEST_TESTS]
        done = subprocess.run([str(python), *words], cwd=ROOT)
    if done.returncode:
        raise Wrong("with the oldest versions tests fail: raise what pyproject.toml asks for")


def _built(tree: Path, kind: str, into: Path) -> str:
    """The name of what the build backend made of a tree."""
    return _ran([sys.executable, "-c", BUILD, kind, str(into)], cwd=tree).stdout.splitlines()[-1]


def _kept() -> set[str]:
    """The files of the package: those that git does not ignore, or all where this is no checkout."""
    words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "gpcjax"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    if done.returncode == 0:
        return set(done.stdout.splitlines())
    files = (file for file in (ROOT / "gpcjax").rglob("*") if file.is_file())
    return {file.relative_to(ROOT).as_posix() for file in files if "__pycache__" not in file.parts}


def _content(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _environment(folder: Path, packages: Sequence[str]) -> Path:
    """A new environment that holds these packages and what they need; its Python."""
    python = _python(folder)
    _install(python, packages)
    return python


def _python(folder: Path) -> Path:
    venv.create(folder)
    return folder / "bin" / "python"


def _install(python: Path, packages: Sequence[str], *words: str) -> None:
    _ran([str(UV), "pip", "install", "--quiet", "--python", str(python), *words, *packages])


def _try_all(python: Path, place: Path, commands: Sequence[Try]) -> None:
    """Runs these in a folder with nothing but what they made before. Raises `Wrong`."""
    for words, says, status in commands:
        done = subprocess.run(
            [python.with_name("gpcjax"), *words.split()],
            capture_output=True,
            text=True,
            cwd=_room(place),
            env=_plain(place),
        )
        said = done.stdout + done.stderr
        if done.returncode != status or not re.search(says, said, re.MULTILINE):
            raise Wrong(f"gpcjax {words}: status {done.returncode}, not {status} with {says!r}\n{said}")
        if status and done.stderr.count("\n") != 1:
            raise Wrong(f"gpcjax {words}: more than a line\n{said}")
        print(f"gpcjax {words}")


def _acts_in_python(python: Path, place: Path) -> None:
    """The public names of the wheel, in a program; it is typed for whoever checks types."""
    code = (
        "import gpcjax, pathlib; here = pathlib.Path(gpcjax.__file__).parent; assert (here / 'py.typed').exists();"
        "assert 'site-packages' in str(here); [getattr(gpcjax, name) for name in gpcjax.__all__];"
        "print(len(gpcjax.load_policies('runs/tiny')))"
    )
    done = subprocess.run(
        [python, "-c", code], capture_output=True, text=True, cwd=_room(place), env=_plain(place)
    )
    if (done.returncode, done.stdout) != (0, "2\n"):
        raise Wrong(f"the wheel in a program of Python\n{done.stdout}{done.stderr}")


def _serves(python: Path, place: Path) -> None:
    """A lesson begins, its page comes, and Ctrl-C ends it. Raises `Wrong`."""
    words = [
        python.with_name("gpcjax"),
        "teach",
        "--env",
        "mountaincar",
        "--port",
        "0",
        "--out",
        "runs/taught",
    ]
    lesson = subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=_room(place),
        env=_plain(place),
    )
    try:
        assert lesson.stdout is not None
        line = lesson.stdout.readline()
        address = re.search(r"http://\S+", line)
        if address is None:
            raise Wrong(f"gpcjax teach says no address: {line}{lesson.stdout.read()}")
        with urllib.request.urlopen(address[0], timeout=60) as page:
            if b"<html" not in page.read():
                raise Wrong("gpcjax teach: no page")
        lesson.send_signal(signal.SIGINT)
        said, _ = lesson.communicate(timeout=60)
        if lesson.returncode or "kept in runs/taught" not in said:
            raise Wrong(f"gpcjax teach: status {lesson.returncode} after Ctrl-C\n{said}")
    finally:
        lesson.kill()
    print("gpcjax teach: its page comes, and Ctrl-C ends it")


def _ran(words: Sequence[str], cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """What a program that has to do well prints. Raises `Wrong`."""
    done = subprocess.run(words, capture_output=True, text=True, cwd=cwd)
    if done.returncode:
        raise Wrong(f"{' '.join(words[:4])} ...: status {done.returncode}\n{done.stdout}{done.stderr}")
    return done


def _room(place: Path) -> Path:
    """The folder that commands are run in."""
    room = place / "room"
    room.mkdir(exist_ok=True)
    return room


def _plain(place: Path) -> dict[str, str]:
    """Nothing of this process's environment but where programs are: no PYTHONPATH, no cache of programs."""
    return {"PATH": os.environ["PATH"], "HOME": str(place), "LANG": "C.UTF-8"}


@contextlib.contextmanager
def _scratch() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="gpcjax-dist-") as name:
        yield Path(name)


def _size(folder: Path) -> str:
    return f"{sum(file.stat().st_size for file in folder.rglob('*') if file.is_file()) / 1e6:,.0f} MB"


if __name__ == "__main__":
    raise SystemExit(main())
