"""The numbers of the README's table of statements, from the files of the other scripts in `--out`.

Numbers in a row are for the orders 2 to 8 of the plant, or for the noise levels named before them.
Errors against order are RMS over the plants, errors against noise medians in which a refusal counts
as worse than any result.
"""

import numpy as np
import pandas as pd

from experiments.murray.correct import FITS, LOOKUPS
from experiments.murray.drawing import rms
from experiments.murray.figures_3_6 import seconds
from experiments.murray.noise_study import failure_rates, medians
from experiments.murray.order_study import rms_by_order
from experiments.murray.runner import Frame, Outcome, Settings, main


T3, TU_TG = "hudzovic_t10_t50_t90", "hudzovic_tu_tg"
FORMULAE, LOOKUP = "sani_interpolation", "sani_t10_t50_t90"
FIT, SANI_FIT = FITS
PROTOCOLS = ("legacy", "correct")
LEVELS = (0.01, 0.05, 0.1, 0.2, 0.34, 0.5, 1.0, 1.5, 1.99)


class Rows(list):
    """Rows (statement, script, number, values)."""

    def add(self, statement: int, script: str, number: str, values, digits: int = 2) -> None:
        """Append one row; numbers are written with so many digits after the point."""
        if not isinstance(values, str):
            values = " ".join(f"{value:.{digits}f}" for value in np.atleast_1d(values))
        self.append((statement, script, number, values))


def run(settings: Settings) -> Outcome:
    def read(name: str) -> Frame:
        try:
            return pd.read_csv(settings.out / f"{name}.csv")
        except FileNotFoundError:
            raise FileNotFoundError(
                f"{settings.out / name}.csv is missing: run `python -m experiments.murray"
                f" --only {name}` with the same --out first."
            ) from None

    rows = Rows()
    for protocol in PROTOCOLS:
        orders(rows, read("figure_8"), protocol)
        for name in ("figure_10", "figure_11", "figure_12"):
            noise(rows, name, read(name), protocol)
    resolution(rows, read("table_resolution"))
    failures(rows, read("failures"))
    refinement(rows, read("figures_13_14"))
    seconds()  # compiles
    rows.add(15, "figures_3_6", "seconds for 700 points", seconds(), 4)
    rows.sort(key=lambda row: row[0])
    frame = pd.DataFrame(rows, columns=["statement", "script", "number", "values"])
    return Outcome(frame, None, {f"{row[0]:2} {row[1]}, {row[2]}": row[3] for row in rows})


def orders(rows: Rows, frame: Frame, protocol: str) -> None:
    """Without noise, by order of the plant."""
    frame = frame[frame.protocol == protocol]
    table = rms_by_order(frame).loc[protocol]
    best_fit, best_lookup = table.loc[[*FITS]].min(), table.loc[[*LOOKUPS]].min()

    def add(statement, number, values, digits=2):
        rows.add(statement, "figure_8", f"{protocol}: {number}", values, digits)

    add(1, "orders of 7 at which a fit is best", (best_fit < best_lookup).sum(), 0)
    add(2, "Hudzovic t3 / best fit, n = 3..8", (table.loc[T3] / best_fit)[1:])
    for statement, method in ((3, FIT), (3, SANI_FIT), (5, T3), (5, LOOKUP), (6, FORMULAE)):
        add(statement, f"{method}, 1e-3", 1000 * table.loc[method])
    add(3, "Sani fit beats Hudzovic fit, % of plants", won(frame, SANI_FIT, FIT), 0)
    add(5, "Sani lookup beats Hudzovic t3, % of plants", won(frame, LOOKUP, T3), 0)
    formulae = frame[frame.method == FORMULAE]
    above = 100 * (formulae.r > 0.7499).groupby(formulae.order).mean()
    add(6, "formulae give r of 0.75 or more, % of plants", above, 0)
    add(7, "formulae / lookup, n = 3..8", (table.loc[FORMULAE] / table.loc[LOOKUP])[1:])
    add(10, f"{TU_TG}, 1e-3", 1000 * table.loc[TU_TG])
    add(10, "sani_tu_tg, 1e-3", 1000 * table.loc["sani_tu_tg"])
    others = table.drop(FORMULAE).max()
    add(12, "formulae / worst other method", table.loc[FORMULAE, 3:] / others.loc[3:])


def won(frame: Frame, first: str, second: str) -> Frame:
    """Per cent of the plants of each order on which the first method's error is the smaller."""
    table = frame.pivot(index=["order", "plant"], columns="method", values="rmse")
    return 100 * (table[first] < table[second]).groupby("order").mean()


def noise(rows: Rows, name: str, frame: Frame, protocol: str) -> None:
    """By noise level."""
    levels = [level for level in LEVELS if level < frame.noise.max()]
    middle = pd.DataFrame({x: medians(frame, x)[protocol] for x in levels})
    failed = pd.DataFrame({x: failure_rates(frame, x)[protocol] for x in levels})
    at = f"{protocol} at " + " ".join(f"{100 * level:.0f}" for level in levels) + " %"

    def add(statement, number, values, digits=2):
        rows.add(statement, name, f"{at}: {number}", values, digits)

    add(1, "best lookup / worse fit", middle.loc[[*LOOKUPS]].min() / middle.loc[[*FITS]].max())
    add(2, "Hudzovic t3 / Hudzovic fit", middle.loc[T3] / middle.loc[FIT])
    add(4, "Sani fit / Hudzovic fit", middle.loc[SANI_FIT] / middle.loc[FIT])
    add(5, "Sani lookup / Hudzovic t3", middle.loc[LOOKUP] / middle.loc[T3])
    add(8, "Hudzovic Tu/Tg / t3", middle.loc[TU_TG] / middle.loc[T3])
    add(9, "Hudzovic Tu/Tg failed, %", failed.loc[TU_TG], 0)
    add(9, "Hudzovic t3 failed, %", failed.loc[T3], 0)
    add(12, "formulae / Hudzovic Tu/Tg", middle.loc[FORMULAE] / middle.loc[TU_TG])


def resolution(rows: Rows, frame: Frame) -> None:
    """Distance of a table's model from that of the exact inversion, and failures."""
    frame = frame[frame.points != "exact"]
    points = frame.points.astype(int)
    at = "at " + " ".join(map(str, sorted(set(points)))) + " points"
    kept = frame[~frame.failed]
    off = kept.off_exact.groupby([kept.method, points]).agg(rms)
    failed = 100 * frame.failed.groupby([frame.method, points]).mean()
    for method in off.index.unique("method"):
        values = " ".join(f"{value:.0e}" for value in off[method])
        rows.add(11, "table_resolution", f"{method} {at}: off exact", values)
        rows.add(11, "table_resolution", f"{method} {at}: failed, %", failed[method], 1)


def failures(rows: Rows, frame: Frame) -> None:
    """Refusals and default values of one lookup by order."""
    part = frame[frame.method == TU_TG]
    keys = [part.noise, part.protocol, part.order]
    count, failed = part.plants, part.plants * part.failed
    rate = (100 * failed.groupby(keys).sum() / count.groupby(keys).sum()).unstack("order")
    for (level, protocol), values in rate.iterrows():
        number = f"{protocol} at {100 * level:.0f} % noise: Hudzovic Tu/Tg failed, %"
        rows.add(13, "failures", number, values, 1)


def refinement(rows: Rows, frame: Frame) -> None:
    """Errors of the lookup over those of the fit."""
    square = frame.groupby(["figure", "noise", "method"]).squared_error
    for error, values in (("RMSE", square.mean() ** 0.5), ("largest squared error", square.max())):
        for (figure, level), part in values.groupby(["figure", "noise"]):
            fits = part.index.get_level_values("method").str.endswith("fit")
            number = f"figure {figure} at {100 * level:.0f} % noise: {error}, lookup / fit"
            rows.add(14, "figures_13_14", number, part[~fits].iloc[0] / part[fits].iloc[0], 1)


if __name__ == "__main__":
    main(__file__)
