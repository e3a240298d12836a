"""The seven classical methods per second: `python -m experiments.benchmarks.points [--json OUT]`.

100 000 records of random plants (one to five lags and a dead time; 250 samples over six times
their sum; white noise of 1 % of the change; levels known) go through all seven methods in one
compiled batch. Engines, in one run: (a) stepax, an equal share of the records on each core; (b)
the same formulas in NumPy, one record after the other, on the first 2 000: crossings by the
cubic through four samples, charts and tables computed once beforehand and interpolated in 20 001
points, LOESS of a tenth of the record before Strejc's tangent in both. (b) uses one core, as
Python loops do. Medians of several runs; compilation and drawing the records are left out.

`agree` is the share of records of (b) on which both engines refuse, or give the same parameters
to 1e-6. `with errors` has (a) also compute RMSE and J of every model, as `compare` needs them.
"""

import argparse
import json
import os
import platform
import time
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import special

from experiments.benchmarks.fit import chunked, seconds
from stepax import METHODS, PTn, StepRecord, over_devices, refused


SAMPLES, NOISE, CHUNK = 250, 0.01, 64
RECORDS, LOOPED, REPETITIONS = 100_000, 2_000, 3
SPAN, AGREEMENT = 0.1, 1e-6
SEVEN = (
    "viteckova_1", "viteckova_2", "latzel", "harriott", "smith", "strejc",
    "sundaresan_krishnaswamy",
)  # fmt: skip


def draw(key):
    """One record: times and noisy response, from 0 to 1."""
    keys = jax.random.split(key, 4)
    order = jax.random.randint(keys[0], (), 1, 6)
    lags = jax.random.uniform(keys[1], (5,), minval=1, maxval=9)
    lags = jnp.where(jnp.arange(5) < order, lags, 0)
    total = jnp.sum(lags)
    delay = total * jax.random.uniform(keys[2], maxval=0.3)
    t = jnp.linspace(0, 1, SAMPLES) * (6 * total + delay)
    y = PTn(lags=lags, delay=delay).step_response(t)
    return t, y + NOISE * jax.random.normal(keys[3], t.shape)


# stepax


def by_stepax(t, y, errors=False):
    """(a): for each method its parameters, filled up to four numbers; NaN where it refuses."""
    record = StepRecord(t, y, initial=0.0, final=1.0)
    rows, quality, lost = [], [], []
    for name in SEVEN:
        result = METHODS[name](record, **({"span": SPAN} if name == "strejc" else {}))
        model: Any = result.model
        own = [model.T] if name not in ("harriott", "smith", "strejc") else []
        if name == "latzel":
            own.append(model.n)
        if name == "strejc":
            own = [model.lags[0], jnp.sum(model.lags)]
        elif not own:
            own = [model.lags[0], model.lags[1]]
        own += [model.delay] + [jnp.zeros_like(model.delay)] * (3 - len(own))
        rows.append(jnp.stack(own))
        quality.append(jnp.stack([result.rmse, result.J]))
        lost.append(refused(result.status))
    return (jnp.stack(rows), jnp.stack(lost), *([jnp.stack(quality)] if errors else []))


# NumPy


def cubic(t, y, row):
    """The cubic around an interval in Newton's form, as a function of numbers."""
    start = min(max(row - 1, 0), len(t) - 4)
    x = [float(v) for v in t[start : start + 4]]
    c = [float(v) for v in y[start : start + 4]]
    for level in range(1, 4):
        for i in range(3, level - 1, -1):
            c[i] = (c[i] - c[i - 1]) / (x[i] - x[i - level])
    a, b, d, e = c
    p, q, r = x[:3]
    return lambda z: a + (z - p) * (b + (z - q) * (d + (z - r) * e))


def crossing(t, y, level):
    """Upward crossing on the way to the largest value up to which the sum of y - level is least."""
    upward = np.flatnonzero((y[:-1] < level) & (y[1:] >= level))
    upward = upward[upward < np.argmax(y)]
    if len(upward) == 0:
        return np.nan
    row = upward[np.argmin(np.cumsum(y - level)[upward])]
    f, low, high = cubic(t, y, row), float(t[row]), float(t[row + 1])
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if f(middle) < level else (low, middle)
    return 0.5 * (low + high)


def reading(t, y, time):
    row = min(max(int(np.searchsorted(t, time, side="right")) - 1, 0), len(t) - 2)
    return cubic(t, y, row)(time) if time > 0 else 0.0


def loess(t, y, span):
    """Local quadratic regression with tricube weights."""
    count = int(np.ceil(span * len(t)))
    starts = np.searchsorted(t[:-count] + t[count:], 2 * t)
    index = starts[:, None] + np.arange(count)
    x = t[index] - t[:, None]
    x /= np.max(np.abs(x), axis=1, keepdims=True)
    weight = (1 - np.abs(x) ** 3) ** 3
    basis = np.stack([np.ones_like(x), x, x * x], axis=-1)
    weighted = basis * weight[..., None]
    normal = np.einsum("nki,nkj->nij", weighted, basis)
    right = np.einsum("nki,nk->ni", weighted, y[index])
    return np.linalg.solve(normal, right[..., None])[:, 0, 0]


def tangent(t, y):
    """Tu and Tn at the inflection of the quartic through five samples with the largest slope."""
    starts = np.clip(np.arange(len(t)) - 2, 0, len(t) - 5)
    x, v = t[starts[:, None] + np.arange(5)], y[starts[:, None] + np.arange(5)]
    slopes = np.zeros(len(t))
    for i in range(5):
        others = [j for j in range(5) if j != i]
        scale = np.prod([x[:, i] - x[:, j] for j in others], axis=0)
        for left in others:
            kept = [j for j in others if j != left]
            slopes += v[:, i] * np.prod([t - x[:, j] for j in kept], axis=0) / scale
    row = int(np.argmax(slopes))
    h = t[1] - t[0]
    c = np.polyfit((x[row] - t[row]) / h, v[row], 4)
    reach, z = 0.5 * (x[row, 4] - x[row, 0]) / h, 0.0
    first = (x[row, 0] - t[row]) / h
    for _ in range(4):
        value, change = np.polyval(np.polyder(c, 2), z), np.polyval(np.polyder(c, 3), z)
        z = np.clip(z - (value / change if change < 0 else 0.0), max(-reach, first), reach)
    slope = np.polyval(np.polyder(c), z) / h
    at, height = t[row] + z * h, np.polyval(c, z)
    return (at - height / slope, 1 / slope) if slope > 0 else (np.nan, np.nan)


def two_lag_response(x, shape):
    """Two lags of sum 1, of a shape ((T1 - T2)/(T1 + T2))^2."""
    q = np.sqrt(shape)
    v = x * 4 * q / np.maximum(1 - shape, 1e-16)
    small = np.where(v > 0, -np.expm1(-v) / np.where(v > 0, v, 1), 1)
    return 1 - np.exp(-2 * x / (1 + q)) * (1 + 2 * x / (1 + q) * small)


class Charts:
    """Curves of Harriott, Strejc and Smith, and the tables, computed once."""

    def __init__(self, points=20_001):
        self.shape = np.linspace(0, 1, points)
        self.half = two_lag_response(0.5, self.shape)
        self.early = two_lag_response(0.3574, self.shape)
        t20, self.t60 = (self.times(q) for q in (0.2, 0.6))
        self.ratio = t20 / self.t60
        n = np.array([2, 2.5, *range(3, 21)])
        quantiles = special.gammaincinv(n[:, None], [0.1, 0.5, 0.9])
        self.latzel = n, (quantiles[:, 0] / quantiles[:, 2]).round(3), (1 / quantiles).round(3)
        n = np.arange(2.0, 11)
        height = special.gammainc(n, n - 1)
        slope = np.exp(n * np.log(n - 1) - (n - 1) - special.gammaln(n))
        self.strejc = n, (slope - height).round(3), height.round(3)

    def times(self, level):
        low, high = np.zeros_like(self.shape), np.full_like(self.shape, 20.0)
        for _ in range(60):
            middle = 0.5 * (low + high)
            below = two_lag_response(middle, self.shape) < level
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return 0.5 * (low + high)


def two_lags(total, shape):
    root = np.sqrt(shape)
    return 0.5 * total * (1 + root), 0.5 * total * (1 - root)


def by_numpy(t, y, charts):
    """(b): one record, rows as in (a)."""
    rows = np.full((7, 4), np.nan)
    t10, t20, t33, t35, t50, t60, t70, t73, t85, t90 = (
        crossing(t, y, q) for q in (0.1, 0.2, 0.33, 0.353, 0.5, 0.6, 0.7, 0.73, 0.853, 0.9)
    )
    rows[0, :2] = 1.245 * (t70 - t33), max(1.498 * t33 - 0.498 * t70, 0)
    late = max(1.937 * t33 - 0.937 * t70, 0)
    rows[1, :2] = 0.794 * (t70 - t33), late
    n, mu, weights = charts.latzel
    place = np.argmin(np.abs(mu - t10 / t90))
    rows[2, :3] = weights[place] @ [t10, t50, t90] / 3, n[place], 0
    total = (t73 - late) / 1.3
    height = reading(t, y, late + 0.5 * total)
    if 0.25 <= height <= 0.41:
        rows[3, :3] = *two_lags(total, np.interp(height, charts.half, charts.shape)), late
    ratio, first, last = t20 / t60, charts.ratio[-1], charts.ratio[0]
    if first * (1 - 2e-3) <= ratio <= last * (1 + 2e-3):
        shape = np.interp(-ratio, -charts.ratio, charts.shape)
        total = t60 / np.interp(shape, charts.shape, charts.t60)
        rows[4, :3] = *two_lags(total, shape), 0
    rows[5, :3] = *strejc_numpy(t, loess(t, y, SPAN), charts), 0
    rows[6, :2] = 0.67 * (t85 - t35), max(1.3 * t35 - 0.29 * t85, 0)
    return np.where(np.isnan(rows[:, :1]), np.nan, np.nan_to_num(rows))


def strejc_numpy(t, y, charts):
    """Largest lag and sum of the lags."""
    n, ratio, heights = charts.strejc
    Tu, Tn = tangent(t, y)
    if not np.isfinite(Tn):
        return np.nan, np.nan
    if Tu / Tn < ratio[0]:
        total = crossing(t, y, 0.72) / 1.2564
        height = reading(t, y, 0.3574 * total)
        if not 0.155 <= height <= 0.310:
            return np.nan, np.nan
        return two_lags(total, np.interp(height, charts.early, charts.shape))[0], total
    place = np.argmin(np.abs(ratio - Tu / Tn))
    T = crossing(t, y, heights[place]) / (n[place] - 1)
    return T, n[place] * T


# measuring


def agreement(ours, lost, theirs):
    """Share of records, for each method, on which both refuse or give the same."""
    ours = np.where(lost[..., None], np.nan, ours)
    same = np.all(np.isclose(ours, theirs, rtol=AGREEMENT, atol=1e-9, equal_nan=True), axis=-1)
    return np.mean(same, axis=0)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # comparisons with NaN in the loop
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)
    machine = f"{jax.devices()[0].device_kind}, {os.cpu_count()} {platform.machine()} cores"
    machine += f", float64, jax {jax.__version__}, load {os.getloadavg()[0]:.1f}"

    keys = jax.random.split(jax.random.key(1), RECORDS)
    records = over_devices(chunked(draw, CHUNK))(keys)
    host = [np.asarray(x[:LOOPED]) for x in records]
    duration, (found, lost) = seconds(over_devices(chunked(by_stepax, CHUNK)), records)
    errors = over_devices(chunked(lambda t, y: by_stepax(t, y, True), CHUNK))
    longer = seconds(errors, records)[0]
    charts, loop, rows = Charts(), [], np.zeros(0)
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        rows = np.array([by_numpy(t, y, charts) for t, y in zip(*host, strict=True)])
        loop.append(time.perf_counter() - start)
    rates = {
        "a  stepax, seven methods": RECORDS / duration,
        "a  with errors": RECORDS / longer,
        "b  NumPy, one by one": LOOPED / float(np.median(loop)),
    }
    lost = np.asarray(lost)
    agree = agreement(np.asarray(found[:LOOPED]), lost[:LOOPED], rows)
    methods = [
        {"method": name, "refused": float(x), "agree": float(y)}
        for name, x, y in zip(SEVEN, np.mean(lost, axis=0), agree, strict=True)
    ]

    sheet = Table("engine", "records/s", "times (b)", title=machine)
    for name, rate in rates.items():
        sheet.add_row(name, f"{rate:.4g}", f"{rate / rates['b  NumPy, one by one']:.3g}")
    Console(width=100).print(sheet)
    sheet = Table("method", "refused", "agree")
    for row in methods:
        sheet.add_row(row["method"], f"{row['refused']:.2%}", f"{row['agree']:.2%}")
    Console(width=100).print(sheet)
    if options.json:
        table = {"machine": machine, "records": RECORDS, "records/s": rates, "methods": methods}
        options.json.write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main()
