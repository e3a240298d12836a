"""Which rows before a step count as rest, and whether the output still moves."""

import numpy as np
import pytest

from stepax.records._rest import rest_before


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_white_noise_and_a_swing_around_one_level_are_rest(noise):
    t, random = np.arange(400.0), np.random.default_rng(1)
    clean = np.where(t < 100, 0, 1 - np.exp(-(t - 100) / 40))
    for k in range(100):
        rest = rest_before(t, clean + noise * random.standard_normal(400), 100.0)
        assert rest == (0, 0.0), k
    assert rest_before(t, clean + 0.1 * np.sin(t), 100.0).unrest == 0


@pytest.mark.parametrize("lag", [5.0, 10.0, 20.0, 40.0])
def test_a_warm_up_is_left_out(lag):
    """What is left of it in the rows that count is less than a hundredth of the response."""
    t = np.arange(400.0)
    warm = -2 * np.exp(-t / lag)
    y = np.where(t < 200, 0, 1 - np.exp(-(t - 200) / 40)) + warm
    y = y + 0.01 * np.random.default_rng(2).standard_normal(400)
    unrest = rest_before(t, y, 200.0).unrest
    left = abs(warm[unrest:200].mean() - warm[199])
    assert lag < unrest < 200 and left < 0.01


def test_a_drift_is_told():
    t = np.arange(400.0)
    for slope in (0.002, -0.002):
        y = np.where(t < 200, 0, 1 - np.exp(-(t - 200) / 40)) + slope * (t - 200)
        np.testing.assert_allclose(rest_before(t, y, 200.0).drift, slope, rtol=1e-6)
