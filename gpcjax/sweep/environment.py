"""The environment of a process that computes, to be set before it loads numpy or jax. Loads neither."""

import functools
import hashlib
import importlib.metadata
import os
import platform
import shutil
import sys
import tempfile
from pathlib import Path

from gpcjax.errors import UserError

SINGLE_THREADED = {
    "NPROC": "1",  # the size of XLA's thread pools
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}
"""The same for any number of jobs."""

XLA_OPTIONS = {
    "0.10": (
        # Full vectors where a processor has them; XLA's own choice is half of AVX-512.
        "--xla_cpu_prefer_vector_width=512",
        # A sum over 64 x 64 numbers is not worth a call of YNNPACK, 8 us of what were 10 in a step's policies.
        "--xla_cpu_experimental_ynn_fusion_type=",
        # A loop whose arrays take less than this is compiled as one function; otherwise its steps are dispatched
        # operation by operation, which costs more than they do. Such a function is large: LLVM, which the second of
        # these is for, otherwise looks at all of it again after every change that it prepares.
        "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=67108864,-cgpp-huge-func=100",
        # A program of GPC-NS has some 250 small kernels, which by way of MLIR take twice the time and 200 MiB more.
        "--xla_cpu_use_fusion_emitters=false",
    ),
}
"""What XLA is told, by the version of jaxlib: it refuses to start with an option that it does not know.

Measured in `benchmarks/README.md`: together they halve the time of a round. Other versions run without any.
"""

PLATFORM = "GPCJAX_PLATFORM"
"""What workers compute on: a variable of gpcjax's own, as those of jax may be set for something else."""

PLATFORMS = ("cpu", "cuda")
"""The values that it may have."""

CACHE = "JAX_COMPILATION_CACHE_DIR"
"""Where XLA's programs are kept; the one variable of jax that a person may set for workers."""

LET_THROUGH = frozenset(
    "PATH HOME USER LOGNAME TMPDIR TMP TEMP TZ LANG LANGUAGE LD_LIBRARY_PATH DYLD_LIBRARY_PATH SYSTEMROOT".split()
)
LET_THROUGH_TO_GPU = frozenset((PLATFORM, "CUDA_VISIBLE_DEVICES"))
LET_THROUGH_PREFIXES = ("LC_", "XDG_")
"""All that a worker gets of the present environment: where things are, and in which language.

Not what is known to be harmful is kept out, but all the rest: jax has a variable for each of its settings, some without
its prefix, and XLA, equinox, OpenBLAS, numpy, glibc and Python have more. With JAX_DEBUG_NANS=1 a sweep ended, with
JAX_PLATFORMS=cuda or a word in XLA_FLAGS that XLA does not know no worker came up, and others change the last bits.
"""

_AT_ONCE = {"JAX_CPU_ENABLE_ASYNC_DISPATCH": "0"}
"""A program is run by who calls it, and not by another thread: who waits for it has it half a tenth of a millisecond
sooner. `gpcjax._x64` reads it."""

_NOTEWORTHY = ("JAX_", "XLA_", "EQX_")
"""A person who sets these wants something of what computes, and is told that sweeps do without."""


def computing_environment(platform: str | None = None) -> dict[str, str]:
    """One thread, XLA's options, and the processor: what rows depend on, whatever the present environment says.

    But for GPCJAX_PLATFORM, or `platform`, where a GPU is asked for: then XLA's own options, and rows that are those
    of a processor but for rounding.
    """
    platform = platform or compute_platform()
    environment = {**SINGLE_THREADED, "XLA_FLAGS": " ".join(xla_options()), "JAX_PLATFORMS": platform}
    if platform != "cpu":
        environment |= {"XLA_FLAGS": "", "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}  # others may be on it, too
    return environment


def compute_platform() -> str:
    """What workers compute on, as jax names it: the processor, unless GPCJAX_PLATFORM says otherwise.

    Raises:
        UserError: it says something else than one of `PLATFORMS`.
    """
    given = os.environ.get(PLATFORM, "") or "cpu"
    if given not in PLATFORMS:
        raise UserError(f"{PLATFORM}={given}: give {' or '.join(PLATFORMS)}, or leave it out")
    return given


def xla_options(jaxlib: str | None = None) -> tuple[str, ...]:
    """The options for this version of jaxlib, such as 0.10.2; for the installed one by default."""
    version = _jaxlib() if jaxlib is None else jaxlib
    return XLA_OPTIONS.get(".".join(version.split(".")[:2]), ())


@functools.cache
def _jaxlib() -> str:
    return importlib.metadata.version("jaxlib")


def worker_environment() -> dict[str, str]:
    """A worker's environment, with compiled programs kept from one sweep to the next.

    XLA's programs are cached below `$XDG_CACHE_HOME/gpcjax` (`~/.cache/gpcjax`), apart for each kind of processor: what
    is compiled for one must not run on another. A JAX_COMPILATION_CACHE_DIR of the user's own is respected. Where
    nothing can be written, nothing is kept. Modules are found where this process finds them, and nowhere else.
    """
    names = LET_THROUGH if compute_platform() == "cpu" else LET_THROUGH | LET_THROUGH_TO_GPU
    environment = {
        name: value
        for name, value in os.environ.items()
        if name in names or name.startswith(LET_THROUGH_PREFIXES)
    }
    environment |= _kept_programs("0.2")
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)
    return {**environment, **computing_environment(), "PYTHONPATH": path}


def compute_here() -> None:
    """Makes this process, which has not loaded jax, compute as workers do: with their options and their programs.

    Always on the processor: what is computed here is a step at a time. Small programs are kept, too: somebody waits for
    each of them.
    """
    for name in [name for name in os.environ if name.startswith(_NOTEWORTHY)]:
        del os.environ[name]
    os.environ.update({**_kept_programs("0"), **computing_environment("cpu"), **_AT_ONCE})


def _kept_programs(seconds: str) -> dict[str, str]:
    """Variables by which programs that took so long to compile are kept, where something can be."""
    folder = cache_folder()
    if _reason_against(folder):
        return {}
    return {
        CACHE: str(folder),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": seconds,
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }


def refuse_another_environment() -> None:
    """Rows must not depend on where they are computed: a worker runs with one thread and XLA's options, or not at all.

    Raises:
        UserError: a variable is not as `computing_environment` has it.
    """
    other = [name for name, value in computing_environment().items() if os.environ.get(name) != value]
    if other:
        raise UserError(
            f"this process computes otherwise than workers do ({', '.join(other)}): give its environment the values"
            " of gpcjax.sweep.environment.computing_environment() before numpy and jax are loaded"
        )


def python(module: str, *words: str) -> list[str]:
    """The command that runs a module in a `worker_environment`: without the present folder, where anything may lie."""
    return [sys.executable, "-P", "-m", module, *words]


def script(file: str, *words: str) -> list[str]:
    """The command that runs a file in the same way, which imports nothing but what it asks for."""
    return [sys.executable, "-P", file, *words]


def notes() -> list[str]:
    """What a person should know of the present environment before a sweep starts: a line for each fact."""
    ours = {CACHE: os.environ.get(CACHE), **computing_environment()}
    others = {name: value for name, value in os.environ.items() if name.startswith(_NOTEWORTHY)}
    ignored = sorted(name for name, value in others.items() if ours.get(name) != value)
    lines = [f"sweeps compute without {', '.join(ignored)} of the environment"] if ignored else []
    folder = cache_folder()
    if reason := _reason_against(folder):
        lines.append(
            f"compiled programs are not kept, {folder or 'their folder'} cannot be written ({reason})"
        )
    return lines


def cache_folder() -> Path | None:
    """Where compiled programs are kept; None if nobody knows where home is."""
    if given := os.environ.get(CACHE):
        return Path(given)
    root = os.environ.get("XDG_CACHE_HOME", "")
    if not os.path.isabs(root):  # as its specification has it
        root = os.path.join(os.path.expanduser("~"), ".cache")
    return Path(root) / "gpcjax" / f"xla-{_processor_hash()}" if os.path.isabs(root) else None


def programs_folder() -> Path | None:
    """Where whole programs are kept: beside what XLA keeps of them. None of a GPU are.

    All in it were made for this processor, by this compiler, which was told the same: XLA looks after that in its own
    cache, and nobody but us in this one.
    """
    folder = cache_folder()
    if folder is None or compute_platform() != "cpu":
        return None
    made_by = hashlib.sha256("\n".join((_processor_hash(), _jaxlib(), *xla_options())).encode())
    return folder / f"programs-{made_by.hexdigest()[:12]}"


def forget_programs() -> bool:
    """Removes the whole programs that are kept; False where there were none."""
    folder = programs_folder()
    if folder is None or not folder.is_dir():
        return False
    shutil.rmtree(folder, ignore_errors=True)
    return True


@functools.lru_cache
def _reason_against(folder: Path | None) -> str:
    """Why nothing can be kept in this folder, found out by a file in it for a moment; empty if something can."""
    if folder is None:
        return "no home folder is known"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return ""
    except (OSError, ValueError) as error:
        return getattr(error, "strerror", None) or str(error)


def _processor_hash() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        lines = [platform.processor(), platform.platform()]
    told = {line for line in lines if line.startswith(("model name", "flags", "Features")) or ":" not in line}
    return hashlib.sha256("\n".join(sorted(told)).encode()).hexdigest()[:12]
