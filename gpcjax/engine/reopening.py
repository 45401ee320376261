"""A session made again: at the place where it was saved, or event by event from its recording."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gpcjax.engine.classroom import Classroom, rooms_of
from gpcjax.engine.course import ROOMS, SETTINGS, credit_of
from gpcjax.engine.pupil import Pupil
from gpcjax.errors import UserError
from gpcjax.learners.base import Learner, State

if TYPE_CHECKING:
    from gpcjax.engine.session import Session

Told = Callable[["Session", Mapping[str, Any], Any], None]
"""Called with a session, an event that was done again, and what its method gave."""


def reopened(
    kind: "type[Session]",
    source: str,
    learner: Learner,
    state: State | None,
    kept: Mapping[str, Any],
    classroom: Classroom | None = None,
) -> "Session":
    """A session with the settings, at the place, that `Session.save` or a recording has kept.

    Args:
        kind: of the session.
        source: begins messages.
        learner, state: those that it had there.
        kept: its `settings` and its `place`.
        classroom: where a session of a classroom is to sit; without one, in one of its own.

    Raises:
        UserError: this is no session of such a learner.
    """
    try:
        settings, place = dict(kept["settings"]), dict(kept["place"])
        if settings.keys() - {ROOMS} != SETTINGS:
            raise UserError("its settings are those of another version")
        if settings.get(ROOMS) is None:
            session = kind(learner, state, **settings)
        else:
            session = _in_classroom(kind, learner, state, settings, classroom)
        session._course.move(place)
    except UserError as error:
        raise UserError(f"{source}: {error}") from None
    except (KeyError, TypeError, ValueError):
        raise UserError(f"{source}: this is no session of such a learner") from None
    return session


def _in_classroom(
    kind: "type[Session]",
    learner: Learner,
    state: State | None,
    settings: dict[str, Any],
    classroom: Classroom | None,
) -> "Session":
    """A session in a classroom, or in one of its own: to the bit it is the same."""
    credit, rooms = credit_of(settings), rooms_of(settings[ROOMS])
    if classroom is None:
        classroom = Classroom(learner, credit, rooms, 1)
    elif rooms_of(classroom.rooms) != rooms:
        raise UserError("its dictionaries grew in other steps than they do here")
    return kind._seated(learner, classroom.enter(learner, settings["seed"], credit, state), settings)


def replay(
    session: "Session", source: Any, events: Sequence[Mapping[str, Any]], told: Told | None, check_from: int
) -> None:
    """Does what the events of a recording tell of, as `Session.replay` says.

    Raises:
        UserError: they were changed, or do not give what was recorded; the message names `source` and the line.
    """
    for number, event in enumerate(events, 2):
        try:
            quickly = event["episode"] < check_from and isinstance(session._course.desk, Pupil)
            outcome = _again(session, event, quickly)
        except UserError as error:
            raise UserError(f"{source}, line {number}: {error}") from None
        if (session.episode, session.step) != (event["episode"], event["step"]):
            raise UserError(f"{source}, line {number}: lines before it are missing, or were changed")
        if told is not None:
            told(session, event, outcome)


def _again(session: "Session", event: Mapping[str, Any], quickly: bool) -> Any:
    """Does what an event of a recording tells of, and gives what that gave."""
    match event:
        case {"event": "propose", "obs": obs, "action": action} if quickly and np.abs(action).max() < 1.0:
            return _follow(session, np.array(obs), np.array(action))
        case {"event": "propose", "obs": obs}:
            action = session.propose(obs)
            recorded = event.get("action", action.tolist())
            if action.tolist() != recorded:
                place = f"episode {session.episode}, step {session.step}"
                raise UserError(f"{place}: the action was {recorded}, it is {action.tolist()} here")
            return action
        case {"event": "executed", "action": action}:
            return session.executed(action)
        case {"event": "advise", "advice": advice}:
            return session.advise(advice)
        case {"event": "undo"}:
            return session.undo()
        case {"event": "end"}:
            return session.end_episode()
    return None


def _follow(session: "Session", obs: np.ndarray, action: np.ndarray) -> np.ndarray:
    """The step at which this action was proposed, which is within its bounds: so nothing was clipped."""
    course = session._course
    desk = course.desk
    assert isinstance(desk, Pupil)
    if course.idles:
        desk.idled()
    desk.move(obs, action, *course.flags)
    with course.recorded():
        course.stepped(obs.tolist(), action, desk.action.tolist())
    return desk.action
