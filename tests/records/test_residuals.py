"""Autocorrelation of residuals against its definition and known processes."""

import numpy as np

from stepax.records._residuals import MOST_LAGS, autocorrelation


def test_definition():
    e = np.random.default_rng(3).normal(size=300) + 5
    found = autocorrelation(e)
    full = np.correlate(e - e.mean(), e - e.mean(), "full")
    expected = full[e.size :][:MOST_LAGS] / full[e.size - 1]
    np.testing.assert_allclose(found.values, expected, atol=1e-12)
    assert list(found.lags) == list(range(1, MOST_LAGS + 1))


def test_white_residuals_keep_to_the_bound():
    rng = np.random.default_rng(4)
    outside = [autocorrelation(rng.normal(size=400)).outside for _ in range(200)]
    share = np.mean(outside) / MOST_LAGS
    assert 0.03 < share < 0.06  # 5 % a lag, a little less for a finite record


def test_residuals_with_a_memory():
    rng = np.random.default_rng(5)
    e = np.zeros(20_000)
    for i, kick in enumerate(rng.normal(size=e.size - 1), 1):
        e[i] = 0.8 * e[i - 1] + kick
    np.testing.assert_allclose(autocorrelation(e).values[:5], 0.8 ** np.arange(1, 6), atol=0.03)


def test_short_and_level_residuals():
    assert autocorrelation(np.ones(9)).values.tolist() == [0.0, 0.0]
    assert autocorrelation(np.arange(3.0)).lags.tolist() == [1]
