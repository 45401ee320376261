"""Which policy is meant: one that a sweep kept, one that was saved, or an expert of a task.

Loads jax only for what needs it: a saved policy does not.
"""

import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gpcjax.errors import UserError
from gpcjax.policies.folder import CARD, read_card
from gpcjax.policies.saved import load_card, load_policy
from gpcjax.sweep.layout import MANIFEST
from gpcjax.teach.course import COURSE, SAVES

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


class Chosen(NamedTuple):
    """A policy, and what is known of it."""

    act: Act
    """A `gpcjax.policies.policy.Policy`, or an expert that is none."""
    who: str
    """For a person, in a few words."""
    env: str | None
    """The task; None where neither the folder nor the person says one."""
    seed: int
    """Of the run, or 0."""
    sizes: tuple[int, int] | None = None
    """Numbers of an observation and of an action, where the policy says them."""
    provenance: Mapping[str, Any] = {}
    """Where it comes from, as JSON has it."""
    folder: Path | None = None
    """The folder with its card; None of a run in a run folder, and of an expert."""
    card: Mapping[str, Any] = {}
    """Of that folder."""


def player_of(word: str, env: str | None, seed: int | None, where: Mapping[str, str]) -> Player:
    """What a person names, on its task; see `policy_of`.

    Raises:
        UserError: as `policy_of`, or nobody says on which task.
    """
    return on_its_task(policy_of(word, env, seed, where))


def on_its_task(chosen: Chosen) -> Player:
    """The policy on the task that its folder or a person names. Raises UserError where neither does."""
    if chosen.env is None:
        raise UserError(f"{chosen.folder}: its card names no task, give one (--env)")
    return Player(chosen.env, chosen.act, chosen.who, chosen.seed, chosen.sizes)


def check_sizes(player: Player, sizes: tuple[int, int]) -> None:
    """Refuse a policy of other sizes than its task has. Raises UserError."""
    if player.sizes not in (None, sizes):
        raise UserError(
            f"{player.who}: it takes {player.sizes[0]} numbers of an observation and gives {player.sizes[1]} actions, "
            f"{player.env} has {sizes[0]} and {sizes[1]}"
        )


def policy_of(word: str, env: str | None, seed: int | None, where: Mapping[str, str]) -> Chosen:
    """What a person names: a folder, or `ENV:EXPERT`.

    Args:
        word: a run folder, the folder of a saved policy or learner, or of `gpcjax teach`; or a task and its expert.
        env: the task, in place of the one that the folder names.
        seed: of the run in a run folder; of several runs that are left, the one that returned most is taken.
        where: columns of a run folder, and the value that the run has there.

    Raises:
        UserError: there is no policy, or one that is damaged.
    """
    folder = Path(os.path.expanduser(word))
    if where and not _has_runs(folder):
        raise UserError(f"--where: {word} is no run folder with kept policies, leave it out")
    if _has_runs(folder):
        return _of_runs(folder, env, seed, where)
    for path in (folder, folder / TAUGHT):
        if (path / CARD).is_file():
            return _saved(path, env)
    if is_lesson(folder):
        raise UserError(f"{word}: {_without_policy(folder)}")
    if folder.is_dir():
        raise UserError(
            f"{word}: no policy is there, give a run folder with kept policies (--keep policies), the folder of a "
            "saved policy or learner, or ENV:EXPERT"
        )
    return _expert(word, env)


def _has_runs(folder: Path) -> bool:
    """Whether a sweep made it; a folder of `gpcjax teach` has rows like one, but its policy lies beside them."""
    return (folder / MANIFEST).is_file() and not is_lesson(folder)


def is_lesson(folder: Path) -> bool:
    """Whether somebody teaches there (`gpcjax teach`), or has."""
    return (folder / COURSE).is_file() or (folder / TAUGHT / CARD).is_file()


def _without_policy(lesson: Path) -> str:
    """What of a lesson can be played where it has no policy of its own."""
    saves = sorted(path.parent for path in lesson.glob(f"{SAVES}/*/{CARD}"))
    if saves:
        return f"there is no policy of this lesson, give one that was saved: {', '.join(map(str, saves[:6]))}"
    return (
        "there is no policy of this lesson yet, or its learner has none that can be written down: save what it learned "
        f"on the page, and give {lesson / SAVES / 'NAME'}"
    )


def _of_runs(folder: Path, env: str | None, seed: int | None, where: Mapping[str, str]) -> Chosen:
    from gpcjax.report.words import algorithm
    from gpcjax.sweep.kept import PACKED, kept_rows, narrowed, newest
    from gpcjax.sweep.layout import tell
    from gpcjax.sweep.learned import learned_of
    from gpcjax.sweep.manifest import read_manifest

    asked = {**where, **({} if seed is None else {"seed": str(seed)})}
    chosen = narrowed(newest(kept_rows(folder, "policy", {}, tell)), asked, str(folder))
    # Of equals the first, in the order of `load`; what is no number comes last.
    returns = chosen["return"].fillna(-math.inf).to_numpy()
    row = chosen.to_dict("records")[int(returns.argmax())]
    policy = learned_of(folder, "policy", row)
    others = f", of {len(chosen):,} runs the best" if len(chosen) > 1 else ""
    who = f"{algorithm(row['algo'])}, seed {row['seed']}, after episode {row['episode']}{others}"
    env = env or read_manifest(folder)["specification"]["env"]
    provenance = {str(name): value for name, value in row.items() if name not in PACKED and value == value}
    return Chosen(policy, who, env, int(row["seed"]), _sizes(policy), provenance)


def _saved(path: Path, env: str | None) -> Chosen:
    card = read_card(path, "policy")
    if card.get("kind") == "learner":
        from gpcjax.learners.saved import load_learner

        learner, state = load_learner(path)
        policy = learner.policy_of(state)
    else:
        policy, card = load_policy(path), load_card(path)
    provenance = card.get("provenance")
    provenance = provenance if isinstance(provenance, dict) else {}
    told = env or provenance.get("env")
    told = told if isinstance(told, str) else None
    return Chosen(policy, path.name, told, 0, _sizes(policy), provenance, path, card)


def _sizes(policy: Any) -> tuple[int, int]:
    """Numbers of an observation and of an action; loads no jax for a policy that needs none."""
    acting = policy.plain or policy.controller
    return acting.obs_size, acting.action_size


def _expert(word: str, env: str | None) -> Chosen:
    """Of a task's own experts, which are none of a folder."""
    from gpcjax.envs.registry import expert_names, make_expert, shipped
    from gpcjax.policies.saved import shipped_path

    task, colon, name = word.rpartition(":")
    if not colon:
        raise UserError(
            f"{word}: there is no such folder, give one, or ENV:EXPERT such as cartpole:{expert_names('cartpole')[0]}"
        )
    if task in ("gym", "brax"):
        raise UserError(
            f"{word}: this is a task, give {word}:EXPERT, or the folder of a policy with --env {word}"
        )
    known = expert_names(task)
    if name not in known:
        raise UserError(
            f"{word}: {task} has no such expert, give {', '.join(known) or 'the folder of a policy'}"
        )
    if env is not None and env != task:
        raise UserError(f"--env {env}: {name} is an expert of {task}, leave --env out")
    if name in shipped(task):
        return _saved(shipped_path(shipped(task)[name]), task)._replace(who=f"expert {name}")
    import jax.numpy as jnp

    expert = make_expert(task, name)
    return Chosen(lambda obs: expert(jnp.asarray(obs)), f"expert {name}", task, 0)
