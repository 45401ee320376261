"""Where an episode is seen: an animated GIF, or a window."""

import io
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from gpcjax.sweep.atomic import write_atomic

FRAMES_A_SECOND = 25
"""At most: a figure takes some 20 ms, and viewers of GIFs slow down those of more than 50."""

COLOURS = 128
MOST_FRAMES = 6_000
"""Of a GIF: each is in memory with 280 kB until it is written."""

WINDOWS = ("gtk3", "gtk4", "macosx", "qt", "qt5", "qt6", "tk", "wx")
"""What matplotlib opens windows with."""

HOLD = 0.8
"""Seconds for which the end of an episode is seen."""


class Frame(NamedTuple):
    """What is seen, and for how long."""

    draw: Callable[[], None]
    """Changes the figure."""
    seconds: float


class Gif(NamedTuple):
    """An animated GIF that was written."""

    frames: int
    seconds: float


def write_gif(path: Path, figure: Figure, frames: Iterator[Frame]) -> Gif:
    """Writes all frames of a figure to `path`, in the place of what was there; what is seen twice in a row is one.

    Raises:
        OSError: it cannot be written.
    """
    canvas = FigureCanvasAgg(figure)
    delays: list[int] = []

    def images() -> Iterator[Image.Image]:
        for frame in frames:
            frame.draw()
            canvas.draw()
            pixels = np.asarray(canvas.buffer_rgba())[..., :3]
            delays.append(10 * round(100 * frame.seconds))  # a GIF counts hundredths of a second
            yield Image.fromarray(pixels).quantize(COLOURS, dither=Image.Dither.NONE)

    content, each = io.BytesIO(), images()
    # Taken one by one, each when its delay is known: Pillow keeps its own copy of every one.
    next(each).save(content, format="GIF", save_all=True, append_images=each, duration=delays, loop=0)
    write_atomic(path, content.getvalue())
    with Image.open(content) as written:
        return Gif(getattr(written, "n_frames", 1), sum(delays) / 1000)


def has_window() -> bool:
    """Whether matplotlib can open one here: there is a display, and a framework for windows that draws on it.

    In a notebook or a browser (nbagg, webagg) nobody would see one.
    """
    import matplotlib
    import matplotlib.pyplot
    from matplotlib.backends.registry import backend_registry

    _, framework = backend_registry.resolve_backend(matplotlib.get_backend())
    return framework in WINDOWS


def watch(figure: Figure, frames: Iterator[Frame]) -> None:
    """Shows the frames in a figure of pyplot, at their pace, until they end or the window is closed."""
    closed: list[object] = []
    figure.canvas.mpl_connect("close_event", closed.append)
    assert figure.canvas.manager is not None
    figure.canvas.manager.show()
    due = time.monotonic()
    for frame in frames:
        if closed:
            return
        frame.draw()
        figure.canvas.draw_idle()
        due = max(due + frame.seconds, time.monotonic())
        figure.canvas.start_event_loop(max(due - time.monotonic(), 0.001))
