"""How many points a lookup table needs: the study that the paper proposes and does not do.

Tables of 5 to 500 points of the exact curves, inverted by splines as the author's code does it,
against the exact inversion, on the characteristic times of random plants of orders 2 to 8 without
noise. A table ends before r = 1/(n-1) (Hudzovic) and before r = 1 (Sani); results beyond its ends
are failures, counted apart.
"""

import jax
import numpy as np
import pandas as pd

from experiments.drawing import new_figure
from experiments.murray import correct, legacy
from experiments.murray.drawing import LOOKS, finish, line, rms
from experiments.murray.figures_3_6 import curves
from experiments.murray.order_study import ORDERS
from experiments.murray.plants import random_lags, record_times
from experiments.murray.runner import Frame, Outcome, Settings, main
from experiments.numpy_responses import chain_response
from stepax import Hudzovic, Sani, StepRecord, crossing_times, tangent


RESOLUTIONS = (5, 7, 10, 15, 20, 30, 50, 100, 200, 500)
LEVELS = np.array([0.1, 0.5, 0.9])
METHODS = {
    "hudzovic_tu_tg": (Hudzovic, "tangent"),
    "hudzovic_t10_t50_t90": (Hudzovic, "levels"),
    "sani_tu_tg": (Sani, "tangent"),
    "sani_t10_t50_t90": (Sani, "levels"),
}


@jax.jit
@jax.vmap
def characterise(t, y):
    """Tu, Tg; t10, t50, t90."""
    record = StepRecord(t, y, initial=0.0, final=1.0)
    found = tangent(record)
    return {"tangent": (found.Tu, found.Tg), "levels": tuple(crossing_times(record, LEVELS))}


def exact_tables(family, resolution):
    """Tables like the author's, of that many points, but of exact values."""
    return [legacy.Table(*rows) for rows in zip(*curves(family, resolution), strict=True)]


def run(settings: Settings) -> Outcome:
    generator, count = settings.generator("table resolution"), settings.size(100, 10)
    lags = np.concatenate([random_lags(generator, count, n) for n in ORDERS])
    t = record_times(lags)
    clean = chain_response(t, lags)
    times = jax.tree.map(np.asarray, characterise(t, clean))
    exact = correct.errors(lags, t)
    resolutions = RESOLUTIONS[:: settings.size(1, 3)]
    rows = []
    for method, (family, kind) in METHODS.items():
        search = legacy.lookup_tangent if kind == "tangent" else legacy.lookup_levels
        best = [
            legacy.Model(family, row["T"], row["r"], row["n"])
            for row in exact[exact.method == method].to_dict("records")
        ]
        response = [model.response(x) for model, x in zip(best, t, strict=True)]
        for plant, model in enumerate(best):
            error = legacy.rmse(model, t[plant], clean[plant])
            rows.append((method, "exact", plant, error, 0.0, np.isnan(error)))
        for resolution in resolutions:
            table = exact_tables(family, resolution)
            for plant, each in enumerate(zip(*times[kind], strict=True)):
                model = search(family, table, *each)
                error = legacy.rmse(model, t[plant], clean[plant])
                off = legacy.rmse(model, t[plant], response[plant])
                rows.append((method, resolution, plant, error, off, model.fallback))
    columns = ["method", "points", "plant", "rmse", "off_exact", "failed"]
    frame = pd.DataFrame(rows, columns=columns)
    frame.insert(2, "order", np.repeat(ORDERS, count)[frame.plant])
    kept = frame[~frame.failed].groupby(["method", "points"])
    table = kept[["rmse", "off_exact"]].agg(rms).join(
        100 * frame.groupby(["method", "points"]).failed.mean()
    )  # fmt: skip
    return Outcome(frame, draw(table, count), numbers_of(table))


def draw(table: Frame, count: int):
    figure = new_figure((14, 5.5))
    panels = figure.subplots(1, 3)
    what = f"RMS over {count} plants of each order 2..8"
    for method, part in table.groupby("method"):
        rows = part.droplevel("method")
        exact, rows = rows.loc["exact"], rows.drop("exact")
        x = rows.index.astype(int)
        color = LOOKS[str(method)].color
        panels[0].axhline(exact.rmse, color=color, linewidth=0.8, label="_")
        for axes, column in zip(panels, ("rmse", "off_exact", "failed"), strict=True):
            line(axes, str(method), *np.array(sorted(zip(x, rows[column], strict=True))).T,
                 markers=True)  # fmt: skip
    panels[0].set(title="Error of the lookup\n(thin: exact inversion)", ylabel=f"RMSE, {what}")
    panels[1].set(title="Distance from the exact inversion's model", ylabel=f"RMS distance, {what}")
    panels[2].set(title="No result: outside the table", ylabel="failed, %")
    for axes in panels:
        axes.set(xscale="log", xlabel="points of each curve")
    panels[0].set_yscale("log")
    panels[1].set_yscale("log")
    figure.suptitle("Accuracy against the resolution of the lookup table, no noise")
    finish(figure, panels)
    return figure


def numbers_of(table: Frame) -> dict[str, str | float]:
    numbers: dict[str, str | float] = {}
    for method in METHODS:
        for points in ("exact", 5, 50, 500):
            if (method, points) in table.index:
                row = table.loc[(method, points)]
                numbers[f"{LOOKS[method].label}, {points} points"] = (
                    f"RMSE {row.rmse:.3g}, off exact {row.off_exact:.1g}, failed {row.failed:.2g} %"
                )
    return numbers


if __name__ == "__main__":
    main(__file__)
