"""Trials in Optuna's database: the same whatever the process that asks for them goes through."""

import json
import sqlite3
from wsgiref.util import setup_testing_defaults

import pytest

from gpcjax.errors import Unwritten, UserError
from gpcjax.tune.objectives import OBJECTIVES
from gpcjax.tune.space import Range, Values
from gpcjax.tune.trials import DATABASE, NAME, Trials
from tests.tune.landscape import PEAK, height

SPACE = {name: Range(0.01, 100.0, log=True) for name in PEAK}
AREA = (OBJECTIVES["area"],)


def opened(folder, space=SPACE, objectives=AREA):
    return Trials(folder, space, objectives, seed=3, startup=6)


def run(folder, most, between=lambda: None):
    while batch := (trials := opened(folder)).next_batch(5, most):
        between()
        for trial in batch:
            trials.tell(trial, [height(trial.point)], 0, True)
    return opened(folder).told()


def test_killed_between_any_two_steps_it_goes_on_the_same(tmp_path, monkeypatch):
    """What is asked for, and told, is what an uninterrupted search asks for and tells."""
    whole, pieces = tmp_path / "whole", tmp_path / "pieces"
    for folder in (whole, pieces):
        folder.mkdir()
    expected = run(whole, 7)
    steps = {"left": 0}

    class Killed(BaseException):
        pass

    def counting(method):
        def counted(*arguments, **options):
            if steps["left"] == 0:
                raise Killed
            steps["left"] -= 1
            return method(*arguments, **options)

        return counted

    import optuna

    monkeypatch.setattr(optuna.Study, "ask", counting(optuna.Study.ask))
    monkeypatch.setattr(optuna.Study, "tell", counting(optuna.Study.tell))
    monkeypatch.setattr(optuna.trial.Trial, "set_user_attr", counting(optuna.trial.Trial.set_user_attr))
    for _ in range(100):
        steps["left"] = 7
        try:
            found = run(pieces, 7)
            break
        except Killed:
            continue
    # One that was killed while it was asked for has its number for nothing.
    assert [each._replace(number=0) for each in found] == [each._replace(number=0) for each in expected]
    assert len(found) == 7


@pytest.mark.slow
def test_it_finds_the_peak(tmp_path):
    best = max(run(tmp_path, 36), key=lambda trial: trial.scores)
    assert best.scores[0] > 90 and best.number > 6
    at_random = max(trial.scores for trial in opened(tmp_path).told()[:6])
    assert best.scores > at_random


def test_more_trials_later(tmp_path):
    assert len(run(tmp_path, 2)) == 2
    assert len(run(tmp_path, 7)) == 7
    assert opened(tmp_path).next_batch(5, 7) == []


def test_several_objectives_and_what_is_given_up(tmp_path):
    """Optuna, and its dashboard, find directions, names and values in the database; what failed has none."""
    import optuna

    both = (OBJECTIVES["area"], OBJECTIVES["corrections"])
    trials = opened(tmp_path, {"policy_nu": Values((0.5, 1.5))}, both)
    first, second, third = trials.next_batch(3, 3)
    trials.tell(first, [10.0, 3.0], 1, True)
    trials.tell(second, [9.0, 5.0], 0, False)
    trials.tell(third, [float("nan"), 5.0], 1, True)
    told = trials.told()
    assert [each.whole for each in told] == [True, False, False]
    assert [each.rung for each in told] == [1, 0, 1]
    study = optuna.load_study(study_name=NAME, storage=f"sqlite:///{tmp_path / DATABASE}")
    assert [direction.name for direction in study.directions] == ["MAXIMIZE", "MINIMIZE"]
    assert study.metric_names == ["area", "corrections"]
    assert [trial.state.name for trial in study.trials] == ["COMPLETE", "PRUNED", "FAIL"]
    assert study.best_trials[0].values == [10.0, 3.0]


def test_no_database(tmp_path):
    (tmp_path / DATABASE).write_text("what is this")
    with pytest.raises(UserError, match=r"study.db: this database cannot be used \(file is not a database\)"):
        opened(tmp_path)


@pytest.mark.parametrize("what", ["told", "next_batch", "tell"])
def test_a_database_that_is_damaged_meanwhile_is_one_line(tmp_path, what):
    trials = opened(tmp_path)
    (trial,) = trials.next_batch(1, 2)
    with sqlite3.connect(tmp_path / DATABASE) as connection:
        tables = [
            name for (name,) in connection.execute("select name from sqlite_master where type = 'table'")
        ]
        for table in tables:
            connection.execute(f"alter table {table} rename to gone_{table}")
    call = {
        "told": trials.told,
        "next_batch": lambda: trials.next_batch(1, 2),
        "tell": lambda: trials.tell(trial, [1.0], 0, True),
    }
    with pytest.raises(
        UserError, match=r"study.db: this database cannot be used \(no such table: .*\): move it away"
    ):
        call[what]()


def test_a_database_on_a_full_disk_is_one_line_and_no_mistake(tmp_path, monkeypatch):
    from optuna.storages import RDBStorage
    from sqlalchemy.exc import OperationalError

    trials = opened(tmp_path)
    (trial,) = trials.next_batch(1, 2)

    def full(*arguments, **options):
        raise OperationalError("insert", {}, sqlite3.OperationalError("database or disk is full"))

    monkeypatch.setattr(RDBStorage, "set_trial_user_attr", full)
    with pytest.raises(
        Unwritten, match=r"study.db: this database cannot be used \(database or disk is full\): make room"
    ):
        trials.tell(trial, [1.0], 0, True)


@pytest.mark.slow
def test_the_dashboard_reads_it(tmp_path):
    """Optuna's own: the study, its objective and its trials are there, as for Optuna itself above."""
    import optuna_dashboard

    run(tmp_path, 3)
    app = optuna_dashboard.wsgi(f"sqlite:///{tmp_path / DATABASE}")

    def get(path):
        environ, said = {"PATH_INFO": path, "REQUEST_METHOD": "GET"}, []
        setup_testing_defaults(environ)
        body = b"".join(app(environ, lambda status, headers, *error: said.append(status)))
        assert said == ["200 OK"], body
        return json.loads(body)

    (study,) = get("/api/studies")["study_summaries"]
    assert study["study_name"] == NAME
    detail = get(f"/api/studies/{study['study_id']}")
    assert detail["objective_names"] == ["area"] and detail["directions"] == ["maximize"]
    assert len(detail["trials"]) == 3 and all(trial["state"] == "Complete" for trial in detail["trials"])
