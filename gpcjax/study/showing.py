"""The messages that say where a participant is: the steps as the page has them, and the end. Standard library only."""

from collections.abc import Mapping
from typing import Any

from gpcjax.registry import find
from gpcjax.study.participant import Participant
from gpcjax.study.protocol import MEASURED
from gpcjax.study.spec import Check, Ending, Study
from gpcjax.study.steps import RECORDED, RunStep

TEXTS = {
    "stopped": "The experimenter has ended your part of the study here. You can close this page.",
    "expired": "You were away for longer than this study allows, so it has ended for you. You can close this page.",
}


def hello(study: Study) -> dict[str, Any]:
    """For a page that has just come."""
    joining = study.joining
    return {
        "type": "hello",
        "title": study.title,
        "parameters": list(joining.parameters),
        "typed": joining.typed,
    }


def present(participant: Participant, rest: float = 0.0) -> dict[str, Any]:
    """The step where a participant is, or the end.

    Args:
        participant: whose.
        rest: seconds until the next run may begin.
    """
    step, study = participant.step, participant.study
    if step is None:
        return ended(participant)
    told: dict[str, Any] = {
        "type": "step",
        "kind": step.kind,
        "name": step.name,
        "index": participant.kept.step,
        "count": len(participant.steps),
    }
    runs = [each.run for each in participant.steps if each.kind == "run"]
    match step.kind:
        case "consent":
            told["text"] = study.consent
        case "check":
            last = participant.kept.checks[-1:]
            told |= {"again": bool(last), "wrong": wrong(study.check, last[0]) if last else []}
        case "instructions":
            told |= {"text": study.instructions, "runs": len(runs), "trial": study.trial is not None}
        case "trial":
            trial = study.trial
            assert trial is not None
            told |= {
                "task": find("task", trial.task).title,
                "passes": trial.passes,
                "presses": trial.presses,
                "total": trial.total,
                "episodes": trial.episodes,
                "attempt": len(participant.kept.trials) + 1,
                "attempts": trial.attempts,
            }
        case "run":
            assert step.run is not None
            told |= _of_run(step.run) | {
                "of": len(runs),
                "episodes": study.runs.episodes[step.run.task],
                "seconds": study.runs.seconds,
                "rest": round(max(rest, 0.0), 1),
            }
        case "questions":
            told |= {
                "questions": [each.shown() for each in step.questions],
                "about": None if step.run is None else _of_run(step.run),
            }
    return told


def _of_run(run: RunStep) -> dict[str, Any]:
    return {
        "number": run.number,
        "letter": run.letter,
        "recorded": run.phase == RECORDED,
        "task": find("task", run.task).title,
    }


def ended(participant: Participant) -> dict[str, Any]:
    """For a participant who has ended: only one who has done all gets what the platform wants to hear of that."""
    study, state = participant.study, participant.kept.state
    endings = {"complete": study.completed, "declined": study.declined, "failed": study.failed}
    ending = endings.get(state, Ending(TEXTS.get(state, "")))
    return {
        "type": "ended",
        "state": state,
        "text": ending.text,
        "code": ending.code,
        "link": ending.link_of(participant.code),
    }


def wrong(check: Check, measured: Mapping[str, Any]) -> list[str]:
    """What of a machine is not enough, each as a sentence for the participant."""
    width, height, frames, trip = (float(measured[name]) for name in MEASURED)
    found = []
    if check.width is not None and width < check.width:
        found.append(
            f"The window is too narrow: {width:.0f} pixels, {check.width} are needed. Make it wider, zoom out, or "
            "use a larger screen."
        )
    if check.height is not None and height < check.height:
        found.append(
            f"The window is too low: {height:.0f} pixels, {check.height} are needed. Make it higher, zoom out, or "
            "use a larger screen."
        )
    if check.frame_rate is not None and frames < check.frame_rate:
        found.append(
            f"The picture moves too slowly: {frames:.0f} frames a second, {check.frame_rate:.0f} are needed. Close "
            "other programs and tabs, or plug in the power cable."
        )
    if check.round_trip is not None and trip > check.round_trip:
        found.append(
            f"The connection is too slow: {trip:.0f} ms to the server and back, {check.round_trip:.0f} are allowed. "
            "Use a cable, go nearer to the router, or end downloads."
        )
    return found
