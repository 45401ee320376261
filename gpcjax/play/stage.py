"""A figure that shows an episode: a scene, pictures that the task makes itself, or its numbers over time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from gpcjax.describe import TaskSpec
from gpcjax.play.episodes import Moment
from gpcjax.play.scenes import BODY, FAINT, INK, LINE, MORE, MUTED, SCENES, SURFACE, Scene, Vector

SIZE = (6.4, 4.4)
DPI = 100
"""Inches, and dots an inch, of a figure."""

_MOST_LINES = 12
"""Numbers of an observation that are drawn; a task may have hundreds."""

Picture = UInt8[np.ndarray, "height width 3"]


class Stage:
    """One task in a figure, with what is to be said of it.

    Args:
        figure: empty; it belongs to the stage.
        task: what is shown.
        who: whose policy it is.
        picture: one of the task, where it makes them.
        sizes: numbers of an observation, and of an action.
    """

    def __init__(
        self,
        figure: Figure,
        task: TaskSpec,
        who: str,
        picture: Picture | None,
        sizes: tuple[int, int],
    ):
        figure.set_size_inches(*SIZE)
        figure.set_dpi(DPI)
        figure.set_facecolor(SURFACE)
        self._seconds = task.time_step
        figure.text(0.02, 0.975, task.title, size=11, color=INK, va="top", weight="bold")
        figure.text(0.02, 0.915, who, size=8.5, color=MUTED, va="top")
        self._told = figure.text(0.98, 0.975, "", size=9.5, color=INK, va="top", ha="right")
        self._below = figure.text(0.98, 0.915, "", size=8.5, color=MUTED, va="top", ha="right")
        self._scene: Scene | Lines | None = None
        self._picture: AxesImage | None = None
        if task.view.scene in SCENES:
            self._scene = SCENES[task.view.scene](_bare(figure))
        elif picture is not None:
            self._picture = _bare(figure).imshow(picture, interpolation="antialiased")
        else:
            names = [name for name, *_ in task.view.observed] or [
                f"observation {i + 1}" for i in range(sizes[0])
            ]
            actions = [*task.actions, *(f"action {i + 1}" for i in range(len(task.actions), sizes[1]))]
            self._scene = Lines(figure, names, actions)

    @property
    def takes_pictures(self) -> bool:
        """Whether it shows those of the task."""
        return self._picture is not None

    def show(self, moment: Moment, picture: Picture | None = None) -> None:
        """Changes the figure to this moment; a task without a scene may give a new `picture`."""
        time = f"step {moment.step}" if self._seconds is None else f"{moment.step * self._seconds:.1f} s"
        self._told.set_text(f"return {moment.total:.5g}")
        self._below.set_text(f"episode {moment.episode}, {'over after ' if moment.over else ''}{time}")
        if self._scene is not None:
            if isinstance(self._scene, Lines) and moment.step == 0:
                self._scene.clear()
            self._scene.show(moment.obs, moment.action)
        elif self._picture is not None and picture is not None:
            self._picture.set_data(picture)


class Lines:
    """Each number of an observation and of an action, over the steps of the episode so far."""

    def __init__(self, figure: Figure, observations: Sequence[str], actions: Sequence[str]):
        self._observed = min(len(observations), _MOST_LINES)
        left_out = len(observations) - self._observed
        names = [*observations[: self._observed], *actions]
        if left_out:
            names[self._observed - 1] += f" (and {left_out} more)"
        self._kept: list[Float[np.ndarray, " lines"]] = []
        grid = figure.add_gridspec(len(names), 1, left=0.24, right=0.965, top=0.84, bottom=0.04, hspace=0.25)
        axes = [figure.add_subplot(grid[row]) for row in range(len(names))]
        self._lines = [
            self._row(axis, name, MORE if row >= self._observed else BODY)
            for row, (axis, name) in enumerate(zip(axes, names, strict=True))
        ]
        for axis in axes[self._observed :]:
            axis.set_ylim(-1.15, 1.15)

    @staticmethod
    def _row(axis: Axes, name: str, colour: str) -> tuple[Axes, Any, Any]:
        axis.set(xticks=[], yticks=[], facecolor=FAINT)
        axis.spines[:].set_visible(False)
        axis.axhline(0.0, color=LINE, lw=0.8)
        axis.text(-0.02, 0.5, name, transform=axis.transAxes, ha="right", va="center", size=8, color=MUTED)
        (line,) = axis.plot([], [], color=colour, lw=1.4)
        (point,) = axis.plot([], [], color=INK, marker="o", ms=3.5)
        return axis, line, point

    def clear(self) -> None:
        """For the next episode."""
        self._kept.clear()

    def show(self, obs: Vector, action: Vector) -> None:
        """As a scene does, for the next of the moments."""
        self._kept.append(np.concatenate([obs[: self._observed], action]))
        values = np.stack(self._kept, axis=1)
        steps = np.arange(values.shape[1])
        for row, ((axis, line, point), kept) in enumerate(zip(self._lines, values, strict=True)):
            line.set_data(steps, kept)
            point.set_data(steps[-1:], kept[-1:])
            axis.set_xlim(0, max(100.0, 1.02 * steps[-1]))
            if row < self._observed:
                low, high = kept.min(), kept.max()
                room = 0.15 * (high - low) or 1.0
                axis.set_ylim(low - room, high + room)


def _bare(figure: Figure) -> Axes:
    """Axes for a scene or a picture: no frame, the same unit in both directions."""
    axes = figure.add_axes((0.02, 0.02, 0.96, 0.83))
    axes.set_aspect("equal")
    axes.set_axis_off()
    return axes
