"""Figure 9: Sani's formulae against the lookup of t10/t50/t90, error against order, no noise."""

import numpy as np

from experiments.drawing import new_figure
from experiments.murray.drawing import LOOKS, finish, line, order_axes
from experiments.murray.figure_8 import FLOOR, name_those_below
from experiments.murray.order_study import order_study, plants_per_order, rms_by_order
from experiments.murray.runner import Outcome, Settings, main


def run(settings: Settings) -> Outcome:
    frame = order_study(settings)
    frame = frame[frame.method.isin(["sani_interpolation", "sani_t10_t50_t90"])]
    table = rms_by_order(frame)
    orders = np.asarray(table.columns)
    legacy = frame[(frame.protocol == "legacy") & (frame.method == "sani_t10_t50_t90")]
    twice = np.sqrt(legacy.groupby("order").rmse.mean())
    formulae, lookup = LOOKS["sani_interpolation"], LOOKS["sani_t10_t50_t90"]
    figure = new_figure((7.5, 6.5))
    axes = figure.subplots()
    axes.plot(
        orders, twice, color="0.6", linewidth=1.2, label="lookup as the paper drew it: root of RMSE"
    )
    line(
        axes, "sani_interpolation", orders, table.loc[("legacy", "sani_interpolation")],
        markers=True, alpha=0.55, markerfacecolor="none",
        label=f"{formulae.label}, bisection ends at r = 0.75",
    )  # fmt: skip
    line(
        axes, "sani_t10_t50_t90", orders, table.loc[("legacy", "sani_t10_t50_t90")],
        markers=True, alpha=0.55, markerfacecolor="none",
        label=f"{lookup.label} in the author's tables",
    )  # fmt: skip
    for method in ("sani_interpolation", "sani_t10_t50_t90"):
        label = f"{LOOKS[method].label}, {'solved' if method == 'sani_interpolation' else 'exact'}"
        line(axes, method, orders, table.loc[("correct", method)], markers=True, label=label)
    count = plants_per_order(settings)
    order_axes(axes, "Sani's formulae and the lookup (Murray 2016, figure 9)")
    axes.set(yscale="log", ylim=(FLOOR, 0.1))
    axes.set_ylabel(f"RMSE, root mean square over {count} plants")
    name_those_below(axes, float(table.loc[("correct", "sani_t10_t50_t90"), 2]))
    finish(figure, [axes], columns=1)
    numbers = {}
    for protocol in ("legacy", "correct"):
        ratio = (
            table.loc[(protocol, "sani_interpolation")] / table.loc[(protocol, "sani_t10_t50_t90")]
        )
        numbers[f"formulae / lookup, {protocol}, n = 2"] = ratio[2]
        numbers[f"formulae / lookup, {protocol}, n = 4"] = ratio[4]
        numbers[f"formulae / lookup, {protocol}, n = 8"] = ratio[8]
    numbers["lookup as the paper drew it, n = 8"] = float(twice[8])
    return Outcome(frame, figure, numbers)


if __name__ == "__main__":
    main(__file__)
