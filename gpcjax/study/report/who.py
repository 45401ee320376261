"""Who took part in a study, who dropped out, and what happened: tables of its report. Loads no jax."""

from collections import Counter
from collections.abc import Iterator

from gpcjax.report.document import Block, Folded, Kind, Sheet
from gpcjax.study.kept import ACTIVE, COMPLETE, ENDED
from gpcjax.study.report.held import Held

MOST_LINES = 200
"""Of technical problems; all of them are in the logs."""

_NAMES = (
    "task",
    "learner",
    "first",
    "second",
    "statistic",
    "question",
    "order",
    "arm",
    "state",
    "event",
    "step",
)
WORDS: dict[str, Kind] = {**dict.fromkeys(_NAMES, "word"), "text": "prose", "why": "prose"}
"""How the columns of all tables of the report are set that hold no numbers."""


def states(held: Held) -> Sheet:
    """How many have come, and how far, by arm."""
    every = [COMPLETE, ACTIVE, *(each for each in ENDED if each != COMPLETE)]
    arms = list(dict.fromkeys(one.arm for one in held.people)) or ["all"]
    rows = []
    for arm in arms:
        counts = Counter(one.kept.state for one in held.people if one.arm == arm)
        rows.append((arm, str(sum(counts.values())), *(str(counts[state]) for state in every)))
    if len(rows) > 1:
        rows.append(
            ("in all", *(str(sum(int(row[place]) for row in rows)) for place in range(1, len(rows[0]))))
        )
    kinds: dict[str, Kind] = {"arm": "word"}
    return Sheet("", ("arm", "joined", *every), tuple(rows), kinds=kinds)


def events(held: Held) -> Iterator[Block]:
    """Who dropped out, and what happened to all."""
    dropped = [one for one in held.people if one.kept.state not in (ACTIVE, COMPLETE)]
    if dropped:
        rows = tuple(
            (
                str(one.kept.number),
                one.arm,
                one.kept.state,
                one.kept.why,
                f"{one.kept.step} of {len(one.steps)}",
            )
            for one in dropped
        )
        yield Sheet(
            "who dropped out", ("participant", "arm", "state", "why", "steps done"), rows, kinds=WORDS
        )
    counted = {
        "came back": "here",
        "looked away in a run": "away",
        "fell idle": "idle",
        "technical problems": "problem",
    }
    rows = []
    for name, event in counted.items():
        each = [held.counted(one.kept.number, event) - (event == "here") for one in held.people]
        some = [count for count in each if count > 0]
        rows.append((name, str(sum(some)), str(len(some)), str(max(some, default=0))))
    yield Sheet("what happened", ("event", "times", "people", "most of one"), tuple(rows), kinds=WORDS)
    problems = [
        (str(one.kept.number), str(event.get("step") or ""), str(event.get("text", "")))
        for one in held.people
        for event in held.events[one.kept.number]
        if event["event"] == "problem"
    ]
    if problems:
        told = Sheet(
            "technical problems",
            ("participant", "step", "text"),
            tuple(problems[:MOST_LINES]),
            kinds=WORDS,
        )
        more = len(problems) - MOST_LINES
        yield Folded(
            f"{len(problems)} technical problem"
            + ("" if len(problems) == 1 else "s")
            + (f", the first {MOST_LINES}" if more > 0 else ""),
            (told,),
        )
