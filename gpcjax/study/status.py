"""How far everybody is: a line for each participant, in the terminal and on the experimenter's page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gpcjax.study.participant import Participant
from gpcjax.study.register import read_folder, read_people
from gpcjax.study.report.made import is_stale
from gpcjax.sweep.lock import holder


def line_of(one: Participant) -> dict[str, Any]:
    """How far one of them is."""
    step = one.step
    runs = [each for each in one.steps if each.kind == "run"]
    done = [each for each in one.steps[: one.kept.step] if each.kind == "run"]
    return {
        "number": one.kept.number,
        "code": one.code,
        "state": one.kept.state,
        "why": one.kept.why,
        "step": "" if step is None else step.name,
        "runs": [len(done), len(runs)],
        "arm": one.arm,
        "order": ", ".join(
            f"{letter} {each.learner}" + ("" if one.cell.arm else f" {each.arm}")
            for letter, each in one.letters.items()
        ),
        "tasks": list(one.cell.tasks),
        "seen": one.kept.seen,
    }


def lesson_of(standing: Any, state: Mapping[str, Any]) -> dict[str, Any]:
    """How a run stands (`gpcjax.study.standing.Standing`), and why it rests, by the latest `state` of its seat."""
    told = {name: getattr(standing, name, None) for name in ("episode", "step", "total", "corrections")}
    return {**told, "why": state.get("why", "") if state["paused"] else ""}


def status(out: Path) -> str:
    """A table of a study's folder. Raises UserError: there is none, or it is damaged."""
    study = read_folder(out)
    people = read_people(out, study)
    taken = sum(each.has_slot for each in people)
    running = holder(out)
    lines = [
        f"{out}: {study.title}, {taken} of {len(study.slots)} slots taken, "
        + (f"running ({running})" if running else "not running")
    ]
    if is_stale(out):
        lines.append(f"its report is of earlier data: gpcjax study report {out} makes it anew")
    if not people:
        return lines[0] + "; nobody has come yet"
    rows = [("number", "code", "state", "runs", "step", "arm", "order", "seen (UTC)")]
    for one in people:
        line = line_of(one)
        done, of = line["runs"]
        present = line["step"] or line["why"]
        seen = line["seen"][:19].replace("T", " ")
        rows.append(
            (
                str(line["number"]),
                line["code"],
                line["state"],
                f"{done}/{of}",
                present,
                line["arm"],
                line["order"],
                seen,
            )
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines += [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join(lines)
