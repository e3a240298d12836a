"""Every method of the package on many records at once: the computation without the errors."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from experiments.murray.runner import Frame
from stepax import METHODS, PTn, Status, StepRecord, over_devices, smooth


FITS = ("hudzovic_fit", "sani_fit")
LOOKUPS = (
    "hudzovic_tu_tg", "hudzovic_t10_t50_t90", "sani_tu_tg", "sani_interpolation",
    "sani_t10_t50_t90",
)  # fmt: skip
SPAN = 0.2
"""Share of a noisy record that LOESS smooths over before a lookup."""
PER_CORE = 256
"""Records of one compiled call on each core."""


def _results(t, clean, smoothed, raw):
    """RMSE, status, order, T and r of every method on one record of gain 1 and no delay.

    Levels 0 and 1 are known. Lookups have the smoothed output, which is what their `span` does;
    fits have the raw one, and T, r and the order free. RMSE is the distance from the clean output.
    """
    rows = []
    for name in (*LOOKUPS, *FITS):
        if name in FITS:
            record = StepRecord(t, raw, initial=0.0, final=1.0)
            result = METHODS[name](record, fixed=("delay",), errors=False)
        else:
            result = METHODS[name](StepRecord(t, smoothed, initial=0.0, final=1.0))
        model = result.model
        error = jnp.sqrt(jnp.mean((model.step_response(t) - clean) ** 2))
        rows.append(jnp.stack([error, result.status._value, model.n, model.T, model.r]))
    return jnp.stack(rows)


@functools.cache
def _compiled(function):
    """`function` of one record, over batches of them on all cores."""
    return over_devices(
        lambda *records: jax.lax.map(lambda a: function(*a), records, batch_size=32)
    )


def _response(t, lags):
    return PTn(lags=lags).step_response(t)


def _smooth(t, y):
    return smooth(t, y, SPAN)


def errors(lags, t, noise=None) -> Frame:
    """Rows (plant, method, rmse, status, n, T, r) of plants (count, 8) at times (count, samples).

    With noise, which is added to the response, lookups smooth with LOESS over `SPAN`.
    """
    count, size = len(t), PER_CORE * jax.device_count()
    found = []
    for start in range(0, count, size):
        rows = np.arange(start, start + size) % count
        clean = raw = smoothed = _compiled(_response)(t[rows], lags[rows])
        if noise is not None:
            raw = clean + noise[rows]
            smoothed = _compiled(_smooth)(t[rows], raw)
        found.append(np.asarray(_compiled(_results)(t[rows], clean, smoothed, raw)))
    table = np.concatenate(found)[:count].reshape(-1, 5)
    names = np.array(list(Status._name_to_item))
    methods = (*LOOKUPS, *FITS)
    return pd.DataFrame(
        {
            "plant": np.repeat(np.arange(count), len(methods)),
            "method": np.tile(methods, count),
            "rmse": table[:, 0],
            "status": names[table[:, 1].astype(int)],
            "n": table[:, 2].astype(int),
            "T": table[:, 3],
            "r": table[:, 4],
        }
    )


def lost(frame: Frame) -> Frame:
    """Which rows hold no result of the method: refusals, and default values of the old code."""
    return frame.rmse.isna() | (frame.status == "fallback")
