"""A lesson without its clock: rows, undo, saving, and a recording that leads to the same wherever it was cut."""

import contextlib
import json
import re
import shutil

import numpy as np
import pytest

import gpcjax
from gpcjax.errors import ForeignError, UserError
from gpcjax.recording import RECORD, Recording
from gpcjax.registry import find
from gpcjax.sweep.given import Given
from gpcjax.sweep.plan import plan
from gpcjax.sweep.spec import spec_of
from gpcjax.teach.course import COURSE, POLICY, SAVES, Course, new_folder
from gpcjax.teach.evaluation import Evaluation
from gpcjax.teach.protocol import Press
from gpcjax.teach.taught import Taught

ENV = "tests.teach.drifting:Drift"


def course(seed=5, env=ENV, **settings):
    given = {name: Given(value, name) for name, value in settings.items()}
    return Course.of({"env": Given(env, "env"), **given}, seed)


def press(number, h=1, dim=0):
    return Press(number, dim, h, 0, 0.0, 0.0, False)


def teach(taught, steps, seed=0):
    """Some steps with advice at some of them, one of it undone."""
    draws = np.random.default_rng(seed)
    for step in range(steps):
        taught.step()
        if draws.random() < 0.4:
            taught.advise(press(step, int(draws.choice([-1, 1]))))
        if step % 13 == 7:
            taught.undo()


def nothing(line):
    pass


ROOM = 8
"""Points of a dictionary: some lessons have more to say."""


@pytest.fixture(scope="module", autouse=True)
def small_dictionaries():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gpcjax.teach.beginning.DICTIONARY", ROOM)
        yield


@pytest.fixture(scope="module")
def lesson(tmp_path_factory):
    """Two episodes and a part of the third, ended by force once."""
    folder = tmp_path_factory.mktemp("lesson")
    taught = Taught.begin(folder, course())
    teach(taught, 20)
    taught.save("middle")
    taught.end("reset")
    teach(taught, 9, seed=1)
    taught.keep()()
    return taught


def test_the_course_of_a_task_without_values_is_taught_to_gpc_ns(lesson):
    assert lesson.course.algo == "gpc-ns"
    assert Course.read(lesson.folder) == lesson.course


def test_an_episode_that_was_ended_by_hand_has_a_status_of_its_own(lesson):
    assert [episode.why for episode in lesson.tally.finished] == ["over", "reset"]
    assert gpcjax.load(lesson.folder)["status"].tolist() == ["ok", "cut"]


def test_a_task_that_leads_far_away_is_made_again(tmp_path):
    """Policies take what is beyond 1e60 for that, and so it is recorded."""
    taught = Taught.begin(tmp_path, course(env="tests.teach.drifting:Far"))
    for _ in range(4):
        taught.step()
    assert np.abs(taught.session.obs).max() == 1e60
    for whole in (True, False):
        assert_same(Taught.resume(tmp_path, nothing, whole=whole), taught)


def test_rows_are_a_sweeps(lesson):
    rows = gpcjax.load(lesson.folder)
    done = lesson.tally.finished
    assert rows["return"].tolist() == [episode.total for episode in done]
    assert rows["length"].tolist() == [episode.length for episode in done] == [12, 8]
    assert rows["corrections"].tolist() == [episode.corrections for episode in done]
    assert set(rows["env"]) == {ENV} and set(rows["oracle"]) == {"person"} and set(rows["seed"]) == {5}
    assert rows["human_points"].iloc[-1] > 0
    corrections = gpcjax.load_corrections(lesson.folder)
    assert corrections.groupby("episode").size().tolist() == rows["corrections"].tolist()
    assert (corrections["rate"] > 0).all()


def test_rows_grow_with_the_lesson(lesson, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(lesson.folder, folder)
    taught = Taught.resume(folder, nothing)
    teach(taught, 12, seed=3)
    taught.keep()()
    rows = gpcjax.load(folder)
    assert rows["episode"].tolist() == [1, 2, 3]
    assert rows["return"].tolist()[:2] == gpcjax.load(lesson.folder)["return"].tolist()
    assert len(list((folder / "episodes").iterdir())) == 1


def test_what_was_taught_acts_as_a_policy_and_as_an_oracle(lesson):
    policy = gpcjax.load_policy(lesson.folder / POLICY)
    for obs in np.random.default_rng(0).normal(size=(5, 2)):
        np.testing.assert_allclose(policy(obs), lesson.session.act(obs), rtol=0, atol=1e-12)
    expert = gpcjax.make_expert(ENV, str(lesson.folder / POLICY))
    assert float(expert([0.1, 0.2])[0]) == float(policy([0.1, 0.2])[0])


def test_a_folder_is_a_teacher(lesson):
    spec = find("teacher", str(lesson.folder))
    assert not spec.needs_expert and spec.action_size == 1
    assert (np.asarray(spec.make().given) != 0).sum() == lesson.tally.corrections
    made = spec_of(env=ENV, teacher=str(lesson.folder), oracle="tests.teach.drifting:expert", seeds=1)
    assert plan(made)[0].teacher == str(lesson.folder)


def test_no_sweep_can_ask_a_person():
    with pytest.raises(UserError, match="in a sweep nobody is there to advise"):
        spec_of(env="cartpole", teacher="person")


def test_undo_takes_back_what_was_learned_and_counted(tmp_path):
    taught = Taught.begin(tmp_path, course())
    taught.step()
    obs, before = taught.session.obs, taught.session.act(taught.session.obs)
    done = taught.advise(press(1))
    assert done.before == before[0] and done.after > done.before
    assert taught.tally.corrections == taught.session.corrections == 1
    for _ in range(12):  # into the next episode
        taught.step()
    assert taught.undo() and not taught.undo()
    assert taught.tally.corrections == taught.session.corrections == 0
    assert taught.tally.finished[0].corrections == 0 and taught.tally.places() == []
    np.testing.assert_array_equal(taught.session.act(obs), before)


@pytest.mark.parametrize(
    "algo", ["tests.teach.drifting:Linear", pytest.param("gpc-ns", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    ("settings", "least"), [({"credit": (0.03,)}, 3), ({"credit": (0.01,), "credit_longest": (0.03,)}, 1)]
)
def test_late_advice_is_told_of_the_step_that_it_is_about(tmp_path, settings, least, algo):
    """The map shows it there; advice about no step of the episode is nowhere, nor is it a correction."""
    taught = Taught.begin(tmp_path, course(algo=(algo,), **settings))
    seen, told = [taught.session.obs.tolist()], []
    for step in range(6):
        if step:
            taught.step()
            seen.append(taught.session.obs.tolist())
        done = taught.advise(press(step))
        if step >= least:
            told.append(done.obs.tolist())
    assert told == seen[: 6 - least] == taught.tally.places()
    taught.end("over")
    assert taught.tally.log()["moments"].tolist() == [[0, step, 0] for step in range(least, 6)]
    assert taught.tally.finished[0].corrections == 6 - least == taught.session.corrections
    again = Taught.resume(tmp_path, nothing, whole=True)
    assert (
        again.tally.places() == told
        and again.tally.log()["moments"].tolist() == taught.tally.log()["moments"].tolist()
    )
    for _ in range(6):
        assert taught.undo()
    assert taught.tally.places() == [] and taught.tally.log()["moments"].size == 0


@pytest.mark.parametrize("algo", [pytest.param("gpc", marks=pytest.mark.slow), "gpc-ns"])
def test_a_full_dictionary_goes_on_learning_in_the_same_room(tmp_path, algo):
    taught = Taught.begin(tmp_path, course(algo=(algo,)))
    assert taught.course.spec(1).on_full == "replace-nearest"
    shapes = [leaf.shape for leaf in _leaves(taught)]
    for number in range(24):
        taught.step()
        done = taught.advise(press(number, 1 if number % 2 else -1))
        assert int(done.info.status) == 0 and float(done.info.rate[0]) > 0
    assert taught.tally.corrections == 24 and taught.session.points[1] == ROOM
    assert [leaf.shape for leaf in _leaves(taught)] == shapes


def test_saved_and_opened(lesson, tmp_path):
    opened = Taught.begin(tmp_path, lesson.course, lesson.folder / SAVES / "middle")
    assert opened.session.points[1] > 0
    assert opened.episode == 0 and opened.tally.corrections == 0
    teach(opened, 3)
    again = Taught.resume(tmp_path, nothing, whole=True)
    assert_same(again, opened)


def test_a_learner_of_ones_own_is_taught_kept_and_opened(tmp_path):
    """Its policy has no format that another program reads: there are rows, and what was saved goes on."""
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    taught = Taught.begin(tmp_path / "one", course(algo=("tests.teach.drifting:Linear",)))
    teach(taught, 20)
    taught.keep()()
    assert len(gpcjax.load(taught.folder)) == taught.episode > 0 and not (taught.folder / POLICY).exists()
    taught.save("good")
    opened = Taught.begin(tmp_path / "two", taught.course, taught.folder / SAVES / "good")
    np.testing.assert_array_equal(opened.session.state, taught.session.state)
    teach(opened, 3)
    for each in (taught, opened):
        assert_same(Taught.resume(each.folder, nothing, whole=True), each)


def test_the_policy_alone_learns_and_records_nothing(lesson):
    size = (lesson.folder / RECORD).stat().st_size
    alone = Evaluation(lesson.session.policy(), lesson.course, 0)
    while not alone.step():
        pass
    assert alone.length == 12
    alone.again()
    assert alone.index == 1 and alone.length == 0
    assert (lesson.folder / RECORD).stat().st_size == size


def test_a_task_of_ones_own_shows_itself(lesson):
    picture = lesson.picture()
    assert picture.shape == (4, 6, 3) and picture.dtype == np.uint8


def assert_same(one, other):
    """To the bit: what they would do, and what they counted."""
    np.testing.assert_array_equal(one.session.proposed, other.session.proposed)
    assert (one.session.episode, one.session.step) == (other.session.episode, other.session.step)
    assert [vars(each) | {"obs": [], "actions": []} for each in one.tally.finished] == [
        vars(each) | {"obs": [], "actions": []} for each in other.tally.finished
    ]
    mine, theirs = one.tally.log(), other.tally.log()
    assert all(np.array_equal(mine[name], theirs[name], equal_nan=name == "values") for name in mine)
    for here, there in zip(_leaves(one), _leaves(other), strict=True):
        np.testing.assert_array_equal(here, there)


def _leaves(taught):
    import jax

    return jax.tree.leaves(taught.session.state)


class TestReplay:
    def test_the_whole_is_the_same(self, lesson):
        again = Taught.resume(lesson.folder, nothing, whole=True)
        assert_same(again, lesson)
        assert again.present.total == lesson.present.total

    @pytest.mark.parametrize("cut", [pytest.param("line", marks=pytest.mark.slow), "torn"])
    def test_it_goes_on_wherever_it_was_cut(self, lesson, tmp_path, cut):
        """After kill -9 at any moment: the same bits as of who goes on from there without it."""
        lines = (lesson.folder / RECORD).read_bytes().splitlines(keepends=True)
        kinds = {}
        for number, line in enumerate(lines[1:], 2):
            event = json.loads(line)
            kinds.setdefault((event["event"], *sorted(event.get("values", {}))[:1]), number)
        assert len(kinds) >= 6  # propose, advise, undo, end, and a note of each kind
        for kind, number in kinds.items():
            folder = tmp_path / "-".join(kind)
            folder.mkdir()
            shutil.copy(lesson.folder / COURSE, folder)
            kept = b"".join(lines[:number]) + (lines[number][:20] if cut == "torn" else b"")
            (folder / RECORD).write_bytes(kept)
            taught = Taught.resume(folder, nothing)
            teach(taught, 14)
            again = Taught.resume(folder, nothing, whole=True)
            assert_same(again, taught)

    @pytest.mark.parametrize(
        ("kind", "change", "told"),
        [
            ("propose", lambda event: event["obs"].__setitem__(0, 0.25), "the task was at|the action was"),
            ("propose", lambda event: event["action"].__setitem__(0, 0.25), "the action was"),
            ("note", lambda event: event["values"].__setitem__("total", 1.5), "it returned 1.5"),
            (
                "advise",
                lambda event: event.update(advice=[-event["advice"][0]]),
                "the action was|the task was",
            ),
        ],
    )
    def test_it_says_where_it_comes_to_something_else(self, lesson, tmp_path, kind, change, told):
        shutil.copy(lesson.folder / COURSE, tmp_path)
        lines = (lesson.folder / RECORD).read_text().splitlines()
        events = [json.loads(line) for line in lines]
        which = [
            number
            for number, event in enumerate(events)
            if event.get("event") == kind and (kind != "note" or "ended" in event["values"])
        ]
        number = which[min(6, len(which) - 1)] if kind != "advise" else which[0]
        change(events[number])
        (tmp_path / RECORD).write_text("\n".join(map(json.dumps, events)) + "\n")
        with pytest.raises(UserError, match=told) as raised:
            Taught.resume(tmp_path, nothing, whole=True)
        assert "episode" in str(raised.value)


class TestDamaged:
    """Lines that were lost or changed are told, by replay and by who goes on; nothing is counted without them."""

    @staticmethod
    def spoilt(lesson, folder, change):
        shutil.copy(lesson.folder / COURSE, folder)
        events = [json.loads(line) for line in (lesson.folder / RECORD).read_text().splitlines()]
        text = "".join(json.dumps(event) + "\n" for event in change(events))
        (folder / RECORD).write_text(text)
        return text

    @pytest.mark.parametrize("whole", [False, True])
    @pytest.mark.parametrize(
        ("values", "told"),
        [
            ({"ended": "over", "total": 1.5}, "what is noted of its end is damaged"),
            ({"ended": "over", "total": 7, "length": 12}, "what is noted of its end is damaged"),
            ({"ended": "over", "total": 1.5, "length": True}, "what is noted of its end is damaged"),
            ({"ended": 3, "total": 1.5, "length": 12}, "what is noted of its end is damaged"),
            ({}, "it is noted of 0 episodes how they ended, lines are missing or doubled"),
        ],
    )
    def test_the_end_of_an_episode(self, lesson, tmp_path, values, told, whole):
        def change(events):
            for event in events:
                if "ended" in event.get("values", {}):
                    event["values"] = values
            return events

        text = self.spoilt(lesson, tmp_path, change)
        with pytest.raises(UserError, match=rf"session\.jsonl: episode 0: {told}") as raised:
            Taught.resume(tmp_path, nothing, whole=whole)
        assert "\n" not in str(raised.value)
        assert (tmp_path / RECORD).read_text() == text

    def test_an_end_that_is_there_twice(self, lesson, tmp_path):
        self.spoilt(
            lesson,
            tmp_path,
            lambda events: [again for event in events for again in [event] * (1 + ("ended" in str(event)))],
        )
        with pytest.raises(
            UserError, match="it is noted of 1 episodes how they ended, lines are missing or doubled"
        ):
            Taught.resume(tmp_path, nothing)

    @pytest.mark.parametrize(
        ("settings", "told"),
        [
            (lambda settings: [], "this is no record of a session"),
            (lambda settings: settings | {"rooms": 5}, "rooms 5 are none of a session"),
            (lambda settings: settings | {"rooms": [[8, "a"]]}, "rooms .* are none of a session"),
        ],
    )
    def test_its_settings(self, lesson, tmp_path, settings, told):
        self.spoilt(
            lesson,
            tmp_path,
            lambda events: [{**events[0], "settings": settings(events[0]["settings"])}, *events[1:]],
        )
        with pytest.raises(UserError, match=told):
            Taught.resume(tmp_path, nothing, whole=True)


class TestFullDisk:
    @pytest.fixture
    def full(self, tmp_path, monkeypatch):
        taught = Taught.begin(tmp_path, course())
        teach(taught, 5)
        real = Recording.append

        def half(self, event):
            with open(tmp_path / RECORD, "rb") as file:
                before = file.read()
            try:
                real(self, event)
            finally:
                (tmp_path / RECORD).write_bytes(before)
            raise UserError("record: it cannot be written (No space left on device)")

        monkeypatch.setattr(Recording, "append", half)
        return taught, monkeypatch

    def test_what_cannot_be_written_down_has_not_happened(self, full):
        taught, patch = full
        before = taught.session.proposed, taught.session.corrections, taught.session.step
        leaves = list(map(np.asarray, _leaves(taught)))
        for do in (lambda: taught.advise(press(1)), taught.undo, lambda: taught.end("reset")):
            with pytest.raises(UserError, match="No space left"):
                do()
        np.testing.assert_array_equal(taught.session.proposed, before[0])
        assert (taught.session.corrections, taught.session.step) == before[1:]
        for here, there in zip(_leaves(taught), leaves, strict=True):
            np.testing.assert_array_equal(here, there)
        patch.undo()
        teach(taught, 3)
        assert_same(Taught.resume(taught.folder, nothing, whole=True), taught)

    def test_a_disk_that_is_full_now_and_then_costs_no_step(self, tmp_path, monkeypatch):
        """Each line may fail, also the last of an episode: what was executed is written down, and not done again."""
        real, coins = Recording.append, np.random.default_rng(0)

        def now_and_then(self, event):
            if coins.random() < 0.4:
                raise UserError("record: it cannot be written (No space left on device)")
            real(self, event)

        def insist(do):
            for _ in range(100):
                try:
                    return do()
                except UserError:
                    failed.append(taught.behind)
                    while taught.behind:  # as a lesson does before anything else
                        with contextlib.suppress(UserError):
                            taught.catch_up()
            raise AssertionError("it never came to an end")

        failed = []
        (tmp_path / "plain").mkdir()
        (tmp_path / "full").mkdir()
        plain, taught = (Taught.begin(tmp_path / name, course()) for name in ("plain", "full"))
        monkeypatch.setattr(Recording, "append", now_and_then)
        while taught.episode < 3:
            before = taught.present.length, taught.episode
            if not taught.present.length % 8:  # each would be a dictionary of hundreds of points
                insist(lambda: taught.advise(press(1)))
            with contextlib.suppress(UserError):
                taught.step()
            while taught.behind:
                with contextlib.suppress(UserError):
                    taught.catch_up()
            assert (taught.present.length, taught.episode) in (
                (before[0] + 1, before[1]),
                (0, before[1] + 1),
            )
        monkeypatch.undo()
        while plain.episode < 3:
            if not plain.present.length % 8:
                plain.advise(press(1))
            plain.step()
        assert failed
        assert_same(taught, plain)
        assert_same(Taught.resume(taught.folder, nothing, whole=True), plain)

    def test_a_proposal_that_fails_makes_no_step_of_its_own(self, tmp_path, monkeypatch):
        taught = Taught.begin(tmp_path, course())
        taught.step()
        with monkeypatch.context() as patch:
            patch.setattr(type(taught.session), "propose", _full)
            for _ in range(3):
                with pytest.raises(UserError, match="full"):
                    taught.step()
        assert taught.behind and taught.present.length == 2
        taught.step()
        assert not taught.behind and taught.present.length == 2
        assert_same(Taught.resume(tmp_path, nothing, whole=True), taught)


def _full(*given, **settings):
    raise UserError("the disk is full")


def test_what_never_began_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("gpcjax.teach.taught.Session", _full)
    with pytest.raises(UserError, match="full"):
        Taught.begin(tmp_path, course())
    assert list(tmp_path.iterdir()) == []


class TestFailing:
    """A task that fails at a step, or gives what is no number: the episode ends there, and the recording is whole."""

    @pytest.mark.parametrize(
        ("task", "said"),
        [
            ("Odd", "reward nan, its reward must be a finite number"),
            ("Unseen", "each entry must be finite"),
            ("Endless", "the reward 1e[+]308, with which those of the episode add up to inf"),
            ("Broken", "its step fails .RuntimeError: a wheel came off"),
        ],
    )
    def test_the_episode_ends_there(self, tmp_path, task, said):
        taught = Taught.begin(tmp_path, course(env=f"tests.teach.failing:{task}"))
        problems = 0
        while problems < 2 or taught.episode < 4:
            try:
                taught.step()
            except UserError as error:
                assert re.search(said, str(error))
                assert taught.broken and taught.present.length == 4
                problems += 1
                assert taught.catch_up().why == "problem"
                taught.advise(press(problems))
        done = taught.tally.finished
        assert {(each.why, each.length) for each in done} == {("problem", 4), ("over", 12)}
        assert np.isfinite([each.total for each in done]).all()
        again = Taught.resume(tmp_path, nothing, whole=True)
        assert_same(again, taught)
        reopened = Taught.resume(tmp_path, nothing)
        assert_same(reopened, taught)
        reopened.step()

    def test_it_is_reopened_where_it_failed(self, tmp_path):
        """Killed before the end was written down: the step fails again, and the episode ends there."""
        taught = Taught.begin(tmp_path, course(env="tests.teach.failing:Odd"))
        with pytest.raises(UserError, match="reward"):
            while True:
                taught.step()
        reopened = Taught.resume(tmp_path, nothing)
        assert reopened.present.length == 4
        with pytest.raises(UserError, match="reward"):
            reopened.step()
        assert reopened.catch_up().why == "problem"
        assert_same(Taught.resume(tmp_path, nothing, whole=True), reopened)

    def test_a_disk_that_is_full_then(self, tmp_path, monkeypatch):
        taught = Taught.begin(tmp_path, course(env="tests.teach.failing:Odd"))
        with pytest.raises(UserError, match="reward"):
            while True:
                taught.step()
        with monkeypatch.context() as patch:
            patch.setattr(Recording, "append", _full)
            for do in (taught.catch_up, taught.step):
                with pytest.raises(UserError, match="full"):
                    do()
        ended = taught.step()
        assert (ended.why, ended.length) == ("problem", 4)
        assert_same(Taught.resume(tmp_path, nothing, whole=True), taught)

    def test_a_replay_says_where_it_fails(self, tmp_path, monkeypatch):
        """As on a machine where something is missing that was there."""
        monkeypatch.setattr("tests.teach.failing.Broken.fails_at", 99)
        taught = Taught.begin(tmp_path, course(env="tests.teach.failing:Broken"))
        for _ in range(60):
            taught.step()
        monkeypatch.undo()
        with pytest.raises(UserError, match=r"episode \d, step 5: .*a wheel"):
            Taught.resume(tmp_path, nothing, whole=True)

    @pytest.mark.parametrize("way", ["undo", "reset"])
    def test_a_policy_that_comes_to_no_number(self, tmp_path, way):
        """Its advice can be taken back, also at the beginning of an episode that it does not come to."""
        taught = Taught.begin(tmp_path, course(algo=("tests.teach.failing:Diverging",)))
        taught.step()
        taught.advise(press(1))
        with pytest.raises(UserError, match="is no number"):
            taught.step()
        assert taught.behind and not taught.ending
        if way == "reset":
            with pytest.raises(UserError, match="is no number"):
                taught.end("reset")
            assert taught.ending
        assert taught.undo()
        ended = taught.catch_up()
        assert (ended is not None) == (way == "reset")
        taught.step()
        assert not taught.behind
        assert_same(Taught.resume(tmp_path, nothing, whole=True), taught)

    def test_undone_while_the_end_is_half_written(self, tmp_path, monkeypatch):
        taught = Taught.begin(tmp_path, course())
        taught.step()
        taught.advise(press(1))
        with monkeypatch.context() as patch:
            patch.setattr(type(taught.session), "end_episode", _full)
            with pytest.raises(UserError, match="full"):
                taught.end("reset")
        assert taught.undo()
        assert taught.catch_up().why == "reset"
        assert_same(Taught.resume(tmp_path, nothing, whole=True), taught)

    def test_a_learner_that_does_not_fit_is_told_as_theirs(self, tmp_path):
        with pytest.raises(ForeignError, match=r"Shapeless\.propose does not fit"):
            Taught.begin(tmp_path, course(algo=("tests.teach.failing:Shapeless",)))
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("task", ["Odd", "Broken"])
    def test_the_policy_alone_says_it_too(self, tmp_path, task):
        taught = Taught.begin(tmp_path, course(env=f"tests.teach.failing:{task}"))
        with pytest.raises(UserError, match=r"reward|wheel"):
            for episode in range(9):
                alone = Evaluation(taught.session.policy(), taught.course, episode)
                while not alone.step():
                    pass


class TestRefused:
    @pytest.mark.parametrize(
        ("content", "told"),
        [
            (None, "cannot be read"),
            ("{", "damaged, or of another version"),
            ('{"format": 2}', "damaged, or of another version"),
            ('{"format": 1, "env": "pendulum", "algo": "gpc", "settings": {}, "seed": true}', "damaged"),
            ('{"format": 1, "env": "moon", "algo": "gpc", "settings": {}, "seed": 0}', "env 'moon'"),
        ],
    )
    def test_a_folder_of_something_else(self, tmp_path, content, told):
        if content is not None:
            (tmp_path / COURSE).write_text(content)
        with pytest.raises(UserError, match=told):
            Taught.resume(tmp_path, nothing)

    def test_several_values(self):
        with pytest.raises(UserError, match="one learner at a time"):
            course(policy_length_scale=(0.1, 0.2))


def test_settings_come_back_as_they_were(tmp_path):
    written = course(policy_length_scale=(0.3,), credit=(0.2,))
    written.write(tmp_path)
    assert Course.read(tmp_path) == written
    assert dict(written.settings) == {"policy_length_scale": 0.3, "credit": 0.2}


def test_folders_are_numbered(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert str(new_folder("cartpole")) == "runs/taught-cartpole-1"
    new_folder("cartpole").mkdir(parents=True)
    assert str(new_folder("cartpole")) == "runs/taught-cartpole-2"
    assert str(new_folder("x", beside=tmp_path / "runs" / "taught-cartpole-1")).endswith("taught-cartpole-2")
    assert "/" not in new_folder("gym:Some/Thing-v0").name
