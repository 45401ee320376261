"""What a worker gets of a person's environment, and how it is told why one ended."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gpcjax.errors import UserError
from gpcjax.sweep import environment, machine
from gpcjax.sweep.environment import CACHE, XLA_OPTIONS, notes, worker_environment, xla_options
from gpcjax.sweep.executors.starting import FEWER, reason

HOSTILE = {
    "JAX_DEBUG_NANS": "1",
    "JAX_PLATFORMS": "cuda",
    "JAX_ENABLE_X64": "0",
    "JAX_DISABLE_JIT": "1",
    "CHECK_VMA": "junk",  # of jax, without its prefix
    "XLA_FLAGS": "--xla_no_such_flag",
    "EQX_ON_ERROR": "breakpoint",
    "JAXTYPING_DISABLE": "junk",
    "OMP_NUM_THREADS": "0",
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "AVX2 AVX512F",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2",
    "MALLOC_PERTURB_": "85",
    "TF_CPP_MIN_LOG_LEVEL": "0",
    "PYTHONWARNINGS": "error",
    "PYTHONOPTIMIZE": "2",
    "PYTHONSTARTUP": "/none",
    "PYTHONINSPECT": "1",
    "CUDA_VISIBLE_DEVICES": "junk",
    "LD_PRELOAD": "",
}


@pytest.fixture(autouse=True)
def plain(monkeypatch, tmp_path):
    """A small environment with a home of its own."""
    for name in list(os.environ):
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    environment._reason_against.cache_clear()
    yield
    environment._reason_against.cache_clear()


def test_nothing_that_computes_hears_of_the_present_environment(monkeypatch):
    before = worker_environment()
    for name, value in HOSTILE.items():
        monkeypatch.setenv(name, value)
    assert worker_environment() == before
    assert before["JAX_PLATFORMS"] == "cpu" and before["XLA_FLAGS"] == " ".join(xla_options())
    assert before["OMP_NUM_THREADS"] == "1" and before["PATH"] == "/usr/bin:/bin"


def test_where_things_are_is_let_through(monkeypatch):
    given = {"TMPDIR": "/tmp/x", "LC_ALL": "C", "XDG_DATA_HOME": "/x", CACHE: os.environ["HOME"] + "/cache"}
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert given.items() <= worker_environment().items()


def test_modules_are_found_where_this_process_finds_them(monkeypatch, tmp_path):
    """And not in the folder that the person happens to be in, where a file may have any name."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "json.py").write_text("raise RuntimeError('not ours')")
    code = "import json, sys; print(json.dumps(sys.path))"
    command = [word for word in environment.python("json") if word not in ("-m", "json")]
    done = subprocess.run([*command, "-c", code], env=worker_environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert set(map(os.path.abspath, sys.path)) <= set(__import__("json").loads(done.stdout))


def test_the_cache(monkeypatch, tmp_path):
    assert worker_environment()[CACHE].startswith(f"{tmp_path}/.cache/gpcjax/xla-")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "x"))
    assert worker_environment()[CACHE].startswith(f"{tmp_path}/x/gpcjax/xla-")
    monkeypatch.setenv("XDG_CACHE_HOME", "not/absolute")
    assert worker_environment()[CACHE].startswith(f"{tmp_path}/.cache/gpcjax/xla-")
    assert not Path("not").exists()


@pytest.mark.parametrize("place", ["HOME", "XDG_CACHE_HOME", CACHE])
def test_where_nothing_can_be_written_nothing_is_kept(monkeypatch, tmp_path, place):
    (tmp_path / "file").touch()
    monkeypatch.setenv(place, str(tmp_path / "file" / "below"))
    assert CACHE not in worker_environment()
    assert notes()[0].startswith("compiled programs are not kept, ") and "Not a directory" in notes()[0]
    assert len(notes()) == 1


def test_a_person_is_told_what_sweeps_do_without(monkeypatch):
    assert notes() == []
    for name in ("JAX_DEBUG_NANS", "XLA_FLAGS", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    assert notes() == ["sweeps compute without JAX_DEBUG_NANS, XLA_FLAGS of the environment"]


@pytest.mark.parametrize(
    ("status", "written", "expected"),
    [
        (-signal.SIGKILL, "", f"was killed by SIGKILL, perhaps by the system for want of memory{FEWER}"),
        (-signal.SIGSEGV, "a\nFatal: b\n\n", "was ended by SIGSEGV: Fatal: b"),
        (-signal.SIGABRT, "terminate called\n  what():  std::bad_alloc\n", f"was ended by SIGABRT: what():  std::bad_alloc{FEWER}"),  # noqa: E501
        (-signal.SIGABRT, "F0000 1 x.cc:3] Unknown flag\n*** Check failure stack trace: ***\n    @ 0x7f\n", "was ended by SIGABRT: F0000 1 x.cc:3] Unknown flag"),  # noqa: E501
        (-64, "", "was ended by SIGRTMAX"),
        (-50, "", "was ended by signal 50"),
        (1, "Traceback\n  File\nModuleNotFoundError: No module named 'x'\n", "ended with status 1: ModuleNotFoundError: No module named 'x'"),  # noqa: E501
        (1, "OSError: [Errno 12] Cannot allocate memory", f"ended with status 1: OSError: [Errno 12] Cannot allocate memory{FEWER}"),  # noqa: E501
        (0, "", "ended with status 0"),
        (3, "x" * 5000, "ended with status 3: " + "x" * 300),
    ],
)  # fmt: skip
def test_the_reason_of_an_end(status, written, expected):
    assert reason(status, written) == expected


def test_options_of_xla_are_those_of_the_version_that_is_installed():
    assert xla_options("0.10.0") == xla_options("0.10.2") == XLA_OPTIONS["0.10"]
    assert xla_options("0.1.75") == xla_options("0.11.0") == xla_options("1.0") == ()
    assert xla_options(), "none are known for the installed jaxlib: add what is measured to be faster"


def starts(*options):
    """What XLA says if it does not start with these options."""
    done = subprocess.run(
        [sys.executable, "-c", "import jax; jax.devices()"],
        env=worker_environment() | {"XLA_FLAGS": " ".join(options)},
        capture_output=True,
        text=True,
    )
    return "" if done.returncode == 0 else f"{' '.join(options)}: {done.stderr[-300:]}"


@pytest.mark.slow
def test_xla_takes_each_option():
    """Together: it ends with the first that it does not know. Every worker of real sweeps is told them."""
    assert starts(*xla_options()) == ""


def test_xla_refuses_what_it_does_not_know():
    assert starts("--xla_no_such_option=1").startswith("--xla_no_such_option=1: ")


def test_programs_are_kept_apart_by_what_xla_was_told_and_by_its_version(monkeypatch):
    """A newer gpcjax with other options must not run what an older one compiled: rows would not be what it says."""
    folders = {environment.programs_folder()}
    for version in ("0.10.99", "0.11.0"):
        monkeypatch.setattr(environment, "_jaxlib", lambda version=version: version)
        folders.add(environment.programs_folder())
    monkeypatch.setattr(environment, "XLA_OPTIONS", {"0.11": ("--xla_cpu_prefer_vector_width=512",)})
    folders.add(environment.programs_folder())
    assert len(folders) == 4 and len({folder.parent for folder in folders if folder}) == 1


def test_a_gpu_is_asked_for_by_a_variable_of_our_own(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1")
    monkeypatch.setenv("GPCJAX_PLATFORM", "cuda")
    asked = worker_environment()
    assert asked["JAX_PLATFORMS"] == "cuda" and asked["XLA_FLAGS"] == ""
    assert asked["GPCJAX_PLATFORM"] == "cuda" and asked["CUDA_VISIBLE_DEVICES"] == "1"
    assert environment.programs_folder() is None  # what is kept of programs is a processor's
    assert machine.kind_of(machine.describe()) != ""
    on_gpu = machine.describe()
    assert on_gpu["accelerator"].startswith("cuda")
    monkeypatch.setenv("GPCJAX_PLATFORM", "")
    assert worker_environment()["JAX_PLATFORMS"] == "cpu"
    assert machine.kind_of(machine.describe()) != machine.kind_of(on_gpu)
    assert "accelerator" in machine.differences(machine.describe(), on_gpu)
    monkeypatch.setenv("GPCJAX_PLATFORM", "tpu")
    with pytest.raises(UserError, match="GPCJAX_PLATFORM=tpu: give cpu or cuda"):
        worker_environment()
