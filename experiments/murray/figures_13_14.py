"""Figures 13 and 14: the tangent lookup against the fit, squared error on the second axis.

Figure 13: Hudzovic's methods on Sani's chain with T = 1, r = 0.5, n = 4. Figure 14: Sani's methods
on Hudzovic's chain with T = 1, r = 1/6, n = 4. Above with uniform noise of 20 % peak to peak, below
without. Duration of the records as in the paper, 253 samples. Gain and offset are known; the
squared error is that from the response without noise.
"""

import numpy as np
import pandas as pd

from experiments.drawing import new_figure
from experiments.murray import correct
from experiments.murray.drawing import finish, line
from experiments.murray.plants import PT4_LAGS, SAMPLES, padded
from experiments.murray.runner import Outcome, Settings, main
from experiments.numpy_responses import chain_lags
from stepax import Hudzovic, PTn, Sani


NOISES = (0.2, 0.0)
CASES = (
    (13, "hudzovic", Hudzovic, chain_lags(Sani, 1.0, 0.5, 4), 8.474),
    (14, "sani", Sani, PT4_LAGS, 23.21),
)
"""Figure, methods, their family, lags of the plant, duration."""
ERROR = "#8a4fb0"


def models_of(name, family, lags, t, noise) -> dict[str, np.ndarray]:
    """Response of the tangent lookup and of the fit."""
    added = None if noise is None else noise[None]
    found = correct.errors(padded(lags)[None], t[None], added).set_index("method")
    responses = {}
    for method in (f"{name}_tu_tg", f"{name}_fit"):
        row = found.loc[method]
        model = family(T=row["T"], r=row["r"], n=int(row["n"]))
        responses[method] = np.asarray(model.step_response(t))
    return responses


def compared(pair: list[float]) -> str:
    return f"{pair[0]:.2g}, {pair[1]:.2g}, {pair[0] / pair[1]:.1f}"


def run(settings: Settings) -> Outcome:
    figure = new_figure((13, 9.5))
    panels = figure.subplots(2, 2)
    generator = settings.generator("figures 13 and 14")
    rows, numbers, seconds = [], {}, []
    for column, (number, name, family, lags, duration) in zip(panels.T, CASES, strict=True):
        t = np.linspace(0, duration, SAMPLES)
        clean = np.asarray(PTn(lags=lags).step_response(t))
        for axes, amplitude in zip(column, NOISES, strict=True):
            noise = amplitude * (generator.random(SAMPLES) - 0.5) if amplitude else None
            y = clean if noise is None else clean + noise
            axes.plot(t, y, "o", color="0.75", markersize=3, label="record")
            axes.plot(t, clean, color="0.3", linewidth=1, label="response without noise")
            axes.set(xlabel="time", ylabel="output", ylim=(-0.15, 1.15))
            level = f"noise {100 * amplitude:.0f} % peak to peak" if amplitude else "no noise"
            axes.set_title(f"Figure {number}: {family.__name__}'s methods, {level}")
            second = axes.twinx()
            second.set_ylabel("squared error", color=ERROR)
            seconds.append(second)
            largest, rmse = [], []
            for method, modelled in models_of(name, family, lags, t, noise).items():
                square = (modelled - clean) ** 2
                largest.append(float(square.max()))
                rmse.append(float(np.sqrt(square.mean())))
                line(axes, method, t, modelled)
                look = {"color": ERROR, "linewidth": 1.2}
                kind = "fit" if method.endswith("fit") else "lookup"
                dashes = "--" if kind == "fit" else "-"
                second.plot(t, square, dashes, **look, label=f"squared error of the {kind}")
                row = {"figure": number, "noise": amplitude, "method": method, "t": t, "y": y}
                row |= {"clean": clean, "model": modelled, "squared_error": square}
                rows.append(pd.DataFrame(row))
            second.set_ylim(0, 1.3 * max(largest))
            numbers[f"figure {number}, {level}: RMSE of lookup, fit, ratio"] = compared(rmse)
            numbers[f"figure {number}, {level}: largest squared error, the same"] = compared(
                largest
            )
    figure.suptitle("Lookup against fit (Murray 2016, figures 13 and 14)")
    finish(figure, [*panels.flat, *seconds], columns=4)
    for second in seconds:
        second.grid(False)
        second.spines["right"].set_visible(True)
    return Outcome(pd.concat(rows), figure, numbers)


if __name__ == "__main__":
    main(__file__)
