"""The paper's statements in numbers, from the files that the other scripts wrote to `--out`."""

import numpy as np
import pandas as pd

from experiments.murray.correct import FITS, LOOKUPS
from experiments.murray.noise_study import failure_rates, medians
from experiments.murray.order_study import rms_by_order
from experiments.murray.runner import Frame, Outcome, Settings, main


T3, FORMULAE, LOOKUP = "hudzovic_t10_t50_t90", "sani_interpolation", "sani_t10_t50_t90"
ORDERS = range(2, 9)


def run(settings: Settings) -> Outcome:
    def read(name: str) -> Frame:
        try:
            return pd.read_csv(settings.out / f"{name}.csv")
        except FileNotFoundError:
            raise FileNotFoundError(
                f"{settings.out / name}.csv is missing: run `python -m experiments.murray"
                f" --only {name}` with the same --out first."
            ) from None

    orders = read("figure_8")
    noisy = {name: read(name) for name in ("figure_10", "figure_11", "figure_12")}
    rows = [
        *order_rows(orders),
        *noise_rows(noisy),
        *failure_rows(read("failures")),
        *refinement_rows(read("figures_13_14")),
        *curve_rows(read("figures_3_6")),
        *resolution_rows(read("table_resolution")),
    ]
    frame = pd.DataFrame(rows, columns=["statement", "number", "value"])
    return Outcome(frame, None, {f"{row[0]} {row[1]}": row[2] for row in rows})


def listed(values, digits: int = 2) -> str:
    """Numbers in a row, in thousandths where they are errors."""
    return " ".join(f"{value:.{digits}f}" for value in values)


def order_rows(frame: Frame):
    """Statements 1 to 7, 10 and 12: figures 8 and 9; errors in thousandths, n = 2..8."""
    table = rms_by_order(frame) * 1000
    for protocol in ("legacy", "correct"):
        part = table.loc[protocol]
        best_fit, best_lookup = part.loc[[*FITS]].min(), part.loc[[*LOOKUPS]].min()
        yield (
            1,
            f"{protocol}: orders at which a fit is best",
            f"{(best_fit < best_lookup).sum()} of 7",
        )
        yield 2, f"{protocol}: Hudzovic t3 / best fit", listed((part.loc[T3] / best_fit)[1:])
        yield 3, f"{protocol}: Hudzovic fit, RMS 1e-3", listed(part.loc["hudzovic_fit"], 3)
        yield 3, f"{protocol}: Sani fit, RMS 1e-3", listed(part.loc["sani_fit"], 3)
        wins = share_won(frame, protocol, "sani_fit", "hudzovic_fit")
        yield 3, f"{protocol}: Sani fit wins, % of plants", listed(wins, 0)
        yield 5, f"{protocol}: Hudzovic t3, RMS 1e-3", listed(part.loc[T3], 3)
        yield 5, f"{protocol}: Sani lookup, RMS 1e-3", listed(part.loc[LOOKUP], 3)
        wins = share_won(frame, protocol, LOOKUP, T3)
        yield 5, f"{protocol}: Sani lookup beats Hudzovic t3, % of plants", listed(wins, 0)
        yield 6, f"{protocol}: formulae, RMS 1e-3", listed(part.loc[FORMULAE])
        yield (
            7,
            f"{protocol}: formulae / lookup",
            listed((part.loc[FORMULAE] / part.loc[LOOKUP])[1:]),
        )
        yield 10, f"{protocol}: Hudzovic Tu/Tg, RMS 1e-3", listed(part.loc["hudzovic_tu_tg"], 3)
        yield 10, f"{protocol}: Sani Tu/Tg, RMS 1e-3", listed(part.loc["sani_tu_tg"], 3)
    formulae = frame[(frame.protocol == "legacy") & (frame.method == FORMULAE)]
    stuck = 100 * (formulae.r > 0.7499).groupby(formulae.order).mean()
    yield 6, "legacy: bisection stuck at r = 0.75, % of plants", listed(stuck, 0)


def share_won(frame, protocol, first, second):
    """Per cent of the plants of each order on which the first method's error is the smaller."""
    part = frame[frame.protocol == protocol].pivot(index="plant", columns="method", values="rmse")
    order = frame.groupby("plant").order.first()
    return 100 * (part[first] < part[second]).groupby(order).mean()


def noise_rows(frames: dict[str, Frame]):
    """Statements 1, 2, 4, 8 and 9: figures 10 to 12."""
    for name, frame in frames.items():
        top = frame.noise.max()
        levels = [x for x in (0.01, 0.05, 0.1, 0.2, 0.34, 0.5, 1.0, 1.5, 1.99) if x < top]
        yield 0, f"{name}: noise levels, %", listed(100 * np.array(levels), 0)
        for protocol in ("legacy", "correct"):
            values = pd.DataFrame({x: medians(frame, x)[protocol] for x in levels})
            best_fit, best_lookup = values.loc[[*FITS]].max(), values.loc[[*LOOKUPS]].min()
            key = f"{name}, {protocol}"
            yield 1, f"{key}: best lookup / worse fit", listed(best_lookup / best_fit)
            yield (
                2,
                f"{key}: Hudzovic t3 / Hudzovic fit",
                listed(values.loc[T3] / values.loc["hudzovic_fit"]),
            )
            yield (
                4,
                f"{key}: Sani fit / Hudzovic fit",
                listed(values.loc["sani_fit"] / values.loc["hudzovic_fit"], 3),
            )
            yield (
                8,
                f"{key}: Hudzovic Tu/Tg / t3",
                listed(values.loc["hudzovic_tu_tg"] / values.loc[T3]),
            )
            rates = pd.DataFrame({x: failure_rates(frame, x)[protocol] for x in levels})
            yield 9, f"{key}: Hudzovic Tu/Tg failed, %", listed(rates.loc["hudzovic_tu_tg"], 0)
            yield 9, f"{key}: Hudzovic t3 failed, %", listed(rates.loc[T3], 0)


def failure_rows(frame: Frame):
    """Failures of the lookups by order."""
    frame["failed"] = frame.plants * ((frame.status == "fallback") | lost_status(frame.status))
    part = frame[frame.method == "hudzovic_tu_tg"].groupby(["noise", "protocol", "order"])
    rate = (100 * part.failed.sum() / part.plants.sum()).unstack("order")
    for (noise, protocol), row in rate.iterrows():
        yield 13, f"{protocol}, noise {100 * noise:.0f} %: Hudzovic Tu/Tg failed, %", listed(row, 1)


def lost_status(status: Frame) -> Frame:
    return ~status.isin(["successful", "fallback", "at_equal_lags", "at_first_order", "at_bound"])


def refinement_rows(frame: Frame):
    """Figures 13 and 14: largest squared error of the lookup over that of the fit, and its root."""
    largest = frame.groupby(["figure", "noise", "method"]).squared_error.max()
    for (figure, noise), part in largest.groupby(["figure", "noise"]):
        fit = part[part.index.get_level_values("method").str.endswith("fit")].iloc[0]
        ratio = part.max() / fit
        key = f"figure {figure}, noise {100 * noise:.0f} %: lookup / fit, squared and root"
        yield 14, key, listed([ratio, ratio**0.5], 1)


def curve_rows(frame: Frame):
    yield 15, "points of the lookup curves computed", str(len(frame))


def resolution_rows(frame: Frame):
    """Distance of a table's model from that of the exact inversion, and failures."""
    for method, part in frame[frame.points != "exact"].groupby("method"):
        part = part.assign(points=part.points.astype(int))
        kept = part[~part.failed].groupby("points").off_exact
        off = kept.agg(lambda x: np.sqrt(np.mean(x**2)))
        rate = 100 * part.groupby("points").failed.mean()
        yield 11, f"{method}: points", listed(off.index, 0)
        yield 11, f"{method}: off exact inversion", " ".join(f"{x:.0e}" for x in off)
        yield 11, f"{method}: failed, %", listed(rate, 1)


if __name__ == "__main__":
    main(__file__)
