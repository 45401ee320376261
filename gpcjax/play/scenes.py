"""What the built-in compiled tasks look like, as the page of `gpcjax teach` draws them.

A scene is made on empty axes without a frame and changes what it drew there; a unit of the axes is a metre in both
directions.
"""

import abc
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyBboxPatch, Polygon
from matplotlib.transforms import Affine2D, Transform

INK, MUTED, LINE, FAINT = "#151a21", "#56606e", "#d5dbe3", "#e9edf2"
BODY, SURFACE, LESS, MORE = "#3c4b60", "#ffffff", "#1f66ad", "#b35205"
"""Of the page: an action is blue where it is less than nothing, orange where it is more."""

Vector = Float[np.ndarray, " n"]


class Scene(abc.ABC):
    """A task on axes of its own."""

    @abc.abstractmethod
    def __init__(self, axes: Axes):
        """Draws all that does not move."""

    @abc.abstractmethod
    def show(self, obs: Vector, action: Vector) -> None:
        """Changes the drawing to this observation and this action in [-1, 1]."""


class _Arrow:
    """A straight arrow along the x axis of `transform`: it begins `gap` beside it, and is at most `full` long."""

    def __init__(self, axes: Axes, transform: Affine2D, y: float, gap: float, full: float, width: float):
        self._y, self._gap, self._full, self._width = y, gap, full, width
        self._shape = Polygon(
            [(0.0, y)] * 7, closed=True, lw=0, zorder=6, transform=transform + axes.transData
        )
        axes.add_patch(self._shape)

    def show(self, value: float) -> None:
        way, half = float(np.sign(value)), self._width / 2
        first, last = self._gap, self._gap + abs(value) * self._full
        neck = max(first, last - 2.6 * half)
        outline = [(first, half), (neck, half), (neck, 2.1 * half), (last, 0.0)]
        mirrored = [(x, -y) for x, y in reversed(outline[:3])]
        self._shape.set_xy([(way * x, self._y + y) for x, y in (*outline, *mirrored)])
        self._shape.set(color=LESS if value < 0 else MORE, visible=abs(value) > 0.004)


class CartPole(Scene):
    """Place and angle of gymnasium's cart-pole, with the bounds beyond which it has fallen."""

    _FAR, _LEAN, _POLE = 2.4, np.radians(12), 1.0
    """Bounds of place and angle, and the length of the pole (the task's half-length is 0.5)."""

    def __init__(self, axes: Axes):
        far, top = self._FAR, 0.34
        axes.set(xlim=(-far - 0.45, far + 0.45), ylim=(-0.35, 1.65))
        axes.plot([-far, far], [-0.02, -0.02], color=LINE, lw=3, solid_capstyle="round")
        for metre in (-far, -1.0, 0.0, 1.0, far):
            axes.text(
                metre,
                -0.12,
                "0 m" if metre == 0 else f"{metre:g}",
                color=MUTED,
                ha="center",
                va="top",
                size=8,
            )
        for side in (-far, far):
            axes.plot([side, side], [-0.02, 0.16], color=MUTED, lw=3, solid_capstyle="round")
        self._cart, self._pole = Affine2D(), Affine2D()
        on_cart, on_pole = self._cart + axes.transData, self._pole + axes.transData
        for lean in (-self._LEAN, self._LEAN):
            x, y = np.sin(lean) * np.array([0.35, 1.08]), top + np.cos(lean) * np.array([0.35, 1.08])
            axes.plot(x, y, color=MUTED, lw=1.2, ls=(0, (3, 4)), transform=on_cart)
        axes.add_patch(_box(0.0, (0.09 + top) / 2, 0.46, top - 0.09, on_cart))
        for side in (-0.14, 0.14):
            axes.add_patch(Circle((side, 0.06), 0.06, color=INK, lw=0, transform=on_cart, zorder=4))
        (self._rod,) = axes.plot(
            [0, 0], [0, self._POLE], lw=6, solid_capstyle="round", zorder=5, transform=on_pole
        )
        axes.add_patch(Circle((0, top), 0.03, color=SURFACE, lw=0, transform=on_cart, zorder=6))
        self._arrow = _Arrow(axes, self._cart, 0.21, 0.28, 0.8, 0.085)
        self._top = top

    def show(self, obs: Vector, action: Vector) -> None:
        place, angle = float(obs[0]), float(obs[2])
        self._cart.clear().translate(place, 0.0)
        self._pole.clear().rotate(-angle).translate(place, self._top)
        self._rod.set_color(MORE if abs(angle) > 0.75 * self._LEAN else INK)
        self._arrow.show(float(action[0]))


class Pendulum(Scene):
    """A rod that shall stand, and the torque at its pivot."""

    _RADIUS = 0.42
    """Of the torque's arrow; an action of 1 goes so far around the pivot: """
    _FULL = np.radians(150)

    def __init__(self, axes: Axes):
        axes.set(xlim=(-1.95, 1.95), ylim=(-1.25, 1.25))
        axes.add_patch(Circle((0, 1), 0.1, fill=False, ec=MUTED, lw=1.5, ls=(0, (3, 3))))
        axes.plot([0, 0], [0, 0.9], color=MUTED, lw=1.2, ls=(0, (3, 4)))
        axes.text(0.16, 1.02, "hold it here", color=MUTED, va="center", size=8)
        (self._rod,) = axes.plot([], [], color=BODY, lw=11, solid_capstyle="round", zorder=3)
        self._bob = Circle((0, 1), 0.085, color=BODY, lw=0, zorder=3)
        axes.add_patch(self._bob)
        self._arc = Line2D([], [], lw=5, solid_capstyle="butt", zorder=4)
        axes.add_line(self._arc)
        self._head = Polygon([(0.0, 0.0)] * 3, closed=True, lw=0, zorder=4)
        axes.add_patch(self._head)
        axes.add_patch(Circle((0, 0), 0.05, fc=SURFACE, ec=INK, lw=2, zorder=5))

    def show(self, obs: Vector, action: Vector) -> None:
        # Counter-clockwise from upright, as the task has it.
        tip = -float(obs[1]), float(obs[0])
        self._rod.set_data([0.0, tip[0]], [0.0, tip[1]])
        self._bob.center = tip
        value, colour = float(action[0]), LESS if action[0] < 0 else MORE
        seen = abs(value) > 0.004
        end, way = np.pi / 2 + value * self._FULL, float(np.sign(value))
        along = np.linspace(np.pi / 2, end - way * min(0.25, abs(value) * self._FULL), 40)
        self._arc.set(
            xdata=self._RADIUS * np.cos(along), ydata=self._RADIUS * np.sin(along), color=colour, visible=seen
        )
        back, wide = end - way * 0.3, 0.1
        corners = [(end, self._RADIUS), (back, self._RADIUS - wide), (back, self._RADIUS + wide)]
        self._head.set_xy([(radius * np.cos(angle), radius * np.sin(angle)) for angle, radius in corners])
        self._head.set(color=colour, visible=seen)


class MountainCar(Scene):
    """A car in its valley, whose height is that of gymnasium, and the goal."""

    _GOAL = 0.45

    def __init__(self, axes: Axes):
        axes.set(xlim=(-1.2, 0.6), ylim=(-0.05, 1.4))
        x = np.linspace(-1.2, 0.6, 181)
        axes.fill_between(x, self._height(x), -0.05, color=FAINT, lw=0)
        axes.plot(x, self._height(x), color=MUTED, lw=2.5)
        foot, high = float(self._height(self._GOAL)), 0.2
        axes.plot([self._GOAL, self._GOAL], [foot, foot + high], color=INK, lw=2)
        flag = [(0, high), (-0.55 * high, 0.8 * high), (0, 0.6 * high)]
        axes.add_patch(Polygon([(self._GOAL + x, foot + y) for x, y in flag], color=MORE, lw=0))
        axes.text(self._GOAL, foot + high + 0.03, "goal", color=MUTED, ha="center", va="bottom", size=8)
        self._car = Affine2D()
        on_car = self._car + axes.transData
        axes.add_patch(_box(0.0, 0.06, 0.17, 0.05, on_car))
        axes.add_patch(_box(-0.005, 0.1, 0.09, 0.05, on_car))
        for side in (-0.05, 0.05):
            axes.add_patch(Circle((side, 0.028), 0.028, color=INK, lw=0, transform=on_car, zorder=4))
        self._arrow = _Arrow(axes, self._car, 0.06, 0.1, 0.32, 0.03)

    @staticmethod
    def _height(x: Vector | float) -> Vector | float:
        return 0.45 * np.sin(3 * x) + 0.55

    def show(self, obs: Vector, action: Vector) -> None:
        x = float(obs[0])
        slope = float(np.arctan(0.45 * 3 * np.cos(3 * x)))
        self._car.clear().rotate(slope).translate(x, float(self._height(x)))
        self._arrow.show(float(action[0]))


def _box(x: float, y: float, width: float, height: float, transform: Transform) -> FancyBboxPatch:
    """A body with round corners around (x, y)."""
    corner = 0.2 * min(width, height)
    style = f"round,pad=0,rounding_size={corner}"
    box = FancyBboxPatch(
        (x - width / 2, y - height / 2), width, height, boxstyle=style, color=BODY, lw=0, zorder=3
    )
    box.set_transform(transform)
    return box


SCENES: Mapping[str, type[Scene]] = {"cartpole": CartPole, "pendulum": Pendulum, "mountaincar": MountainCar}
"""By the name in `gpcjax.describe.View`."""
