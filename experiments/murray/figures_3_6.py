"""Figures 3 to 6: the lookup curves of both families, with the paper's example lookups.

Each pair has the ratio of two times above, from which n and r are read, and below the factor that
turns a time into T. Figure 6 of the paper drew Sani's formulae in place of the curves.
"""

import time
from typing import NamedTuple

import numpy as np
import pandas as pd

from experiments.drawing import new_figure
from experiments.murray.drawing import ORDER_COLORS, finish
from experiments.murray.legacy import ORDERS, RESOLUTION, formula_lam, formula_t50, r_grid
from experiments.murray.runner import Outcome, Settings, main
from stepax import Hudzovic, Sani, lookup_curves


PANELS = (
    ("Figure 3: Hudzovic, Tu/Tg", Hudzovic, "tu_tg", "inv_tg", "Tu/Tg", "T/Tg"),
    ("Figure 4: Hudzovic, t10/t50/t90", Hudzovic, "lam", "inv_t50", "(t90 - t10)/t50", "T/t50"),
    ("Figure 5: Sani, Tu/Tg", Sani, "tu_tg", "inv_tg", "Tu/Tg", "T/Tg"),
    ("Figure 6: Sani, t10/t50/t90", Sani, "lam", "inv_t50", "(t90 - t10)/t50", "T/t50"),
)


class Values(NamedTuple):
    r: np.ndarray
    tu_tg: np.ndarray
    inv_tg: np.ndarray
    lam: np.ndarray
    inv_t50: np.ndarray


EXAMPLES = ((3, 0.4), (3, 0.3479), (4, 0.9), (3, 0.8))
"""Order and r of the lookups drawn in the paper."""


def curves(family, resolution=RESOLUTION):
    """Grid of r and the four curves, each (7, resolution); compiled for 50 points at a time."""
    r = np.array([r_grid(family, n, resolution) for n in ORDERS])
    parts = []
    for start in range(0, resolution, RESOLUTION):
        place = np.arange(start, start + RESOLUTION) % resolution
        parts.append(np.array(lookup_curves(family, np.array(ORDERS)[:, None], r[:, place])))
    return r, *np.concatenate(parts, axis=2)[..., :resolution]


def seconds() -> float:
    """Time of all 700 points, compiled before."""
    start = time.perf_counter()
    for family in (Hudzovic, Sani):
        curves(family)
    return time.perf_counter() - start


def formulae(r):
    """lam and T/t50 by Sani's formulae on the grid, each (7, resolution)."""
    rows = list(zip(r, ORDERS, strict=True))
    return np.array([[formula_lam(*row) for row in rows], [1 / formula_t50(*row) for row in rows]])


def run(settings: Settings) -> Outcome:
    found = {family: Values(*curves(family)) for family in (Hudzovic, Sani)}
    duration = seconds()
    approximate: dict[str, np.ndarray] = dict(
        zip(("lam", "inv_t50"), formulae(found[Sani].r), strict=True)
    )
    figure = new_figure((16, 8.5))
    panels = figure.subplots(2, 4)
    numbers: dict[str, str | float] = {"700 points, seconds": duration}
    for column, (title, family, ratio, factor, *labels) in enumerate(PANELS):
        values = found[family]
        n, at = EXAMPLES[column]
        exact = lookup_curves(family, n, at)
        for axes, name, label in zip(panels[:, column], (ratio, factor), labels, strict=True):
            for k, color in enumerate(ORDER_COLORS):
                axes.plot(
                    values.r[k], getattr(values, name)[k], color=color, label=f"n = {ORDERS[k]}"
                )
                if column == 3:
                    axes.plot(values.r[k], approximate[name][k], ":", color=color, label="_")
            level = float(getattr(exact, name))
            axes.set(xlabel="r", ylabel=label, xlim=(0, 1), ylim=(0, None))
            top = axes.get_ylim()[1]
            axes.set_ylim(0, top)
            axes.plot([0, at], [level, level], "k--", linewidth=1.2)
            axes.plot([at, at], [level, 0 if name == ratio else top], "k--", linewidth=1.2)
            numbers[f"figure {column + 3}: {label} at n = {n}, r = {at}"] = level
        panels[0, column].set_title(title)
    panels[0, 3].plot([], [], "k:", label="Sani's formulae 2.17 and 2.19, figure 6")
    panels[0, 0].plot([], [], "k--", label="example lookup")
    finish(figure, panels.flat, columns=9)
    figure.suptitle("Lookup curves at T = 1 (Murray 2016)")
    for name in ("lam", "inv_t50"):
        off = np.abs(approximate[name] / getattr(found[Sani], name) - 1)
        numbers[f"formula of {name}, largest error, %"] = float(100 * off.max())
    rows = []
    for family, values in found.items():
        order = np.repeat(ORDERS, RESOLUTION)
        part = {name: column.ravel() for name, column in values._asdict().items()}
        rows.append(pd.DataFrame({"family": family.__name__, "n": order} | part))
    return Outcome(pd.concat(rows), figure, numbers)


if __name__ == "__main__":
    main(__file__)
