"""The optimum between samples: against SciPy in each interval, and in a batch of many groups."""

import itertools

import jax
import numpy as np
import pytest
from scipy.optimize import least_squares

from stepax import FOPDT, StepRecord, identify, refine
from stepax.fitting._certainty import SAMPLES_AT_ONCE


T = np.linspace(0.0, 30.0, 61)
COUNT = 700
assert COUNT > 2 * SAMPLES_AT_ONCE // T.size  # standard errors in several groups


def records() -> np.ndarray:
    """Two lags and a dead time with 3 % noise, a row a record: no first-order plant."""
    draw = np.random.default_rng(0)
    slow = draw.uniform(2, 6, (COUNT, 1))
    fast, delay = slow * draw.uniform(0.05, 0.6, (COUNT, 1)), draw.uniform(0.5, 4, (COUNT, 1))
    x = np.maximum(T - delay, 0)
    g = 1 - (slow * np.exp(-x / slow) - fast * np.exp(-x / fast)) / (slow - fast)
    return 1 + 2 * g + 0.06 * draw.standard_normal(g.shape)


def fitted(y):
    """What is compared."""
    result = identify(StepRecord(T, y), "fopdt_fit")
    return result.rmse, result.covariance, result.details["steps"], result.status._value


@pytest.fixture(scope="module")
def batch():
    y = records()
    return y, [np.asarray(x) for x in jax.jit(jax.vmap(fitted))(y)]


def best_of_all_intervals(y: np.ndarray) -> float:
    """Least RMSE over the dead time in each interval between samples up to 8, by SciPy."""

    def residual(x):
        T1, delay = np.exp(x[0]), x[1]
        g = -np.expm1(-np.maximum(T - delay, 0) / T1)
        columns = np.stack([np.ones_like(g), g]).T
        return y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]

    costs = []
    for left, right in itertools.pairwise(T[:17]):
        ends = [-3, left], [4, right]
        found = least_squares(residual, [1.2, (left + right) / 2], bounds=ends, xtol=1e-12)
        costs.append(np.sqrt(np.mean(found.fun**2)))
    return min(costs)


def test_no_interval_between_samples_has_a_better_one(batch):
    """Most are given up after one look."""
    y, (rmse, *_) = batch
    for i in range(8):
        assert rmse[i] <= best_of_all_intervals(y[i]) * (1 + 1e-6)


def test_a_batch_in_groups_is_one_by_one(batch):
    y, found = batch
    one = jax.jit(fitted)
    for i in (0, 1, 267, 268, 350, COUNT - 1):
        for ours, expected in zip(found, one(y[i]), strict=True):
            np.testing.assert_allclose(ours[i], expected, rtol=1e-8, atol=1e-12)


def test_nothing_to_find_in_a_batch_in_groups_and_derived():
    """Neither coordinates nor, with known levels, anything: arrays without elements."""
    y = records()[:300]

    def found(y, **levels):
        record = StepRecord(T, y, **levels)
        result = refine(record, FOPDT(T=4.0, delay=1.2), fixed=("T", "delay"))
        return result.model.gain, result.std["gain"], result.rmse

    gain, _, _ = jax.jit(jax.vmap(found))(y)
    slope = jax.grad(lambda y: found(y)[0])(y[0])
    moved = found(y[0] + 1e-3 * np.eye(T.size)[30])[0]
    np.testing.assert_allclose(slope[30], (moved - gain[0]) / 1e-3, rtol=1e-6)
    _, std, rmse = jax.jit(jax.vmap(lambda y: found(y, initial=1.0, final=3.0)))(y)
    assert np.all(np.asarray(std) == 0) and np.all(np.isfinite(rmse))
