"""A recorded teacher: the advice that somebody gave in a session, at the same steps again."""

import dataclasses
import functools
import os
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int8, Int32

from gpcjax.describe import TeacherSpec
from gpcjax.elsewhere import path_here
from gpcjax.errors import UserError
from gpcjax.moment import Moment
from gpcjax.recording import RECORD, Recording
from gpcjax.teachers.base import Teacher

LARGEST = 1 << 31
"""Steps of all episodes of a recording, each counted as long as the longest: moments have numbers of 32 bits."""


class Replay(Teacher):
    """Gives the advice of a recording, whatever the learner does: its coins are not looked at.

    Fields:
        moments: (n,), when there was advice, in order: `episode * longest + step`.
        given: (n, action), h as it was given then.
        longest: steps of an episode, at most.
        episode: the index of the present episode; `during` sets it.
    """

    moments: Int[Array, "n *lanes"]
    given: Int8[Array, "n action *lanes"]
    longest: Int[Array, "*lanes"]
    episode: Int[Array, "*lanes"] | None = None

    def during(self, episode: Int[Array, "*lanes"]) -> "Replay":
        return dataclasses.replace(self, episode=episode)

    def chance(self, sigma_human: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """1: where the recording has advice, it is given."""
        return jnp.ones_like(sigma_human)

    def may_advise(
        self,
        coins: Float[Array, "action *lanes"],
        largest_sigma: Float[Array, "*lanes"],
        step: Int[Array, "*lanes"],
    ) -> Bool[Array, "action *lanes"]:
        return self._at(step) != 0

    def advise(self, coins: Float[Array, "action *lanes"], moment: Moment) -> Float[Array, "action *lanes"]:
        return self._at(moment.step).astype(float)

    def _at(self, step: Int[Array, "*lanes"]) -> Int8[Array, "action *lanes"]:
        assert self.episode is not None
        look = _looked_up
        for _ in range(step.ndim):
            look = jax.vmap(look, in_axes=-1, out_axes=-1)
        return look(self.moments, self.given, self.longest, self.episode, step)


def _looked_up(
    moments: Int[Array, " n"],
    given: Int8[Array, "n action"],
    longest: Int[Array, ""],
    episode: Int[Array, ""],
    step: Int[Array, ""],
) -> Int8[Array, " action"]:
    """What was given at a step of one lane; zeros where nothing was."""
    # A later episode than any of the recording has no number.
    known = (step < longest) & (episode <= moments[-1] // longest)
    moment = jnp.where(known, episode * longest + step, -1).astype(moments.dtype)
    place = jnp.searchsorted(moments, moment)
    return jnp.where(known & (moments[place] == moment), given[place], 0)


def described_record(path: str, source: str) -> TeacherSpec:
    """The teacher `replay:PATH` of a sweep: a file, or the folder of what a person taught in the browser.

    Raises:
        UserError: there is no recording, or one without advice; `source` begins the message.
    """
    file = path_here(path)
    if os.path.isdir(file):
        file = os.path.join(file, RECORD)
    try:
        recorded = read_advice(file)
    except UserError as error:
        raise UserError(f"{source} replay:{error}") from None
    return TeacherSpec(
        name=f"replay:{path}",
        make=functools.partial(Replay, *map(jnp.asarray, recorded)),
        needs_expert=False,
        action_size=recorded.given.shape[1],
        label=f"recording {Path(path).name}",
    )


class Advice(NamedTuple):
    """The advice of a recording, as `Replay` has it."""

    moments: Int32[np.ndarray, " n"]
    given: Int8[np.ndarray, "n action"]
    longest: np.int32


def read_advice(path: str) -> Advice:
    """The advice of the recording of a session, where there was any.

    Of several at one step the last one holds, for each action dimension; what was undone was not given.

    Raises:
        UserError: it is no recording, has no advice, or advice of different sizes.
    """
    given: list[tuple[int, int, list[int]]] = []
    for event in Recording.read(path)[1]:
        match event:
            case {"event": "advise", "advice": [*advice]}:
                given.append((event["episode"], event["step"], advice))
            case {"event": "undo"} if given:
                given.pop()
    if not given:
        raise UserError(f"{path}: nobody gave advice in this session")
    sizes = {len(advice) for _, _, advice in given}
    values = {value for _, _, advice in given for value in advice}
    if len(sizes) > 1 or not values <= {-1, 0, 1}:
        raise UserError(f"{path}: its advice has different sizes, or other values than -1, 0 and 1")
    episodes, steps = 1 + max(each[0] for each in given), 1 + max(each[1] for each in given)
    if episodes * steps > LARGEST:
        raise UserError(
            f"{path}: {episodes:,} episodes of {steps:,} steps are too many, at most {LARGEST:,} in all"
        )
    held: dict[int, np.ndarray] = {}
    for episode, step, advice in given:
        latest, moment = np.asarray(advice, np.int8), episode * steps + step
        held[moment] = np.where(latest != 0, latest, held.get(moment, latest))
    moments = sorted(held)
    return Advice(np.array(moments, np.int32), np.array([held[each] for each in moments]), np.int32(steps))
