"""Lookup curves against high precision."""

import jax
import mpmath
import numpy as np
import pytest
from mpmath import mpf
from scipy import special
from tests import oracle
from tests.spread_curves import (
    EQUAL_LAGS,
    ORDERS,
    compiled_curves,
    curves,
    equal_lag_ends,
    families,
    grid,
)

from stepax import Hudzovic, Sani, lookup_curves


pytestmark = pytest.mark.usefixtures("quick_compilation")


def high_precision_curves(model, n, r):
    """The four curves of one plant, by root finding on partial fractions."""
    family = model.__name__
    with oracle.enough_digits(family, {"n": n}):
        p = {"T": mpf(1), "r": oracle.exact(r), "n": n}
        lags = (oracle.hudzovic_lags if model is Hudzovic else oracle.sani_lags)(p)
        middle = mpmath.log(mpmath.fsum(lags))

        def time_at(level):
            def logit(x):
                g = oracle.chain(mpmath.exp(x), lags)
                return mpmath.log(g / (1 - g)) - mpmath.log(level / (1 - level))

            return mpmath.exp(mpmath.findroot(logit, (middle, middle - 0.5), tol=1e-18))

        def differences(t):
            h = t * oracle.STEP
            below, at, above = (oracle.chain(t + k * h, lags) for k in (-1, 0, 1))
            return at, (above - below) / (2 * h), (above - 2 * at + below) / h**2

        def relative_curvature(x):
            t = mpmath.exp(x)
            _, slope, curvature = differences(t)
            return t * curvature / slope

        # Tu/Tg and 1/Tg are stationary at the inflection: half their digits suffice.
        bracket = (mpmath.log(mpf(10) ** -3), middle)
        log_t = mpmath.findroot(relative_curvature, bracket, solver="anderson", tol=1e-11)
        t = mpmath.exp(log_t)
        g, slope, _ = differences(t)
        t10, t50, t90 = (time_at(mpf(k) / 10) for k in (1, 5, 9))
        return [float(x) for x in (t * slope - g, slope, (t90 - t10) / t50, 1 / t50)]


SHARES = {Hudzovic: (0, 0.02, 0.5, 0.98, 0.99999), Sani: (0.01, 0.1, 0.5, 0.99, 1)}


@families
def test_curves_at_high_precision(model):
    n, r = grid(model, SHARES[model])
    expected = np.array([high_precision_curves(model, *x) for x in zip(n.tolist(), r, strict=True)])
    error = np.abs(curves(model, n, r) - expected)
    # Sani's Tu/Tg is a difference of numbers known to some 1e-13.
    floor = np.array([2e-13 if model is Sani else 0, 0, 0, 0])
    assert (error <= 1e-11 * expected + floor).all()


@families
def test_curves_at_equal_lags_have_the_published_values(model):
    n, r = grid(model, [1.0 if model is Sani else 0.0])
    tu_tg, inv_tg, lam, inv_t50 = curves(model, n, r).T
    assert np.abs(np.stack([tu_tg, inv_tg, lam, inv_t50], 1) - EQUAL_LAGS).max() < 5.1e-7
    assert np.allclose(tu_tg, equal_lag_ends("tu_tg"), rtol=1e-12, atol=0)
    assert np.allclose(lam, equal_lag_ends("lam"), rtol=1e-12, atol=0)


@pytest.mark.long
def test_hudzovic_quantiles_are_those_of_the_beta_distribution():
    n, r = grid(Hudzovic, np.linspace(0.001, 0.97, 300))
    m = 1 - (n - 1) * r
    # the complement, exp(-r t): towards the end of r the quantile itself rounds to 1
    t10, t50, t90 = (-np.log(special.betaincinv(m / r, n, 1 - p)) / r for p in (0.1, 0.5, 0.9))
    *_, lam, inv_t50 = curves(Hudzovic, n, r).T
    assert np.allclose(lam, (t90 - t10) / t50, rtol=1e-9, atol=0)
    assert np.allclose(inv_t50, 1 / t50, rtol=1e-9, atol=0)


@families
def test_curves_are_monotone_in_r(model):
    table = curves(model, *grid(model, np.linspace(0.001, 0.999, 36))).reshape(7, 36, 4)
    rising = 1 if model is Sani else -1
    assert (rising * np.diff(table[..., 0], axis=1) > 0).all()
    assert (rising * np.diff(table[..., 2], axis=1) < 0).all()


def test_curves_published_as_examples():
    """Figures 3-5 of Murray 2016; recomputed in reference/murray_notes.md, E35."""
    hudzovic = curves(Hudzovic, np.array([3, 3]), np.array([0.4, 0.3479]))
    sani = curves(Sani, np.array([4, 3]), np.array([0.9, 0.8]))
    assert np.allclose(hudzovic[0, :2], (0.16529, 0.10733), rtol=0, atol=6e-6)
    assert np.allclose(hudzovic[1, 2:], (1.76677, 0.20077), rtol=0, atol=6e-6)
    assert np.allclose(sani[0, :2], (0.31658, 0.26023), rtol=0, atol=6e-6)
    assert np.allclose(sani[1, 2:], (1.6026, 0.4623), rtol=0, atol=6e-5)


@families
def test_curves_of_an_r_out_of_range_are_nan(model):
    wrong = {Hudzovic: (-1e-3, 1.001, 1.2, np.nan), Sani: (-1e-3, -1.0, 1.001, np.nan)}[model]
    n, r = grid(model, (*wrong, 0.5))
    table = curves(model, n, r).reshape(len(ORDERS), -1, 4)
    assert np.isnan(table[:, :-1]).all() and np.isfinite(table[:, -1]).all()


@families
def test_curves_broadcast_and_follow_the_dtype(model):
    shape = jax.eval_shape(
        lambda n, r: lookup_curves(model, n, r), np.array([[2], [3]]), np.zeros((1, 4), np.float32)
    )
    assert [(x.shape, x.dtype) for x in shape] == [((2, 4), np.float32)] * 4
    shape = jax.eval_shape(lambda r: lookup_curves(model, 3, r), 0.1)
    assert all(x.shape == () for x in shape)


@families
def test_curves_in_float32(model):
    n, r = grid(model, (0.1, 0.5, 0.9))
    single = curves(model, n, r.astype(np.float32))
    assert single.dtype == np.float32
    assert np.allclose(single, curves(model, n, r), rtol=2e-4, atol=2e-5)


def test_curves_broadcast_values():
    n, r = np.array([[2, 3]]), np.array([[0.1], [0.2]])
    table = np.stack(compiled_curves(Hudzovic)(n, r), axis=-1).reshape(4, 4)
    row = curves(Hudzovic, np.array([2, 3, 2, 3]), np.array([0.1, 0.1, 0.2, 0.2]))
    assert np.allclose(table, row, rtol=1e-13, atol=0)


@families
def test_curves_of_an_order_out_of_range_are_nan(model):
    table = curves(model, np.array([-1, 0, 1, 9, 20]), np.full(5, 0.01))
    assert np.isnan(table).all()
