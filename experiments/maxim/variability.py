"""The paper's stated future work: variability of the estimates over noise sequences.

1000 sequences a cell, the same for all methods. Plants: examples 1 to 5 and exact second-order
plants of nine dampings with dead times of 0, 1 and 5 over omega_n. Noise: white at the output, of
the same standard deviation but through the plant's input ("input"), and both as in examples 1 to 3.
Records of 1.25 settling times and 200 samples, some of 1.0 and 1.5 and of 500.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from rich.progress import track
from rich.table import Table

from experiments.drawing import new_figure, quiet
from experiments.jakoubek.outcome import Outcome
from experiments.maxim.batch import PARAMETERS, identified
from experiments.maxim.drawing import LOOKS, legend_below
from experiments.maxim.noise import at_level, noisy
from experiments.maxim.plants import EXAMPLES, Plant, mode
from experiments.maxim.published import SETTINGS
from stepax import SOPDT


SEQUENCES, SAMPLES, LENGTH = 1000, 200, 1.25
DAMPINGS = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.5, 2.5)
DELAYS = (0.0, 1.0, 5.0)
NAMES = (
    "rdkam, K and Tp given", "rdkam", "fit", "fit, K known", "three points", "integrals",
    "integrals, instruments",
)  # fmt: skip


class Cell(NamedTuple):
    """One plant under one kind of noise; `damping` None where the plant is none of second order."""

    plant: Plant
    damping: float | None
    omega_n: float
    kind: str
    level: float
    length: float = LENGTH
    samples: int = SAMPLES
    listing: bool = False


def exact(zeta: float, delay: float) -> Plant:
    return Plant((mode(zeta, 1.0),), (), 1.0, delay, f"zeta {zeta:g}, delay {delay:g}")


def cells() -> list[Cell]:
    """All that is studied."""
    found = []
    for zeta in DAMPINGS:
        for delay in DELAYS:
            levels = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2) if delay == 1 else (0.01, 0.1)
            found += [Cell(exact(zeta, delay), zeta, 1.0, "white", level) for level in levels]
        middle = exact(zeta, 1.0)
        found += [Cell(middle, zeta, 1.0, "white", 0.05, length) for length in (1.0, 1.5)]
        found.append(Cell(middle, zeta, 1.0, "white", 0.05, LENGTH, 500))
    for number, plant in EXAMPLES.items():
        damping = 0.5 if number == 2 else None
        for kind, level in [(k, x) for k in ("white", "input") for x in (0.01, 0.05, 0.1)]:
            found.append(Cell(plant, damping, 10.0, kind, level, listing=level == 0.1))
        if number <= 3:
            found.append(Cell(plant, damping, 10.0, "both", np.nan, listing=True))
    return found


def records_of(cell: Cell, generator):
    plant = cell.plant
    t = np.linspace(0, plant.delay + cell.length * plant.settling_time(), cell.samples)
    clean = plant.response(t)
    if cell.kind == "both":
        setting = SETTINGS[int(plant.name[-1])]
        noise = noisy(generator, plant, t, SEQUENCES, setting.sigma_in, setting.sigma_out)
    else:
        noise = at_level(generator, cell.kind, plant, t, SEQUENCES, cell.level)
    return t, clean, clean + noise


def bound(cell: Cell, t) -> np.ndarray:
    """Cramer-Rao bound of the standard deviations of K, zeta, omega_n, delay under white noise."""
    assert cell.damping is not None

    def response(x):
        return SOPDT(gain=x[0], zeta=x[1], omega_n=x[2], delay=x[3]).step_response(jnp.asarray(t))

    plant = cell.plant
    at = jnp.array([plant.gain, cell.damping, cell.omega_n, plant.delay])
    slopes = np.asarray(jax.jacfwd(response)(at))
    if plant.delay == 0:  # at its bound
        return np.append(_deviations(slopes[:, :3], cell.level * plant.gain), np.nan)
    return _deviations(slopes, cell.level * plant.gain)


def _deviations(slopes, sigma):
    return sigma * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))


def _rows(cell: Cell, number: int) -> list[dict]:
    t, clean, y = records_of(cell, np.random.default_rng([15, number]))
    plant, rows = cell.plant, []
    swings = min(a / 2 / np.sqrt(b) if b else 1.0 for a, b in plant.factors) < 0.5
    slowest = min((b for a, b in plant.factors if b), default=0.0)
    period = None
    if swings:
        zeta = next(a / 2 / np.sqrt(b) for a, b in plant.factors if b == slowest)
        period = 2 * np.pi * np.sqrt(slowest) / np.sqrt(1 - zeta**2)
    limits = bound(cell, t) if cell.damping is not None and cell.kind == "white" else None
    for name in (*NAMES, *(["listing"] if cell.listing else [])):
        found = identified(name, t, y, clean, plant.gain, period)
        kept = np.isfinite(found.mse)
        values = found.parameters[kept]
        row = {
            "plant": plant.name, "zeta": cell.damping, "delay": plant.delay, "noise": cell.kind,
            "level": cell.level, "length": cell.length, "samples": cell.samples, "method": name,
            "refused": 1 - np.mean(kept), "edge": np.mean(found.edge[kept]) if kept.any() else 1,
            "wrong branch": np.mean(found.oscillatory[kept] != swings) if kept.any() else np.nan,
        }  # fmt: skip
        nmse = np.where(kept, found.mse, np.inf) / np.var(clean)
        shares = np.percentile(np.nan_to_num(nmse, posinf=1e9), (5, 50, 95))
        row |= dict(zip(("NMSE 5 %", "NMSE 50 %", "NMSE 95 %"), shares, strict=True))
        row |= _parameters(values, limits) if len(values) > 9 else {}
        rows.append(row)
    return rows


def _parameters(values, limits) -> dict:
    row = {}
    for k, name in enumerate(PARAMETERS):
        low, middle, high = np.percentile(values[:, k], (5, 50, 95))
        row |= {f"{name} mean": np.mean(values[:, k]), f"{name} std": np.std(values[:, k]),
                f"{name} 5 %": low, f"{name} 50 %": middle, f"{name} 95 %": high}  # fmt: skip
        if limits is not None:
            row[f"{name} std over bound"] = (high - low) / 3.29 / limits[k]
    if np.all(np.std(values[:, 1:], axis=0) > 0):
        between = np.corrcoef(values[:, 1:].T)
        row |= {"corr zeta omega_n": between[0, 1], "corr zeta delay": between[0, 2],
                "corr omega_n delay": between[1, 2]}  # fmt: skip
    return row


def run() -> Outcome:
    rows = [row for k, cell in enumerate(track(cells(), "cells")) for row in _rows(cell, k)]
    frame = pd.DataFrame(rows)
    return Outcome(frame, _draw(frame), _table(frame), _numbers(frame))


def _main(frame):
    """Exact plants of dead time 1 under white noise, records of the usual length."""
    usual = (frame.length == LENGTH) & (frame.samples == SAMPLES) & (frame.noise == "white")
    return frame[usual & frame.plant.str.endswith("delay 1") & frame.zeta.notna()]


def _table(frame) -> Table:
    part = _main(frame)
    part = part[part.level == 0.1]
    table = Table("method", *(f"{z:g}" for z in DAMPINGS),
                  title="10 % white noise: zeta, 5 to 95 %; median NMSE, %")  # fmt: skip
    for name in NAMES:
        cells = []
        for zeta in DAMPINGS:
            row = part[(part.method == name) & (part.zeta == zeta)].iloc[0]
            cells.append(
                f"{row['zeta 5 %']:.2f}..{row['zeta 95 %']:.2f}; {100 * row['NMSE 50 %']:.2g}"
            )
        table.add_row(name, *cells)
    return table


def _numbers(frame) -> dict[str, str]:
    part = _main(frame)
    numbers = {"cells, sequences each": f"{len(cells())}, {SEQUENCES}"}
    for level in (0.01, 0.1):
        rows = part[part.level == level]
        for name in ("rdkam", "rdkam, K and Tp given", "fit", "fit, K known"):
            mine = rows[rows.method == name]
            swing = mine[mine.zeta < 0.5]
            bias = (swing["zeta mean"] / swing.zeta - 1).abs().max()
            numbers[f"{name}, {100 * level:.0f} %: zeta std over bound, bias of zeta below 0.5"] = (
                f"median {mine['zeta std over bound'].median():.2f}, at most {100 * bias:.1f} %"
            )
    mine = part[part.method == "rdkam"]
    for level, rows in mine.groupby("level"):
        numbers[f"rdkam, {100 * level:g} %: wrong branch, damping at an end"] = (
            f"{100 * rows['wrong branch'].mean():.1f} %, {100 * rows.edge.mean():.1f} %"
        )
    return numbers


def _draw(frame):
    part, figure = _main(frame), new_figure((13, 8))
    panels = figure.subplots(2, 3)
    shown = ("rdkam", "fit", "fit, K known", "three points", "integrals, instruments")
    for name in shown:
        color, dashes = LOOKS[name]
        rows = part[part.method == name]
        for axes, zeta in zip(panels[0], (0.2, 0.7, 1.5), strict=True):
            at = rows[rows.zeta == zeta].sort_values("level")
            axes.plot(100 * at.level, at["zeta 50 %"], color=color, linestyle=dashes, label=name)
            if name in ("rdkam", "fit"):
                axes.fill_between(
                    100 * at.level, at["zeta 5 %"], at["zeta 95 %"], color=color, alpha=0.13
                )
            axes.set(xscale="log", title=f"zeta = {zeta}: median, and 5 to 95 %", xlabel="noise, %")
            axes.set_ylim(0.3 * zeta, 2.2 * zeta)
        for axes, what, label in zip(
            panels[1], ("NMSE 50 %", "zeta std over bound", "edge"),
            ("median NMSE", "spread of zeta over Cramer-Rao", "share of dampings at an end"),
            strict=True,
        ):  # fmt: skip
            at = rows[rows.level == 0.1].sort_values("zeta")
            axes.plot(at.zeta, at[what], color=color, linestyle=dashes)
            axes.set(xscale="log", xlabel="zeta", title=f"10 % noise: {label}")
            if what != "edge":
                axes.set_yscale("log")
    quiet(panels.flat)
    legend_below(figure, panels[0, 0], 5)
    return figure
