"""What ends a command in one line: a person's mistake, or a run that failed without one."""

import errno
import os
from typing import Any

_HERE = os.path.dirname(os.path.abspath(__file__)) + os.sep

_OF_THE_MACHINE = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EROFS,
    errno.EFBIG,
    errno.EIO,
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
)


class UserError(ValueError):
    """A request that cannot be met as it was made.

    Its message is one sentence that names the value (or the file and key) and what is allowed. The command line
    prints it as one line and ends with status 2.
    """


class Unwritten(UserError):
    """Something that cannot be written for the want of a disk, which is no mistake of a person's.

    The command line ends with status 1.
    """


def unwritten(error: OSError, message: str) -> UserError:
    """What this error of the system, at writing, is to a person: of the machine, or of what they asked for."""
    return Unwritten(message) if error.errno in _OF_THE_MACHINE else UserError(message)


class Failure(RuntimeError):
    """A run that ended for a reason of the machine or of ours: what was finished is kept.

    Its message is one sentence that names the reason. The command line prints it as one line and ends with status 1.
    """

    def __init__(self, message: str, details: str = ""):
        super().__init__(message)
        self.details = details
        """The full text of an error that is no fault of the machine, a traceback; else empty."""


class ForeignError(UserError):
    """Somebody else's code that failed: a task, a learner or a teacher of a person's own.

    Its message is one sentence that ends with the error's own; the command line prints `details` before it, the
    traceback from the first line on that is theirs, and ends with status 2.
    """

    def __init__(self, message: str, error: BaseException | str, details: str = ""):
        if isinstance(error, BaseException):
            text = " ".join(str(error).split())
            line = f"{type(error).__name__}{f': {text[:300]}' if text else ''}"
            details = details or _theirs(error)
        else:
            line = error
        super().__init__(f"{message} ({line})")
        self.arguments = message, line, details
        """What makes it again, also in another process."""
        self.details = details

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self.arguments


def _theirs(error: BaseException) -> str:
    """The traceback without the frames of ours, and of Python's imports, that led there."""
    import traceback

    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None and _is_ours(frame.tb_frame.f_code.co_filename):
        frame = frame.tb_next
    return "".join(traceback.format_exception(type(error), error, frame))


def _is_ours(filename: str) -> bool:
    return filename.startswith((_HERE, "<frozen ")) or f"{os.sep}importlib{os.sep}" in filename
