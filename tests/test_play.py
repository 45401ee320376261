"""Watching a policy: which one it is, what is drawn of it, and the GIF that is written."""

import shutil
import weakref

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import gpcjax
from gpcjax import cli
from gpcjax.engine.evaluate import evaluate
from gpcjax.envs.experts import LanderHeuristic
from gpcjax.envs.registry import make_env, make_expert
from gpcjax.errors import UserError
from gpcjax.learners.factory import make_learner
from gpcjax.play.chosen import Player, player_of
from gpcjax.play.command import SPEED
from gpcjax.play.episodes import Moment, moments
from gpcjax.play.scenes import LESS, MORE, SCENES
from gpcjax.play.showing import Frame, has_window, watch, write_gif
from gpcjax.play.stage import DPI, SIZE, Stage
from gpcjax.registry import find
from gpcjax.sweep.run import sweep
from gpcjax.teach.course import Course
from gpcjax.teach.world import World
from tests.sweep.learned import Learned

OBS = {"cartpole": [0.3, 0.0, 0.05, 0.0], "pendulum": [0.6, 0.8, 0.0], "mountaincar": [-0.2, 0.01]}


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    """This process computes already, and has no window."""
    monkeypatch.setattr("gpcjax.play.command.compute_here", lambda: None)
    monkeypatch.chdir(tmp_path)


def learner_and_state(action):
    """Of the cart-pole, taught to do this where it stands."""
    learner = make_learner("coach", "cartpole")
    state, _ = learner.correct(learner.init(), np.zeros(4), np.zeros(1), np.sign([action]))
    return learner, state


def learned(cell):
    """After the second and the third episode of a run: it acts by seed and error."""
    for episode in (2, 3):
        way = 1 if (cell.seed + int(10 * cell.error) + episode) % 2 else -1
        # The run that returned most is not the one with the largest seed.
        yield episode, 100.0 * episode - abs(cell.seed - 1) - cell.error, *learner_and_state(way)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "out"
    settings = {"algo": "coach", "oracle": "lqr", "error": [0, 0.1], "seeds": 3, "episodes": 3}
    return sweep(out, executor=Learned("policies", learned), keep="policies", env="cartpole", **settings)


def way(player):
    return float(np.sign(player.act(np.zeros(4))[0]))


@pytest.mark.parametrize(
    ("seed", "where", "who", "expected"),
    [
        (None, {}, "COACH, seed 1, after episode 3, of 6 runs the best", -1),
        (2, {}, "COACH, seed 2, after episode 3, of 2 runs the best", 1),
        (2, {"error": "0.1"}, "COACH, seed 2, after episode 3", -1),
        (None, {"algo": "coach", "seed": "0", "error": "0"}, "COACH, seed 0, after episode 3", 1),
    ],
)
def test_of_a_run_folder_it_plays_the_best_of_what_was_kept_last(folder, seed, where, who, expected):
    player = player_of(str(folder), None, seed, where)
    assert (player.who, player.env, player.seed) == (who, "cartpole", int(who.split("seed ")[1][0]))
    assert way(player) == expected


def test_what_is_damaged_there_is_a_line(folder, tmp_path, capsys):
    """Of ours, and no warning of Python's."""
    out = shutil.copytree(folder, tmp_path / "out")
    part = min((out / "corrections").iterdir())
    shutil.copy(part, part.with_name("mine.parquet"))
    assert player_of(str(out), None, None, {}).env == "cartpole"
    told = capsys.readouterr().err
    assert told.startswith(f"gpcjax: {out}: not rows of this sweep") and told.count("\n") == 1


def test_what_was_saved_is_played(tmp_path):
    learner, state = learner_and_state(-1)
    gpcjax.save_policy(tmp_path / "policy", learner, state, env="cartpole")
    gpcjax.save_learner(tmp_path / "learner", learner, state)
    for name, env in (("policy", None), ("learner", "cartpole")):
        player = player_of(str(tmp_path / name), env, None, {})
        assert (player.env, player.who, player.sizes, way(player)) == ("cartpole", name, (4, 1), -1)
    (tmp_path / "manifest.json").touch()  # a folder of gpcjax teach
    assert player_of(str(tmp_path), None, None, {}).who == "policy"


def test_a_lesson_without_a_policy_says_what_of_it_can_be_played(folder, tmp_path, capsys):
    """It has rows as a sweep's, and no kept policies: those of a learner of one's own have no form."""
    lesson = tmp_path / "lesson"
    shutil.copytree(folder, lesson)
    Course("cartpole", "coach").write(lesson)
    for words in (["play", "lesson"], ["policy", "info", "lesson"]):
        assert cli.main(words) == 2
        assert "lesson: there is no policy of this lesson yet, or" in capsys.readouterr().err
        assert "--keep" not in capsys.readouterr().err
    learner, state = learner_and_state(1)
    gpcjax.save_learner(lesson / "saves" / "good one", learner, state, env="cartpole")
    assert cli.main(["play", "lesson"]) == 2
    assert "give one that was saved: lesson/saves/good one\n" in capsys.readouterr().err
    assert way(player_of("lesson/saves/good one", None, None, {})) == 1


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["nowhere"], "nowhere: there is no such folder, give one, or ENV:EXPERT such as cartpole:"),
        (["cartpole:pump"], "cartpole:pump: cartpole has no such expert, give "),
        (["nothing:pump"], "'nothing'"),
        (
            ["cartpole:lqr", "--env", "pendulum"],
            "--env pendulum: lqr is an expert of cartpole, leave --env out",
        ),
        (
            ["cartpole:lqr", "--where", "algo=gpc"],
            "--where: cartpole:lqr is no run folder with kept policies",
        ),
        (["cartpole:lqr", "--where", "algo"], "--where 'algo': give COLUMN=VALUE"),
        (["cartpole:lqr", "--gif", "x.png"], "--gif x.png: give a path that ends in .gif"),
        (["cartpole:lqr", "--speed", "0"], f"--speed 0: give {SPEED}"),
        (
            ["cartpole:lqr", "--gif", "x.gif", "--episodes", "13"],
            "--episodes 13: 6,526 frames are more than the 6,000 of a GIF, give fewer episodes, fewer --seconds, or",
        ),
        (
            ["pendulum:gpc", "--gif", "x.gif", "--episodes", "100", "--seconds", "600"],
            "--episodes 100: 20,200 frames",
        ),
        (["empty"], "empty: no policy is there, give a run folder with kept policies"),
        (["OUT", "--seed", "7"], "no run with seed 7 was kept, give 0, 1, 2"),
        (
            ["OUT", "--where", "beta=1"],
            "'beta' is no column of its runs, give env, algo, oracle, error, seed",
        ),
        (
            ["OUT", "--env", "pendulum"],
            "takes 4 numbers of an observation and gives 1 actions, pendulum has 3 and 1",
        ),
        (["saved"], "saved: its card names no task, give one (--env)"),
    ],
)
def test_mistakes_are_a_line(folder, words, line, capsys, tmp_path):
    (tmp_path / "empty").mkdir()
    if "saved" in words:
        gpcjax.save_policy(tmp_path / "saved", *learner_and_state(1))
    assert cli.main(["play", *(word.replace("OUT", str(folder)) for word in words)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("gpcjax: error: ") and line in said and said.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_an_episode_is_that_of_evaluate():
    player = player_of("mountaincar:pump", None, None, {})
    env = make_env("mountaincar")
    seen = list(moments(World(env, 0), player, 1))
    reference = evaluate(env, make_expert("mountaincar", "pump"), 1)
    np.testing.assert_allclose(seen[-1].total, float(reference.returns[0]), rtol=1e-9)
    assert [moment.step for moment in seen] == list(range(int(reference.length[0]) + 1))
    assert [moment.over for moment in seen] == [False] * (len(seen) - 1) + [True]
    again = next(moments(World(env, 0), player, 2))
    assert (again.episode, again.total) == (2, 0.0) and (again.obs != seen[0].obs).any()
    broken = Player("mountaincar", lambda obs: [np.nan], "somebody", 0)
    with pytest.raises(UserError, match="somebody: episode 1, step 0: its action is no number"):
        next(moments(World(env, 0), broken, 1))


def drawn(env, obs, action, picture=None):
    """What is seen there, (height, width, 3)."""
    figure = Figure()
    sizes = len(obs), len(action)
    stage = Stage(figure, find("task", env), "somebody", picture, sizes)
    stage.show(Moment(1, 3, np.array(obs), np.array(action, float), 12.0, over=False), picture)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(int)


def middle_of(image, colour):
    """Mean row and column of the pixels of a colour, given as #rrggbb; None if there are none."""
    wanted = [int(colour[place : place + 2], 16) for place in (1, 3, 5)]
    found = np.argwhere((abs(image - wanted) < 12).all(-1))
    return tuple(found.mean(0)) if len(found) > 20 else None


@pytest.mark.parametrize("env", SCENES)
def test_scenes_follow_observation_and_action(env):
    less, none, more = (drawn(env, OBS[env], [action]) for action in (-0.6, 0.0, 0.6))
    assert none.shape == (round(SIZE[1] * DPI), round(SIZE[0] * DPI), 3)
    assert middle_of(none, LESS) is None and middle_of(less, LESS) is not None
    left, right = middle_of(less, LESS)[1], middle_of(more, MORE)[1]
    # A torque that is more turns counter-clockwise, from the top to the left.
    assert (right < left) if env == "pendulum" else (left < right)
    moved = list(OBS[env])
    moved[1 if env == "pendulum" else 0] *= -1
    assert (drawn(env, moved, [0.0]) != none).any()


def test_the_pole_leans_to_where_it_falls():
    upright, right = (drawn("cartpole", [0.0, 0.0, angle, 0.0], [0.0]) for angle in (0.0, 0.12))
    ink = "#151a21"
    assert middle_of(right, ink)[1] > middle_of(upright, ink)[1] + 2


def test_other_tasks_show_pictures_or_numbers():
    picture = np.zeros((40, 60, 3), np.uint8)
    picture[..., 1] = 200
    shown = drawn("lunarlander", np.zeros(8), [0, 0], picture)
    assert (shown == [0, 200, 0]).all(-1).mean() > 0.2
    lines = drawn("lunarlander", np.zeros(8), [0.5, 0])
    assert not (lines == [0, 200, 0]).all(-1).any() and middle_of(lines, "#e9edf2") is not None


def test_a_gif_has_the_frames_at_their_pace(tmp_path):
    figure = Figure(figsize=(0.5, 0.4), dpi=100)
    label = figure.text(0.1, 0.1, "")
    frames = [Frame(lambda text=text: label.set_text(text), 0.04) for text in "abc"]
    path = tmp_path / "x.gif"
    made = write_gif(path, figure, iter([*frames, Frame(lambda: label.set_text("d"), 0.8)]))
    assert (made.frames, made.seconds) == (4, 0.92)
    with Image.open(path) as image:
        delays = []
        for place in range(image.n_frames):
            image.seek(place)
            delays.append(image.info["duration"])
        assert delays == [40, 40, 40, 800] and image.info["loop"] == 0 and image.size == (50, 40)


def test_what_is_seen_twice_in_a_row_is_one_frame(tmp_path):
    """As in the file; and no picture is drawn before the one before it was taken."""
    figure = Figure(figsize=(0.5, 0.4), dpi=100)
    label = figure.text(0.1, 0.1, "")
    frames = (Frame(lambda text=text: label.set_text(text), 0.04) for text in "aabbbc")
    made = write_gif(tmp_path / "x.gif", figure, frames)
    with Image.open(tmp_path / "x.gif") as image:
        assert made.frames == image.n_frames == 3 and made.seconds == pytest.approx(0.24)
    still = write_gif(tmp_path / "y.gif", figure, iter([Frame(lambda: None, 0.04)] * 3))
    assert still.frames == 1 and still.seconds == pytest.approx(0.12)


def test_pictures_are_not_kept_until_the_last_one(tmp_path, monkeypatch):
    figure, alive = Figure(figsize=(0.5, 0.4), dpi=100), []
    made = Image.fromarray

    def seen(pixels):
        picture = made(pixels)
        alive.append(weakref.ref(picture))
        return picture

    monkeypatch.setattr(Image, "fromarray", seen)
    most = []
    frames = (Frame(lambda: most.append(sum(each() is not None for each in alive)), 0.04) for _ in range(20))
    write_gif(tmp_path / "x.gif", figure, frames)
    assert max(most) <= 2


@pytest.mark.parametrize(
    ("backend", "shows"),
    [("webagg", False), ("nbagg", False), ("agg", False), ("qtagg", True), ("TkAgg", True)],
)
def test_only_a_framework_for_windows_opens_one(monkeypatch, backend, shows):
    monkeypatch.setattr("matplotlib.get_backend", lambda: backend)
    assert has_window() is shows


def test_a_window_shows_all_frames_until_it_is_closed():
    figure, seen = pyplot.figure(), []
    watch(figure, (Frame(lambda i=i: seen.append(i), 0.001) for i in range(3)))
    assert seen == [0, 1, 2]

    def closing(i):
        seen.append(i)
        figure.canvas.callbacks.process("close_event", None)

    watch(figure, (Frame(lambda i=i: closing(i), 0.001) for i in range(3, 9)))
    assert seen == [0, 1, 2, 3]
    pyplot.close(figure)


def test_where_no_pictures_can_be_made_numbers_are_shown(capsys, monkeypatch):
    def no_library(world):
        raise RuntimeError("no OpenGL\nand more of that")

    monkeypatch.setattr(World, "picture", no_library)
    monkeypatch.setattr(LanderHeuristic, "__call__", lambda expert, obs: np.zeros(2))  # it falls, and soon
    assert cli.main(["play", "lunarlander:heuristic", "--gif", "x.gif", "--seconds", "0.1"]) == 0
    out, err = capsys.readouterr()
    assert err == "gpcjax: no pictures of lunarlander can be made here (no OpenGL): its numbers are shown\n"
    with Image.open("x.gif") as image:
        assert out.splitlines()[-1].startswith(f"x.gif: {image.n_frames} frames, ")


def test_the_command_says_what_it_shows(folder, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("gpcjax.play.showing.has_window", lambda: False)
    words = ["play", str(folder), "--seed", "2", "--where", "error=0", "--episodes", "2", "--speed", "10"]
    assert cli.main(words) == 0
    first, *told, last = capsys.readouterr().out.splitlines()
    assert first == "COACH, seed 2, after episode 3"
    learner, state = learner_and_state(1)
    world, player = World(make_env("cartpole"), 2), Player("cartpole", learner.policy_of(state), "", 0)
    for episode, line in enumerate(told, 1):
        *_, end = moments(world, player, episode)
        assert line == f"episode {episode}: return {end.total:g}, {end.step} steps"
    with Image.open(tmp_path / "runs" / "play-out.gif") as image:
        assert last.startswith(f"runs/play-out.gif: {image.n_frames} frames, ") and len(told) == 2
