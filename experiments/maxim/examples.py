"""Examples 1 to 5 of the paper: published, reproduced by its listing, ours, and under noise."""

import numpy as np
import pandas as pd
from rich.table import Table

from experiments.drawing import new_figure, quiet
from experiments.jakoubek.outcome import Outcome
from experiments.maxim.batch import Found, identified, identified_alone
from experiments.maxim.drawing import LOOKS, legend_below
from experiments.maxim.noise import noisy
from experiments.maxim.plants import EXAMPLES
from experiments.maxim.published import PRINTED, SETTINGS


OURS = ("rdkam, K and Tp given", "rdkam", "fit, K known", "fit", "three points", "integrals")
CLEAN = ("listing", *OURS)
SEQUENCES = 1000


def record_of(number: int):
    setting = SETTINGS[number]
    t = setting.interval * np.arange(setting.samples)
    return t, EXAMPLES[number].response(t)


def _row(number, name, found: Found, k=0):
    gain, zeta, omega_n, delay = found.parameters[k]
    return {
        "example": number, "model": name, "K": gain, "a2": omega_n**-2, "a1": 2 * zeta / omega_n,
        "zeta": zeta, "delay": delay, "MSE": found.mse[k],
    }  # fmt: skip


def noise_free() -> Outcome:
    """Every model of the paper with the MSE that it has, and ours on the record without noise."""
    rows = []
    for number, models in PRINTED.items():
        t, y = record_of(number)
        setting = SETTINGS[number]
        for model in models:
            error = np.mean((model.plant.response(t) - y) ** 2)
            rows.append({
                "example": number, "model": f"{model.method}, printed", "K": model.gain,
                "a2": model.a2, "a1": model.a1, "zeta": model.a1 / 2 / np.sqrt(model.a2),
                "delay": model.delay, "MSE": error, "MSE published": model.mse,
            })  # fmt: skip
        for name in CLEAN:
            found = identified_alone(name, t, y, y, setting.gain, setting.period)
            rows.append(_row(number, name, found))
    frame = pd.DataFrame(rows)
    table = Table(*frame.columns, title="Noise-free examples")
    for row in frame.itertuples(index=False):
        table.add_row(*(x if isinstance(x, str) else f"{x:.4g}" for x in row))
    numbers = {}
    for number in (4, 5):
        part = frame[frame.example == number].set_index("model")
        listing, ours = part.loc["listing"], part.loc["rdkam, K and Tp given"]
        published = part.loc["RDKAM, printed"]["MSE published"]
        numbers[f"example {number}: listing a2, a1, L, MSE"] = (
            f"{listing.a2:.2f}, {listing.a1:.2f}, {listing.delay:.2f}, {listing.MSE:.3g}"
        )
        numbers[f"example {number}: MSE published, ours"] = f"{published:.3g}, {ours.MSE:.3g}"
    return Outcome(frame, None, table, numbers)


def noisy_examples() -> Outcome:
    """Examples 1 to 3 over 1000 noise sequences with the published standard deviations."""
    generator, rows = np.random.default_rng(14), []
    figure = new_figure((12, 7.5))
    panels = figure.subplots(2, 3)
    for column, number in zip(panels.T, (1, 2, 3), strict=True):
        plant, setting = EXAMPLES[number], SETTINGS[number]
        t, clean = record_of(number)
        y = clean + noisy(generator, plant, t, SEQUENCES, setting.sigma_in, setting.sigma_out)
        published = PRINTED[number][0]
        for name in CLEAN:
            found = identified(name, t, y, clean, setting.gain, setting.period)
            rows.append(_spread(number, name, found, published))
            color, dashes = LOOKS[name]
            error = np.sort(np.nan_to_num(found.mse, nan=np.inf))
            share = np.arange(1, len(error) + 1) / len(error)
            column[0].plot(error, share, color=color, linestyle=dashes, label=name)
            column[1].plot(
                np.sort(np.nan_to_num(found.parameters[:, 1], nan=np.inf)), share, color=color,
                linestyle=dashes,
            )  # fmt: skip
        column[0].axvline(published.mse, color="0.4", linestyle=":", label="published RDKAM")
        damping = published.a1 / 2 / np.sqrt(published.a2)
        column[1].axvline(damping, color="0.4", linestyle=":")
        low, high = {1: (5e-4, 0.1), 2: (5e-3, 5), 3: (0.02, 20)}[number]
        column[0].set(title=plant.name, xscale="log", xlim=(low, high), xlabel="MSE")
        column[1].set(xlabel="zeta", xlim={1: (0.5, 6), 2: (0.3, 0.7), 3: (0.05, 0.4)}[number])
    for axes in panels[:, 0]:
        axes.set_ylabel("share of 1000 noise sequences")
    quiet(panels.flat)
    legend_below(figure, panels[0, 0])
    frame = pd.DataFrame(rows)
    table = Table(*frame.columns, title="Examples 1 to 3 with the published noise, 1000 sequences")
    for row in frame.itertuples(index=False):
        table.add_row(*(x if isinstance(x, str) else f"{x:.3g}" for x in row))
    return Outcome(frame, figure, table)


def _spread(number, name, found: Found, published):
    low, middle, high = np.nanpercentile(found.mse, (5, 50, 95))
    zetas = np.nanpercentile(found.parameters[:, 1], (5, 50, 95))
    below = np.mean(np.nan_to_num(found.mse, nan=np.inf) < published.mse)
    return {
        "example": number, "model": name, "MSE 5 %": low, "median": middle, "95 %": high,
        "published at percentile": 100 * below, "zeta 5 %": zetas[0], "zeta median": zetas[1],
        "zeta 95 %": zetas[2], "refused %": 100 * np.mean(np.isnan(found.mse)),
    }  # fmt: skip
