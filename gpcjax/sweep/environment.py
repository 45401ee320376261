"""The environment of a process that computes, to be set before it loads numpy or jax. Loads neither."""

import hashlib
import os
import platform
from pathlib import Path

SINGLE_THREADED = {
    "NPROC": "1",  # the size of XLA's thread pools
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}
"""The same for any number of jobs."""

XLA_OPTIONS = (
    # Full vectors where a processor has them; XLA's own choice is half of AVX-512.
    "--xla_cpu_prefer_vector_width=512",
    # A sum over 64 x 64 numbers is not worth a call of YNNPACK, 8 us of what were 10 in a step's policies.
    "--xla_cpu_experimental_ynn_fusion_type=",
    # A loop whose arrays take less than this is compiled as one function; otherwise its steps are dispatched
    # operation by operation, which costs more than they do.
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=67108864",
)
"""Measured in `benchmarks/README.md`: together they halve the time of a round."""


def computing_environment() -> dict[str, str]:
    """One thread, and XLA's options; what is already set in XLA_FLAGS has the last word."""
    flags = " ".join([*XLA_OPTIONS, os.environ.get("XLA_FLAGS", "")]).strip()
    return {**SINGLE_THREADED, "XLA_FLAGS": flags}


def worker_environment() -> dict[str, str]:
    """The present environment as a worker gets it, with compiled programs kept from one sweep to the next.

    XLA's programs are cached below `$XDG_CACHE_HOME/gpcjax` (`~/.cache/gpcjax`), apart for each kind of processor: what
    is compiled for one must not run on another. A JAX_COMPILATION_CACHE_DIR of the user's own is respected.
    """
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    cache = {
        "JAX_COMPILATION_CACHE_DIR": str(root / "gpcjax" / f"xla-{_processor_hash()}"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    return {**cache, **os.environ, **computing_environment()}


def _processor_hash() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = [platform.processor(), platform.platform()]
    told = {line for line in lines if line.startswith(("model name", "flags", "Features")) or ":" not in line}
    return hashlib.sha256("\n".join(sorted(told)).encode()).hexdigest()[:12]
