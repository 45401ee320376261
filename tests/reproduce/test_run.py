"""A reproduction from its files to its report: with workers that are only pretended; see test_real."""

import dataclasses
import functools
import re
import zlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gpcjax import cli
from gpcjax.errors import Failure, UserError
from gpcjax.report.figures import style
from gpcjax.reproduce import records
from gpcjax.reproduce import run as reproduce_module
from gpcjax.reproduce.parts import PARTS, ROWS, chosen
from gpcjax.reproduce.run import reproduce
from gpcjax.sweep.executors import Totals
from gpcjax.sweep.manifest import read_manifest
from gpcjax.sweep.reading import read_episodes
from gpcjax.sweep.schedule import offered_rates
from gpcjax.sweep.spec import make_spec, read_toml
from tests.reproduce.illustrated import illustrations
from tests.sweep.pretended import rows

SWEPT = tuple(part for part in PARTS if PARTS[part].experiments)
BASELINES = {"idle": 0.0}
"""The return of a policy that does not learn; 100 for an oracle."""


@pytest.fixture
def sweeps(tmp_path):
    """The files of the project, with three seeds and three episodes where it has to be quick."""
    folder = tmp_path / "sweeps"
    folder.mkdir()
    for path in (Path(__file__).parents[2] / "sweeps").glob("*.toml"):
        head, quick, tail = path.read_text().partition("[quick]")
        (folder / path.name).write_text(head + quick + re.sub(r"(seeds|episodes) = \d+", r"\1 = 3", tail))
    return folder


class Pretended:
    """In place of `Processes`: rows of all cells, or of some and then Ctrl-C."""

    def __init__(self):
        self.cells, self.stop_after = [], None
        self.called, self.fails = [], False

    def __call__(self, jobs):
        self.jobs = jobs
        return self

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def run(self, office):
        """As one worker, which has all that it may and then hands it in."""
        while (answer := office.answer(0, ("ready",))) != ("stop",):
            match answer:
                case ("errand", function, words):
                    self.called.append((function, *words))
                    if self.fails:
                        office.answer(0, ("failed", "MemoryError", ""))
                case ("baseline", _, name):
                    numbers = {"mean": BASELINES.get(name, 100.0), "std": 1.0, "n": 100}
                    office.answer(0, ("baseline", name, numbers))
                case ("program", *_):
                    while cells := office.answer(0, ("next",))[1]:
                        for cell in cells:
                            self._teach(office, cell)
                    office.answer(0, ("progress", Totals(env_steps=10, episodes=3, compile_seconds=1.0)))

    def _teach(self, office, cell):
        if len(self.cells) == self.stop_after:
            raise KeyboardInterrupt
        self.cells.append(cell)
        office.answer(0, ("rows", taught(cell)))


def taught(cell):
    """What a run might leave: enough corrections for every claim, chances that differ."""
    made = rows(cell, cell.episodes, corrections=160)
    random = np.random.default_rng(zlib.crc32(repr(cell).encode()))
    made.episodes["returns"][:] = 50 + random.normal(size=cell.episodes)
    made.episodes["length"][:], made.episodes["corrections"][:] = 50, 3
    made.episodes["rate_sum"][:] = random.uniform(0.05, 0.2, cell.episodes)
    made.episodes["asked"][:] = 5
    made.episodes["chance_sum"][:] = 5 * random.uniform(0.05, 0.2, cell.episodes)
    made.corrections["values"][:, 0] = random.uniform(0.02, 0.1, 160)
    return made


@pytest.fixture
def pretended(monkeypatch):
    workers = Pretended()
    monkeypatch.setattr(reproduce_module, "Processes", workers)
    return workers


@pytest.fixture
def unpainted(monkeypatch):
    """Every figure is made, none is painted: that takes seconds, and test_the_whole_of_it does it in the end."""
    monkeypatch.setattr(style, "image", lambda figure, kind: kind.encode())


@pytest.fixture
def one_table(monkeypatch):
    """Of Table 5.4 its first variant alone: the others are the same again with other numbers."""
    first = tuple(f"table5_4_{row}" for row in ROWS)
    monkeypatch.setitem(PARTS, "active", dataclasses.replace(PARTS["active"], experiments=first))


@pytest.fixture
def undrawn(monkeypatch):
    """No report is made."""
    monkeypatch.setattr(reproduce_module, "_drawn", lambda out, quick: (out / "report.html", {}))


def files(out):
    return {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


def numbers(out):
    """The files that hold no picture."""
    return {
        path: content
        for path, content in files(out).items()
        if path.parent.name != "figures" and path.name != "report.html"
    }


@pytest.mark.parametrize("painted", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_whole_of_it(sweeps, pretended, request, tmp_path, monkeypatch, painted):
    """In few pixels, or none and with one table."""
    if not painted:
        request.getfixturevalue("one_table")
    experiments = [name for part in SWEPT for name in PARTS[part].experiments]
    paint = functools.partial(style.image, dpi=20) if painted else lambda figure, kind: kind.encode()
    monkeypatch.setattr(style, "image", paint)
    out = tmp_path / "out"
    assert reproduce(sweeps, out, SWEPT, quick=True, jobs=1) == out / "report.html"
    for name in experiments:
        manifest = read_manifest(out / name)
        assert manifest["complete"] and manifest["specification"]["seeds"] == 3
        # As many as the file says, and no other rows.
        assert len(read_episodes(out / name)) == 3 * manifest["cells"]
    for name in PARTS["active"].experiments:
        stem, _, row = name.rpartition("_")
        schedule = read_manifest(out / name)["specification"]["rate_schedule"]
        source = {"iii": "i", "iv": "ii"}.get(row)
        # Of the folder beside it, whatever the file calls it.
        assert tuple(schedule) == (offered_rates(out / f"{stem}_{source}") if source else ())
    claims = pd.read_csv(out / "claims.csv")
    # What is said of Table 5.4 needs all its variants.
    assert set(claims["part"]) == {*SWEPT, "all"} - (set() if painted else {"active"})
    lander = claims[(claims["part"] == "lander") & claims["claim"].str.startswith("GPC-NS outperforms")]
    assert set(lander["n"]) == {3}  # though the two learners are of two sweeps
    assert set(lander["verdict"]) == {"not tested"}
    page = (out / "report.html").read_text()
    text = (out / "claims.md").read_text()
    assert all(name in page for name in experiments)
    assert all(claim in text for claim in claims["claim"])
    figures = {path.name for path in (out / "figures").iterdir()}
    assert {path.removesuffix(".png") for path in figures if path.endswith(".png")} == {
        path.removesuffix(".pdf") for path in figures if path.endswith(".pdf")
    }
    for start in ("fig5_1", "fig5_2", "fig5_4", "fig5_5", "fig5_7", "fig5_8", "oracles_cart", "oracles_pend"):
        assert any(name.startswith(start) for name in figures)
    # Again, and nothing is new; test_a_part_at_a_time says that of claims, test_real of what is painted.
    before, ran = numbers(out), len(pretended.cells)
    request.getfixturevalue("undrawn")
    reproduce(sweeps, out, SWEPT, quick=True, jobs=2)
    assert len(pretended.cells) == ran and numbers(out) == before


@pytest.mark.parametrize(
    ("name", "jobs", "told"),
    [
        ("fig5_1_pendulum", 2, "900 runs of 40 episodes, about 20 s where nothing is done yet"),
        ("fig5_5_lunarlander_ns", 2, "60 runs of 200 episodes, about 20 min where nothing is done yet"),
        ("oracles_cartpole", 2, "4,320 runs of 30 episodes, about 11 min where nothing is done yet"),
    ],
)
def test_costs_of_whole_experiments(tmp_path, name, jobs, told):
    """About what they took where they were measured (38 s the first, 12 min the last; compiling took longer then)."""
    spec = make_spec(read_toml(Path(__file__).parents[2] / "sweeps" / f"{name}.toml", quick=False))
    assert reproduce_module._cost(spec, tmp_path, jobs) == told


def test_a_part_at_a_time(sweeps, pretended, unpainted, tmp_path, capsys):
    """The report shows what there is, of earlier calls too; what each experiment costs is told, and what came of it."""
    out = tmp_path / "out"
    told = "27 runs of 3 episodes, about 20 s where nothing is done yet"
    reproduce(sweeps, out, ("pendulum",), quick=True, jobs=1)
    first = pd.read_csv(out / "claims.csv")
    assert set(first["part"]) == {"pendulum"}
    assert f"fig5_1_pendulum, 1 of 1: {told}" in capsys.readouterr().err.splitlines()
    reproduce(sweeps, out, ("pendulum", "cartpole"), quick=True, jobs=1)
    lines = capsys.readouterr().err.splitlines()
    assert "fig5_1_pendulum, 1 of 2: 27 runs of 3 episodes, done" in lines
    assert f"fig5_4_cartpole, 2 of 2: {told}" in lines
    assert lines[-1].startswith("Of ") and "are not tested" in lines[-1]
    claims = pd.read_csv(out / "claims.csv")
    assert set(claims["part"]) == {"pendulum", "cartpole"}
    pd.testing.assert_frame_equal(claims[claims["part"] == "pendulum"].reset_index(drop=True), first)
    assert {cell.env for cell in pretended.cells} == {"pendulum", "cartpole"}


def test_stopped_it_goes_on(sweeps, pretended, unpainted, request, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["reproduce", "--quick", "--only=pendulum,cartpole", f"--sweeps={sweeps}", f"--out={out}"]
    pretended.stop_after = 3 * 9 + 5
    assert cli.main(words) == 130
    told = f"gpcjax: stopped: {out} keeps what is finished, the same command goes on from there"
    assert capsys.readouterr().err.splitlines()[-1] == told
    assert not (out / "report.html").exists()
    assert read_manifest(out / "fig5_1_pendulum")["complete"]
    assert not read_manifest(out / "fig5_4_cartpole")["complete"]
    pretended.stop_after = None
    request.getfixturevalue("undrawn")
    assert cli.main(words) == 0
    assert capsys.readouterr().out == f"{out / 'report.html'}\n"
    assert len(pretended.cells) == len(set(pretended.cells)) == 2 * 27


class TestRefused:
    """Before anything runs."""

    @pytest.fixture(autouse=True)
    def nothing_runs(self, pretended):
        yield
        assert not pretended.cells

    def refusal(self, sweeps, out, *only):
        with pytest.raises(UserError) as error:
            reproduce(sweeps, out, only or SWEPT, quick=True, jobs=1)
        return str(error.value)

    def test_a_folder_of_something_else(self, sweeps, tmp_path):
        folder = tmp_path / "out" / "fig5_5_lunarlander"
        folder.mkdir(parents=True)
        (folder / "thesis.tex").touch()
        assert f"{folder}: it holds 'thesis.tex' and no run" in self.refusal(sweeps, tmp_path / "out")

    def test_a_file(self, sweeps, tmp_path):
        (tmp_path / "out").touch()
        assert f"{tmp_path / 'out'}: this is no folder" in self.refusal(sweeps, tmp_path / "out")

    def test_a_file_of_settings_that_is_missing_or_wrong(self, sweeps, tmp_path):
        (sweeps / "table5_4_iv.toml").write_text('env = "cartpole"\n[quick]\nsedes = 3\n')
        assert "table5_4_iv.toml: [quick] 'sedes' is no setting" in self.refusal(sweeps, tmp_path / "out")
        (sweeps / "table5_4_iv.toml").unlink()
        assert "table5_4_iv.toml: cannot be read" in self.refusal(sweeps, tmp_path / "out")
        assert not (tmp_path / "out").exists()

    def test_a_part_that_there_is_not(self):
        with pytest.raises(UserError, match=r"--only 'pendulm': give .* .did you mean pendulum"):
            chosen("cartpole,pendulm")


def test_the_settings_of_another_reproduction_are_refused(sweeps, pretended, undrawn, tmp_path):
    """A quick one and a whole one do not share a folder."""
    reproduce(sweeps, tmp_path / "out", ("pendulum",), quick=True, jobs=1)
    ran = len(pretended.cells)
    message = r"fig5_1_pendulum: it holds another specification \(seeds, episodes\)"
    with pytest.raises(UserError, match=message):
        reproduce(sweeps, tmp_path / "out", ("pendulum",), quick=False, jobs=1)
    assert len(pretended.cells) == ran


def test_a_file_that_has_changed_is_refused(sweeps, pretended, one_table, undrawn, tmp_path):
    """What is known only when the rates are: just before that experiment would run."""
    reproduce(sweeps, tmp_path / "out", ("active",), quick=True, jobs=1)
    path, ran = sweeps / "table5_4_iii.toml", len(pretended.cells)
    path.write_text(path.read_text().replace("constant_rate = 0.01", "constant_rate = 0.02"))
    with pytest.raises(UserError, match=r"table5_4_iii: it holds another specification \(hyperparameters\)"):
        reproduce(sweeps, tmp_path / "out", ("active",), quick=True, jobs=1)
    assert len(pretended.cells) == ran


def test_parts_are_chosen_in_their_own_order():
    assert chosen(None) == tuple(PARTS)
    assert chosen("lander, pendulum,lander") == ("pendulum", "lander")


def test_illustrations_are_computed_once(tmp_path, pretended, sweeps, undrawn):
    called = pretended.called
    path = tmp_path / "out" / "illustrations.npz"
    reproduce(sweeps, tmp_path / "out", ("illustrations",), quick=True, jobs=1)
    assert called == [("gpcjax.reproduce.illustrations:compute", path)]
    path.touch()  # as an interrupted one, or one of another version: no illustrations of ours
    reproduce(sweeps, tmp_path / "out", ("illustrations", "pendulum"), quick=True, jobs=1)
    assert len(called) == 2 and len(pretended.cells) == 27
    records.write(path, illustrations())
    reproduce(sweeps, tmp_path / "out", ("illustrations",), quick=True, jobs=1)
    assert len(called) == 2
    path.unlink()
    pretended.fails = True
    with pytest.raises(Failure, match="a worker process failed: MemoryError"):
        reproduce(sweeps, tmp_path / "out", ("illustrations",), quick=True, jobs=1)


def test_dry_run(sweeps, tmp_path, capsys):
    words = f"reproduce --dry-run --only active,lander --sweeps {sweeps} --out {tmp_path / 'out'} --jobs 3"
    assert cli.main(words.split()) == 0
    told = f"active, lander: 18 experiments, in 3 processes, into {tmp_path / 'out'}\n"
    assert capsys.readouterr().out == told
    assert not (tmp_path / "out").exists()
