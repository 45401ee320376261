"""`gpcjax policy`: which policy it is, how well it does, and what is wrong with one."""

import json
import math
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gpcjax
from gpcjax import cli
from gpcjax.deploy.evaluation import Evaluation, facts, sheet
from gpcjax.engine.evaluate import evaluate
from gpcjax.envs.registry import make_env
from gpcjax.learners.factory import make_learner
from gpcjax.play.chosen import Player, player_of
from gpcjax.play.episodes import moments
from gpcjax.policies.plain import PlainNetwork
from gpcjax.policies.policy import Policy
from gpcjax.policies.saved import save_controller, shipped_path
from gpcjax.report.statistics import Interval, mean_interval
from gpcjax.sweep.run import sweep
from gpcjax.teach.world import World
from tests.policies.made import made
from tests.policies.test_damaged import damage
from tests.sweep.learned import Learned


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    """This process computes already, and has no window."""
    for name in ("gpcjax.deploy.command", "gpcjax.play.command"):
        monkeypatch.setattr(f"{name}.compute_here", lambda: None)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def told(capsys):
    """What a command prints, without the blanks at the ends of lines."""

    def run(*words):
        capsys.readouterr()
        assert cli.main(["policy", *map(str, words)]) == 0, capsys.readouterr().err
        return "\n".join(map(str.rstrip, capsys.readouterr().out.splitlines()))

    return run


@pytest.fixture
def refused(capsys):
    """The line that a command complains with."""

    def run(*words):
        capsys.readouterr()
        assert cli.main(["policy", *map(str, words)]) == 2
        out, err = capsys.readouterr()
        assert out == "" and err.startswith("gpcjax: error: ") and err.count("\n") == 1
        return err.removeprefix("gpcjax: error: ").rstrip()

    return run


def learner_and_state(way):
    """Of the mountain car, taught to do this where it stands."""
    learner = make_learner("coach", "mountaincar")
    state, _ = learner.correct(learner.init(), [-0.5, 0.0], [0.0], [way])
    return learner, state


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder; the run with seed 1 returned most."""

    def learned(cell):
        yield 2, 10.0 - abs(cell.seed - 1), *learner_and_state(1 if cell.seed == 1 else -1)

    out = tmp_path_factory.mktemp("runs") / "out"
    settings = {"algo": "coach", "seeds": 3, "episodes": 2}
    return sweep(out, executor=Learned("policies", learned), keep="policies", env="mountaincar", **settings)


class TestInfo:
    def test_of_a_saved_policy(self, told):
        text = told("info", shipped_path("pendulum"))
        first, *lines = text.splitlines()
        found = {line.split("  ")[0].strip(): line for line in lines}
        assert first == "pendulum" and "Matern 0.5" in found["kind"]
        assert found["task"].endswith(" pendulum") and found["format"].endswith(
            "its files are as they were saved"
        )
        assert "obs[0]: cos of the angle" in text
        policy = gpcjax.load_policy(shipped_path("pendulum")).plain
        assert found["points"].split() == ["points", str(policy.points.shape[1])]
        assert found["length-scales"].split()[1:] == ["0.7,", "0.7,", "4.2"]
        # Tables 5.1 and 5.2 of the thesis: l_p 0.2, observations divided by (1, 1, 0.13, 0.4).
        lengths = json.loads(told("info", "cartpole:gpc", "--json"))["length_scales"]
        np.testing.assert_allclose(lengths, [[0.2, 0.2, 0.026, 0.08]], rtol=1e-9)
        assert "  teacher" in text and "energy" in text

    def test_for_programs(self, told):
        found = json.loads(told("info", shipped_path("brax-reacher"), "--json"))
        assert found["kind"] == "network" and found["layers"] == [32, 32, 2, 2] and found["format"] == 2
        assert (found["obs_size"], found["action_size"], found["env"]) == (11, 2, "brax:reacher")
        assert found["provenance"]["learner"] == "ppo of brax" and found["exports"] == ["python", "c", "onnx"]
        weights = sum(out * (size + 1) for size, out in ((11, 32), (32, 32), (32, 2), (2, 2)))
        assert found["numbers"] == weights

    def test_of_each_kind(self, told, tmp_path):
        kinds = {}
        for number, plain in enumerate(made()):
            save_controller(tmp_path / str(number), Policy.of(plain).controller, {})
            found = json.loads(told("info", tmp_path / str(number), "--json"))
            kinds.setdefault(found["kind"], []).append(found)
            assert (found["obs_size"], found["action_size"], found["env"]) == (3, 2, None)
            assert "nobody says (--env)" in told("info", tmp_path / str(number))
        assert sorted(kinds) == ["grid", "kernel", "network", "squashed-network"]
        assert [each["smoothness"] for each in kinds["kernel"]] == [0.5, 1.5, 2.5, "infinity"]
        assert kinds["kernel"][0]["points"] == [7, 7] and kinds["grid"][0]["counts"] == [2, 4, 3]

    def test_of_a_run_a_learner_and_an_expert(self, told, folder, tmp_path):
        found = json.loads(told("info", folder, "--json"))
        assert found["policy"] == "COACH, seed 1, after episode 2, of 3 runs the best"
        assert found["provenance"]["seed"] == 1 and found["provenance"]["return"] == 10.0
        assert json.loads(told("info", folder, "--seed", "2", "--json"))["provenance"]["seed"] == 2
        gpcjax.save_learner(tmp_path / "learner", *learner_and_state(1), env="mountaincar")
        found = json.loads(told("info", tmp_path / "learner", "--json"))
        assert found["learner"] and found["kind"] == "grid" and found["exports"]
        assert "teaching can go on from it" in told("info", tmp_path / "learner")
        rule = json.loads(told("info", "cartpole:lqr", "--json"))
        assert (rule["kind"], rule["obs_size"], rule["exports"]) == ("code", 4, [])


class TestEval:
    def test_its_numbers_are_those_of_evaluate_and_of_play(self, told):
        found = json.loads(told("eval", "mountaincar:pump", "--episodes", "3", "--seed", "3", "--json"))
        env, expert = make_env("mountaincar"), gpcjax.make_expert("mountaincar", "pump")
        reference = evaluate(env, expert, 6)
        returns = [each["return"] for each in found["episodes"]]
        np.testing.assert_allclose(returns, reference.returns[3:], rtol=1e-12)
        assert [each["seed"] for each in found["episodes"]] == [3, 4, 5]
        assert [each["steps"] for each in found["episodes"]] == reference.length[3:].tolist()
        interval = mean_interval(np.array(returns)[:, None])
        assert tuple(found[name] for name in ("mean", "lower", "upper")) == interval
        assert interval.lower < interval.estimate < interval.upper
        *_, end = moments(World(env, 5), player_of("mountaincar:pump", None, None, {}), 1)
        np.testing.assert_allclose(end.total, returns[2], rtol=1e-9)

    def test_of_runs(self, told, folder):
        """The starts are the same whichever run it is: policies can be compared."""
        best, other = (
            json.loads(told("eval", folder, "--episodes", "3", "--json", *more))
            for more in ((), ("--where", "seed=2"))
        )
        assert best["policy"].startswith("COACH, seed 1") and other["policy"].startswith("COACH, seed 2")
        assert [each["seed"] for each in other["episodes"]] == [0, 1, 2]
        assert best["mean"] != other["mean"]

    def test_for_a_person(self, told):
        lines = told("eval", "mountaincar:pump", "--episodes", "12").splitlines()
        assert lines[0] == "return of each episode, by the seed of its start"
        assert lines[1].split() == ["seed", *(f"+{place}" for place in range(10))]
        assert [len(line.split()) for line in lines[3:5]] == [11, 3]
        assert lines[6] == "expert pump" and lines[8].startswith("mean return")

    def test_what_is_no_number_is_said(self):
        returns, steps = np.array([1.0, math.nan, 3.0]), np.array([5, 2, 5])
        player = Player("cartpole", lambda obs: obs, "somebody", 0)
        found = Evaluation(player, 7, returns, steps, Interval(math.nan, math.nan, math.nan))
        assert facts(found)["no number"].startswith("1 of 3 episodes, the first with seed 8: ")
        assert facts(found)["mean return"] == "-" and sheet(found).rows == (("7", "1.00", "-", "3.00"),)
        from gpcjax.deploy.evaluation import as_json

        assert "NaN" not in json.dumps(as_json(found)) and as_json(found)["episodes"][1]["return"] is None

    def test_on_a_task_of_ones_own(self, told, tmp_path):
        """Two unstable coordinates: what pushes them back stays longer than what does nothing."""
        push = PlainNetwork((np.array([[-4.0, 0.0], [0.0, -4.0]]),), (np.zeros(2),))
        save_controller(tmp_path / "push", Policy.of(push).controller, {})
        words = ["eval", tmp_path / "push", "--env", "tests.engine.tasks:Drift", "--episodes", "4", "--json"]
        found = json.loads(told(*words))
        assert found["env"] == "tests.engine.tasks:Drift" and found["lower"] < found["mean"] < 0
        assert [each["steps"] for each in found["episodes"]] == [30] * 4

    @pytest.mark.slow
    @pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what brax imports
    @pytest.mark.parametrize(
        ("words", "low", "high"),
        [
            (["lunarlander:heuristic"], 200, 400),
            ([shipped_path("pendulum"), "--env", "gym:Pendulum-v1"], -500, 0),
            (["brax:reacher:ppo"], -10, 0),
        ],
        ids=["host", "gymnasium", "brax"],
    )
    def test_further_tasks(self, words, low, high, told):
        assert low < json.loads(told("eval", *words, "--episodes", "2", "--json"))["mean"] < high


def test_a_lesson_is_taken_by_its_folder(told, tmp_path):
    """As `gpcjax teach` leaves it: rows like a sweep's, and beside them the policy."""
    gpcjax.save_policy(tmp_path / "lesson" / "policy", *learner_and_state(1), env="mountaincar")
    (tmp_path / "lesson" / "manifest.json").touch()
    found = json.loads(told("info", tmp_path / "lesson", "--json"))
    assert found["folder"] == str(tmp_path / "lesson" / "policy") and found["env"] == "mountaincar"
    told("export", tmp_path / "lesson", "--out", "lesson.py")
    assert "# env: mountaincar\n" in Path("lesson.py").read_text()


def test_a_gif_is_that_of_play(told, capsys):
    policy = shipped_path("pendulum")
    text = told("gif", policy, "--out", "deep/x.gif", "--seconds", "0.2")
    assert text.splitlines()[0] == "pendulum" and text.splitlines()[-1].startswith("deep/x.gif: ")
    with Image.open("deep/x.gif") as image:
        assert image.n_frames > 3
    assert cli.main(["play", str(policy), "--gif", "y.gif", "--seconds", "0.2"]) == 0
    assert Path("y.gif").read_bytes() == Path("deep/x.gif").read_bytes()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ([], "COMMAND is missing: give info, eval, export, gif, see gpcjax policy --help"),
        (
            ["evla", "x"],
            "'evla' is no command of gpcjax policy (did you mean eval?): give info, eval, export, gif",
        ),
        (["info"], "POLICY is missing: see gpcjax policy info --help"),
        (["eval", "a", "b"], "'b' is one value too many: see gpcjax policy eval --help"),
        (["eval", "nowhere"], "nowhere: there is no such folder, give one, or ENV:EXPERT such as cartpole:"),
        (
            ["eval", "mountaincar:pump", "--episodes", "0"],
            "--episodes 0: give a whole number from 1 to 100,000",
        ),
        (
            ["eval", "mountaincar:pump", "--seed", "-1"],
            "--seed -1: give a whole number from 0 to 1,000,000,000",
        ),
        (
            ["eval", "mountaincar:pump", "--speed", "2"],
            "'--speed' is no flag (did you mean --seed?): give --episodes",
        ),
        (
            ["eval", "SHIPPED", "--env", "pendulum"],
            "cartpole: it takes 4 numbers of an observation and gives 1 actions",
        ),
        (["eval", "SAVED"], "its card names no task, give one (--env)"),
        (["gif", "SHIPPED", "--out", "x.png"], "--out x.png: give a path that ends in .gif"),
        (["info", "SHIPPED", "--where", "seed=1"], "no run folder with kept policies, leave it out"),
        (["info", "EMPTY"], "no policy is there, give a run folder with kept policies"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_mistakes_are_a_line(words, line, refused, tmp_path):
    (tmp_path / "empty").mkdir()
    if "SAVED" in words:
        gpcjax.save_policy(tmp_path / "saved", *learner_and_state(1))
    places = {"SHIPPED": shipped_path("cartpole"), "EMPTY": tmp_path / "empty", "SAVED": tmp_path / "saved"}
    assert line in refused(*(places.get(word, word) for word in words))
    assert not (tmp_path / "runs").exists()


EACH = (["info"], ["eval", "--episodes=1"], ["export", "--out=x.h"], ["gif", "--out=x.gif"])


@pytest.mark.parametrize("words", EACH, ids=lambda words: words[0])
class TestDamaged:
    """Refused in a line that names the file, and nothing is written."""

    def test_a_newer_format(self, words, refused, tmp_path):
        path = shutil.copytree(shipped_path("pendulum"), tmp_path / "newer")
        card = json.loads((path / "card.json").read_text())
        (path / "card.json").write_text(json.dumps(card | {"format": 3}))
        line = refused(words[0], path, *words[1:])
        assert line == f"{path / 'card.json'}: format 3 is not known, this version reads 1 and 2"
        assert [each.name for each in tmp_path.iterdir()] == ["newer"]

    def test_any_changed_byte(self, words, refused, tmp_path):
        draw = random.Random(5)
        for number in range(8):
            path = shutil.copytree(shipped_path("pendulum"), tmp_path / f"damaged-{number}")
            damage(path, draw, ("SHA256SUMS",))
            line = refused(words[0], path, *words[1:])
            assert line.startswith(str(path)), line
        assert {each.name[:8] for each in tmp_path.iterdir()} == {"damaged-"}
