"""The two rigs of the paper as simulated surrogates: no record of the real ones was published."""

import numpy as np
import pandas as pd
from rich.table import Table

from experiments.drawing import new_figure, quiet
from experiments.jakoubek.outcome import Outcome
from experiments.maxim.batch import identified_alone
from experiments.maxim.drawing import LOOKS
from experiments.maxim.plants import RIGS, Plant
from experiments.maxim.published import RIGS as PRINTED


SAMPLING = {
    "six tanks (simulated)": (1.0, 351, None, 0.01),
    "mass-spring-damper (simulated)": (0.01, 401, 0.3130, 0.0),
}
"""Interval, samples, period given, white noise over the gain."""

NAMES = ("listing", "rdkam, K and Tp given", "rdkam", "fit")


def run() -> Outcome:
    rows, figure = [], new_figure((12, 4.5))
    for axes, (name, plant) in zip(figure.subplots(1, 2), RIGS.items(), strict=True):
        interval, samples, period, level = SAMPLING[name]
        t = interval * np.arange(samples)
        clean = plant.response(t)
        noise = level * plant.gain * np.random.default_rng(6).standard_normal(samples)
        axes.plot(t, clean + noise, color="0.7", label="simulated record")
        printed = PRINTED[name]
        rows.append({
            "rig": name, "model": "RDKAM of the real rig, printed", "K": printed.gain,
            "zeta": printed.a1 / 2 / np.sqrt(printed.a2), "omega_n": printed.a2**-0.5,
            "delay": printed.delay, "MSE": printed.mse,
        })  # fmt: skip
        for method in NAMES:
            found = identified_alone(method, t, clean + noise, clean, plant.gain, period)
            gain, zeta, omega_n, delay = found.parameters[0]
            rows.append({"rig": name, "model": method, "K": gain, "zeta": zeta,
                         "omega_n": omega_n, "delay": delay, "MSE": found.mse[0]})  # fmt: skip
            if method in ("listing", "rdkam"):
                color, dashes = LOOKS[method]
                model = Plant(((2 * zeta / omega_n, omega_n**-2),), (), gain, delay)
                axes.plot(t, model.response(t), color=color, linestyle=dashes, label=method)
        axes.set(title=name, xlabel="time, s")
        axes.legend(frameon=False)
        quiet([axes])
    frame = pd.DataFrame(rows)
    table = Table(*frame.columns, title="The rigs, simulated")
    for row in frame.itertuples(index=False):
        table.add_row(*(x if isinstance(x, str) else f"{x:.4g}" for x in row))
    return Outcome(frame, figure, table)
