"""The commands `gpcjax teach` and `gpcjax replay`, after their words were read and checked."""

import contextlib
import sys
from pathlib import Path

from gpcjax.errors import UserError
from gpcjax.sweep.environment import compute_here
from gpcjax.teach.course import COURSE, Course, new_folder
from gpcjax.teach.lesson import Lesson
from gpcjax.teach.origin import Origin
from gpcjax.teach.standing import Options, Say

EXTRA = "gpcjax teach needs its extra: pip install 'gpcjax[teach]' ({})"

SWITCH_SECONDS = 0.0005
"""How long a thread may keep Python while another waits, of the usual 5 ms: no step waits for what is compiled."""

ENDED = 130
"""The status of what Ctrl-C stops: here it is how a lesson ends."""


def teach(
    folder: Path | None,
    course: Course | None,
    origin: Origin | None,
    options: Options,
    host: str,
    port: int | None,
) -> int:
    """Holds a lesson until it is stopped.

    Args:
        folder: what is taught there goes on; None makes a new one.
        course: what is taught, None to go on with what the folder has.
        origin: what to begin with: a saved learner, or a run.
        options: how.
        host, port: where it listens; without a port on the first from 8765 on that is free.

    Raises:
        UserError: a mistake of the person's.
    """
    try:
        from gpcjax.teach.server import Serving
    except ImportError as error:
        raise UserError(EXTRA.format(error)) from None
    if folder is not None and (folder / COURSE).exists():
        here = Course.read(folder)
        if course is not None and course != here:
            raise UserError(
                f"{folder}: {here.algo} is taught {here.env} there, with other settings: give a new folder"
            )
        course = None
    elif course is None:
        raise UserError(
            f"no env: give one (--env), or a folder of gpcjax teach to go on with (--out {folder or 'OUT'})"
        )
    elif folder is not None and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UserError(f"{folder}: it holds something else, give a new folder (--out)")
    made = folder if folder is not None else new_folder(course.env if course else "")
    fresh = not made.exists()
    try:
        made.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"{made}: nothing can be written there ({error.strerror}), give a new folder"
        ) from None
    compute_here()
    sys.setswitchinterval(SWITCH_SECONDS)

    def lesson(say: Say) -> Lesson:
        return Lesson(made, course, origin, options, say)

    stopped: KeyboardInterrupt | None = None
    try:
        serving = Serving(lesson, host, port)
        print(f"open {serving.address} in a browser; Ctrl-C ends the lesson, {made} keeps it", flush=True)
        try:
            serving.run()
        except KeyboardInterrupt as stop:
            stopped = stop
    except BaseException:
        if fresh:
            with contextlib.suppress(OSError):
                made.rmdir()  # only what is empty: nothing was begun
        raise
    print(f"kept in {serving.lesson.folder}: gpcjax teach --out {serving.lesson.folder} goes on with it")
    if stopped is not None and getattr(stopped, "status", ENDED) != ENDED:
        raise stopped
    return 0


def replay(folder: Path) -> int:
    """Makes a lesson again from its recording, and says whether it comes to the same.

    Raises:
        UserError: it is damaged, or comes to something else; the message names the step.
    """
    Course.read(folder)
    compute_here()
    from gpcjax.teach.taught import Taught

    taught = Taught.resume(folder, lambda line: print(line, file=sys.stderr, flush=True), whole=True)
    finished, tally = taught.tally.finished, taught.tally
    for index, episode in enumerate(finished):
        print(
            f"episode {index + 1}: return {episode.total:g}, {episode.length} steps, {episode.corrections} corrections"
        )
    steps = sum(episode.length for episode in finished) + taught.present.length
    print(f"{folder}: the same to the bit, {steps:,} steps and {tally.corrections:,} corrections")
    return 0
