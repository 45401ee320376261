"""A recorded teacher: the advice that somebody gave in a session, at the same steps again."""

import dataclasses
import functools
import os
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int8

from gpcjax.describe import TeacherSpec
from gpcjax.elsewhere import path_here
from gpcjax.errors import UserError
from gpcjax.moment import Moment
from gpcjax.recording import RECORD, Recording
from gpcjax.teachers.base import Teacher

LARGEST = 1 << 24
"""Steps of all episodes of a recording, each counted as long as the longest."""


class Replay(Teacher):
    """Gives the advice of a recording, whatever the learner does: its coins are not looked at.

    Fields:
        table: (episodes, steps, action), h as it was given at each step.
        episode: the index of the present episode; `during` sets it.
    """

    table: Int8[Array, "episodes steps action *lanes"]
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
        look = lambda table, episode, step: table.at[episode, step].get(mode="fill", fill_value=0)  # noqa: E731
        for _ in range(step.ndim):
            look = jax.vmap(look, in_axes=-1, out_axes=-1)
        return look(self.table, self.episode, step)


def described_record(path: str, source: str) -> TeacherSpec:
    """The teacher `replay:PATH` of a sweep: a file, or the folder of what a person taught in the browser.

    Raises:
        UserError: there is no recording, or one without advice; `source` begins the message.
    """
    file = path_here(path)
    if os.path.isdir(file):
        file = os.path.join(file, RECORD)
    try:
        table = read_advice(file)
    except UserError as error:
        raise UserError(f"{source} replay:{error}") from None
    return TeacherSpec(
        name=f"replay:{path}",
        make=functools.partial(Replay, jnp.asarray(table)),
        needs_expert=False,
        action_size=table.shape[2],
        label=f"recording {Path(path).name}",
    )


def read_advice(path: str) -> np.ndarray:
    """The advice of the recording of a session: (episodes, steps, action), int8, 0 where there was none.

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
    table = np.zeros((episodes, steps, sizes.pop()), np.int8)
    for episode, step, advice in given:
        table[episode, step] = np.where(np.asarray(advice) != 0, advice, table[episode, step])
    return table
