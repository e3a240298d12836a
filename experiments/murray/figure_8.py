"""Figure 8: error against the order of the plant, without noise, 200 random plants per order."""

from matplotlib.axes import Axes

from experiments.drawing import new_figure
from experiments.murray.correct import lost
from experiments.murray.drawing import finish, line, order_axes
from experiments.murray.order_study import order_study, plants_per_order, rms_by_order
from experiments.murray.runner import Frame, Outcome, Settings, main


TITLES = {
    "legacy": "as the paper computed it",
    "correct": "exact curves, known levels",
}

FLOOR = 3e-4
"""Lowest error that figures 8 and 9 show."""


def name_those_below(axes: Axes, largest: float) -> None:
    """Say how small the errors at n = 2 are that lie below the axis."""
    text = f"n = 2:\nothers to\n{largest:.1e}"
    axes.annotate(text, (1.78, 1.1 * FLOOR), fontsize=9, color="0.3")


def name_default_values(axes: Axes, frame: Frame, table: Frame) -> None:
    """Say how many plants of a point have default values in place of a result."""
    counts = frame[frame.status == "fallback"].groupby(["method", "order"]).size()
    for (method, order), count in counts.items():
        text = f"{count} plant{'s' if count > 1 else ''} with T = 1"
        place = (order, table.loc[method, order])
        axes.annotate(
            text, place, xytext=(0, 8), textcoords="offset points", fontsize=9, ha="right"
        )


def run(settings: Settings) -> Outcome:
    frame = order_study(settings)
    table = rms_by_order(frame)
    figure = new_figure((11, 6))
    panels = figure.subplots(1, 2, sharey=True)
    count = plants_per_order(settings)
    for axes, (protocol, title) in zip(panels, TITLES.items(), strict=True):
        rows = table.loc[protocol]
        for method, row in rows.iterrows():
            line(axes, str(method), row.index, row.values, markers=True)
        name_default_values(axes, frame[frame.protocol == protocol], rows)
        below = rows[2][rows[2] < FLOOR]
        if below.size:
            name_those_below(axes, below.max())
        order_axes(axes, title)
        axes.set_yscale("log")
    panels[0].set(ylim=(FLOOR, 0.1), ylabel=f"RMSE, root mean square over {count} plants")
    figure.suptitle("Error against order (Murray 2016, figure 8)")
    finish(figure, panels)
    correct = table.loc["correct"]
    lookup, formulae = correct.loc["sani_t10_t50_t90"], correct.loc["sani_interpolation"]
    fits = correct.loc[["hudzovic_fit", "sani_fit"]]
    numbers = {
        "Sani lookup, largest RMS for n = 3..8": lookup.loc[3:].max(),
        "formulae / lookup, smallest ratio for n = 3..8": (formulae / lookup).loc[3:].min(),
        "formulae, RMS at n = 4": formulae[4],
        "formulae, RMS at n = 8": formulae[8],
        "fits at n = 2, largest RMS": fits[2].max(),
        "fits at n = 3..8, RMS from": fits.loc[:, 3:].min(axis=None),
        "fits at n = 3..8, RMS to": fits.loc[:, 3:].max(axis=None),
        "refusals": int(lost(frame[frame.protocol == "correct"]).sum()),
    }
    return Outcome(frame, figure, numbers)


if __name__ == "__main__":
    main(__file__)
