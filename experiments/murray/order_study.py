"""Random plants of every order on every method: the study behind figures 8 and 9."""

import functools

import numpy as np
import pandas as pd

from experiments.murray import correct, legacy
from experiments.murray.drawing import rms
from experiments.murray.plants import random_lags, record_times
from experiments.murray.runner import Frame, Settings


ORDERS = range(2, 9)
RESULTS = ["plant", "method", "rmse", "status", "n", "T", "r"]


def plants_per_order(settings: Settings) -> int:
    return settings.size(200, 20)


@functools.cache
def order_study(settings: Settings) -> Frame:
    """Rows (protocol, order, plant, method, rmse, status, n, T, r); the same plants in both.

    Correct: records from 0 to 99.9 % of the change, 253 samples, at least 10 of them before the
    inflection; exact curves, known levels. Legacy: the records and the code of the author.
    """
    return study(settings, "orders")


def study(settings: Settings, name: str, noise: float = 0.0, fits: bool = True) -> Frame:
    """The same with uniform noise, peak to peak `noise`; `fits` of the legacy code."""
    generator, count = settings.generator(name), plants_per_order(settings)
    lags = np.concatenate([random_lags(generator, count, n) for n in ORDERS])
    order = np.repeat(ORDERS, count)
    t = record_times(lags)
    added = noise * (generator.random(t.shape) - 0.5)
    found = correct.errors(lags, t, added if noise else None)
    rows = []
    for plant, row in enumerate(lags):
        t_old, clean = legacy.simulated(row)
        added = noise * (generator.random(t_old.shape) - 0.5)
        rows += [
            (plant, *result)
            for result in legacy.errors(t_old, clean, added if noise else None, fits)
        ]
    old = pd.DataFrame(rows, columns=RESULTS)
    frame = pd.concat([old.assign(protocol="legacy"), found.assign(protocol="correct")])
    frame["order"] = order[frame.plant]
    return frame[["protocol", "order", *RESULTS]]


def rms_by_order(frame: Frame) -> Frame:
    """RMS over the plants of the RMSE: one row per protocol and method, one column per order.

    The legacy code's default values count with their error, as they did in the paper; refusals do
    not, and are counted apart.
    """
    return frame.dropna().groupby(["protocol", "method", "order"]).rmse.agg(rms).unstack("order")
