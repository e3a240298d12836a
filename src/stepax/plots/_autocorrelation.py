"""Picture of the autocorrelation of residuals."""

from matplotlib.figure import Figure

from ..records._residuals import Autocorrelation
from ._model import EDGE, MODEL, SHADE, Picture, quiet


def plot_autocorrelation(found: Autocorrelation, *, size: tuple[float, float]) -> Figure:
    """A bar for each lag, and the band that independent residuals keep to; `size` in inches."""
    figure = Picture(figsize=size, dpi=150, layout="constrained")
    axes = figure.subplots()
    axes.axhspan(-found.bound, found.bound, color=SHADE, linewidth=0, zorder=0)
    axes.bar(found.lags, found.values, width=0.45, color=MODEL)
    axes.axhline(0, color=EDGE, linewidth=0.8)
    quiet(axes)
    axes.set_xlabel("lag, rows")
    axes.set_ylabel("autocorrelation")
    axes.tick_params(labelsize=9)
    return figure
