"""Saving what a learner has learned."""

import os
from typing import Any

from gpcjax.learners.base import Learner, State
from gpcjax.policies.saved import save_controller


def save_policy(path: str | os.PathLike[str], learner: Learner, state: State, **provenance: Any) -> None:
    """Writes the policy of `state` into a new folder, for `load_policy`.

    Args:
        path: the folder; it must not exist.
        learner, state: whose policy.
        **provenance: JSON values for the card, such as `env="cartpole"` or `teacher="Ada"`.

    Raises:
        FileExistsError: there is something at `path`.
    """
    sizes = {"obs_size": learner.obs_size, "action_size": learner.action_size}
    save_controller(
        path, learner.controller(state), {"learner": type(learner).__name__, **sizes, **provenance}
    )
