"""The tables of a study, as `gpcjax.study.report.columns` has them. Loads no jax."""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any

import pyarrow as pa

from gpcjax.registry import find
from gpcjax.study.design import Treatment
from gpcjax.study.participant import Participant
from gpcjax.study.report.columns import EPISODES, TABLES, Column
from gpcjax.study.report.held import Held, RunRows
from gpcjax.study.steps import RECORDED
from gpcjax.sweep.sofar import FINAL_EPISODES
from gpcjax.teach.course import seconds_of


def tables_of(held: Held) -> dict[str, pa.Table]:
    """Each table by its name: the same folder gives the same rows in the same order."""
    rows = {
        "participants": [_participant(held, one) for one in held.people],
        "runs": [_run(held, run) for run in held.runs],
        "episodes": [row for run in held.runs for row in _episodes(held, run)],
        "answers": [row for one in held.people for row in _answers(held, one)],
    }
    return {name: _table(TABLES[name], rows[name]) for name in TABLES}


def treatment_name(held: Held, treatment: Treatment) -> str:
    """What stands behind a letter, as tables have it: the learner, with the arm where there are several."""
    return treatment.learner if len(held.study.arms) == 1 else f"{treatment.learner} ({treatment.arm})"


def _table(columns: Sequence[Column], rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    rows = list(rows)
    schema = pa.schema([(each.name, pa.type_for_alias(each.kind)) for each in columns])
    for row in rows:
        assert row.keys() == set(schema.names), row.keys() ^ set(schema.names)
    return pa.Table.from_pylist(rows, schema=schema)


def _participant(held: Held, one: Participant) -> dict[str, Any]:
    kept, number = one.kept, one.kept.number
    passed = next((each for each in kept.checks if each.get("passed")), {})
    begun, end = (datetime.fromisoformat(each) for each in (kept.begun, kept.ended or kept.seen))
    mine = [run for run in held.runs if run.participant is one]
    return {
        "participant": number,
        "state": kept.state,
        "why": kept.why or None,
        "arm": one.arm,
        "learners": ", then ".join(treatment_name(held, each) for each in one.letters.values()),
        "tasks": ", then ".join(one.cell.tasks),
        "steps": kept.step,
        "of_steps": len(one.steps),
        "runs": sum(run.complete and run.step.phase == RECORDED for run in mine),
        "minutes": round((end - begun).total_seconds() / 60, 2),
        **{name: passed.get(name) for name in ("width", "height", "frame_rate", "round_trip")},
        "trials": len(kept.trials),
        "came_back": max(held.counted(number, "here") - 1, 0),
        "looked_away": held.counted(number, "away"),
        "fell_idle": held.counted(number, "idle"),
        "problems": held.counted(number, "problem"),
    }


def _of_run(held: Held, run: RunRows) -> dict[str, Any]:
    step, one = run.step, run.participant
    return {
        "participant": one.kept.number,
        "run": step.number,
        "phase": step.phase,
        "task": step.task,
        "learner": step.treatment.learner,
        "arm": step.treatment.arm,
        "letter": step.letter,
        "met": list(one.letters).index(step.letter) + 1,
        "task_met": one.cell.tasks.index(step.task) + 1,
        "repetition": step.repetition,
        "seed": run.seed,
        "complete": run.complete,
    }


def _run(held: Held, run: RunRows) -> dict[str, Any]:
    returns, steps = run.whole.column("return").to_numpy(), run.episodes.column("length").to_numpy()
    return {
        **_of_run(held, run),
        "episodes": run.episodes.num_rows,
        "is_cut": run.is_cut,
        "steps": int(steps.sum()),
        "seconds": round(float(steps.sum()) * seconds_of(find("task", run.step.task)), 6),
        "corrections": int(run.episodes.column("corrections").to_numpy().sum()),
        "area": float(returns.mean()) if len(returns) else None,
        "final_return": float(returns[-FINAL_EPISODES:].mean()) if len(returns) else None,
    }


def _episodes(held: Held, run: RunRows) -> Iterable[dict[str, Any]]:
    same = _of_run(held, run)
    known = {each.name for each in EPISODES} & set(run.episodes.column_names) - same.keys()
    for row in run.episodes.select(sorted(known)).to_pylist():
        is_cut = run.is_cut and row["episode"] == run.episodes.num_rows
        yield {**same, **row, "advice_rate": row["corrections"] / row["length"], "is_cut": is_cut}


def _answers(held: Held, one: Participant) -> Iterable[dict[str, Any]]:
    questions = {each.name: each for each in held.study.questions}
    runs = {step.run.folder: step.run for step in one.steps if step.run is not None}
    for answer in one.kept.answers:
        question, value, run = questions[answer["question"]], answer["value"], runs.get(answer["run"])
        meant = one.letters.get(value) if question.kind == "choice" else None
        yield {
            "participant": one.kept.number,
            "question": question.name,
            "kind": question.kind,
            "run": run and run.number,
            "task": run and run.task,
            "learner": run and run.treatment.learner,
            "arm": run and run.treatment.arm,
            "letter": run and run.letter,
            "value": None if value is None else str(value),
            "number": float(value) if question.kind == "scale" and value is not None else None,
            "means": None if meant is None else treatment_name(held, meant),
        }
