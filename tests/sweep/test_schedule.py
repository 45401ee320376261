"""One sweep's chances of advice as another's schedule: the means, the refusals, and a small real pair of sweeps."""

import json
import shutil

import numpy as np
import pytest

from gpcjax import cli
from gpcjax.errors import UserError
from gpcjax.sweep import run
from gpcjax.sweep.build import start_of
from gpcjax.sweep.plan import plan
from gpcjax.sweep.reading import read_corrections, read_episodes
from gpcjax.sweep.schedule import offered_rates
from gpcjax.sweep.spec import from_dict, spec_of
from tests.report import synthetic
from tests.sweep.pretended import Pretended

ACTIVE = "sweep --env=cartpole --algo=gpc --error=0.1 --oracle=lqr --seeds=3 --episodes=3 --max-capacity=48 --jobs=1"
ACTIVE += " --on-full=replace-nearest --rate=0.05 --active-gain=1"
FOLLOWER = "sweep --env=cartpole --algo=coach --oracle=lqr --seeds=2 --episodes=3 --jobs=1"


@pytest.fixture
def stored(tmp_path):
    """A folder with these chances, a row for each seed and a column for each episode; nan is null."""

    def write(chances, frame=None, varying=(), **manifest):
        chances = np.asarray(chances, float)
        seeds, episodes = chances.shape
        if frame is None:
            frame = synthetic.episodes(algos=("gpc",), errors=(0.1,), seeds=seeds, length=episodes)
        frame["chance"] = chances[frame["seed"], frame["episode"] - 1]
        frame = frame.sample(frac=1, random_state=0)  # the order of arrival does not matter
        corrections = synthetic.corrections(algos=("gpc",), errors=(0.1,), seeds=seeds).iloc[:0]
        corrections = corrections.assign(**dict.fromkeys(varying, 0.0))
        return synthetic.write(
            tmp_path / "run", frame, corrections, synthetic.manifest(frame, varying, **manifest)
        )

    return write


class TestOfferedRates:
    def test_the_mean_over_runs_for_each_episode(self, stored):
        assert offered_rates(stored([[0.5, 0.2, 0.1], [0.3, 0.4, 0.2]])) == pytest.approx((0.4, 0.3, 0.15))

    def test_a_run_counts_once_however_long_its_episodes_are(self, stored):
        frame = synthetic.episodes(algos=("gpc",), errors=(0.1,), seeds=2, length=1)
        frame["asked"] = np.array([1, 1000], np.int32)
        assert offered_rates(stored([[0.2], [0.4]], frame)) == pytest.approx((0.3,))

    def test_a_null_is_no_chance_of_zero(self, stored):
        rates = offered_rates(stored([[0.5, np.nan, 0.1], [0.3, 0.4, np.nan]]))
        assert rates == pytest.approx((0.4, 0.4, 0.1))

    def test_an_episode_of_nulls_has_the_chance_of_the_one_before(self, stored):
        nan = np.nan
        rates = offered_rates(stored([[0.5, nan, nan, 0.1], [0.3, nan, nan, nan]]))
        assert rates == pytest.approx((0.4, 0.4, 0.4, 0.1))

    def test_a_run_that_stopped_early_counts_while_it_ran(self, stored):
        frame = synthetic.episodes(algos=("gpc",), errors=(0.1,), seeds=2, length=3)
        frame = frame[(frame["seed"] == 0) | (frame["episode"] == 1)]
        frame = frame.assign(status=frame["seed"].map({0: "ok", 1: "full"}))
        rates = offered_rates(stored([[0.5, 0.2, 0.1], [0.3, 9, 9]], frame))
        assert rates == pytest.approx((0.4, 0.2, 0.1))

    def test_an_incomplete_sweep_is_refused(self, stored):
        out = stored([[0.5]], complete=False)
        with pytest.raises(UserError, match=f"{out}: this sweep is not complete, run it to its end first"):
            offered_rates(out)

    def test_one_that_lost_a_part_is_refused(self, stored):
        """The means over the rest would be another schedule."""
        out = stored([[0.5, 0.2], [0.3, 0.4]])
        offered_rates(out)
        (out / "episodes" / "1.parquet").unlink()
        with pytest.raises(UserError, match=f"{out}: this sweep is not complete, run it to its end first"):
            offered_rates(out)

    @pytest.mark.parametrize(
        ("name", "many"),
        [
            ("algo", {"algos": ("gpc", "coach")}),
            ("error", {"errors": (0.0, 0.1)}),
            ("oracle", {"oracles": ("gpc", "lqr")}),
            ("noise", {"points": {"gpc": [{"noise": 1e-7}, {"noise": 1e-6}]}}),
        ],
    )
    def test_several_settings_are_refused(self, stored, name, many):
        frame = synthetic.episodes(**{"algos": ("gpc",), "errors": (0.1,), "seeds": 1, "length": 1} | many)
        out = stored([[0.5]], frame, ("noise",) if name == "noise" else ())
        with pytest.raises(UserError, match=f"{out}: its runs differ in {name}, give a sweep of one setting"):
            offered_rates(out)

    def test_no_run_folder_is_refused(self, tmp_path):
        with pytest.raises(UserError, match="none: no such folder"):
            offered_rates(tmp_path / "none")
        with pytest.raises(UserError, match=r"manifest.json: cannot be read"):
            offered_rates(tmp_path)


@pytest.fixture(scope="module", params=["pretended", pytest.param("real", marks=pytest.mark.slow)])
def workers(request, figures_unpainted):
    """Rows are made up, or computed here."""
    if request.param == "real":
        request.getfixturevalue("workers_in_process")
        yield request.param
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "Processes", Pretended())
        yield request.param


@pytest.fixture(scope="module")
def active(workers, tmp_path_factory):
    """A finished sweep whose teacher learned actively."""
    out = tmp_path_factory.mktemp("active") / "out"
    if workers == "pretended":
        frame = synthetic.episodes(algos=("gpc",), errors=(0.1,), seeds=3, length=3)
        frame["chance"] = 0.3 / frame["episode"] + 0.01 * frame["seed"] + 0.05
        rows = synthetic.corrections(algos=("gpc",), errors=(0.1,), seeds=3).iloc[:0]
        return synthetic.write(out, frame, rows, synthetic.manifest(frame))
    assert cli.main([*ACTIVE.split(), f"--out={out}"]) == 0
    return out


@pytest.fixture(scope="module")
def followed(active, tmp_path_factory):
    """A finished sweep whose teacher offered as much."""
    out = tmp_path_factory.mktemp("followed") / "out"
    assert cli.main([*FOLLOWER.split(), f"--rate-from={active}", f"--out={out}"]) == 0
    return out


def specification(out):
    return json.loads((out / "manifest.json").read_text())["specification"]


class TestCommandLine:
    def test_the_chances_are_offered_anew(self, active, followed):
        out = followed
        offered = read_episodes(active)
        means = offered.groupby("episode")["chance"].mean()
        # They depend on the uncertainty: from the least chance upwards, and in each run different.
        assert offered["chance"].between(0.05, 1.0).all() and offered["chance"].nunique() == len(offered)
        assert means.iloc[0] > 0.1 and means.nunique() == 3
        schedule = specification(out)["rate_schedule"]
        np.testing.assert_allclose(schedule, means, rtol=1e-13)
        # The teacher of each run has them, and does with them what engine/test_schedule.py says.
        for cell in plan(from_dict(specification(out))):
            np.testing.assert_array_equal(start_of(cell).teacher.schedule[: len(schedule)], schedule)
        assert "rate" not in read_episodes(out)
        before = {path: path.read_bytes() for path in out.rglob("*.parquet")}
        assert cli.main([*FOLLOWER.split(), f"--rate-from={active}", f"--out={out}"]) == 0
        assert before == {path: path.read_bytes() for path in out.rglob("*.parquet")}

    @pytest.mark.slow
    @pytest.mark.parametrize("workers", ["real"], indirect=True)
    def test_steps_had_these_chances(self, followed):
        """Corrections are at most the coins below them."""
        rows, schedule = read_episodes(followed), np.array(specification(followed)["rate_schedule"])
        assert len(rows) == 6 and (rows["asked"] > 0).all()
        np.testing.assert_allclose(rows["chance"], schedule[rows["episode"] - 1], rtol=1e-12)
        assert (rows["corrections"] <= rows["asked"]).all() and (rows["asked"] < rows["length"]).all()
        assert not read_corrections(followed).empty

    def test_the_same_numbers_given_by_hand_are_the_same_sweep(self, active, monkeypatch, tmp_path):
        """The hash has the numbers, and not where they came from."""
        specs = []
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(
            "gpcjax.cli.running._teach", lambda spec, out, jobs: specs.append((spec, out)) or 0
        )
        shutil.copytree(active, tmp_path / "moved")
        numbers = ",".join(map(repr, offered_rates(active)))
        for flag in (f"--rate-from={active}", "--rate-from=moved", f"--rate-schedule={numbers}"):
            assert cli.main([*FOLLOWER.split(), flag]) == 0
        assert specs[0] == specs[1] == specs[2]

    def test_a_toml_file_may_name_it(self, active, monkeypatch, tmp_path):
        specs = []
        monkeypatch.setattr("gpcjax.cli.running._teach", lambda spec, out, jobs: specs.append(spec) or 0)
        (tmp_path / "a.toml").write_text(f'rate_from = "{active}"\n')
        assert cli.main([*FOLLOWER.split(), str(tmp_path / "a.toml"), f"--out={tmp_path / 'out'}"]) == 0
        assert specs[0].rate_schedule == offered_rates(active)

    def test_dry_run(self, active, tmp_path, capsys):
        words = [*FOLLOWER.split(), f"--rate-from={active}", f"--out={tmp_path / 'out'}", "--dry-run"]
        assert cli.main(words) == 0
        assert capsys.readouterr().out.startswith("2 cells of cartpole, 3 episodes each")
        assert not list(tmp_path.iterdir())

    def test_dry_run_into_its_own_folder(self, active, followed):
        words = [*FOLLOWER.split(), f"--rate-from={active}", f"--out={followed}"]
        assert cli.main([*words, "--dry-run"]) == 0

    @pytest.mark.parametrize("more", [[], ["--dry-run"]], ids=["run", "dry run"])
    @pytest.mark.parametrize(
        ("flag", "message"),
        [
            ("--rate=0.1", "--rate: beside rate_from it changes nothing, give one of the two"),
            ("--rate-schedule=0.1", "--rate-schedule: beside rate_from it changes nothing, give one of the two"),
            ("--rate-from=none", "none: no such folder, give a folder that a sweep has made"),
        ],
    )  # fmt: skip
    def test_refused(self, active, tmp_path, capsys, monkeypatch, flag, message, more):
        monkeypatch.chdir(tmp_path)
        source = [] if flag.startswith("--rate-from") else [f"--rate-from={active}"]
        words = [*FOLLOWER.split(), *source, flag, "--out=out", *more]
        assert cli.main(words) == 2
        assert capsys.readouterr().err == f"gpcjax: error: {message}\n"
        assert not list(tmp_path.iterdir())


def test_python_does_not_pass_over_it(tmp_path):
    """It takes the schedule, or refuses the name."""
    with pytest.raises(ValueError, match="rate_from"):
        spec_of(env="cartpole", rate_from=str(tmp_path / "none"))
