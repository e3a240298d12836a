"""How everything is drawn: one colour, dash and marker for each method in all figures."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure


class Look(NamedTuple):
    label: str
    color: str
    dashes: Any
    marker: str


LOOKS = {
    "hudzovic_tu_tg": Look("Hudzovic Tu/Tg", "#1f5fa8", "-", "o"),
    "hudzovic_t10_t50_t90": Look("Hudzovic t10/t50/t90", "#d2560a", (0, (6, 2)), "s"),
    "sani_tu_tg": Look("Sani Tu/Tg", "#b08900", (0, (7, 2, 1.2, 2)), "^"),
    "sani_interpolation": Look("Sani t10/t50/t90, formulae", "#7a2f8a", (0, (1.2, 1.2)), "D"),
    "sani_t10_t50_t90": Look("Sani t10/t50/t90, lookup", "#c058b0", (0, (3, 1.5)), "v"),
    "hudzovic_fit": Look("Hudzovic fit", "#3f7a10", (0, (10, 2)), "P"),
    "sani_fit": Look("Sani fit", "#151515", (0, (1, 3)), "X"),
}
"""Colours as in the paper where it has them; dashes and markers tell the lines apart in grey."""

ORDER_COLORS = ("#151515", "#1f5fa8", "#d2560a", "#3f7a10", "#7a2f8a", "#b08900", "#2a9fb5")
"""One for each order from 2 to 8."""


def line(axes: Axes, method: str, x, y, markers: bool = False, **changes: Any) -> None:
    """Line of one method, in its own look."""
    look = LOOKS[method]
    style = {"color": look.color, "linestyle": look.dashes, "label": look.label, "linewidth": 1.8}
    if markers:
        style |= {"marker": look.marker, "markersize": 6}
    axes.plot(x, y, **(style | changes))


def finish(figure: Figure, panels: Iterable[Axes], columns: int = 4, legend: bool = True) -> None:
    """A quiet frame and grid, and one legend below all panels."""
    panels = list(panels)
    entries: dict[str, Any] = {look.label: None for look in LOOKS.values()}
    for axes in panels:
        axes.grid(color="0.9", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries[label] = entries.get(label) or handle
    entries = {label: handle for label, handle in entries.items() if handle is not None}
    if legend:
        figure.legend(
            list(entries.values()), list(entries), loc="outside lower center", ncols=columns,
            frameon=False, handlelength=4,
        )  # fmt: skip


def order_axes(axes: Axes, title: str) -> None:
    axes.set(title=title, xlabel="order n of the plant", xticks=range(2, 9))


def rms(values) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
