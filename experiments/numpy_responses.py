"""Step responses of chains of lags in NumPy, for code that is not compiled."""

import numpy as np

from stepax import Hudzovic
from stepax.models._contour import _PAIRS_10


POLES, WEIGHTS = np.array(_PAIRS_10).T


def chain_lags(family, T, r, n):
    """Lags of a chain of order n: T/(1 - k r) for `Hudzovic`, T r^k for `Sani`."""
    k = np.arange(n)
    return T / (1 - k * r) if family is Hudzovic else T * r**k


def chain_response(t, lags):
    """Contour quadrature, as in `stepax`: lags (..., n) >= 0, t (..., samples); 0 is no lag."""
    largest = np.max(lags, axis=-1)[..., None]
    x = 1 / np.maximum(t, 1e-12 * largest)
    poles, weights = (a.reshape(-1, *[1] * x.ndim) for a in (POLES, WEIGHTS))
    product = np.ones((len(POLES), *x.shape), complex)
    for k in range(lags.shape[-1]):
        product *= 1 + poles * (x * lags[..., k, None])
    return np.where(t > 0, np.sum((weights / product).real, axis=0), 0)


def hudzovic_response(t, T, r, n):
    """Closed form for equally spaced rates, as in `stepax`: 0 <= r < 1/(n-1)."""
    d, m = max(r, 1e-9), 1 - (n - 1) * r
    e = -np.expm1(-d * t / T) / d
    total = np.ones_like(t)
    for j in range(n - 1, 0, -1):
        total = 1 + (m + (j - 1) * d) / j * e * total
    return 1 - np.exp(-m * t / T) * total
