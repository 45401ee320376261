"""Whether a recording is one of a lesson: its settings, and that each episode ends once."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gpcjax.allowed import shown
from gpcjax.engine.classroom import Rooms, rooms_of
from gpcjax.engine.course import ROOMS
from gpcjax.engine.session import Session
from gpcjax.errors import UserError


def rooms_in(record: Path, settings: Mapping[str, Any]) -> Rooms | None:
    """The rooms of a session in a classroom, as its recording names them; None of any other session.

    Raises:
        UserError: they are none.
    """
    try:
        return None if settings.get(ROOMS) is None else rooms_of(settings[ROOMS])
    except (TypeError, ValueError):
        raise UserError(f"{record}: {ROOMS} {shown(settings[ROOMS])} are none of a session") from None


def check_end(record: Path, session: Session, event: Mapping[str, Any], finished: int) -> None:
    """That an episode ends once, with a note of what it came to, and only then.

    Args:
        record: begins messages.
        session: after the event.
        event: of the recording.
        finished: episodes of which there was such a note before.

    Raises:
        UserError: such lines are lost, changed, or there twice.
    """
    place = f"{record}: episode {session.episode}"
    match event:
        case {"event": "note", "values": {"ended": _} as values}:
            if not _is_end(values):
                raise UserError(f"{place}: what is noted of its end is damaged ({shown(dict(values))})")
            sound = finished == session.episode
        case {"event": "end"}:
            sound = finished == session.episode + 1
        case {"event": "propose"}:
            sound = finished == session.episode
        case _:
            return
    if not sound:
        raise UserError(
            f"{place}: it is noted of {finished} episodes how they ended, lines are missing or doubled"
        )


def _is_end(values: Mapping[str, Any]) -> bool:
    match values:
        case {"ended": str(), "total": float(), "length": int(length)}:
            return type(length) is int and length >= 0  # true is an int to Python
    return False
