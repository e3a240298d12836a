"""Curves of two lags that the paper's figures 4 and 6 and table 2 are read from, by theory."""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from experiments.drawing import new_figure, quiet
from experiments.jakoubek.cells import all_rows
from experiments.jakoubek.drawing import HELP, LEGEND, MARK
from experiments.jakoubek.outcome import Outcome
from experiments.jakoubek.systems import SYSTEMS
from stepax.curves._roots import clamped_root
from stepax.curves._second_order import damping, level_times, shape_ends, unit_response
from stepax.methods._charts import HARRIOTT, STREJC, smith_ratio


SHARE = r"$\tau_1/(\tau_1 + \tau_2)$"


def shape_of(ratio):
    """Shape of two lags from tau2/tau1, 1 for equal lags."""
    return ((1 - ratio) / (1 + ratio)) ** 2


@jax.jit
def heights(ratios, at):
    """Response of two lags at `at` times their sum, for each tau2/tau1."""
    return jax.vmap(lambda ratio: unit_response(jnp.asarray(at), shape_of(ratio)))(ratios)


@jax.jit
def strejc_ratios(values):
    """Table 2: tau2/tau1 from y(t2); beyond the curve its end."""
    _, equal_lags, one_lag = shape_ends(values.dtype)
    at = jnp.asarray(STREJC.height_at)

    def invert(y):
        shape = clamped_root(lambda x: unit_response(at, x) - y, equal_lags, one_lag)[0]
        contrast = jnp.sqrt(shape)
        return (1 - contrast) / (1 + contrast)

    return jax.vmap(invert)(values)


def figure_4() -> Outcome:
    """Harriott's curve, and the time at which two lags reach 73 %."""
    shares = np.linspace(0.5, 1 - 1e-7, 101)
    ratios = (1 - shares) / shares
    y = np.asarray(heights(ratios, HARRIOTT.height_at))
    times = jax.jit(jax.vmap(lambda ratio: level_times((HARRIOTT.level,), shape_of(ratio))[0]))
    t73 = np.asarray(times(ratios))

    figure = new_figure((10.5, 4.3))
    left, right = figure.subplots(1, 2)
    left.plot(y, shares, color="0.1", linewidth=2, label="curve, from theory")
    for bound in (0.26, 0.39):
        left.axvline(bound, color=HELP, linestyle=(0, (4, 3)), linewidth=0.9)
    left.annotate(
        "printed bounds\n0.26 and 0.39", (0.26, 0.955), (5, 0), textcoords="offset points",
        fontsize=8.5, color=HELP, va="center",
    )  # fmt: skip
    places = {"S1": (5, -3), "S2": (8, -2), "S3": (8, -10), "S4": (5, 7), "S5": (-15, 7)}
    for point in _harriott_points():
        _mark(left, point, places[point.system], apart=0.05)
    left.set(
        xlabel=r"$y(t_1)/K$ at $t_1 = (\tau_1 + \tau_2)/2$", ylabel=SHARE, xlim=(0.255, 0.405),
        ylim=(0.48, 1.02), title="Figure 4: Harriott's curve",
    )  # fmt: skip
    left.legend(loc="lower right", **LEGEND)
    right.plot(shares, t73, color="0.1", linewidth=2, label="from theory")
    right.axhline(HARRIOTT.total, color=MARK, linestyle=(0, (4, 3)), label="1.3, as printed")
    right.set(
        xlabel=SHARE, ylabel=r"$t_{73}/(\tau_1 + \tau_2)$", xlim=(0.49, 1.01),
        title="Time at which two lags reach 73 %",
    )  # fmt: skip
    right.legend(loc="upper center", **LEGEND)
    quiet((left, right))
    frame = pd.DataFrame(
        {"tau1_over_sum": shares, "tau2_over_tau1": ratios, "y_at_half_sum": y, "t73_over_sum": t73}
    )
    numbers = {
        "t73/(tau1 + tau2)": f"{t73.min():.4f} to {t73.max():.4f}, printed {HARRIOTT.total}",
        "ends of Harriott's curve": f"{y[0]:.4f} and {y[-1]:.4f}, printed 0.26 and 0.39",
    }
    return Outcome(frame, figure, numbers=numbers)


class Point(NamedTuple):
    """What is read on one system, and what a chart gives there, correctly and by the paper."""

    system: str
    read: float
    correct: float
    published: float


def _mark(axes: Axes, point: Point, place: tuple[int, int], apart: float) -> None:
    """The correct value as a circle and the published one as a cross, both named if far apart."""
    look = {"linestyle": "none", "color": MARK, "markersize": 7, "markeredgewidth": 1.5}
    first = point.system == "S1"
    axes.plot(
        point.read, point.correct, marker="o", markerfacecolor="none",
        label="read off correctly" if first else None, **look,
    )  # fmt: skip
    axes.plot(
        point.read, point.published, marker="x",
        label="of the printed model" if first else None, **look,
    )  # fmt: skip
    names = [(point.published, place)]
    if apart < abs(point.correct - point.published) < np.inf:
        names.append((point.correct, (7, -9)))
    for y, offset in names:
        axes.annotate(point.system, (point.read, y), offset, textcoords="offset points", fontsize=9)


def _harriott_points() -> list[Point]:
    """y(t1), and tau1 over the sum."""
    points = []
    for name in SYSTEMS:
        row = all_rows()[name, "harriott"]
        shares = (lags[0] / sum(lags) for lags in (row.correct.lags, row.cell.values))
        points.append(Point(name, row.correct.details["y_read"], *shares))
    return points


def figure_6() -> Outcome:
    """Smith's curves: damping and t60/tau over t20/t60."""
    zetas = np.concatenate([np.linspace(0.02, 1, 50), np.geomspace(1, 40, 71)[1:]])
    shapes = np.where(zetas >= 1, 1 - 1 / zetas**2, zetas**2 - 1)

    def at(shape):
        ratio, t60 = smith_ratio(shape)
        return ratio, t60 * damping(shape)[1]  # omega_n is 1/tau

    ratios, times = (np.asarray(x) for x in jax.jit(jax.vmap(at))(shapes))
    one_lag, equal_lags, no_damping = 0.243529, 0.407646, 0.555087
    figure = new_figure((10.5, 4.3))
    panels = figure.subplots(1, 2)
    names = (r"$\zeta$", r"$t_{60}/\tau$")
    for axes, y, points, name in zip(
        panels, (zetas, times), zip(*_smith_points(), strict=True), names, strict=True
    ):
        axes.plot(ratios, y, color="0.1", linewidth=2, label="curve, from theory")
        for end in (one_lag, equal_lags, no_damping):
            axes.axvline(end, color=HELP, linestyle=(0, (4, 3)), linewidth=0.9)
        for point in points:
            _mark(axes, point, (-20, -4) if point.system == "S1" else (7, 4), apart=np.inf)
        axes.set(xlabel="$t_{20}/t_{60}$", ylabel=name, yscale="log", xlim=(0.222, 0.565))
        axes.yaxis.set_major_formatter("{x:g}")
    panels[0].set(title="Figure 6: Smith's curve of the damping", ylim=(0.1, 30))
    panels[1].set(title="Figure 6: Smith's curve of the time", ylim=(1, 60))
    panels[0].annotate("two real lags", (0.325, 0.13), ha="center", fontsize=9, color=HELP)
    panels[0].annotate("oscillating", (0.48, 0.13), ha="center", fontsize=9, color=HELP)
    panels[1].legend(loc="upper right", **LEGEND)
    quiet(panels)
    frame = pd.DataFrame({"zeta": zetas, "t20_over_t60": ratios, "t60_over_tau": times})
    return Outcome(frame, figure)


def _smith_points() -> Iterator[tuple[Point, Point]]:
    """t20/t60 of S1 to S3, with zeta and with t60/tau."""
    for name in ("S1", "S2", "S3"):
        row = all_rows()[name, "smith"]
        t20, t60 = row.correct.details["t20"], row.correct.details["t60"]
        zetas, times = [], []
        for lags in (row.correct.lags, row.cell.values):
            tau = np.sqrt(np.prod(lags)) if len(lags) == 2 else 0.0
            zetas.append(sum(lags) / (2 * tau) if tau else np.inf)
            times.append(t60 / tau if tau else np.inf)
        yield Point(name, t20 / t60, *zetas), Point(name, t20 / t60, *times)
