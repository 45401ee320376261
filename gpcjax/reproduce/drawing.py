"""A figure with what is said about it: captions are made where it is drawn, so that they describe what is drawn."""

from dataclasses import dataclass

from matplotlib.figure import Figure


@dataclass(frozen=True)
class Drawing:
    """`figure`, its `alternative` in a few words for those who do not see it, and its `caption`."""

    figure: Figure
    alternative: str
    caption: str
