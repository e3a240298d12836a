"""Bias and spread of every point method under noise, with the old and the new rule of crossing.

The old rule took the middle of the first and the last upward crossing of a level.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from rich.table import Table

from experiments.drawing import new_figure, quiet
from experiments.jakoubek.outcome import Outcome
from stepax import FOPDT, METHODS, PTn, StepRecord, over_devices, refused
from stepax.methods import ROWS
from stepax.records import _characterise


LEVELS = (0.0, 0.01, 0.05, 0.1)
SEQUENCES, SAMPLES, END = 400, 250, 8.0
CHUNK = 25
NAMES = [name for name, row in ROWS.items() if row.levels and not row.has_tangent]


def plants():
    """For each group of methods a plant that it fits."""
    return {
        "first": FOPDT(T=0.5, delay=0.25),
        "second": PTn(lags=jnp.array([0.7, 0.3])),
        "nth": PTn(lags=jnp.array([0.6, 0.3, 0.2])),
    }


def middle_of_crossings(t, y, level, count):
    """The rule that was."""
    rows = jnp.arange(y.shape[0] - 1)
    upward = (y[:-1] < level) & (y[1:] >= level) & (rows < jnp.argmax(y))
    first = jnp.argmax(upward)
    last = y.shape[0] - 2 - jnp.argmax(upward[::-1])
    times = jax.vmap(lambda row: _characterise._interpolate(t, y, row, level, count))(
        jnp.stack([first, last])
    )
    return jnp.where(jnp.any(upward), jnp.mean(times), jnp.nan)


@functools.cache
def compiled(names, rule):
    def one(case):
        t, y, clean = case
        record, found = StepRecord(t, y, initial=0.0, final=1.0), []
        for name in names:
            result = METHODS[name](record)
            error = jnp.sqrt(jnp.mean((result.model.step_response(t) - clean) ** 2))
            half = [x for key, x in result.details.items() if key.startswith("t")][-1]
            lost = refused(result.status)
            found.append(jnp.stack([half, jnp.where(lost, jnp.nan, error)]))
        return jnp.stack(found)

    def chunked(*rows):
        parts = [x.reshape(-1, CHUNK, *x.shape[1:]) for x in rows]
        found = jax.lax.map(jax.vmap(one), tuple(parts))
        return found.reshape(-1, *found.shape[2:])

    return over_devices(chunked)


def run() -> Outcome:
    rows = []
    t = np.linspace(0, END, SAMPLES)
    noise = np.random.default_rng(5).standard_normal((SEQUENCES, SAMPLES))
    new = _characterise.crossing
    for rule, crossing in (("before", middle_of_crossings), ("now", new)):
        _characterise.crossing = crossing
        jax.clear_caches()
        try:
            for group, plant in plants().items():
                names = tuple(name for name in NAMES if ROWS[name].group == group)
                clean = np.asarray(plant.step_response(jnp.asarray(t)))
                wide = lambda x: np.broadcast_to(x, noise.shape)  # noqa: E731
                for level in LEVELS:
                    y = clean + level * noise
                    found = np.asarray(compiled(names, rule)(wide(t), y, wide(clean)))
                    for k, name in enumerate(names):
                        rows.append(_row(rule, name, level, *found[:, k].T))
        finally:
            _characterise.crossing = new
    frame = pd.DataFrame(rows)
    clean = {
        (row["rule"], row["method"]): row["late level, mean"] for row in rows if row["noise"] == 0
    }
    frame.insert(3, "bias", [
        row["late level, mean"] - clean[row["rule"], row["method"]] for row in rows
    ])  # fmt: skip
    return Outcome(frame, _draw(frame), _table(frame))


def _row(rule, name, level, late, error):
    return {
        "rule": rule, "method": name, "noise": level, "late level, mean": np.nanmean(late),
        "spread": np.nanstd(late), "median RMSE": np.median(np.nan_to_num(error, nan=np.inf)),
        "refused %": 100 * np.mean(np.isnan(error)),
    }  # fmt: skip


def _table(frame) -> Table:
    table = Table(title="Latest level of each method: bias +- spread; median RMSE; refused, %")
    for head in (
        "method",
        *(f"{100 * x:.0f} % {r}" for x in LEVELS[1:] for r in ("before", "now")),
    ):
        table.add_column(head)
    for name in NAMES:
        cells = []
        for level in LEVELS[1:]:
            for rule in ("before", "now"):
                chosen = (frame.method == name) & (frame.noise == level) & (frame.rule == rule)
                row = frame[chosen].iloc[0]
                cells.append(f"{row.bias:+.3f}+-{row.spread:.3f}; {row['median RMSE']:.3f};"
                             f" {row['refused %']:.0f}")  # fmt: skip
        table.add_row(name, *cells)
    return table


def _draw(frame):
    figure = new_figure((11, 7))
    panels = figure.subplots(2, 2, sharey="col")
    for (left, right), rule in zip(panels, ("before", "now"), strict=True):
        part = frame[frame.rule == rule]
        for name in NAMES:
            row = part[part.method == name]
            left.plot(100 * row.noise, row.bias, color="#1f5fa8", alpha=0.6)
            right.plot(100 * row.noise, row["median RMSE"], color="#d2560a", alpha=0.6)
        left.set(title=f"{rule}: bias of the latest level", xlabel="noise, %")
        right.set(title=f"{rule}: median RMSE of the model", xlabel="noise, %", ylim=(0, 0.12))
    quiet(panels.flat)
    return figure
