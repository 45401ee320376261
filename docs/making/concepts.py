"""Draws the figures of docs/concepts.md with the learners themselves: `python -m docs.making.concepts`.

One number is observed, but where it is said. Hyperparameters are those of the lander (Table 5.3), which are for
observations of about one in size.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import gpcjax
from gpcjax.learners.gpc import GPC
from gpcjax.report.figures import style
from gpcjax.reproduce.probing import as_gpc, idle_state, look, sigmas
from gpcjax.sweep.atomic import write_atomic

FOLDER = Path(__file__).parents[1] / "figures"
BLUE, VERMILION, GREEN = (style.ALGORITHM_COLOURS[name] for name in ("gpc", "gpc-ns", "coach"))
X = np.linspace(-1.5, 1.5, 241)


def learner_of(algo: str = "gpc", sizes: int = 1, **options) -> GPC:
    """GPC with room for 64 points."""
    return as_gpc(gpcjax.make_learner(algo, obs_size=sizes, action_size=1, capacity=64, **options))


def wanted(x):
    """What the teacher of these figures wants at x."""
    return 0.7 * np.sin(3.0 * x)


def taught(learner: GPC, places, teacher: Callable = wanted, delta: float = 0.05):
    """The state after a correction at each place at which the teacher is not content, and how many there were."""
    state, count = idle_state(learner), 0
    for place in places:
        obs = np.atleast_1d(place)
        action = learner.act(state, obs)
        gap = teacher(place) - float(action[0])
        if abs(gap) > delta:
            state, _ = learner.correct(state, obs, action, [np.sign(gap)])
            count += 1
    return state, count


def kernel_policy() -> Figure:
    """A policy after few, some and many corrections, with its uncertainty."""
    learner, random = learner_of(), np.random.default_rng(1)
    visits = (0, 6, 40, 300)
    places = random.uniform(-1.3, 1.3, visits[-1])
    states = [taught(learner, places[:number]) for number in visits]
    with style.publication():
        figure, axes = style.panels([f"{count} corrections" for _, count in states])
        figure.set_figwidth(6.2)
        for axis, (state, _) in zip(axes, states, strict=True):
            seen = look(learner, state, X[:, None])
            spread = 1.96 * seen["sigma_policy"]
            axis.fill_between(
                X, seen["policy"] - spread, seen["policy"] + spread, color=BLUE, alpha=0.18, lw=0
            )
            axis.plot(X, wanted(X), color=style.ORACLE_COLOUR, linewidth=0.9, linestyle="--")
            axis.plot(X, seen["policy"], color=BLUE)
            number = int(state.policy.count[0])
            points, targets = state.policy.points[0, :number, 0], state.policy.targets[0, :number]
            axis.plot(points / learner.scaling[0], targets, "o", color=style.INK, markersize=2.5)
        style.label(axes, "state $s$", "action")
        style.legend(
            figure,
            [
                Line2D(
                    [],
                    [],
                    color=style.ORACLE_COLOUR,
                    linewidth=0.9,
                    linestyle="--",
                    label="what the teacher wants",
                ),
                Line2D([], [], color=BLUE, label="policy"),
                Patch(color=BLUE, alpha=0.18, linewidth=0, label=r"$\pm 1.96\,\sigma_p$"),
                Line2D([], [], color=style.INK, marker="o", markersize=2.5, linestyle="none", label="points"),
            ],
        )
    return figure


def learning_rate() -> Figure:
    """What a correction moves an action by, and of what that is made up, under consistent and alternating advice."""
    learner, obs = learner_of(), np.zeros(1)
    with style.publication():
        figure, axes = style.panels(["always “more”", "“more” and “less” in turn"])
        figure.set_figwidth(6.2)
        for axis, signs in zip(axes, (np.ones(12), np.tile([1.0, -1.0], 6)), strict=True):
            state, parts = idle_state(learner), []
            for sign in signs:
                state, info = learner.correct(state, obs, learner.act(state, obs), [sign])
                parts.append(
                    (float(learner.constant_rate), float(info.sigma_policy[0]), float(info.sigma_human[0]))
                )
            bottom, number = np.zeros(len(signs)), np.arange(1, len(signs) + 1)
            for height, colour in zip(np.array(parts).T, (style.IDLE_COLOUR, BLUE, GREEN), strict=True):
                axis.bar(number, height, bottom=bottom, color=colour, width=0.75)
                bottom += height
            axis.set_xticks(number[::2] + 1)
        style.label(axes, "correction at the same state", "learning rate $r$")
        names = (r"$c_r$", BLUE, GREEN)
        style.legend(
            figure,
            [
                Patch(color=style.IDLE_COLOUR, label=names[0]),
                Patch(color=BLUE, label=r"$\sigma_p$, of the policy"),
                Patch(color=GREEN, label=r"$\sigma_h$, of the human model"),
            ],
        )
    return figure


def replacement() -> Figure:
    """Eight corrections at neighbouring states, appended and by SPARS."""
    places = np.array([0.0, 0.02, -0.02, 0.01, -0.01, 0.03, -0.03, 0.0])
    with style.publication():
        figure, axes = style.panels(["every point appended", "SPARS"])
        figure.set_figwidth(6.2)
        for axis, sparsify in zip(axes, (False, True), strict=True):
            learner = learner_of(sparsify=sparsify)
            state, _ = taught(learner, places, lambda place: 2.0)
            seen = look(learner, state, X[:, None])
            number = int(state.policy.count[0])
            axis.plot(X, seen["policy"], color=BLUE)
            axis.plot(
                state.policy.points[0, :number, 0],
                state.policy.targets[0, :number],
                "o",
                color=style.INK,
                ms=3,
            )
            axis.text(0.03, 0.95, f"{number} of {len(places)} kept", transform=axis.transAxes, va="top")
            axis.set_xlim(-1.0, 1.0)
        style.label(axes, "state $s$", "action")
        style.legend(
            figure,
            [
                Line2D([], [], color=BLUE, label="policy"),
                Line2D([], [], color=style.INK, marker="o", markersize=3, linestyle="none", label="points"),
            ],
        )
    return figure


def human_model() -> Figure:
    """Where advice was given: sigma_h over states and actions."""
    learner, random = learner_of(), np.random.default_rng(1)
    actions = np.linspace(-1.0, 1.0, 121)
    with style.publication():
        figure = Figure(figsize=(6.2, 2.5), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        for axis, visits in zip(axes, (6, 60), strict=True):
            state, count = taught(learner, random.uniform(-1.3, 1.3, visits))
            values = np.array(
                [sigmas(learner, state, np.array([x]), actions[:, None])[:, 0] for x in X[::2]]
            ).T
            shown = axis.pcolormesh(
                X[::2], actions, values, cmap="viridis", shading="nearest", vmin=0.0, rasterized=True
            )
            axis.plot(X, look(learner, state, X[:, None])["policy"], color="white")
            number = int(state.human.count[0])
            advised = np.asarray(state.human.points[0, :number])
            axis.plot(advised[:, 0], advised[:, 1], "o", color=VERMILION, markersize=2.5)
            axis.set_title(f"{count} corrections")
            axis.set_xlabel("state $s$")
        axes[0].set_ylabel("action $a$")
        figure.colorbar(shown, ax=axes, label=r"$\sigma_h(s, a)$")
    return figure


def normalisation() -> Figure:
    """Two observed numbers of very different size: how near is near, for GPC as it is and for GPC-NS."""
    random = np.random.default_rng(2)
    observed = np.stack([random.normal(0.0, 0.05, 30), random.normal(0.0, 2.0, 30)], 1)
    here = np.array([0.04, 1.0])
    first, second = np.linspace(-0.15, 0.15, 81), np.linspace(-6.0, 6.0, 81)
    grid = np.stack(np.meshgrid(first, second), -1)
    with style.publication():
        figure, axes = style.panels(["GPC, observations as they are", "GPC-NS"])
        figure.set_figwidth(6.2)
        for axis, algo in zip(axes, ("gpc", "gpc-ns"), strict=True):
            learner = learner_of(algo, sizes=2)
            state, _ = taught(learner, observed, lambda obs: np.sign(obs[0]) * 2.0)
            scale = np.asarray(state.policy.scale[0])
            distance = np.linalg.norm((grid - here) * scale, axis=-1) / float(
                learner.policy.kernel.length_scale
            )
            root = np.sqrt(3.0) * distance
            covariance = (1.0 + root) * np.exp(-root)  # Matern of smoothness 3/2, in parts of c_p
            shown = axis.contourf(first, second, covariance, np.linspace(0.0, 1.0, 11), cmap="Blues")
            axis.plot(*observed.T, "o", color=style.INK, markersize=2.5)
            axis.plot(*here, "o", color=VERMILION, markersize=4)
            assert float(learner.policy.kernel.smoothness) == 1.5
        style.label(axes, "first number, rad", "second number, rad/s")
        figure.colorbar(shown, ax=axes, label="covariance with the red point, of $c_p$", ticks=[0, 0.5, 1])
    return figure


FIGURES = {
    "kernel_policy": kernel_policy,
    "learning_rate": learning_rate,
    "replacement": replacement,
    "human_model": human_model,
    "normalisation": normalisation,
}


def main() -> None:
    """Draws all of them."""
    FOLDER.mkdir(exist_ok=True)
    for name, draw in FIGURES.items():
        write_atomic(FOLDER / f"{name}.png", style.image(draw(), "png"))


if __name__ == "__main__":
    main()
