"""The report of a study whose numbers are known."""

import functools
import json
import os
import shutil

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import gpcjax
from gpcjax.errors import UserError
from gpcjax.report.figures import style
from gpcjax.report.statistics import mean_interval, student_p
from gpcjax.study.design import Treatment
from gpcjax.study.register import Register
from gpcjax.study.report import run as report_run
from gpcjax.study.report.asked import asked_of
from gpcjax.study.report.columns import TABLES, dictionary
from gpcjax.study.report.held import read_held
from gpcjax.study.report.made import is_stale
from gpcjax.study.report.naming import algorithms_of, names_of
from gpcjax.study.report.numbers import numbers_of, welch
from gpcjax.study.report.run import draw
from gpcjax.study.status import status
from tests.study.example import TOML, study_with
from tests.study.written import goes, study_of, write_run

CHOICE = '[[questions]]\nname = "who"\nkind = "choice"\ntext = "Whom?"\noptions = ["A", "B"]\n\n[completed]'


def nothing(line):
    raise AssertionError(line)


def frames(out):
    return {path.stem: pd.read_parquet(path) for path in (out / "analysis").glob("*.parquet")}


def everything(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


@pytest.fixture
def plain(monkeypatch):
    """No figures: most of the time of a report."""
    monkeypatch.setattr(report_run, "_pictures", lambda *given: [])


@pytest.fixture(scope="module", autouse=True)
def in_few_pixels():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "image", functools.partial(style.image, dpi=20))
        yield


@pytest.fixture
def unpainted(monkeypatch):
    """Figures are made, and none is painted."""
    monkeypatch.setattr(style, "image", lambda figure, kind: kind.encode())


class PaintsTheFirst:
    """Of the others each kind is there alone: painting takes most of the time of a report."""

    def __init__(self):
        self._image, self._first, self._process = style.image, None, os.getpid()

    def __call__(self, figure, kind):
        self._first = self._first or figure
        paints = figure is self._first and os.getpid() == self._process
        return self._image(figure, kind) if paints else kind.encode()


@pytest.fixture(scope="module")
def drawn(tmp_path_factory, in_few_pixels):
    """Three who have done all, one who left in a run, one who is under way."""
    out, register = study_of(tmp_path_factory.mktemp("study"), old="[completed]", new=CHOICE)
    left = register.admit("secretive")
    goes(left, 6)
    left.end("declined")
    goes(register.admit("slow"), 6)
    left.log("problem", text="the disk was full")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "image", PaintsTheFirst())
        draw(out, nothing)
    return out


def test_tables_are_those_of_the_dictionary(drawn):
    found = frames(drawn)
    assert found.keys() == TABLES.keys()
    for name, columns in TABLES.items():
        assert list(found[name].columns) == [each.name for each in columns]
        assert [str(field.type) for field in pq.read_schema(drawn / "analysis" / f"{name}.parquet")] == [
            {"float64": "double"}.get(each.kind, each.kind) for each in columns
        ]
        for each in columns:
            assert f"| {each.name} | {each.kind} |" in dictionary()
    assert (drawn / "analysis" / "dictionary.md").read_text() == dictionary()


def test_rows_are_what_was_taught(drawn):
    found = frames(drawn)
    people, runs, episodes = found["participants"], found["runs"], found["episodes"]
    assert people["state"].tolist() == ["complete"] * 3 + ["declined", "active"]
    assert people["problems"].tolist() == [0, 0, 0, 1, 0]
    assert len(runs) == 3 * 8 + 2 * 2 and runs["complete"].all() and len(episodes) == 2 * len(runs)
    row = runs.query("participant == 2 and task == 'cartpole' and learner == 'gpc' and phase == 'recorded'")
    assert row["area"].item() == 100 + 20 + 2 + 2 + 0.5
    assert row["seed"].item() == 7000 + 100 * 2 + 2 and row["seconds"].item() == pytest.approx(0.4)
    first = people.set_index("participant")["learners"].str.split(", then ").str[0]
    assert (runs[runs.met == 1].apply(lambda run: first[run.participant] == run.learner, axis=1)).all()
    assert (episodes["advice_rate"] == 0.3).all()


def test_no_code_and_no_time_of_day_is_in_it(drawn):
    for name, content in everything(drawn / "analysis").items():
        assert b"secretive" not in content, name
    (kept,) = (json.loads(path.read_bytes()) for path in drawn.glob("participants/p0001/participant.json"))
    day = kept["begun"][:10].encode()
    assert not any(day in content for content in everything(drawn / "analysis").values())


def test_run_folders_are_those_of_a_sweep(drawn):
    folder = drawn / "analysis" / "rows" / "recorded" / "cartpole-gpc"
    rows = gpcjax.load(folder)
    assert rows["seed"].unique().tolist() == [7102, 7202, 7302] and len(rows) == 6
    assert rows["return"].tolist() == [113, 114, 124, 125, 135, 136]
    assert len(gpcjax.load_corrections(folder)) == 3
    found = gpcjax.compare(folder, folder.with_name("cartpole-coach"), by=["algo", "on_full"])
    area = found.differences_table.query("statistic == 'area'")
    assert area["pairs"].item() == 3 and area["difference"].item() == 2.0


def test_differences_are_paired_by_participant(drawn):
    numbers = numbers_of(read_held(drawn, nothing))
    area = {each.task: each for each in numbers.differences if each.statistic == "area"}
    apart = np.array([1.0, 2.0, 3.0])
    for task, each in area.items():
        assert (each.first.learner, each.second.learner) == ("gpc", "coach")
        assert each.participants == 3 and each.difference == mean_interval(apart[:, None]), task
        assert each.p == student_p(apart) and each.p_holm == pytest.approx(6 * each.p)
    corrections = [each for each in numbers.differences if each.statistic == "corrections"]
    assert all(each.difference.estimate == 0 and each.p_holm == 1 for each in corrections)


def test_who_dropped_out_is_counted_and_in_no_number(drawn):
    numbers = numbers_of(read_held(drawn, nothing))
    by = {(each.task, each.treatment.learner): each.participants for each in numbers.taught}
    learner = frames(drawn)["runs"].query("participant == 5 and phase == 'recorded'")["learner"].item()
    assert by["cartpole", "gpc"] == [1, 2, 3]
    assert by["pendulum", learner] == [1, 2, 3, 5], "who is under way counts, who has left does not"
    page = (drawn / "analysis" / "report.md").read_text()
    assert "| all | 5 | 3 | 1 | 1 | 0 | 0 | 0 |" in page
    assert "| 4 | all | declined | left the study | 6 of 17 |" in page and "the disk was full" in page


def test_answers_are_of_learners_not_letters(drawn):
    held = read_held(drawn, nothing)
    asked = asked_of(held, names_of(held))
    (choice,) = asked.choices
    firsts = [one.letters["A"].learner for one in held.people[:3]]
    assert choice.counts == {"COACH": firsts.count("coach"), "GPC": firsts.count("gpc")}
    given = frames(drawn)["answers"].query("question == 'who'")
    assert given["means"].tolist() == firsts and given["value"].tolist() == ["A"] * 3
    for scale in asked.scales:
        treatment = scale.about[1]
        assert treatment is not None
        wanted = [
            1 + one.kept.number % 6 + (one.letters["A"] == treatment)
            for one in held.people
            if one.kept.number in scale.scores.seeds
        ]
        assert scale.scores.values.tolist() == wanted and sum(scale.counts) == len(wanted)
    assert [each.participant for each in asked.texts] == [1, 2, 3]
    assert "&lt;b&gt;" in (drawn / "analysis" / "report.html").read_text()


def test_effects_of_the_order(drawn):
    effects = {(each.task, each.name): each for each in numbers_of(read_held(drawn, nothing)).effects}
    people = frames(drawn)["runs"].query("task == 'cartpole' and phase == 'recorded'")
    by_place = people.pivot(index="participant", columns="met", values="area")
    met = effects["cartpole", "learner met"]
    assert met.difference.estimate == pytest.approx((by_place[2] - by_place[1]).mean()) and met.pairs == 3
    assert ("cartpole", "recorded run") not in effects, "there is one for each learner"


def test_drawn_twice_it_is_the_same_to_the_byte(drawn, tmp_path, monkeypatch):
    """Of the pictures the first is painted: so are the others."""
    again = shutil.copytree(drawn, tmp_path / drawn.name)
    monkeypatch.setattr(style, "image", PaintsTheFirst())
    draw(again, nothing)
    before, after = (everything(folder / "analysis") for folder in (drawn, again))
    assert before == after and sum(content in (b"png", b"pdf") for content in after.values()) == 2 * 3
    assert not [path for path in again.iterdir() if path.name.startswith(".analysis")]


def test_every_figure_is_there_and_in_the_page(drawn):
    names = {path.name for path in (drawn / "analysis" / "figures").iterdir()}
    stems = ("curves", "advice", "participants-1", "participants-2")
    assert names == {f"{stem}.{kind}" for stem in stems for kind in ("png", "pdf")}
    assert (drawn / "analysis" / "report.html").read_text().count("<figure>") == 4


# --- what becomes of it


def test_after_more_was_done_it_is_stale_and_after_a_deletion_gone(tmp_path, plain):
    out, register = study_of(tmp_path, ["one", "two"])
    assert is_stale(out) is None
    draw(out, nothing)
    assert is_stale(out) is False and "earlier data" not in status(out)
    goes(register.admit("three"), 5)
    assert is_stale(out) is True and "its report is of earlier data" in status(out)
    register.delete("two")
    assert not (out / "analysis").exists() and is_stale(out) is None
    draw(out, nothing)
    assert frames(out)["participants"]["participant"].tolist() == [1, 3]


def test_who_is_deleted_while_it_is_made_is_not_in_what_stays(tmp_path, monkeypatch, plain):
    out, register = study_of(tmp_path, ["one", "two"])
    write = report_run._write

    def slow(held, analysis):
        write(held, analysis)
        register.delete("two")

    monkeypatch.setattr(report_run, "_write", slow)
    with pytest.raises(UserError, match="deleted while"):
        draw(out, nothing)
    assert not (out / "analysis").exists()


def test_nobody_and_no_run(tmp_path):
    out, register = study_of(tmp_path, [])
    with pytest.raises(UserError, match="nobody has come yet"):
        draw(out, nothing)
    goes(register.admit("one"), 2)
    draw(out, nothing)
    assert "No recorded run" in (out / "analysis" / "report.md").read_text()
    with pytest.raises(UserError, match="no study is kept there"):
        draw(tmp_path / "elsewhere", nothing)


def test_a_run_under_way_is_in_the_tables_and_damaged_rows_are_told(tmp_path, plain):
    out, register = study_of(tmp_path, ["one"])
    two = register.admit("two")
    goes(two, 4)
    write_run(two, two.step.run, [1.0])
    part = next(out.glob("participants/p0001/runs/02-*/episodes/*.parquet"))
    part.write_bytes(part.read_bytes()[:-30])
    told = []
    draw(out, told.append)
    assert len(told) == 1 and "02-recorded" in told[0] and "left out" in told[0]
    runs = frames(out)["runs"]
    assert runs.query("participant == 2")["complete"].tolist() == [False]
    assert 2 not in runs.query("participant == 1")["run"].tolist()
    with open(two.folder / "log.jsonl", "ab") as file:
        file.write(b'{"at": "x", "ev')
    draw(out, told.append)


def test_arms_between_participants(tmp_path, unpainted):
    arms = "[[arms]]\nname = 'late'\ndelay = 0.3\n[[arms]]\nname = 'soon'\n[[learners]]"
    out, _ = study_of(tmp_path, ["one", "two", "three", "four"], "[[learners]]", arms)
    draw(out, nothing)
    found = [each for each in numbers_of(read_held(out, nothing)).differences if each.statistic == "area"]
    between = [each for each in found if not each.paired]
    assert len(found) == 2 * (2 + 2) and len(between) == 4
    assert all(each.first.learner == each.second.learner and each.participants == 4 for each in between)
    assert (out / "analysis" / "rows" / "recorded" / "cartpole-gpc-late").is_dir()
    page = (out / "analysis" / "report.md").read_text()
    assert "4 (not paired)" in page and "GPC (late)" in page and "| in all | 4 |" in page


def test_arms_within_participants(tmp_path):
    arms = 'arms_are = "within"\n[[arms]]\nname = "late"\ndelay = 0.3\n[[arms]]\nname = "soon"\n[[learners]]'
    out, _ = study_of(tmp_path, ["one", "two"], "[[learners]]", arms)
    found = [each for each in numbers_of(read_held(out, nothing)).differences if each.task == "cartpole"]
    assert len(found) == 3 * 6 and all(each.paired and each.participants == 2 for each in found)


def test_welch_is_scipys():
    from scipy import stats

    first, second = np.array([1.0, 2.0, 4.0, 8.0]), np.array([3.0, 3.5, 5.0])
    interval, p = welch(first, second)
    known = stats.ttest_ind(first, second, equal_var=False)
    assert p == pytest.approx(known.pvalue)
    assert interval[1:] == pytest.approx(tuple(known.confidence_interval()))
    assert np.isnan(welch(first[:1], second)[1]) and np.isnan(welch(np.ones(3), np.ones(2))[1])


def test_two_learners_of_one_kind_have_names_and_looks_of_their_own(tmp_path):
    text = TOML.replace('algo = "coach"', 'algo = "gpc"\nname = "slow gpc"\nconstant_rate = 0.01')
    out, _ = study_with(tmp_path, text=text)
    held = read_held(out, nothing)
    names = names_of(held)
    assert set(names.values()) == {"GPC", "slow gpc"}
    assert names[Treatment("slow gpc", "all")] == "slow gpc"
    from gpcjax.study.report.figures import looks_of

    looks = looks_of(list(names), algorithms_of(held))
    assert len({look.colour for look in looks.values()}) == 2


def test_choices_of_letters_count_the_learners_of_all_arms(tmp_path):
    arms = "[[arms]]\nname = 'late'\ndelay = 0.3\n[[arms]]\nname = 'soon'\n[[learners]]"
    text = TOML.replace("[completed]", CHOICE.replace('"B"]', '"B", "neither"]')).replace(
        "[[learners]]", arms, 1
    )
    out, study = study_with(tmp_path, text=text)
    register = Register(out, study)
    for code in ("one", "two", "three"):
        goes(register.admit(code))
    (choice,) = asked_of(held := read_held(out, nothing), names_of(held)).choices
    assert set(choice.counts) == {*names_of(held).values(), "neither"}
    assert sum(choice.counts.values()) == 3 and choice.counts["neither"] == 0


def test_an_episode_that_the_limit_of_time_cut_is_in_no_number(tmp_path, plain):
    out, _ = study_of(tmp_path, ["one", "two"])
    folder = next(out.glob("participants/p0002/runs/06-*"))
    assert "cartpole" in folder.name
    ends = [{"event": "note", "values": {"ended": why}} for why in ("over", "time")]
    (folder / "session.jsonl").write_text("\n".join(map(json.dumps, [*ends, {"event": "end"}])) + "\n")
    draw(out, nothing)
    tables = frames(out)
    (run,) = tables["runs"].query("is_cut").to_dict("records")
    rows = tables["episodes"].query(f"participant == 2 and run == {run['run']}")
    assert rows["is_cut"].tolist() == [False, True] and run["episodes"] == 2 and run["corrections"] == 6
    assert run["area"] == run["final_return"] == rows["return"].iloc[0]
    taught = {each.treatment.learner: each for each in numbers_of(read_held(out, nothing)).of("cartpole")}
    assert (
        np.isnan(taught[run["learner"]].curves[1, 1]) and not np.isnan(taught[run["learner"]].curves[0]).any()
    )
    assert taught[run["learner"]].scores("area").values[1] == run["area"]
    (folder / "session.jsonl").write_text(json.dumps(ends[0]) + "\n" + json.dumps(ends[1])[:-4])
    assert not any(run.is_cut for run in read_held(out, nothing).runs), "a last line that is half written"
