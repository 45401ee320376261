"""`gpcjax oracles` and `gpcjax reproduce`: what is made for all, and the whole thesis. Loads no jax."""

import argparse
import os
from pathlib import Path

from gpcjax.cli.running import default_jobs, keeping, note
from gpcjax.envs.registry import env_names
from gpcjax.reproduce.parts import SWEEPS, check, chosen, folder
from gpcjax.sweep.options import OPTIONS, parse


def oracles(text: str | None) -> int:
    """`gpcjax oracles`, of these tasks."""
    names = env_names() if text is None else text.split(",")
    envs = tuple(dict.fromkeys(parse(OPTIONS["env"], name, "--env") for name in names))
    from gpcjax.sweep.executors import run_alone

    run_alone("gpcjax.sweep.oracles", *envs)
    return 0


def reproduce(arguments: argparse.Namespace) -> int:
    """`gpcjax reproduce`."""
    only, sweeps = chosen(arguments.only), Path(arguments.sweeps) if arguments.sweeps else SWEEPS
    given = {
        name: getattr(arguments, name) for name in ("out", "jobs") if getattr(arguments, name) is not None
    }
    given = {name: parse(OPTIONS[name], text, f"--{name}") for name, text in given.items()}
    out = Path(os.path.expanduser(given["out"])) if "out" in given else folder(arguments.quick)
    jobs = given.get("jobs", default_jobs())
    runs = check(sweeps, out, only, arguments.quick)
    if arguments.dry_run:
        print(f"{', '.join(only)}: {runs} experiments, in {jobs} processes, into {out}")
        return 0
    from gpcjax.reproduce.run import reproduce

    with keeping(out):
        note()
        print(reproduce(sweeps, out, only, arguments.quick, jobs))
    return 0
