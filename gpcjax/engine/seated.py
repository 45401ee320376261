"""Sessions in a classroom: each learner is a lane of blocks that others share; a block's step in one call."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gpcjax.engine.classroom import Classroom
from gpcjax.engine.course import ROOMS, credit_of
from gpcjax.engine.pupil import Pupil, idle, propose
from gpcjax.engine.session import Session, no_number
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner
from gpcjax.policies.vectors import near
from gpcjax.recording import Deferred


def in_classroom(
    classroom: Classroom, learner: Learner, settings: Mapping[str, Any], recording: Path
) -> Session:
    """A new session on a free desk of a classroom, which writes its recording (`Deferred`).

    Args:
        classroom: for learners of this structure.
        learner: with the numbers of this session.
        settings: `credit`, `credit_longest`, `credit_shape`, `time_step` and `seed` of a session.
        recording: as `record` of a session.

    Raises:
        UserError: all places are taken, or the recording cannot be written.
    """
    settings = {**settings, "undos": 0, ROOMS: classroom.rooms}
    desk = classroom.enter(learner, settings["seed"], credit_of(settings))
    session = Session._seated(learner, desk, settings)
    try:
        deferred = Deferred.new(recording, session._course.settings, session._course.place())
        deferred.flush()
        session._course.record(deferred)
    except UserError:
        classroom.leave(desk)
        raise
    return session


def leave(session: Session) -> None:
    """Gives the session's desk in a classroom back: nothing follows."""
    _pupil(session).leave()


def propose_together(
    sessions: Sequence[Session], observations: Float[np.ndarray, "sessions obs"]
) -> list[UserError | None]:
    """`Session.propose` of each session of one classroom at its observation, in one call for each block.

    Their recordings are deferred. Gives what each of them raised.
    """
    pupils = [_pupil(session) for session in sessions]
    courses = [session._course for session in sessions]
    idle([pupil for course, pupil in zip(courses, pupils, strict=True) if course.idles])
    observations = np.where(np.isfinite(observations), near(observations), observations)
    proposed, finite = propose(pupils, observations)
    actions = proposed.clip(-1.0, 1.0)
    raised: list[UserError | None] = []
    for course, pupil, obs, each, action, sound in zip(
        courses, pupils, observations, proposed, actions, finite.tolist(), strict=True
    ):
        if sound:
            pupil.move(obs, action, *course.flags)
            course.stepped(obs.tolist(), each, action.tolist())
        raised.append(None if sound else no_number(obs))
    return raised


def _pupil(session: Session) -> Pupil:
    desk = session._course.desk
    assert isinstance(desk, Pupil)
    return desk
