"""Saving what a learner has learned: its policy alone, or all of it, to go on teaching.

A learner and its state are a folder as a policy is (`gpcjax.policies.folder`); `gpcjax.learners.packed` makes and reads
what is in it.
"""

from pathlib import Path
from typing import Any

from gpcjax._x64 import under_own_settings
from gpcjax.allowed import shown
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner, State
from gpcjax.learners.packed import checked_learner, pack_learner, template_of, unpacked
from gpcjax.policies.folder import CARD, read_arrays, read_card, write_folder
from gpcjax.policies.saved import has_format, save_controller

_OWN = ("learner", "obs_size", "action_size")
"""What the card of a policy says of its learner."""


@under_own_settings
def save_policy(path: Any, learner: Any, state: State, **provenance: Any) -> None:
    """Writes the policy of `state` into a new folder, for `load_policy`.

    One without a form of its own, as a learner of a person's own may have, is kept as the learner that it follows from.

    Args:
        path: the folder; it must not exist.
        learner, state: whose policy.
        **provenance: JSON values for the card, such as `env="cartpole"` or `teacher="Ada"`; numpy's numbers too.

    Raises:
        FileExistsError: there is something at `path`.
        ValueError: `learner` is none, its policy is not finite, or provenance has values that are not.
        TypeError: provenance has values that JSON does not know.
    """
    learner = checked_learner(learner)
    taken = sorted(provenance.keys() & set(_OWN))
    if taken:
        raise UserError(f"{taken[0]}: the learner says it itself, leave it out")
    sizes = {"obs_size": learner.obs_size, "action_size": learner.action_size}
    told = {"learner": type(learner).__name__, **sizes, **provenance}
    controller = learner.policy_of(state).controller
    if has_format(controller):
        return save_controller(path, controller, told)
    card, arrays = pack_learner(learner, state)
    write_folder(path, {**card, "provenance": told}, arrays)


@under_own_settings
def save_learner(path: Any, learner: Any, state: State, **provenance: Any) -> None:
    """Writes a learner and its state into a new folder, for `load_learner`: all that is needed to go on teaching.

    Args:
        path: the folder; it must not exist.
        learner, state: from `make_learner` (numbers may be others), and one state of it, no batch.
        **provenance: JSON values for the card, such as `env="cartpole"` or `teacher="Ada"`; numpy's numbers too.

    Raises:
        FileExistsError: there is something at `path`.
        ValueError: a learner or a state that has no format, that is not finite, or not the learner's.
        TypeError: provenance has values that JSON does not know.
    """
    card, arrays = pack_learner(learner, state)
    write_folder(path, {**card, "provenance": provenance}, arrays)


@under_own_settings
def load_learner(path: Any) -> tuple[Learner, State]:
    """The learner and the state that `save_learner` wrote: corrections go on to the bit as if nothing had been between.

    Args:
        path: the folder that `save_learner` wrote.

    Raises:
        ValueError: there is no learner at `path`, one of another format, or one that is damaged; the message names the
            file.
    """
    card = read_card(path, "learner")
    file = Path(path) / CARD
    if card.get("kind") != "learner" or card["format"] == 1:
        raise UserError(f"{file}: this is not a learner's card (its kind is {shown(card.get('kind'))})")
    template = template_of(card, file)
    return unpacked(template, read_arrays(path, card, "learner"), Path(path))
