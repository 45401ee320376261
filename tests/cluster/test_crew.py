"""The workers of a cluster as the desk's side handles them: places, losses, checkpoints. No Ray, no process."""

import dataclasses
import pickle

import numpy as np
import pytest

from gpcjax.errors import Failure, UserError
from gpcjax.policies.folder import write_folder
from gpcjax.sweep import machine
from gpcjax.sweep.blocks import block_of
from gpcjax.sweep.checkpoints import KIND, runs_as_json, survey, told
from gpcjax.sweep.checkpoints import Place as CheckpointPlace
from gpcjax.sweep.executors import Desk, Orders, crew
from gpcjax.sweep.machine import kind_of
from gpcjax.sweep.parcel import pack
from gpcjax.sweep.plan import plan
from gpcjax.sweep.rows import CellRows
from gpcjax.sweep.spec import spec_of
from gpcjax.sweep.versions import versions
from tests.cluster.fakes import HERE, NEVER, FakeRay, there
from tests.sweep import pretended

CELLS = plan(spec_of(env="cartpole", algo="coach", seeds=4, oracle="lqr"))
OTHER = {**HERE.machine, "vector_features": "none at all"}


NONE = Orders()


def rows_of(cell):
    return CellRows(cell, np.array([1]), ["ok"], {"returns": np.zeros(1), "length": np.array([7])}, {})


class Good:
    """A worker that does what it is told; after `most` cells it is lost."""

    def __init__(self, place=HERE, most=99, first=()):
        self._place, self._left, self._first, self.got = place, most, list(first), []

    def begin(self):
        return self._place

    def hear(self, answer, archives):
        self.got.append((answer, archives))
        match answer:
            case None:
                return [*self._first, ("ready",)]
            case ("program", *_):
                return [("next",)]
            case ("cells", []):
                return [("ready",)]
            case ("cells", cells, *_):
                done, self._left = min(len(cells), self._left), self._left - len(cells)
                said = [("rows", rows_of(cell)) for cell in cells[:done]]
                return [*said, ("next",) if self._left >= 0 else ("ended", "a worker process was killed")]
        raise AssertionError(answer)


class Waiting:
    """One that finds no machine."""

    def begin(self):
        return NEVER


class Hanging(Good):
    """One that takes cells and says no more."""

    def hear(self, answer, archives):
        said = super().hear(answer, archives)
        return NEVER if answer and answer[0] == "cells" else said


class Gone(Good):
    """One whose machine is lost at once."""

    def begin(self):
        raise RuntimeError("The actor died\nbecause its node has died")


def served(hire, jobs=1, orders=NONE, cells=CELLS, **options):
    """Serves a desk with these actors; gives rows, notes, machines and the fake."""
    got, notes, machines = [], [], []
    fake = FakeRay(hire)
    desk = Desk(
        cells,
        [],
        jobs,
        got.append,
        lambda *_: None,
        lambda _: None,
        notes.append,
        orders,
        on_machine=machines.append,
        **options,
    )
    workers = crew.Crew(fake, desk)
    workers.serve()
    workers.dismiss()
    desk.refuse_less()
    return got, notes, machines, fake


def test_cells_of_a_worker_that_is_lost_go_to_another_one():
    got, notes, _, fake = served(lambda number: Good(most=2 if number == 0 else 99))
    assert sorted(rows.cell.seed for rows in got) == [0, 1, 2, 3]
    assert len(fake.actors) == 2 and set(fake.killed) == set(fake.actors)  # also who has cleared up
    (note,) = notes
    assert note.startswith(f"a worker on {HERE.name} is lost") and note.endswith(
        "(a worker process was killed)"
    )


def test_a_machine_that_is_lost_before_it_began():
    got, notes, _, fake = served(lambda number: Gone() if number < 3 else Good())
    assert len(got) == 4 and len(fake.actors) == 4
    assert notes == [
        "a worker on the cluster is lost, its runs go to others (The actor died)"
    ]  # once, not thrice


def test_one_that_is_lost_again_and_again_ends_the_sweep():
    with pytest.raises(Failure, match=r"^a worker on the cluster was lost 4 times: The actor died$"):
        served(lambda number: Gone())


def test_workers_that_find_no_machine_are_not_waited_for():
    got, _, _, fake = served(lambda number: Good() if number == 1 else Waiting(), jobs=3)
    assert len(got) == 4 and len(fake.killed) == 3


def test_what_a_machine_that_hangs_had_runs_elsewhere_too():
    many = plan(spec_of(env="cartpole", algo="coach", seeds=96, oracle="mpc"))
    got, notes, _, fake = served(lambda number: Good() if number else Hanging(), jobs=2, cells=many)
    assert sorted(rows.cell.seed for rows in got) == list(range(96)) and not notes
    assert len(fake.actors) == 2 and set(fake.killed) == set(fake.actors)  # also who has cleared up


def test_rows_that_come_twice_count_once():
    """The first of two workers says what it has just as the other has run a copy of it."""
    got = []
    desk = Desk(CELLS[:3], [], 2, got.append, lambda *_: None, lambda _: None)
    desk.give_copies()
    assert desk.answer(0, ("ready",))[0] == "program"
    mine = [cell for _ in range(3) for cell in desk.answer(0, ("next",))[1]]
    assert mine == CELLS[:3] and desk.answer(1, ("ready",))[1] == CELLS[0]
    assert desk.answer(1, ("next",))[1] == mine and desk.answer(1, ("next",)) == ("cells", [])
    desk.answer(1, ("rows", rows_of(mine[1])))
    assert desk.is_late(0) and not desk.done
    desk.answer(0, ("rows", block_of([pretended.rows(cell) for cell in mine], ())))
    desk.answer(1, ("rows", rows_of(mine[0])))
    assert desk.done and not desk.is_late(0) and desk.is_late(1)
    assert [cell for each in got for cell in each.cells] == [mine[1], mine[0], mine[2]]
    assert {work.finished for work in desk.works.values()} == {3}
    with pytest.raises(Failure, match="its worker has not"):
        desk.answer(1, ("rows", rows_of(mine[1])))
        desk.answer(1, ("rows", rows_of(mine[1])))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"versions": {**HERE.versions, "jax": "0.9.9"}}, r"^machine node7: it has jax 0\.9\.9, this one \d"),
        ({"source": "abc"}, r"^machine node7: its gpcjax 0\S+ is of another source \(abc, here \w{12}\)"),
    ],
)
def test_a_machine_with_other_versions_is_refused(changes, message):
    with pytest.raises(UserError, match=message):
        served(lambda number: Good(there("node7", **changes)))


def test_rows_of_another_kind_of_machine_say_so():
    got, _, machines, _ = served(lambda number: Good(there(machine=OTHER)) if number else Good(most=1))
    kinds = [rows.machine for rows in got]
    assert kinds == ["", *[kind_of(OTHER)] * 3] and machines == [OTHER]


class TestCheckpoints:
    """What a worker saves comes to the desk's side, and goes with its cells to the next one of the same kind."""

    @pytest.fixture
    def archive(self, tmp_path):
        name = "1795715941520164536-10949-0"
        runs = runs_as_json((cell, 5) for cell in CELLS[:3])
        write_folder(tmp_path / name, {"kind": KIND, "runs": runs, "lanes": []}, {"some": np.arange(3.0)})
        return name, pack([(tmp_path / name, name)])

    @pytest.fixture
    def orders(self, tmp_path):
        (tmp_path / "out").mkdir()
        return Orders(checkpoints=str(tmp_path / "out" / "checkpoints"), seconds=15.0)

    @pytest.mark.parametrize("changes", [{}, {"machine": OTHER}])
    def test_of_one_that_is_lost(self, archive, orders, changes, tmp_path):
        class Saving(Good):
            def hear(self, answer, archives):
                saved = [("checkpoint", *archive)] if answer and answer[0] == "cells" else []
                return [*saved, *super().hear(answer, archives)]

        got, _, _, fake = served(
            lambda number: Good(there(**changes)) if number else Saving(most=0), orders=orders
        )
        assert len(got) == 4
        sent = [each for each in fake.actors[1].got if each[0] and each[0][0] == "cells" and each[0][1]]
        places = {
            cell: place for (_, _, *more), _ in sent for cell, place in (more[0] if more else {}).items()
        }
        archives = {name for _, given in sent for name in given}
        if changes:  # on another kind of machine its bits would be neither of the two
            assert not places and not archives
        else:
            assert places == {CELLS[0]: CheckpointPlace(archive[0], 0)}  # the one that it had
            assert archives == {archive[0]}
        assert (tmp_path / "out" / "checkpoints" / archive[0] / "card.json").is_file()

    def test_a_newer_one_takes_the_place_of_the_one_before(self, archive, orders, tmp_path):
        name, packed = archive
        first = [("checkpoint", name, packed), ("checkpoint", "no_such", packed)]
        _, notes, _, _ = served(lambda number: Good(first=first), orders=orders)
        assert len(notes) == 1 and notes[0].startswith(
            "no checkpoint: "
        )  # the name is not that of what is in it
        assert [path.name for path in (tmp_path / "out" / "checkpoints").iterdir()] == [name]

    @pytest.mark.parametrize("mine", [True, False], ids=["of its kind", "of another kind"])
    def test_of_a_driver_that_was_on_another_kind_of_machine(self, orders, mine, tmp_path):
        """What its workers had saved waits for workers of their kind, whatever kind the new driver is of."""
        name, kind = "1795715941520164536-10949-0", kind_of(OTHER)
        folder = tmp_path / "out" / "checkpoints" / name
        agree = told(versions(), kind, None)
        runs = runs_as_json((cell, 5) for cell in CELLS)
        write_folder(folder, {"kind": KIND, **agree, "runs": runs, "lanes": []}, {"some": np.arange(3.0)})
        here = told(versions(), kind_of(HERE.machine), None)
        places = survey(tmp_path / "out", lambda cell: True, here, print)
        assert folder.is_dir() and list(places) == [kind]
        got, _, _, fake = served(
            lambda number: Good(there(machine=OTHER) if mine else HERE), orders=orders, places=places
        )
        sent = [each for each in fake.actors[0].got if each[0] and each[0][0] == "cells" and each[0][1]]
        given = {cell: place.folder for (_, _, *more), _ in sent for cell, place in (more or [{}])[0].items()}
        assert given == (dict.fromkeys(CELLS, name) if mine else {})
        assert {each for _, archives in sent for each in archives} == ({name} if mine else set())
        assert len(got) == 4 and folder.is_dir()
        # It goes when nobody needs it any more.
        assert not survey(tmp_path / "out", lambda cell: False, here, print) and not folder.exists()

    def test_where_many_save_each_does_it_less_often(self, orders):
        desk = Desk(CELLS, [], 4, lambda _: None, lambda *_: None, lambda _: None, orders=orders)
        desk.workers = 1000
        workers = crew.Crew(FakeRay(lambda number: Waiting()), desk)
        member = crew.Member(0, None, HERE)
        answer, _ = pickle.loads(workers._packed(member, ("program", CELLS[0], orders)))
        assert answer[2].seconds == 250.0
        never = dataclasses.replace(orders, seconds=0.0)
        answer, _ = pickle.loads(workers._packed(member, ("program", CELLS[0], never)))
        assert answer[2].seconds == 0.0


def test_this_machine_is_described_as_everywhere():
    assert HERE.machine == machine.describe() and len(HERE.source) == 12
