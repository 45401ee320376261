"""What goes wrong in a lesson, in a line for the page. Loads no jax."""

import sys

from gpcjax.errors import Failure, ForeignError, UserError
from gpcjax.registry import built_in
from gpcjax.teach.course import Course


def problem(raised: Exception, course: Course) -> str:
    """What the page is told of something that cannot be done; the terminal is told where code of theirs failed.

    Raises:
        Exception: the same, a fault of ours.
    """
    error = _of_theirs(raised, course)
    if not isinstance(error, UserError | OSError):
        raise raised
    if isinstance(error, ForeignError) and error.details:
        print(error.details, file=sys.stderr, flush=True)
    return str(error)


def _of_theirs(error: BaseException, course: Course) -> BaseException:
    """What was raised; of a learner of a person's own as its own. A task's is told by `World`."""
    told = isinstance(error, UserError | Failure | OSError) or not isinstance(error, Exception)
    if told or course.algo in built_in("learner"):
        return error
    return ForeignError(f"algo {course.algo}: it fails", error)


def reason(error: BaseException) -> str:
    """Why a lesson ended."""
    return str(error) if isinstance(error, UserError | Failure | OSError) else f"a fault of gpcjax: {error!r}"
