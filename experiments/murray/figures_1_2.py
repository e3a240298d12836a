"""Figures 1 and 2: Tu and Tg, and t10, t50, t90, drawn on the response of 1.4 + 5/(...)."""

import numpy as np
import pandas as pd

from experiments.drawing import new_figure
from experiments.murray.drawing import finish
from experiments.murray.runner import Outcome, Settings, main
from stepax import PTn, StepRecord, crossing_times, tangent


PLANT = {"lags": np.array([1.0, 1.0, 0.5, 0.4]), "gain": 5.0, "offset": 1.4}
"""1.4 + 5/((1 + s)^2 (1 + 0.5 s)(1 + 0.4 s)): the step goes from 1.4 to 6.4."""
LEVELS = np.array([0.1, 0.5, 0.9])
LINE, MARK, HELP = "#1f5fa8", "#d2560a", "0.25"


def run(settings: Settings) -> Outcome:
    t = np.linspace(0, 10, 401)
    y = np.asarray(PTn(**PLANT).step_response(t))
    low, high = 1.4, 6.4
    record = StepRecord(t, y, initial=low, final=high)
    found, times = tangent(record), np.asarray(crossing_times(record, LEVELS))
    Tu, Tg = float(found.Tu), float(found.Tg)

    figure = new_figure((11, 5.2))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes in (left, right):
        axes.plot(t, y, color=LINE, linewidth=2)
        axes.set(xlabel="time", xlim=(0, 10), ylim=(1, 6.9))
    left.set_ylabel("output")
    for level in (low, high):
        left.axhline(level, color=HELP, linestyle="--", linewidth=1)
    ends = np.array([Tu - 0.25, Tu + Tg + 0.25])
    left.plot(ends, low + (ends - Tu) / Tg * (high - low), color=HELP, linestyle="--")
    left.plot(float(found.t_inflection), float(found.y_inflection), "o", color=LINE)
    left.plot([Tu, Tu + Tg], [low, high], "o", color=MARK, markersize=8)
    left.vlines([Tu, Tu + Tg], 1, [low, high], color=HELP, linestyle=":")
    for place, text in ((Tu / 2, "Tu"), (Tu + Tg / 2, "Tg")):
        left.annotate(text, (place, 1.1), ha="center")
    left.annotate("inflection", (float(found.t_inflection), float(found.y_inflection)),
                  xytext=(10, -8), textcoords="offset points")  # fmt: skip
    left.set_title(f"Figure 1: Tu = {Tu:.4f}, Tg = {Tg:.4f}, Tu/Tg = {Tu / Tg:.4f}")
    values = low + LEVELS * (high - low)
    right.hlines(values, 0, times, color=HELP, linestyle="--", linewidth=1)
    right.vlines(times, 1, values, color=HELP, linestyle="--", linewidth=1)
    right.plot(times, values, "o", color=MARK, markersize=8)
    for q, x, y_q in zip(LEVELS, times, values, strict=True):
        right.annotate(f"t{100 * q:.0f} = {x:.4f}", (x, y_q), xytext=(8, -14),
                       textcoords="offset points",
                       bbox={"color": "white", "pad": 1.5})  # fmt: skip
    lam = float((times[2] - times[0]) / times[1])
    right.set_title(f"Figure 2: (t90 - t10)/t50 = {lam:.4f}")
    figure.suptitle("Characterisations of 1.4 + 5/((1 + s)²(1 + 0.5 s)(1 + 0.4 s))")
    finish(figure, [left, right], legend=False)
    numbers = {"Tu": Tu, "Tg": Tg, "Tu/Tg": Tu / Tg, "lam": lam}
    numbers |= {f"t{100 * q:.0f}": float(x) for q, x in zip(LEVELS, times, strict=True)}
    frame = pd.DataFrame({"t": t, "y": np.asarray(y)}).assign(**numbers)
    return Outcome(frame, figure, numbers)


if __name__ == "__main__":
    main(__file__)
