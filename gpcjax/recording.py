"""What happens in a session, a line of JSON for each event: kept at once, and read back to the bit.

The first line has the session's `settings` and the `place` where it stood when the recording began; each further one is
an event with its `episode` and `step` (from 0), and its `time`, seconds since the program began to record:

| `event`    | values   | Meaning                                                  |
|------------|----------|----------------------------------------------------------|
| `propose`  | `obs`, `action` | a step began, and what was proposed there          |
| `executed` | `action` | what was executed there, where that is not what was proposed |
| `advise`   | `advice` | h, -1, 0 or 1 for each action dimension                  |
| `undo`     |          | the latest advice was taken back                         |
| `end`      |          | the next step begins a new episode                       |
| `note`     | `values` | what a program wants to be kept beside; it changes nothing |

Numbers are written with all their digits. What began in another program than the event before it has a smaller `time`.
"""

import contextlib
import errno
import json
import math
import os
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gpcjax.allowed import checked_path, holds_numbers, shown
from gpcjax.errors import UserError

FORMAT = 1

RECORD = "session.jsonl"
"""The name of the file in the folder of what a person taught in the browser."""

CUT = "cut"
"""The status of an episode, in the rows of what a person taught, that somebody or something ended before the task did:
what it returned is no return of an episode."""


class Recording:
    """A file that events are appended to, each given to the operating system before `append` returns.

    It is opened for each of them: nothing is left open when its program forgets it or dies.
    """

    def __init__(self, path: Path):
        self._path = path.absolute()

    @classmethod
    def new(cls, path: Any, settings: Mapping[str, Any], place: Mapping[str, Any]) -> "Recording":
        """Begins a file. Raises UserError: there is something at `path`, or nothing can be written there."""
        path = checked_path("record", path)
        if os.path.lexists(path):
            raise UserError(
                f"record {path}: it exists, give another path, or Session.replay to go on with it"
            )
        with _writing(path):
            path.touch(exist_ok=False)
        recording = cls(path)
        recording.append({"format": FORMAT, "settings": dict(settings), "place": dict(place)})
        return recording

    @classmethod
    def again(cls, path: Any) -> "Recording":
        """Goes on with a file that was read; a line that its program did not finish is taken away.

        Raises:
            UserError: it cannot be written.
        """
        path = checked_path("record", path)
        with _writing(path):
            content = path.read_bytes()
            os.truncate(path, content.rfind(b"\n") + 1)
        return cls(path)

    def append(self, event: Mapping[str, Any]) -> None:
        """Writes one event. Raises UserError: it cannot be written, or the file was taken away."""
        self._write(_line(event).encode())

    def _write(self, lines: bytes) -> None:
        """All of it or nothing."""
        with _writing(self._path), open(self._path, "ab", buffering=0, opener=_existing) as file:
            before = file.seek(0, os.SEEK_END)
            try:
                written = file.write(lines)
                if written < len(lines):  # a full disk takes a part
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except OSError:
                with contextlib.suppress(OSError):
                    file.truncate(before)
                raise

    def flush(self) -> None:
        """Has all that was appended on the disk. Raises UserError: it cannot be written."""
        with _writing(self._path), open(self._path, "ab", opener=_existing) as file:
            os.fsync(file.fileno())

    @staticmethod
    def read(path: Any) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """The first line of a file, and its events; a last line that was not finished is left out.

        Raises:
            UserError: it cannot be read, or is no recording; the message names the line.
        """
        path = checked_path("record", path)
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "this is no text"
            raise UserError(f"{path}: it cannot be read ({reason}), give the record of a session") from None
        lines = text.split("\n")[:-1]
        parsed = [_parsed(path, number, line) for number, line in enumerate(lines, 1)]
        first = parsed[0] if parsed else {}
        tables = all(isinstance(first.get(name), dict) for name in ("settings", "place"))
        if first.get("format") != FORMAT or not tables:
            raise UserError(f"{path}: this is no record of a session, or one of another format")
        for number, event in enumerate(parsed[1:], 2):
            if not _is_event(event):
                raise UserError(f"{path}, line {number}: this is no event of a session")
        return parsed[0], parsed[1:]


class Deferred(Recording):
    """A recording whose lines are written by `flush`, from whatever thread: who appends never waits for a disk.

    What cannot be written is kept, and tried again with the next flush.
    """

    def __init__(self, path: Path):
        super().__init__(path)
        self._waiting: deque[Mapping[str, Any]] = deque()
        self._flushing = threading.Lock()

    def append(self, event: Mapping[str, Any]) -> None:
        """Takes one event."""
        self._waiting.append(event)

    def flush(self) -> None:
        """Writes all that was appended, and has it on the disk. Raises UserError: it cannot be written."""
        with self._flushing:
            # By place: an iterator of a deque breaks when another thread appends, as may happen at any collection.
            taken = [self._waiting[place] for place in range(len(self._waiting))]
            if not taken:
                return
            self._write("".join(map(_line, taken)).encode())
            for _ in taken:
                self._waiting.popleft()
            super().flush()


def as_json(values: Mapping[str, Any]) -> dict[str, Any]:
    """`values` as a line keeps them. Raises UserError: JSON knows no such value."""
    try:
        return json.loads(json.dumps(values, allow_nan=False, default=_of_numpy))
    except (TypeError, ValueError, RecursionError):
        raise UserError(
            f"note {shown(dict(values))}: give what JSON knows, texts, truth values, finite numbers, lists and tables"
        ) from None


def _of_numpy(value: Any) -> Any:
    """A number or an array of numpy's or jax's as one of Python's, or a list of them."""
    if not holds_numbers(value) and getattr(getattr(value, "dtype", None), "kind", "") != "b":
        raise TypeError
    return value.tolist()


def _line(event: Mapping[str, Any]) -> str:
    return json.dumps(event, allow_nan=False) + "\n"


def _existing(path: str, flags: int) -> int:
    return os.open(path, flags & ~os.O_CREAT)


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UserError(
            f"record {path}: it cannot be written ({error.strerror}), give another path"
        ) from None


def _parsed(path: Path, number: int, line: str) -> dict[str, Any]:
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise UserError(f"{path}, line {number}: this is no record of a session")
    return value


def _is_event(event: Mapping[str, Any]) -> bool:
    """Whether it has all that an event has, of the right kind."""
    match event:
        case {"event": "propose", "obs": [*numbers]} | {"event": "executed", "action": [*numbers]}:
            proposed = event.get("action", [])
            sound = isinstance(proposed, list) and all(map(_is_number, [*numbers, *proposed]))
        case {"event": "advise", "advice": [*advice]}:
            sound = all(type(value) is int and -1 <= value <= 1 for value in advice)
        case {"event": "undo" | "end"} | {"event": "note", "values": {}}:
            sound = True
        case _:
            return False
    # Before the first step nothing can happen but that an episode ends.
    least = {"episode": 0, "step": -1 if event["event"] in ("undo", "end", "note") else 0}
    return sound and all(type(event.get(name)) is int and event[name] >= low for name, low in least.items())


def _is_number(value: Any) -> bool:
    return type(value) is float and math.isfinite(value)
