"""Runs that are under way: what is saved of them when, and which of them can go on. No engine."""

import pytest

from gpcjax.errors import UserError
from gpcjax.sweep.checkpointing import Checkpointer
from gpcjax.sweep.executors import Orders
from gpcjax.sweep.runs import Runs


class Looked:
    """A pool without runs, that counts how often they were asked for."""

    count = 0

    def snapshot(self):
        self.count += 1
        return []


class TestWhereNothingCanBeWritten:
    def test_it_is_tried_again_when_it_is_time(self, tmp_path):
        class Full(Looked):
            def snapshot(self):
                super().snapshot()
                raise UserError("the disk is full")

        pool, checkpointer = Full(), Checkpointer(tmp_path / "checkpoints", 100.0, {})
        checkpointer._since -= 101
        with pytest.raises(UserError):
            checkpointer.look(pool, {})
        checkpointer.look(pool, {})
        assert pool.count == 1

    def test_a_run_folder_that_was_removed_is_not_made_anew(self, tmp_path):
        pool, out = Looked(), tmp_path / "out"
        with pytest.raises(UserError, match=f"^{out}: the folder was removed or moved while it was in use$"):
            Checkpointer(out / "checkpoints", 1e-9, {}).look(pool, {})
        assert not out.exists() and not pool.count

    def test_it_is_said_once(self, tmp_path):
        said = []
        runs = Runs(
            Looked(), Orders(checkpoints=str(tmp_path / "out" / "checkpoints"), seconds=1e-9), said.append
        )
        for _ in range(3):
            runs.save()
        assert [word for word, _ in said] == ["note"]
