r"""How residuals hang together; host code."""

from typing import NamedTuple

import numpy as np


MOST_LAGS = 40
"""Lags that are shown; a record of fewer than four times as many rows shows a quarter of them."""


class Autocorrelation(NamedTuple):
    """Autocorrelation of residuals from lag 1 on, in rows, and the bound that white ones keep.

    `bound` holds for each lag in 95 % of records with independent residuals.
    """

    lags: np.ndarray
    values: np.ndarray
    bound: float

    @property
    def outside(self) -> int:
        """How many lags lie beyond the bound."""
        return int(np.sum(np.abs(self.values) > self.bound))


def autocorrelation(residuals: np.ndarray) -> Autocorrelation:
    r"""$r_k = \sum_i e_i e_{i+k} / \sum_i e_i^2$ of residuals less their mean (Box, Jenkins 1970).

    Each $r_k$ of N independent residuals has a standard deviation of about $1/\sqrt N$ (Bartlett
    1946): the bound is 1.96 times that. Lags count rows, also where these are not equally spaced;
    residuals that are all equal have none (0).
    """
    e = np.asarray(residuals, float)
    e = e - e.mean()
    square = float(e @ e)
    lags = np.arange(1, max(1, min(MOST_LAGS, e.size // 4)) + 1)
    values = np.array([float(e[k:] @ e[:-k]) for k in lags])
    values = values / square if square > 0 else np.zeros(lags.size)
    return Autocorrelation(lags, values, 1.96 / e.size**0.5)
