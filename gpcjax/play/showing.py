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
    """Writes all frames of a figure to `path`, in the place of what was there.

    Raises:
        OSError: it cannot be written.
    """
    canvas = FigureCanvasAgg(figure)
    images, delays = [], []
    for frame in frames:
        frame.draw()
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]
        images.append(Image.fromarray(pixels).quantize(COLOURS, dither=Image.Dither.NONE))
        delays.append(10 * round(100 * frame.seconds))  # a GIF counts hundredths of a second
    content = io.BytesIO()
    first, *others = images
    first.save(content, format="GIF", save_all=True, append_images=others, duration=delays, loop=0)
    write_atomic(path, content.getvalue())
    return Gif(len(images), sum(delays) / 1000)


def has_window() -> bool:
    """Whether matplotlib can open one here: there is a display, and something that draws on it."""
    import matplotlib
    import matplotlib.pyplot
    from matplotlib.backends.registry import BackendFilter, backend_registry

    return matplotlib.get_backend().lower() in backend_registry.list_builtin(BackendFilter.INTERACTIVE)


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
