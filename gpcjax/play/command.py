"""The command `gpcjax play`, after its words were read. Loads jax only once they are checked."""

import argparse
import functools
import math
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from gpcjax.allowed import Anything, Numbers
from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.sweep.environment import compute_here
from gpcjax.sweep.options import OPTIONS, conditions, own_values, parse
from gpcjax.teach.course import seconds_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gpcjax.play.chosen import Player
    from gpcjax.play.episodes import Moment
    from gpcjax.play.showing import Frame
    from gpcjax.play.stage import Stage
    from gpcjax.teach.world import World

SEED = Numbers(0, 2**31 - 1, whole=True)
EPISODES = Numbers(1, 1000, whole=True)
SPEED = Numbers(0.05, 100)
SECONDS = Numbers(0.1, 600)

GIF_SECONDS = 20.0
"""How much of each episode a GIF shows unless somebody says more: one of a cart-pole takes 50 s."""


class Wishes(NamedTuple):
    """How it is played."""

    seed: int | None
    episodes: int
    speed: float
    """Times real time."""
    seconds: float | None
    """Of each episode, of its own time, that are shown."""
    gif: Path | None


def play(arguments: argparse.Namespace) -> int:
    """Shows episodes of a policy in a window, or writes them as a GIF where there is none or that is asked for.

    Raises:
        UserError: a mistake of the person's.
    """
    wishes = _wishes(arguments)
    where = conditions(arguments.where)
    env = None if arguments.env is None else parse(OPTIONS["env"], arguments.env, "--env")
    compute_here()
    import gpcjax.report.figures  # noqa: F401  (before matplotlib, which it imports as a notebook's kernel allows)
    from gpcjax.play.chosen import player_of

    player = player_of(arguments.out, env, wishes.seed, where)
    return _show(player, wishes, arguments.out)


def _wishes(arguments: argparse.Namespace) -> Wishes:
    given = own_values(
        arguments,
        ("seed", int, SEED),
        ("episodes", int, EPISODES),
        ("speed", float, SPEED),
        ("seconds", float, SECONDS),
        ("gif", str, Anything("a path that ends in .gif")),
    )
    gif = Path(os.path.expanduser(given["gif"])) if "gif" in given else None
    if gif is not None and (gif.suffix.lower() != ".gif" or gif.is_dir()):
        raise UserError(f"--gif {gif}: give a path that ends in .gif")
    return Wishes(
        given.get("seed"), given.get("episodes", 1), given.get("speed", 1.0), given.get("seconds"), gif
    )


def _show(player: "Player", wishes: Wishes, word: str) -> int:
    from matplotlib.figure import Figure

    from gpcjax.play.showing import has_window, watch, write_gif
    from gpcjax.report.figures.style import publication

    world = _world(player, player.seed if wishes.seed is None else wishes.seed)
    print(player.who, flush=True)
    if wishes.gif is None and has_window():
        from matplotlib import pyplot

        with publication():
            figure = pyplot.figure(f"gpcjax play {word}")
            watch(figure, _frames(world, player, wishes, _stage(figure, world, player)))
        return 0
    path = wishes.gif if wishes.gif is not None else Path("runs", f"play-{_name_of(word)}.gif")
    few = wishes if wishes.seconds is not None else wishes._replace(seconds=GIF_SECONDS)
    _check_frames(world, player, few)
    path.parent.mkdir(parents=True, exist_ok=True)
    with publication():
        figure = Figure()
        made = write_gif(path, figure, _frames(world, player, few, _stage(figure, world, player)))
    print(f"{path}: {made.frames} frames, {made.seconds:.1f} s")
    return 0


def _check_frames(world: "World", player: "Player", wishes: Wishes) -> None:
    """Refuses a GIF that no memory holds. Raises UserError."""
    from gpcjax.play.showing import MOST_FRAMES

    every, last = _shown(player, wishes)
    each = math.floor(min(last, world.max_steps) / every) + 2
    if wishes.episodes * each > MOST_FRAMES:
        raise UserError(
            f"--episodes {wishes.episodes}: {wishes.episodes * each:,} frames are more than the {MOST_FRAMES:,} of a "
            "GIF, give fewer episodes, fewer --seconds, or a higher --speed"
        )


def _shown(player: "Player", wishes: Wishes) -> tuple[int, float]:
    """Each how many steps of an episode are seen, and the last one of them."""
    from gpcjax.play.showing import FRAMES_A_SECOND

    seconds = seconds_of(find("task", player.env))
    every = max(1, math.ceil(wishes.speed / (FRAMES_A_SECOND * seconds) - 1e-9))
    return every, math.inf if wishes.seconds is None else wishes.seconds / seconds


def _world(player: "Player", seed: int) -> "World":
    from gpcjax.envs.registry import make_env
    from gpcjax.play.chosen import check_sizes
    from gpcjax.teach.world import World

    env = make_env(player.env)
    check_sizes(player, (env.obs_size, env.action_size))
    return World(env, seed, pictures=True)


def _stage(figure: "Figure", world: "World", player: "Player") -> "Stage":
    from gpcjax.play.stage import Stage

    world.begin(0)
    picture = None
    try:
        picture = world.picture()
    except Exception as error:  # whatever a renderer meets: no OpenGL, a library that is missing
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        print(
            f"gpcjax: no pictures of {player.env} can be made here ({reason}): its numbers are shown",
            file=sys.stderr,
        )
    return Stage(figure, find("task", player.env), player.who, picture, world.sizes)


def _frames(world: "World", player: "Player", wishes: Wishes, stage: "Stage") -> "Iterator[Frame]":
    """What is seen of all episodes; each is simulated to its end, and what it returned is printed."""
    from gpcjax.play.episodes import moments
    from gpcjax.play.showing import HOLD, Frame

    step = seconds_of(find("task", player.env)) / wishes.speed
    every, last = _shown(player, wishes)
    for episode in range(1, wishes.episodes + 1):
        moment: Moment | None = None
        for moment in moments(world, player, episode):
            if moment.over or (moment.step % every == 0 and moment.step <= last):
                seen = functools.partial(_see, stage, moment, world)
                yield Frame(seen, HOLD if moment.over else every * step)
        assert moment is not None
        beginning = f", the first {wishes.seconds:g} s of it are shown" if moment.step > last else ""
        print(f"episode {episode}: return {moment.total:.6g}, {moment.step:,} steps{beginning}", flush=True)


def _see(stage: "Stage", moment: "Moment", world: "World") -> None:
    stage.show(moment, world.picture() if stage.takes_pictures else None)


def _name_of(word: str) -> str:
    """Of a file, for what was named."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", Path(word).name or Path(word).absolute().name)
