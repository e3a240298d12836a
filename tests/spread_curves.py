"""Curves of Hudzovic's and Sani's plants in batches, which the tests of curves and lookup share."""

import functools

import jax
import numpy as np
import pytest
from scipy import special

from stepax import Hudzovic, Sani, lookup_curves


ORDERS = np.arange(2, 9)


FAMILIES = [Hudzovic, Sani]


BATCH = 256
"""Lanes of every batch, so that each function is compiled once."""


families = pytest.mark.parametrize("model", FAMILIES)


# Murray 2016, recomputed independently: reference/murray_notes.md section 1.2 (6 decimals).
EQUAL_LAGS = np.array(
    [  # max Tu/Tg, 1/Tg, min lam, 1/t50
        (0.103638, 0.367879, 2.000724, 0.595824),
        (0.218018, 0.270671, 1.578220, 0.373963),
        (0.319357, 0.224042, 1.344208, 0.272327),
        (0.410304, 0.195367, 1.190560, 0.214091),
        (0.493298, 0.175467, 1.079824, 0.176362),
        (0.570042, 0.160623, 0.995152, 0.149933),
        (0.641733, 0.149003, 0.927704, 0.130391),
    ]
)


def batched(function, *columns):
    """A batch function on columns of any length, BATCH rows at a time (the last row repeated)."""
    columns = [np.asarray(x) for x in columns]
    count = len(columns[0])
    parts = []
    for start in range(0, count, BATCH):
        rows = np.minimum(np.arange(start, start + BATCH), count - 1)
        parts.append(function(*(x[rows] for x in columns)))
    return jax.tree.map(lambda *x: np.concatenate(x)[:count], *parts)


@functools.cache
def compiled_curves(model):
    return jax.jit(lambda n, r: lookup_curves(model, n, r))


def curves(model, n, r):
    """The four curves, as the columns of a table."""
    return np.stack(batched(compiled_curves(model), n, r), axis=1)


def equal_lag_ends(kind):
    """Closed forms: the gamma distribution."""
    if kind == "tu_tg":
        x = ORDERS - 1
        slope = np.exp(x * np.log(x) - x - special.gammaln(ORDERS))
        return x * slope - special.gammainc(ORDERS, x)
    t10, t50, t90 = (special.gammaincinv(ORDERS, p) for p in (0.1, 0.5, 0.9))
    return (t90 - t10) / t50


def grid(model, shares):
    """Every order with every share of the range of r."""
    n, share = (x.ravel() for x in np.meshgrid(ORDERS, shares, indexing="ij"))
    return n, share if model is Sani else share / (n - 1)
