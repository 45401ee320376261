"""The commands `gpcjax policy ...`, after their words were read. Loads no jax before they are checked."""

import argparse
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

from gpcjax.allowed import Anything, Numbers
from gpcjax.deploy.export import FORMATS, NAMES, TO, checked_file, checked_name, export
from gpcjax.errors import UserError
from gpcjax.sweep.environment import compute_here
from gpcjax.sweep.options import OPTIONS, conditions, own_values, parse

if TYPE_CHECKING:
    from gpcjax.play.chosen import Chosen

SEED = Numbers(0, 2**31 - 1, whole=True)
FIRST_SEED = Numbers(0, 1_000_000_000, whole=True)
EPISODES = Numbers(1, 100_000, whole=True)
USUAL_EPISODES = 100


def policy(arguments: argparse.Namespace) -> int:
    """Runs the one that is named.

    Raises:
        UserError: a mistake of the person's.
    """
    match arguments.part:
        case "info":
            return _info(arguments)
        case "eval":
            return _eval(arguments)
        case "export":
            return _export(arguments)
    return _gif(arguments)


def _chosen(arguments: argparse.Namespace, seed: int | None) -> "Chosen":
    where = conditions(arguments.where)
    env = None if arguments.env is None else parse(OPTIONS["env"], arguments.env, "--env")
    compute_here()
    from gpcjax.play.chosen import policy_of

    return policy_of(arguments.policy, env, seed, where)


def _info(arguments: argparse.Namespace) -> int:
    given = own_values(arguments, ("seed", int, SEED))
    chosen = _chosen(arguments, given.get("seed"))
    from gpcjax.deploy import facts

    if arguments.json:
        print(json.dumps(facts.as_json(chosen)))
        return 0
    from gpcjax.report.terminal import show_facts

    show_facts(chosen.who, facts.facts(chosen))
    return 0


def _eval(arguments: argparse.Namespace) -> int:
    given = own_values(arguments, ("seed", int, FIRST_SEED), ("episodes", int, EPISODES))
    chosen = _chosen(arguments, None)
    from gpcjax.deploy import evaluation
    from gpcjax.play.chosen import on_its_task

    found = evaluation.evaluated(
        on_its_task(chosen), given.get("episodes", USUAL_EPISODES), given.get("seed", 0)
    )
    if arguments.json:
        print(json.dumps(evaluation.as_json(found)))
        return 0
    from gpcjax.report.terminal import show_facts, show_sheet

    show_sheet(evaluation.sheet(found))
    print()
    show_facts(chosen.who, evaluation.facts(found))
    return 0


def _export(arguments: argparse.Namespace) -> int:
    given = own_values(
        arguments,
        ("seed", int, SEED),
        ("to", str, TO),
        ("name", str, Anything(NAMES)),
        ("out", str, Anything("the path of a file")),
    )
    to, out = given.get("to"), given.get("out")
    if to is None and out is None:
        raise UserError(f"--to is missing: give {TO}")
    if "name" in given:
        checked_name(given["name"])
    out = Path("runs", f"{_name_of(arguments.policy)}{FORMATS[str(to)].suffix}") if out is None else Path(out)
    checked_file(out, to, "--out")
    made = export(_chosen(arguments, given.get("seed")), out, to, given.get("name"), "--out")
    size = made.file.stat().st_size
    if arguments.json:
        print(json.dumps({**made._asdict(), "file": str(made.file), "bytes": size}))
    else:
        print(f"{made.file}: {made.call}; {size:,} bytes")
    return 0


def _gif(arguments: argparse.Namespace) -> int:
    from gpcjax.play.command import play

    out = str(Path("runs", f"{_name_of(arguments.policy)}.gif")) if arguments.out is None else arguments.out
    if Path(out).suffix.lower() != ".gif" or Path(os.path.expanduser(out)).is_dir():
        raise UserError(f"--out {out}: give a path that ends in .gif")
    return play(argparse.Namespace(**{**vars(arguments), "out": arguments.policy, "gif": out}))


def _name_of(word: str) -> str:
    """Of a file, for what was named."""
    from gpcjax.deploy.label import identifier

    return identifier(Path(os.path.expanduser(word)).absolute().name)
