"""The file of a study, read and checked: each mistake is told with file, key, value and what to give. Loads no jax."""

from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from gpcjax.allowed import FINITE, NON_NEGATIVE, SWITCH, Numbers, OneOf, checked, shown
from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.study.design import LETTERS, ORDERS, Arm, Cell, cells, slots
from gpcjax.study.questions import question_of
from gpcjax.study.spec import CODE_WORDS, Check, Ending, Joining, Runs, Study, Trial, is_code
from gpcjax.study.tables import REQUIRED, Table, once
from gpcjax.sweep.given import Given
from gpcjax.sweep.spec import accepted_of
from gpcjax.sweep.tomlfile import read_file
from gpcjax.teach.course import Course

SEED = Numbers(0, 900_000_000, whole=True)
PARTICIPANTS = Numbers(1, 9999, whole=True)
RUNS = Numbers(0, 40, whole=True)
"""Of one kind, of one learner on one task: their seeds are the participant's and a number below a hundred."""
EPISODES = Numbers(1, 1000, whole=True)
MINUTES = Numbers(0, 600, above=True)
SECONDS = Numbers(0, 3600)
DELAY = Numbers(0, 5)
TIMES = Numbers(1, 100, whole=True)
PIXELS = Numbers(1, 10_000, whole=True)
RATE = Numbers(1, 500)
HOURS = Numbers(0, 24 * 365, above=True)
"""Values of the keys."""

PARAMETERS = ("PROLIFIC_PID", "survey_code", "code")
"""Of Prolific, of SONA, and plain."""


def read_study(path: Path) -> Study:
    """The study of a TOML file.

    Raises:
        UserError: it cannot be read, or something in it is missing, unknown, not allowed, or does not fit.
    """
    table = Table(read_file(path), f"{path}: ")
    title = table.take("title", str)
    seed = table.take("seed", int, SEED, 0)
    participants = table.take("participants", int, PARTICIPANTS)
    tasks = table.several("tasks")
    for name in tasks:
        find("task", name, table.source("tasks"))
    learners = _learners(table)
    within = table.take("arms_are", str, OneOf(("between", "within")), "between") == "within"
    arms, courses = _arms(table, learners, tasks, within)
    outer, every, most = _orders(table.table("orders"), arms, within, tasks)
    given = slots(every, participants, seed, most, arms)
    if len(given) < participants:
        raise UserError(
            f"{table.source('participants')} {participants}: the caps of orders and arms leave room for {len(given)}, "
            "give fewer or raise them"
        )
    questions = tuple(question_of(each) for each in table.tables("questions"))
    once((each.name for each in questions), table.source("[[questions]] name"))
    study = Study(
        title=title,
        seed=seed,
        participants=participants,
        tasks=tasks,
        courses=courses,
        arms=arms,
        within=within,
        outer=outer,
        runs=_runs(table.table("runs"), tasks),
        consent=_text(table.table("consent")),
        instructions=_text(table.table("instructions")),
        check=_check(table.table("check")),
        trial=_trial(table.table("trial"), learners) if "trial" in table else None,
        questions=questions,
        completed=_ending(table.table("completed"), "You have completed the study. Thank you."),
        declined=_ending(table.table("declined"), "You have left the study. You can close this page."),
        failed=_ending(table.table("failed"), "You cannot take part. You can close this page."),
        joining=_joining(table.table("joining")),
        slots=given,
    )
    table.done()
    return study


class _Learner(NamedTuple):
    algo: str
    settings: dict[str, Any]
    place: str


def _learners(table: Table) -> dict[str, _Learner]:
    """By the name that each has in this study."""
    found: dict[str, _Learner] = {}
    tables = table.tables("learners")
    if not tables:
        raise UserError(f"{table.source('learners')} is missing: begin each with a line [[learners]]")
    for each in tables:
        algo = each.take("algo", str)
        find("learner", algo, each.source("algo"))
        name = each.take("name", str, default=algo)
        once([*found, name], each.source("name"))
        found[name] = _Learner(algo, each.rest(), each.place)
    return found


def _arms(
    table: Table, learners: dict[str, _Learner], tasks: tuple[str, ...], within: bool
) -> tuple[tuple[Arm, ...], dict[tuple[str, str, str], Course]]:
    """The arms, and what is taught in them; without any in the file, one."""
    arms: list[Arm] = []
    courses: dict[tuple[str, str, str], Course] = {}
    for each in table.tables("arms") or [Table({"name": "all"}, table.place)]:
        whom = each.several("learners", OneOf(tuple(learners)), tuple(learners))
        arm = Arm(
            name=each.take("name", str),
            learners=whom,
            cue=each.take("cue", bool, SWITCH, False),
            delay=float(each.take("delay", float, DELAY, 0.0)),
            most=each.take("participants", int, PARTICIPANTS, None),
        )
        unsure = [name for name in whom if not find("learner", learners[name].algo).uncertain]
        if arm.cue and unsure:
            apart = ", which would tell them apart" if len(unsure) < len(whom) else ""
            raise UserError(
                f"{each.source('cue')}: {', '.join(unsure)} cannot say how sure it is{apart}: give learners "
                "that can, or no cue"
            )
        if arm.most is not None and within:
            raise UserError(
                f"{each.source('participants')}: each participant has every arm here, leave it out, or give "
                'arms_are = "between"'
            )
        once([*(one.name for one in arms), arm.name], each.source("name"))
        arms.append(arm)
        own = each.rest()
        for name in whom:
            for task in tasks:
                courses[name, arm.name, task] = _course(learners[name], task, own, each.place)
    if sum(len(arm.learners) for arm in arms) > len(LETTERS):
        raise UserError(f"{table.place}more than {len(LETTERS)} learners and arms: there are no letters left")
    return tuple(arms), courses


def _course(learner: _Learner, task: str, settings: dict[str, Any], place: str) -> Course:
    """What a learner is taught, with its own settings and those of an arm, which win."""
    given = accepted_of(learner.settings, learner.place) | accepted_of(settings, place)
    for name, setting in given.items():
        if name in ("env", "algo"):
            raise UserError(f"{setting.source}: it is known already, leave it out")
    return Course.of({"env": Given(task, "tasks"), "algo": Given((learner.algo,), "algo"), **given})


def _orders(
    table: Table, arms: tuple[Arm, ...], within: bool, tasks: tuple[str, ...]
) -> tuple[str, tuple[Cell, ...], int | None]:
    """What changes slowest, all cells, and how many participants one of them may have."""
    kind = OneOf(ORDERS)
    outer = table.take("outer", str, OneOf(("tasks", "learners")), "tasks")
    of_learners, of_tasks = (table.take(name, str, kind, "complete") for name in ("learners", "tasks"))
    most = table.take("participants", int, PARTICIPANTS, None)
    try:
        every = cells(arms, within, tasks, of_learners, of_tasks)
    except UserError as error:
        raise UserError(f"{table.place}{error}") from None
    table.done()
    return outer, every, most


def _runs(table: Table, tasks: tuple[str, ...]) -> Runs:
    found = Runs(
        dummy=table.take("dummy", int, RUNS, 2),
        recorded=table.take("recorded", int, RUNS, 2),
        episodes=_episodes(table, tasks),
        seconds=60.0 * table.take("minutes", float, MINUTES, 15.0),
        rest=table.take("rest", float, SECONDS, 5.0),
        idle=table.take("idle", float, SECONDS, 120.0) or None,
    )
    if found.recorded == 0:
        raise UserError(f"{table.source('recorded')} 0: nothing would be recorded, give 1 or more")
    table.done()
    return found


def _episodes(table: Table, tasks: tuple[str, ...]) -> dict[str, int]:
    """Of each task: from one number, or from a table with one for each; without it the task's own."""
    source, value = table.source("episodes"), table.raw("episodes", None)
    if value is not None and not isinstance(value, dict):
        number: int = checked(source, value, int, EPISODES)
        return dict.fromkeys(tasks, number)
    for name in value or ():
        if name not in tasks:
            raise UserError(f"{source} {shown(name)} is no task of this study: give {', '.join(tasks)}")
    found: dict[str, int] = {}
    for task in tasks:
        each = (value or {}).get(task, find("task", task).episodes)
        if each is None:
            raise UserError(f"{source} {task} is missing: the task has no usual number, give one")
        found[task] = checked(f"{source} {task}", each, int, EPISODES)
    return found


def _text(table: Table) -> str:
    text = table.take("text", str)
    table.done()
    return text


def _check(table: Table) -> Check:
    found = Check(
        width=table.take("width", int, PIXELS, None),
        height=table.take("height", int, PIXELS, None),
        frame_rate=table.take("frame_rate", float, RATE, None),
        round_trip=table.take("round_trip", float, NON_NEGATIVE, None),
    )
    table.done()
    return found


def _trial(table: Table, learners: dict[str, _Learner]) -> Trial:
    task = table.take("task", str)
    find("task", task, table.source("task"))
    name = table.take("learner", str, OneOf(tuple(learners)), next(iter(learners)))
    passes = table.take("passes", str, OneOf(("keys", "return")), "keys")
    found = Trial(
        task=task,
        course=_course(learners[name], task, {}, table.place),
        passes=passes,
        presses=table.take("presses", int, TIMES, 3),
        total=table.take("return", float, FINITE, REQUIRED if passes == "return" else 0.0),
        episodes=table.take("episodes", int, EPISODES, 5),
        seconds=60.0 * table.take("minutes", float, MINUTES, 5.0),
        attempts=table.take("attempts", int, TIMES, 3),
    )
    table.done()
    return found


def _ending(table: Table, text: str) -> Ending:
    ending = Ending(
        text=table.take("text", str, default=text),
        code=table.take("code", str, default=None),
        link=table.take("link", str, default=None),
    )
    if ending.link is not None:
        parts = urlsplit(ending.link)
        if parts.scheme != "https" or not parts.hostname or parts.username or "{" in parts.netloc:
            raise UserError(f"{table.source('link')} {shown(ending.link)}: give an address with https://")
    table.done()
    return ending


def _joining(table: Table) -> Joining:
    codes = table.several("codes", default=None)
    found = Joining(
        parameters=table.several("parameters", default=PARAMETERS),
        codes=None if codes is None else frozenset(codes),
        typed=table.take("typed", bool, SWITCH, True),
        hours=table.take("hours", float, HOURS, 24.0),
        a_minute=table.take("a_minute", int, PARTICIPANTS, 60),
    )
    for code in found.codes or ():
        if not is_code(code):
            raise UserError(f"{table.source('codes')} {shown(code)}: give {CODE_WORDS}")
    table.done()
    return found
