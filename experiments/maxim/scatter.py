"""Where the estimates of single cells lie: scatter, responses, and error over the dead time."""

import functools

import jax
import numpy as np
import pandas as pd

from experiments.drawing import new_figure, quiet
from experiments.jakoubek.outcome import Outcome
from experiments.maxim.batch import identified
from experiments.maxim.drawing import LOOKS, legend_below
from experiments.maxim.noise import at_level
from experiments.maxim.plants import EXAMPLES, Plant, mode
from stepax import METHODS, StepRecord


CASES = {
    "zeta 0.2, delay 1": Plant((mode(0.2, 1.0),), (), 1.0, 1.0, "zeta 0.2, delay 1"),
    "zeta 0.7, delay 1": Plant((mode(0.7, 1.0),), (), 1.0, 1.0, "zeta 0.7, delay 1"),
    "Example 4": EXAMPLES[4],
}
SHOWN, SEQUENCES, LEVEL = ("rdkam", "fit"), 1000, 0.1


def run() -> Outcome:
    figure, rows = new_figure((12, 10.5)), []
    panels = figure.subplots(3, 3)
    for column, (name, plant) in zip(panels.T, CASES.items(), strict=True):
        t = np.linspace(0, plant.delay + 1.25 * plant.settling_time(), 200)
        clean = plant.response(t)
        y = clean + at_level(np.random.default_rng(3), "white", plant, t, SEQUENCES, LEVEL)
        column[1].plot(t, y[0], color="0.85", zorder=0)
        for method in SHOWN:
            color, _ = LOOKS[method]
            found = identified(method, t, y, clean, plant.gain)
            gain, zeta, omega_n, delay = found.parameters.T
            column[0].plot(zeta, omega_n, ".", color=color, markersize=2, alpha=0.5, label=method)
            kept = found.parameters[np.isfinite(found.mse)]
            models = np.array([
                Plant((mode(z, w),), (), k, d).response(t) for k, z, w, d in kept[:300]
            ])  # fmt: skip
            low, high = np.percentile(models, (5, 95), axis=0)
            column[1].fill_between(
                t, low, high, color=color, alpha=0.3, label=f"{method}, 5 to 95 %"
            )
            for row in zip(gain, zeta, omega_n, delay, found.mse, strict=True):
                rows.append((name, method, *row))
        column[1].plot(t, clean, color="#151515", linewidth=0.8)
        column[0].set(title=f"{name}, {100 * LEVEL:.0f} % noise", xlabel="zeta", ylabel="omega_n")
        _without_the_farthest(column[0], rows[-len(SHOWN) * SEQUENCES :])
        column[1].set(xlabel="time", ylabel="response")
        _error_over_delay(column[2], plant, t, clean, y[0])
    panels[0, 0].legend(frameon=False, markerscale=5, loc="lower right")
    panels[1, 0].legend(frameon=False)
    legend_below(figure, panels[2, 0])
    quiet(panels.flat)
    columns = ["plant", "method", "gain", "zeta", "omega_n", "delay", "MSE"]
    return Outcome(pd.DataFrame(rows, columns=columns), figure)


def _without_the_farthest(axes, rows):
    """Axes that show what lies near: a few fits run off to a damping of 200, one lag."""
    points = np.array([row[3:5] for row in rows])
    points = points[np.isfinite(points).all(axis=1)]
    low, high = np.percentile(points, (0.5, 99.5), axis=0)
    low, high = low - 0.15 * (high - low), high + 0.15 * (high - low)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    beyond = np.sum(np.any((points < low) | (points > high), axis=1))
    axes.text(0.02, 0.95, f"{beyond} beyond", transform=axes.transAxes, color="0.4")


@functools.cache
def _errors(name):
    """Root mean square error of the model for each dead time, of one record."""

    def one(d, t, y, gain):
        record = StepRecord(t, y, initial=0.0)
        return METHODS[name](record, gain=gain, min_delay=d, max_delay=d).rmse

    return jax.jit(jax.vmap(one, in_axes=(0, None, None, None)))


def _error_over_delay(axes, plant, t, clean, y):
    """Squared error of the best model of each dead time, first branch and oscillatory."""
    delays = np.linspace(0, plant.delay + 0.1 * t[-1], 120)
    for name, color in (("rdkam_sopdt", "#1f5fa8"), ("rdkam_oscillatory", "#d2560a")):
        for record, line in ((clean, "-"), (y, ":")):
            found = np.asarray(_errors(name)(delays, t, record, plant.gain))
            if np.isfinite(found).any():
                label = f"{name}{'' if line == '-' else ', noisy'}"
                axes.plot(delays, found**2, color=color, linestyle=line, label=label)
    axes.axvline(plant.delay, color="0.6", linewidth=0.8)
    axes.set(xlabel="dead time", ylabel="squared error, mean", yscale="log")
