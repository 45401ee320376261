"""A participant's way through the steps, on disk at each of them; and the register of all."""

import json
import time
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpcjax.errors import UserError
from gpcjax.study import participant
from gpcjax.study.participant import CARD, Participant
from gpcjax.study.register import ANALYSIS, PEOPLE, Refused, Register, read_people
from tests.study.example import study_with


@pytest.fixture
def register(tmp_path):
    out, study = study_with(tmp_path)
    return Register(out, study)


def again(register):
    """As another process finds it."""
    return Register(register.out, register.study)


def step(one):
    """Does the present step; gives its kind."""
    kind = one.step.kind
    match kind:
        case "check":
            one.checked({"width": 1000}, True)
        case "trial":
            one.attempted(True)
        case "questions":
            one.answered({each.name: 3 for each in one.step.questions if each.kind == "scale"})
        case _:
            one.advance(kind)
    return kind


def test_all_steps_and_the_end(register):
    one = register.admit("alpha")
    kinds = []
    while one.step is not None:
        kinds.append(step(one))
    assert kinds[:4] == ["consent", "check", "instructions", "trial"]
    assert kinds[4:] == ["run", "run", "questions"] * 4 + ["questions"]
    assert one.kept.state == "complete" and all(each["ended"] for each in one.kept.times)
    answers = [each for each in one.kept.answers if each["question"] == "easy"]
    assert [(each["letter"], each["task"], each["value"]) for each in answers] == [
        ("A", "pendulum", 3), ("B", "pendulum", 3), ("A", "cartpole", 3), ("B", "cartpole", 3),
    ]  # fmt: skip


def test_at_every_step_another_process_finds_the_same(register):
    one = register.admit("alpha")
    while one.step is not None:
        found = again(register).get("alpha")
        assert found.kept == one.kept and found.step == one.step and found.seed == one.seed == 7100
        assert found.letters == one.letters
        before = one.kept.step
        step(one)
        assert one.kept.step == before + 1
    assert again(register).get("alpha").kept.state == "complete"


def test_nothing_of_a_person_is_kept_but_the_code(register):
    card = json.loads((register.admit("alpha").folder / CARD).read_bytes())
    assert set(card) == {
        "format", "number", "code", "slot", "state", "why", "step", "begun", "seen", "ended", "times", "checks",
        "trials", "answers", "seed", "arm", "letters", "tasks", "steps",
    }  # fmt: skip


def test_a_step_out_of_turn_changes_nothing(register):
    one = register.admit("alpha")
    before = (one.folder / CARD).read_bytes()
    for act in (
        lambda: one.advance("run"), lambda: one.checked({}, True), lambda: one.attempted(True),
        lambda: one.answered({}),
    ):  # fmt: skip
        with pytest.raises(UserError, match="not at this step"):
            act()
    assert (one.folder / CARD).read_bytes() == before


def test_the_trial_ends_after_its_attempts(register):
    one = register.admit("alpha")
    one.advance("consent")
    one.checked({"width": 200}, False)
    one.checked({"width": 400}, True)
    one.advance("instructions")
    assert one.trial_folder().name == "1"
    one.attempted(False)
    assert one.step.kind == "trial" and one.trial_folder().name == "2"
    one.attempted(False)
    assert one.kept.state == "failed" and one.step is None and not one.has_slot


@pytest.mark.parametrize(
    "given_", [{}, {"easy": 0}, {"easy": 8}, {"easy": "3"}, {"easy": True}, {"easy": 3, "hard": 1}]
)
def test_what_is_no_answer_is_refused(register, given_):
    one = register.admit("alpha")
    one.kept.step = next(k for k, step in enumerate(one.steps) if step.kind == "questions")
    with pytest.raises(UserError):
        one.answered(given_)
    assert one.kept.answers == []


def test_who_drops_out_gives_the_slot_to_the_next(register):
    four = [register.admit(name) for name in ("a1", "b2", "c3", "d4")]
    with pytest.raises(Refused, match="All places"):
        register.admit("e5")
    four[2].end("declined")
    fifth = again(register).admit("e5")
    assert fifth.kept.slot == 2 and fifth.cell == four[2].cell
    assert fifth.kept.number == 5 and fifth.seed != four[2].seed


def test_who_stays_away_too_long_is_ended(register):
    one, two = register.admit("a1"), register.admit("b2")
    one.kept.seen = (datetime.now(UTC) - timedelta(hours=25)).isoformat()
    two.kept.seen = (datetime.now(UTC) - timedelta(hours=23)).isoformat()
    assert register.expire() == [one]
    assert one.kept.state == "expired" and two.kept.state == "active" and register.free == 3


def test_deleted_everywhere_and_the_number_is_never_given_again(register):
    one, two = register.admit("a1"), register.admit("b2")
    made = register.out / ANALYSIS / "rows.parquet"
    made.parent.mkdir()
    made.write_text("rows of both")
    removed = register.delete("b2")
    assert str(two.folder) in removed[0] and str(made.parent) in removed[1]
    assert not two.folder.exists() and not made.exists() and one.folder.exists()
    assert not any("b2" in path.read_text() for path in register.out.rglob("*") if path.is_file())
    assert again(register).admit("b2").kept.number == 3
    with pytest.raises(UserError, match="nobody has the code"):
        register.delete("zz")


@pytest.mark.parametrize("content", ["", "[]", '{"next": "3"}', '{"next": true}', '{"next": 0}'])
def test_damaged_numbers_are_told_and_given_to_nobody(register, content):
    register.admit("one")
    file = register.out / "numbers.json"
    file.write_text(content)
    for ask in (register.kept_number, lambda: register.admit("two")):
        with pytest.raises(UserError, match=r"numbers\.json: it is damaged, write"):
            ask()
    assert register.get("two") is None
    register.delete("one")  # which needs none


def test_a_deletion_that_was_killed_is_finished(register):
    one = register.admit("a1")
    one.folder.rename(one.folder.with_name(f".deleted-{one.folder.name}"))
    assert list(again(register)) == [] and not any((register.out / PEOPLE).iterdir())


def test_a_deletion_that_failed_is_finished_by_the_next_one(register, monkeypatch):
    one = register.admit("a1")

    def fails(path):
        raise PermissionError(13, "Permission denied", str(path))

    with monkeypatch.context() as patch:
        patch.setattr("shutil.rmtree", fails)
        with pytest.raises(OSError, match="Permission denied"):
            register.delete("a1")
    assert register.get("a1") is one
    assert str(one.folder) in register.delete("a1")[0] and not any((register.out / PEOPLE).iterdir())


def test_what_cannot_be_written_has_not_happened(register, monkeypatch):
    one = register.admit("a1")
    while one.kept.step < len(one.steps) - 1:
        step(one)
    before = json.loads((one.folder / CARD).read_bytes())

    def full(*_):
        raise OSError(28, "No space left on device")

    for broken in ("write_atomic", "os.fsync"):
        with monkeypatch.context() as patch:
            patch.setattr(f"gpcjax.study.participant.{broken}", full)
            with pytest.raises(OSError):
                step(one)
        assert one.step.name == "questions-end" and one.kept.state == "active"
        assert json.loads((one.folder / CARD).read_bytes()) == before
    step(one)
    assert one.kept.state == "complete" and len(one.kept.answers) == len(before["answers"]) + 1


@pytest.mark.parametrize("code", ["", " a", "a b", "-a", "<b>", "a/b", "..", "x" * 65, "ä", "a\n"])
def test_a_code_is_plain(register, code):
    with pytest.raises(Refused, match="no code"):
        register.admit(code)


@given(st.data())
def test_a_damaged_card_is_told(data):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        register = Register(*study_with(Path(folder)))
        path = register.admit("a1").folder / CARD
        content = path.read_bytes()
        end = data.draw(st.integers(0, len(content) - 3))
        path.write_bytes(content[:end])
        with pytest.raises(UserError, match=r"participant\.json"):
            read_people(register.out, register.study)


def test_codes_may_be_listed(tmp_path):
    out, study = study_with(tmp_path, "[completed]", "[joining]\ncodes = ['a1', 'b2']\n[completed]")
    register = Register(out, study)
    assert register.admit("a1").code == "a1"
    with pytest.raises(Refused, match="not known here"):
        register.admit("c3")


def test_the_time_is_kept_as_it_is_read(register):
    one = register.admit("a1")
    assert abs(datetime.fromisoformat(one.kept.seen).timestamp() - time.time()) < 60
    assert isinstance(Participant.read(one.folder, register.study), Participant)


def test_what_a_lesson_is_just_replacing_is_waited_for(register, monkeypatch):
    one = register.admit("alpha")
    going = one.folder / "runs" / ".policy.old"
    going.mkdir(parents=True)
    synchronise, seen = participant._synchronise, []

    def vanishing(path):
        if path == going:
            going.rmdir()
        seen.append(path)
        synchronise(path)

    monkeypatch.setattr(participant, "_synchronise", vanishing)
    monkeypatch.setattr(participant, "SEAL_APART", 0.0)
    while one.step is not None:
        step(one)
    assert one.kept.state == "complete" and one.folder in seen and not going.exists()
    monkeypatch.setattr(participant, "SEAL_TRIES", 1)
    monkeypatch.setattr(participant, "_synchronise", lambda path: (going / "gone").stat())
    with pytest.raises(FileNotFoundError):
        one.seal()
