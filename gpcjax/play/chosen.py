"""Which policy is played: one that a sweep kept, one that was saved, or an expert of a task."""

import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp

from gpcjax.envs.registry import expert_names, make_expert
from gpcjax.errors import UserError
from gpcjax.learners.saved import load_learner
from gpcjax.policies.folder import CARD, read_card
from gpcjax.policies.saved import load_card, load_policy
from gpcjax.report.words import algorithm
from gpcjax.sweep.kept import kept_rows, narrowed, newest
from gpcjax.sweep.layout import MANIFEST
from gpcjax.sweep.learned import learned_of
from gpcjax.sweep.manifest import read_manifest

TAUGHT = "policy"
"""In a folder of `gpcjax teach`, that of the policy so far."""

Act = Callable[[Any], Any]


class Player(NamedTuple):
    """A policy on a task."""

    env: str
    act: Act
    """obs (obs_size,) -> action (action_size,) in [-1, 1]"""
    who: str
    """For a person, in a few words."""
    seed: int
    """Of the starts, where nobody says another one."""
    sizes: tuple[int, int] | None = None
    """Numbers of an observation and of an action, where the policy says them."""


def player_of(word: str, env: str | None, seed: int | None, where: Mapping[str, str]) -> Player:
    """What a person names: a folder, or `ENV:EXPERT`.

    Args:
        word: a run folder, the folder of a saved policy or learner, or of `gpcjax teach`; or a task and its expert.
        env: the task, in place of the one that the folder names.
        seed: of the run in a run folder; of several runs that are left, the one that returned most is taken.
        where: columns of a run folder, and the value that the run has there.

    Raises:
        UserError: there is no policy, or nobody says on which task.
    """
    folder = Path(os.path.expanduser(word))
    if where and not _has_runs(folder):
        raise UserError(f"--where: {word} is no run folder with kept policies, leave it out")
    if _has_runs(folder):
        return _of_runs(folder, env, seed, where)
    for path in (folder, folder / TAUGHT):
        if (path / CARD).is_file():
            return _saved(path, env)
    if folder.is_dir():
        raise UserError(
            f"{word}: no policy is there, give a run folder with kept policies (--keep policies), the folder of a "
            "saved policy or learner, or ENV:EXPERT"
        )
    return _expert(word, env)


def _has_runs(folder: Path) -> bool:
    """Whether a sweep made it; a folder of `gpcjax teach` has rows like one, but its policy lies beside them."""
    return (folder / MANIFEST).is_file() and not (folder / TAUGHT / CARD).is_file()


def _of_runs(folder: Path, env: str | None, seed: int | None, where: Mapping[str, str]) -> Player:
    asked = {**where, **({} if seed is None else {"seed": str(seed)})}
    chosen = narrowed(newest(kept_rows(folder, "policy", {})), asked, str(folder))
    # Of equals the first, in the order of `load`; what is no number comes last.
    returns = chosen["return"].fillna(-math.inf).to_numpy()
    row = chosen.to_dict("records")[int(returns.argmax())]
    policy = learned_of(folder, "policy", row)
    others = f", of {len(chosen):,} runs the best" if len(chosen) > 1 else ""
    who = f"{algorithm(row['algo'])}, seed {row['seed']}, after episode {row['episode']}{others}"
    sizes = policy.controller.obs_size, policy.controller.action_size
    return Player(env or read_manifest(folder)["specification"]["env"], policy, who, int(row["seed"]), sizes)


def _saved(path: Path, env: str | None) -> Player:
    if read_card(path, "policy")["kind"] == "learner":
        learner, state = load_learner(path)
        policy, card = learner.policy_of(state), read_card(path, "learner")
    else:
        policy, card = load_policy(path), load_card(path)
    told = env or card.get("provenance", {}).get("env")
    if not isinstance(told, str):
        raise UserError(f"{path}: its card names no task, give one (--env)")
    return Player(told, policy, path.name, 0, (policy.controller.obs_size, policy.controller.action_size))


def _expert(word: str, env: str | None) -> Player:
    """Of a task's own experts, which are none of a folder."""
    task, colon, name = word.rpartition(":")
    if not colon:
        raise UserError(
            f"{word}: there is no such folder, give one, or ENV:EXPERT such as cartpole:{expert_names('cartpole')[0]}"
        )
    known = expert_names(task)
    if name not in known:
        raise UserError(
            f"{word}: {task} has no such expert, give {', '.join(known) or 'the folder of a policy'}"
        )
    if env is not None and env != task:
        raise UserError(f"--env {env}: {name} is an expert of {task}, leave --env out")
    expert = make_expert(task, name)
    return Player(task, lambda obs: expert(jnp.asarray(obs)), f"expert {name}", 0)
