"""Files of settings: their tables [quick], and those that come with the project."""

from dataclasses import asdict
from pathlib import Path

import pytest

from gpcjax import cli
from gpcjax.envs.registry import expert_names, task
from gpcjax.errors import UserError
from gpcjax.registry import find
from gpcjax.reproduce.parts import ABLATIONS, PARTS, ROWS
from gpcjax.sweep.plan import count
from gpcjax.sweep.seeds import Seeds
from gpcjax.sweep.spec import make_spec, read_toml, spec_of

SWEEPS = Path(__file__).parents[2] / "sweeps"
SHIPPED = sorted(path for path in SWEEPS.glob("*.toml") if not path.stem.startswith("study_"))
GRIDS = [path.stem for path in SHIPPED if path.stem.startswith("grid_")]
SOME = """
env = "cartpole"
error = [0, 0.1]
seeds = 50

[quick]
seeds = 5
episodes = 4
"""


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "a.toml"
        path.write_text(text)
        return path

    return write


class TestQuick:
    def test_it_changes_nothing_unless_asked_for(self, file):
        assert make_spec(read_toml(file(SOME))) == spec_of(env="cartpole", error=[0, 0.1], seeds=50)

    def test_it_wins_over_the_rest_of_the_file(self, file):
        spec = make_spec(read_toml(file(SOME), quick=True))
        assert spec == spec_of(env="cartpole", error=[0, 0.1], seeds=5, episodes=4)

    def test_without_one_quick_is_refused(self, file):
        """It would be the whole sweep, which nobody wanted who asked for a small one."""
        path = file(SOME.partition("[quick]")[0])
        with pytest.raises(UserError, match=r"a.toml: it has no table \[quick\]: leave --quick out"):
            read_toml(path, quick=True)
        assert make_spec(
            read_toml(file(SOME.partition("[quick]")[0] + "[quick]"), quick=True)
        ).seeds == Seeds.of(50)

    def test_a_dash_or_an_underscore_is_the_same_setting(self, file):
        path = file('env = "cartpole"\nmax-capacity = 64\n[quick]\nmax_capacity = 8\n')
        assert make_spec(read_toml(path, quick=True)).max_capacity == 8

    @pytest.mark.parametrize("quick", [False, True])
    @pytest.mark.parametrize(
        ("text", "message"),
        [
            (
                'env = "pendulum"\n[quick]\nsedes = 3',
                "[quick] 'sedes' is no setting (did you mean seeds?): give env, algo",
            ),
            ("[quick]\nseeds = 0", "[quick] seeds 0: give a whole number from 1"),
            ("[quick.quick]\nseeds = 1", "[quick] 'quick' is no setting"),
            ("[quik]\nseeds = 1", "'quik' is no setting"),
            ("quick = true", "quick is no table: begin one with a line [quick]"),
        ],
    )
    def test_a_mistake_names_file_and_table(self, file, text, message, quick):
        """Whether it is asked for or not."""
        path = file(text)
        with pytest.raises(UserError) as refusal:
            make_spec(read_toml(path, quick))
        assert str(refusal.value).startswith(f"{path}: {message}")

    def test_what_does_not_fit_together_names_it_too(self, file):
        path = file('env = "cartpole"\nalgo = "gpc"\n[quick]\nbeta = 3\n')
        with pytest.raises(UserError, match=r"a.toml: \[quick\] beta: with gpc alone it changes nothing"):
            make_spec(read_toml(path, quick=True))

    def test_the_command_line(self, file, capsys, monkeypatch, tmp_path):
        """Flags win over both."""
        monkeypatch.chdir(tmp_path)
        words = ["sweep", str(file(SOME)), "--jobs=1", "--out=new", "--dry-run"]
        for more, cells, episodes in (
            ([], 300, 30),
            (["--quick"], 30, 4),
            (["--quick", "--seeds=7"], 42, 4),
            (["--quick", "--episodes=9", "--error=0"], 15, 9),
        ):
            assert cli.main([*words, *more]) == 0
            told = f"{cells} cells of cartpole, {episodes} episodes each, in 1 processes, into new\n"
            assert capsys.readouterr().out == told
        assert cli.main(["sweep", "--env=cartpole", "--quick", "--dry-run"]) == 2
        told = "gpcjax: error: --quick takes the table [quick] of a TOML file: give the file\n"
        assert capsys.readouterr().err == told


def spec(path, quick=False):
    """Of a file, as far as it can be known before another sweep is done."""
    given = read_toml(path, quick)
    given.pop("rate_from", None)
    return make_spec(given)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
class TestShipped:
    def test_it_is_valid_and_quick_is_quicker(self, path):
        whole, quick = spec(path), spec(path, quick=True)
        assert count(quick) * quick.episodes <= count(whole) * whole.episodes / 10
        assert len(quick.seeds) > 2  # an interval needs some runs
        smaller = {"seeds", "episodes", "error", "oracle", "delta"}
        assert {name for name, value in asdict(whole).items() if value != asdict(quick)[name]} <= smaller
        assert set(quick.error) <= set(whole.error) and set(quick.oracle) <= set(whole.oracle)

    def test_it_says_what_it_is_and_how_to_run_it(self, path):
        comment = path.read_text().partition("\n\n")[0]
        assert all(line.startswith("#") for line in comment.splitlines())
        assert f"make sweep SPEC=sweeps/{path.name}" in comment


def test_every_experiment_has_its_file_and_every_file_its_part():
    experiments = [name for part in PARTS.values() for name in part.experiments]
    assert len(set(experiments)) == len(experiments)
    assert sorted(experiments) == [path.stem for path in SHIPPED if path.stem not in GRIDS]


@pytest.mark.parametrize("name", GRIDS)
def test_a_preset_is_a_point_of_the_grid_that_it_comes_from(name):
    grid = spec(SWEEPS / f"{name}.toml")
    (algo,) = grid.algo
    preset = {**find("learner", algo).defaults, **task(grid.env).presets.get(algo, {})}
    assert name == f"grid_{grid.env}_{algo}"
    for hyperparameter, values in grid.hyperparameters.items():
        assert preset[hyperparameter] in values and len(values) > 1


def test_an_experiment_comes_after_the_one_whose_rates_it_takes():
    order = PARTS["active"].experiments
    for name in order:
        source = read_toml(SWEEPS / f"{name}.toml").get("rate_from")
        if source is not None:
            folder = Path(source.value)
            assert folder.parent == Path("runs/reproduction")
            assert folder.name in order[: order.index(name)]


@pytest.mark.parametrize("stem", ABLATIONS)
def test_the_rows_of_an_ablation_differ_in_what_their_names_say(stem):
    """Active in i and ii, whose chances iii and iv take; adaptive in i and iii, static in ii and iv."""
    given = {row: read_toml(SWEEPS / f"{stem}_{row}.toml") for row in ROWS}
    assert [row for row in ROWS if "active_gain" in given[row]] == ["i", "ii"]
    sources = {row: Path(given[row]["rate_from"].value).name for row in ROWS if "rate_from" in given[row]}
    assert sources == {"iii": f"{stem}_i", "iv": f"{stem}_ii"}
    assert [row for row in ROWS if "constant_rate" in given[row]] == ["i", "iii"]
    assert [row for row in ROWS if "static_rate" in given[row]] == ["ii", "iv"]
    specs = [spec(SWEEPS / f"{stem}_{row}.toml") for row in ROWS]
    assert (
        len({(each.env, each.error, each.delta, each.oracle, each.seeds, each.episodes) for each in specs})
        == 1
    )
    static, constant = (given["iv"]["static_rate"].value[0], given["i"]["constant_rate"].value[0])
    assert static == pytest.approx(4 * constant)


def test_the_parts_teach_the_tasks_that_they_are_named_after():
    for part, env in (("pendulum", "pendulum"), ("cartpole", "cartpole"), ("lander", "lunarlander")):
        specs = [spec(SWEEPS / f"{name}.toml") for name in PARTS[part].experiments]
        assert {each.env for each in specs} == {env}
        assert sorted(algo for each in specs for algo in each.algo) == ["coach", "gpc", "gpc-ns"]
        assert {each.error for each in specs} == {(0.0, 0.1, 0.2)}
        assert {each.oracle for each in specs} == {expert_names(env)[:1]}
    for env in ("cartpole", "pendulum"):
        assert set(spec(SWEEPS / f"oracles_{env}.toml").oracle) == set(expert_names(env))
