"""What the last bits of a sweep's rows depend on beside the versions: the processor and what XLA and BLAS make of it.

The same program rounds differently where vectors are wider, where there is a fused multiply-add, or where BLAS chooses
other kernels: "AMD EPYC" is the name of processors that differ in all three. So the manifest tells what counts. Rows
are the same bits on one kind of machine (`kind_of`); on others they agree within the intervals that a report gives.
Loads no jax.
"""

import ctypes
import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gpcjax.sweep.environment import compute_platform, worker_environment

CPUINFO = Path("/proc/cpuinfo")

_VECTORS = re.compile(
    r"(sse\w*|ssse3|avx\w*|fma\w*|f16c|bmi[12]|amx\w*|gfni|vaes|asimd\w*|sve\w*|neon|fphp|bf16|i8mm)"
)
"""Features of a processor, as Linux names them, that compilers of arithmetic look at."""

_WIDTH = re.compile(r"--xla_cpu_prefer_vector_width=(\d+)")

_BITS = ("architecture", "cpu_family", "cpu_model", "vector_features", "vector_width", "xla_flags", "lapack")
"""Entries of `describe` that decide about bits."""
_MAY_BE = ("accelerator",)
"""The same, of some machines only."""


def describe() -> dict[str, Any]:
    """What the manifest says of the present machine: texts and numbers by name.

    `vector_width` is what XLA is told to prefer, in bits (0: its own choice); `lapack` the library of scipy that jaxlib
    calls for factorisations, with the kernels that it has chosen here.
    """
    cpu = _cpuinfo()
    flags = worker_environment().get("XLA_FLAGS", "")
    widths = _WIDTH.findall(flags)
    features = cpu.get("flags", cpu.get("Features", "")).split()
    told = {
        "platform": platform.platform(),
        "processor": cpu.get("model name", platform.processor()),
        "cores": os.cpu_count(),
        "architecture": f"{platform.system()} {platform.machine()}",
        "cpu_family": cpu.get("cpu family", cpu.get("CPU implementer", "")),
        "cpu_model": " ".join(
            cpu[name] for name in ("model", "stepping", "CPU part", "CPU revision") if name in cpu
        ),
        "vector_features": " ".join(sorted(filter(_VECTORS.fullmatch, features))),
        "vector_width": int(widths[-1]) if widths else 0,
        "xla_flags": flags,
        "lapack": _lapack(),
    }
    if (accelerator := compute_platform()) != "cpu":
        told["accelerator"] = f"{accelerator} {_graphics_card()}".strip()
    return told


def kind_of(machine: Mapping[str, Any]) -> str:
    """Twelve hex digits that machines share on which a sweep gives the same bits, as far as a manifest can tell.

    Empty for a machine of an old manifest, which does not say.
    """
    if not all(name in machine for name in _BITS):
        return ""
    bits = [machine[name] for name in _BITS] + [machine[name] for name in _MAY_BE if name in machine]
    text = json.dumps(bits)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """Names of the entries, of those that decide about bits, that are not the same."""
    return [name for name in (*_BITS, *_MAY_BE) if one.get(name) != other.get(name)]


def _cpuinfo() -> dict[str, str]:
    """What Linux says of the first core."""
    try:
        text = CPUINFO.read_text()
    except OSError:
        return {}
    entries = (line.partition(":") for line in text.split("\n\n")[0].splitlines())
    return {name.strip(): value.strip() for name, _, value in entries}


def _graphics_card() -> str:
    """Name of the first card that Nvidia's driver knows; empty where it tells none."""
    try:
        command = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
        told = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return told.stdout.partition("\n")[0].strip()


@functools.cache
def _lapack() -> str:
    """Version and kernels of scipy's OpenBLAS; where scipy brings none, its own version alone."""
    version = f"scipy {importlib.metadata.version('scipy')}"
    found = importlib.util.find_spec("scipy")
    if found is None or found.origin is None:
        return version
    for path in sorted(Path(found.origin).parents[1].glob("scipy.libs/libscipy_openblas*")):
        try:
            library = ctypes.CDLL(str(path))
            config, kernels = library.scipy_openblas_get_config, library.scipy_openblas_get_corename
            config.restype = kernels.restype = ctypes.c_char_p
            name = " ".join(config().decode().split()[:2])
            return f"{version}, {name}, kernels {kernels().decode()}"
        except (OSError, AttributeError):
            continue
    return version
