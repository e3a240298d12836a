"""Figures 1, 2, 3, 5, 7, 8: what each method reads off a response, and the model that it gives."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from experiments.drawing import new_figure, quiet
from experiments.jakoubek.cells import all_rows
from experiments.jakoubek.drawing import HELP, LEGEND, LOOKS, MARK, SYSTEM
from experiments.jakoubek.outcome import Outcome
from experiments.jakoubek.published import METHODS
from experiments.jakoubek.systems import GAIN, SYSTEMS, response


class Panel(NamedTuple):
    """One response: the methods on it, and by name in their details the marks that they read."""

    system: str
    methods: tuple[str, ...]
    marks: dict[str, str]
    tangent: bool = False


HEIGHT = {"t_read": "y_read", "t_i": "y_i"}
"""Details that hold the height of a mark whose level is not in its name."""

FIGURES = {
    1: (Panel("S5", ("viteckova_1", "viteckova_2"), {"t33": "$t_{33}$", "t70": "$t_{70}$"}),),
    2: (Panel("S5", ("latzel",), {"t10": "$t_{10}$", "t50": "$t_{50}$", "t90": "$t_{90}$"}),),
    3: (Panel("S3", ("harriott",), {"t_read": "$t_1$", "t73": "$t_{73}$"}),),
    5: (Panel("S3", ("smith",), {"t20": "$t_{20}$", "t60": "$t_{60}$"}),),
    7: (
        Panel("S3", ("strejc",), {"t72": "$t_1$", "t_read": "$t_2$"}),
        Panel("S5", ("strejc",), {"t_i": "$t_i$"}, tangent=True),
    ),
    8: (Panel("S5", ("sundaresan_krishnaswamy",), {"t35_3": "$t_{35.3}$", "t85_3": "$t_{85.3}$"}),),
}


def run(figure: int) -> Outcome:
    """One figure, of one panel or two."""
    panels = FIGURES[figure]
    picture = new_figure((6.4 * len(panels) + 0.4, 4.4))
    places = picture.subplots(1, len(panels), squeeze=False)[0]
    lines = []
    for axes, panel in zip(places, panels, strict=True):
        lines += _draw(axes, panel)
        axes.set_title(f"{panel.system}: G(s) = {SYSTEMS[panel.system].title}", fontsize=10)
    names = " and ".join(dict.fromkeys(METHODS[x] for x in panels[0].methods))
    picture.suptitle(f"Figure {figure}: what the method reads ({names})", fontsize=11)
    quiet(places)
    return Outcome(pd.DataFrame(lines), picture)


def _draw(axes: Axes, panel: Panel) -> list[dict]:
    """The response, the models and the marks; returns all points drawn."""
    system, cells = SYSTEMS[panel.system], all_rows()
    end = 4 * sum(system.lags)
    t = np.linspace(0, end, 401)
    curves = {"system": response(system.plant, t)}
    axes.plot(t, curves["system"], color=SYSTEM, linewidth=4, label="system")
    for method in panel.methods:
        reading, look = cells[panel.system, method].correct, LOOKS[method]
        curves[method] = reading.response(t)
        axes.plot(
            t, curves[method], color=look.color, linestyle=look.dashes, linewidth=1.6,
            label=f"{METHODS[method]}: {reading.text}",
        )  # fmt: skip
    details = cells[panel.system, panel.methods[0]].correct.details
    axes.axhline(GAIN, color=HELP, linewidth=0.8, linestyle=(0, (4, 3)))
    if panel.tangent:
        _draw_tangent(axes, details)
    marks = list(_marks(panel, details))
    for name, time, y in marks:
        axes.plot([0, time, time], [y, y, 0], color=HELP, linestyle=":", linewidth=1)
        axes.plot(
            time, y, "o", color=MARK, markersize=8, markerfacecolor="none", markeredgewidth=1.6,
            zorder=5,
        )  # fmt: skip
        axes.annotate(
            f"{name} = {time:.4g} s", (time, y), (10, -11), textcoords="offset points", fontsize=9,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
        )  # fmt: skip
    axes.set(xlabel="time (s)", ylabel="output", xlim=(0, end), ylim=(0, 1.35 * GAIN))
    axes.set_yticks(np.linspace(0, GAIN, 5))
    if panel.tangent:
        axes.set_ylim(bottom=-0.26 * GAIN)
    axes.legend(loc="upper left", fontsize=8.5, handlelength=3.5, **LEGEND)
    points = [
        {"system": panel.system, "series": name, "time_s": time, "output": value}
        for name, values in curves.items()
        for time, value in zip(t, values, strict=True)
    ]
    return points + [
        {"system": panel.system, "series": f"mark {name}", "time_s": time, "output": y}
        for (_, time, y), name in zip(marks, panel.marks, strict=True)
    ]


def _marks(panel: Panel, details: dict[str, float]) -> Iterator[tuple[str, float, float]]:
    """Label, time and output of each mark."""
    for key, label in panel.marks.items():
        known = HEIGHT.get(key)
        share = details[known] if known else float(key[1:].replace("_", ".")) / 100
        yield label, details[key], share * GAIN


def _draw_tangent(axes: Axes, details: dict[str, float]) -> None:
    """The tangent at the inflection with its two times below the response."""
    Tu, Tn = details["Tu"], details["Tg"]
    axes.plot([Tu, Tu + Tn], [0, GAIN], color="0.1", linewidth=1.1, marker="o", markersize=4)
    axes.axhline(0, color=HELP, linewidth=0.8)
    axes.vlines([Tu, Tu + Tn], -0.1 * GAIN, [0, GAIN], color=HELP, linestyle=":", linewidth=1)
    for left, right, name in ((0, Tu, "T_U"), (Tu, Tu + Tn, "T_N")):
        axes.annotate(
            "", (right, -0.07 * GAIN), (left, -0.07 * GAIN),
            arrowprops={"arrowstyle": "<->", "color": "0.1", "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        axes.annotate(f"${name}$\n{right - left:.4g} s", ((left + right) / 2, -0.1 * GAIN),
                      ha="center", va="top", fontsize=9)  # fmt: skip
