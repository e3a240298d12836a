"""Forty plots of known responses, as matplotlib draws them, and what is known of each."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image


# Responses, by closed forms of their own


def lag(t, T=1.5, delay=0.8):
    return 1 - np.exp(-np.maximum(t - delay, 0) / T)


def chain(t, T=0.7, r=0.2, delay=0.5):
    """Hudzovic's chain of order 3, by partial fractions."""
    lags = T / (1 - r * np.arange(3))
    t = np.maximum(t - delay, 0)[:, None]
    shares = [np.prod([a / (a - b) for b in lags if b != a]) for a in lags]
    return 1 - np.exp(-t / lags) @ np.array(shares)


def oscillation(t, zeta=0.25, omega=2.2, delay=0.4):
    t = np.maximum(t - delay, 0)
    damped = omega * np.sqrt(1 - zeta**2)
    ratio = zeta * omega / damped
    return 1 - np.exp(-zeta * omega * t) * (np.cos(damped * t) + ratio * np.sin(damped * t))


def fast(t):
    return lag(t, T=0.12, delay=1.0)


FITS: dict[Callable, tuple[str, dict[str, Any]]] = {
    lag: ("fopdt_fit", {}),
    fast: ("fopdt_fit", {}),
    chain: ("hudzovic_fit", {"orders": (3,)}),
    oscillation: ("sopdt_fit", {}),
}
"""The fit of each plant's own family."""


# What else is in a picture; each draws on axes whose curve is there already


def plain(axes: Axes) -> None:
    pass


def grid(axes: Axes) -> None:
    axes.grid(True)


def dashed_grid(axes: Axes) -> None:
    axes.grid(True, linestyle="--", color="0.5")


def dark_dashes_in_front(axes: Axes) -> None:
    axes.grid(True, linestyle=(0, (8, 8)), color="black", linewidth=0.8)
    axes.set_axisbelow(False)


def two_spines(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)


def ticks_inside(axes: Axes) -> None:
    axes.tick_params(which="both", direction="in", top=True, right=True)


def minor_ticks(axes: Axes) -> None:
    axes.minorticks_on()


def legend(axes: Axes) -> None:
    axes.legend(loc="lower right")


def legend_over_the_curve(axes: Axes) -> None:
    axes.legend(loc=(0.15, 0.5), framealpha=1)


def words(axes: Axes) -> None:
    x, y = (0.5 * (a + b) for a, b in (axes.get_xlim(), axes.get_ylim()))
    axes.annotate("steepest here", (x, y), (1.1 * x, 0.7 * y), arrowprops={"arrowstyle": "->"})
    axes.text(0.05, 0.9, "step of 1 at t = 0", transform=axes.transAxes)
    axes.set(title="Response of a heater", xlabel="time in s", ylabel="temperature in K")


def second_curve(axes: Axes) -> None:
    t = np.linspace(0, 10, 300)
    axes.plot(t, 22 + 14 * np.exp(-t / 3), label="falling")
    axes.legend()


def four_curves(axes: Axes) -> None:
    t = np.linspace(0, 10, 300)
    for k in range(3):
        axes.plot(t, 21 + 5 * k + 6 * np.sin(0.5 * t + k) * np.exp(-t / 9), label=f"run {k}")
    axes.legend(loc="lower right", ncols=2)


def limits_at_ticks(axes: Axes) -> None:
    axes.set(xlim=(0, 10), ylim=(20, 45))


@dataclass(frozen=True)
class Plot:
    """One picture: what is drawn, how, and how it is calibrated."""

    name: str
    response: Callable = chain
    noise: float = 0.0
    size: tuple[float, float] | None = None
    dpi: int = 100
    style: str = "default"
    line: dict[str, Any] = field(default_factory=dict)
    beside: tuple[Callable[[Axes], None], ...] = (plain,)
    ticks: bool = True
    kind: str = "png"
    quality: int = 75
    grey: bool = False
    color: str | None = None
    samples: int = 400

    @cached_property
    def data(self) -> tuple[np.ndarray, np.ndarray]:
        """What is drawn: 0 to 10 s, 22 to 37 degrees."""
        t = np.linspace(0, 10, self.samples)
        noise = np.random.default_rng(len(self.name)).normal(0, self.noise, t.size)
        return t, 22 + 15 * (self.response(t) + noise)

    def written(self, folder: Path) -> tuple[Path, dict[str, Any], Any]:
        """The picture's path, the options of its calibration, and the exact edges of its box.

        The edges are in pixels, their centres at whole numbers: left, top, right, bottom.
        """
        path = folder / f"{self.name.replace(' ', '_')}.{self.kind}"
        with matplotlib.style.context(["default", self.style]):
            figure = Figure(figsize=self.size, dpi=self.dpi)
            canvas = FigureCanvasAgg(figure)
            axes = figure.subplots()
            axes.plot(*self.data, label="response", **self.line)
            for draw in self.beside:
                draw(axes)
            canvas.draw()
            options = {**self.calibration(axes), "color": self.color}
            image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        window = axes.get_window_extent()
        edges = np.array([window.x0, image.height - window.y1, window.x1, image.height - window.y0])
        if self.grey:
            image = image.convert("L")
        image.save(path, **({"quality": self.quality} if self.kind in ("jpg", "webp") else {}))
        return path, options, edges - 0.5

    def calibration(self, axes: Axes) -> dict[str, tuple[float, float]]:
        """By ticks or by the edges of the box."""
        limits = {"x": axes.get_xlim(), "y": axes.get_ylim()}
        if not self.ticks:
            return {f"{name}_range": pair for name, pair in limits.items()}
        places = {"x": axes.get_xticks(), "y": axes.get_yticks()}
        inside = {n: [v for v in p if limits[n][0] <= v <= limits[n][1]] for n, p in places.items()}
        return {f"{name}_ticks": (values[0], values[-1]) for name, values in inside.items()}


BLACK = {"color": "black"}
THIN, THICK = {"linewidth": 0.8}, {"linewidth": 5}
DASHED = {"linestyle": "--"}
MARKED = {"marker": "o", "markevery": 20}

_PLOTS = (
    Plot("default"),
    Plot("default by its edges", ticks=False),
    Plot("lag", lag),
    Plot("oscillation", oscillation),
    Plot("steep", fast),
    Plot("noisy", lag, 0.01, samples=200),
    Plot("noisier", chain, 0.03, samples=120),
    Plot("noisy oscillation", oscillation, 0.02, samples=150),
    Plot("ggplot", style="ggplot", beside=(legend,)),
    Plot("ggplot lag", lag, style="ggplot", ticks=False),
    Plot("bmh", oscillation, style="bmh"),
    Plot("darkgrid", lag, style="seaborn-v0_8-darkgrid"),
    Plot("dark", style="dark_background"),
    Plot("dark with grid", oscillation, style="dark_background", beside=(grid, legend)),
    Plot("dashed grid", beside=(dashed_grid,)),
    Plot("dashed grid in front", lag, beside=(dark_dashes_in_front,)),
    Plot("legend over the curve", lag, beside=(legend_over_the_curve,)),
    Plot("legend over the curve and grid", beside=(grid, legend_over_the_curve), size=(5, 4)),
    Plot("thick", lag, line=THICK),
    Plot("thick black", line=THICK | BLACK, beside=(grid,)),
    Plot("thin", oscillation, line=THIN, beside=(grid,)),
    Plot("markers", line=MARKED),
    Plot("markers on a lag", lag, line=MARKED | {"marker": "s", "markersize": 5}),
    Plot("dashed", line=DASHED),
    Plot("dashed oscillation", oscillation, line=DASHED | {"linewidth": 2}, beside=(grid,)),
    Plot("grey", grey=True, beside=(grid,)),
    Plot("black on a dashed grid", lag, line=BLACK, beside=(dashed_grid,)),
    Plot("jpeg 40", kind="jpg", quality=40),
    Plot("jpeg 40 lag", lag, kind="jpg", quality=40, beside=(grid, words)),
    Plot("jpeg 60 oscillation", oscillation, kind="jpg", quality=60, beside=(grid,)),
    Plot("webp", kind="webp", beside=(legend,)),
    Plot("two curves", beside=(second_curve,), color="#1f77b4"),
    Plot("two curves thick", lag, line={"linewidth": 3}, beside=(second_curve,), color="blue"),
    Plot("four curves", beside=(four_curves,), color="#1f77b4"),
    Plot("four curves oscillation", oscillation, beside=(four_curves, grid), color="tab:blue"),
    Plot("small", size=(3.2, 2.4)),
    Plot("large", oscillation, size=(10, 20 / 3), dpi=300, beside=(grid, words)),
    Plot("coarse", lag, dpi=50, size=(8, 6)),
    Plot("two spines", lag, beside=(two_spines, words), dpi=150),
    Plot("ticks inside", oscillation, beside=(limits_at_ticks, minor_ticks, ticks_inside), dpi=200),
)

PLOTS = tuple(
    replace(plot, size=(5.8 + (0.37 * k) % 3, 4.3 + (0.23 * k) % 1.9))
    if plot.size is None
    else plot
    for k, plot in enumerate(_PLOTS)
)
"""Every picture of another size, so that lines meet other parts of pixels."""
