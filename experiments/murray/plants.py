"""The plants of the studies: random chains, and the one of figures 10 and 12."""

import numpy as np

from experiments.numpy_responses import chain_response
from stepax import MAX_ORDER


PT4_LAGS = np.array([1, 1.2, 1.5, 2])
"""Hudzovic's chain with T = 1, r = 1/6, n = 4. (The paper says r = 0.5: half of the range.)"""

SAMPLES = 253
"""Samples of every record: those of the author's response of that chain."""


def padded(lags):
    """Lags as a row of the longest order; a lag of 0 is no lag."""
    lags = np.asarray(lags)
    return np.pad(lags, [(0, 0)] * (lags.ndim - 1) + [(0, MAX_ORDER - lags.shape[-1])])


def random_lags(generator, count, order):
    """Lags uniform in [1, 9] (Murray 2016, eq. 4.1 as the code has it), padded."""
    return padded(generator.uniform(1, 9, (count, order)))


def settling_time(lags, rest=1e-3):
    """Time at which the response of a chain, or of each of a batch, is 1 - `rest`."""
    low, high = np.zeros(lags.shape[:-1]), 20 * np.sum(lags, axis=-1)
    for _ in range(60):
        middle = (low + high) / 2
        above = chain_response(middle[..., None], lags)[..., 0] > 1 - rest
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return high


def record_times(lags):
    """Equispaced times from 0 to 99.9 % of the change, one row for each plant."""
    return np.linspace(0, 1, SAMPLES) * settling_time(lags)[..., None]
