"""How everything is drawn: one colour and dash for each method in all figures."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure


LOOKS: dict[str, tuple[str, Any]] = {
    "listing": ("#c0203a", (0, (4, 1.5))),
    "rdkam, K and Tp given": ("#7a2f8a", (0, (1.2, 1.2))),
    "rdkam": ("#1f5fa8", "-"),
    "fit": ("#151515", (0, (10, 2))),
    "fit, K known": ("#3f7a10", (0, (6, 2))),
    "three points": ("#d2560a", (0, (3, 1.5))),
    "integrals": ("#b08900", (0, (7, 2, 1.2, 2))),
    "integrals, instruments": ("#2a9fb5", (0, (2, 2))),
}


def legend_below(figure: Figure, axes: Axes, columns: int = 4) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=columns, frameon=False, handlelength=4
    )
