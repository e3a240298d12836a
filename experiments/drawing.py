"""What the pictures of all experiments share."""

from collections.abc import Iterable

from matplotlib.axes import Axes
from matplotlib.figure import Figure


def new_figure(size: tuple[float, float]) -> Figure:
    return Figure(figsize=size, layout="constrained")


def quiet(panels: Iterable[Axes]) -> None:
    """A quiet frame and grid."""
    for axes in panels:
        axes.grid(color="0.92", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
