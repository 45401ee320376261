"""Folders of what ended by a mistake before anything came of it."""

from unittest import mock

import pytest

from gpcjax import cli
from gpcjax.errors import ForeignError, UserError
from gpcjax.sweep import run as run_module
from gpcjax.sweep.beginning import begun
from tests.sweep.pretended import Pretended

SETTINGS = {"env": "cartpole", "algo": "coach", "seeds": 2, "episodes": 3}


def fail(out, *files, error=UserError):
    """Begins something in a folder, that makes some files and fails."""
    with pytest.raises(error), begun(out):
        for name in ("manifest.json", *files):
            (out / name).parent.mkdir(exist_ok=True)
            (out / name).touch()
        (out / "episodes").mkdir(exist_ok=True)
        raise error("a mistake")


def test_nothing_is_left(tmp_path):
    fail(tmp_path / "runs" / "out", "trial/manifest.json")
    assert not list(tmp_path.iterdir())
    (tmp_path / "mine").mkdir()
    fail(tmp_path / "mine")
    assert not list((tmp_path / "mine").iterdir())


@pytest.mark.parametrize("name", ["episodes/part", "checkpoints/card.json", "fault.txt"])
def test_what_came_of_it_stays(tmp_path, name):
    fail(tmp_path / "out", name)
    assert (tmp_path / "out" / name).exists() and (tmp_path / "out" / "manifest.json").exists()


def test_what_was_there_before_stays(tmp_path):
    (tmp_path / "manifest.json").touch()
    fail(tmp_path)
    assert (tmp_path / "manifest.json").exists()


def test_who_stops_it_goes_on_later(tmp_path):
    fail(tmp_path / "out", error=KeyboardInterrupt)
    assert (tmp_path / "out" / "manifest.json").exists()


@pytest.mark.parametrize("command", [False, True])
def test_of_code_of_a_persons_own_that_fails(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    error = ForeignError("env mine:Task: its step failed", ValueError("no"))
    for after, left in ((0, False), (1, True)):
        with mock.patch.object(run_module, "Processes", Pretended(fails_after=after, error=error)):
            if command:
                words = [word for name, value in SETTINGS.items() for word in (f"--{name}", str(value))]
                assert cli.main(["sweep", *words]) == 2
                assert "its step failed" in capsys.readouterr().err
            else:
                with pytest.raises(ForeignError):
                    run_module.sweep(**SETTINGS)
        assert (tmp_path / "runs").exists() == left
