"""The shape of second-order plants, and their level times, against closed forms in SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special
from scipy.optimize import brentq

from stepax.curves._second_order import damping, lags_of, level_times, shape_ends, unit_response


LEVELS = (0.1, 0.5, 0.9)
SHAPES = np.array([-0.999, -0.7, -0.1, -1e-3, 0.0, 1e-3, 0.25, 0.9, 0.9999])


def response(x, shape):
    """Step response in NumPy: two lags of sum 1, equal ones, or an oscillation with omega_n = 2."""
    if shape == 0:
        return special.gammainc(2, 2 * x)
    if shape > 0:
        slow, fast = (1 + np.sqrt(shape)) / 2, (1 - np.sqrt(shape)) / 2
        return 1 - (slow * np.exp(-x / slow) - fast * np.exp(-x / fast)) / (slow - fast)
    zeta, omega = np.sqrt(1 + shape), 2 * np.sqrt(-shape)
    decay = np.exp(-2 * zeta * x)
    return 1 - decay * (np.cos(omega * x) + 2 * zeta / omega * np.sin(omega * x))


def crossing(level, shape):
    """By Brent's method, before the first peak."""
    end = 0.5 * np.pi / np.sqrt(-shape) if shape < -1e-2 else 30.0
    return brentq(lambda x: response(x, shape) - level, 0, end, xtol=1e-15, rtol=1e-14)


def times(shape):
    return level_times(LEVELS, shape)


compiled = jax.jit(jax.vmap(times))


def test_level_times():
    oracle = [[crossing(level, shape) for level in LEVELS] for shape in SHAPES]
    np.testing.assert_allclose(compiled(SHAPES), oracle, rtol=2e-12)
    alone = jax.jit(times)(jnp.asarray(SHAPES[1]))
    np.testing.assert_allclose(alone, oracle[1], rtol=2e-12)


def test_responses():
    x = np.array([0.0, 0.01, 0.3, 1.0, 4.0])
    found = jax.jit(jax.vmap(lambda shape: unit_response(jnp.asarray(x), shape)))(SHAPES)
    oracle = [[response(a, shape) for a in x] for shape in SHAPES]
    np.testing.assert_allclose(found, oracle, atol=1e-12)


def test_derivatives_are_finite_also_at_equal_lags():
    """Both modes against differences, one-sided at 0, where the unit of time changes its form."""
    forward, reverse = jax.jit(
        jax.vmap(lambda shape: (jax.jacfwd(times)(shape), jax.jacrev(times)(shape)))
    )(SHAPES)
    np.testing.assert_allclose(reverse, forward, rtol=1e-12)
    h = 5e-4 * (1 - np.abs(SHAPES))
    below, at, above, further = (compiled(SHAPES + k * h) for k in (-1, 0, 1, 2))
    central, onward = (above - below) / 2, (4 * above - 3 * at - further) / 2
    difference = np.where((SHAPES == 0)[:, None], onward, central) / h[:, None]
    np.testing.assert_allclose(forward, difference, rtol=1e-5)


def test_in_float32():
    found = compiled(SHAPES.astype(np.float32))
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, compiled(SHAPES), rtol=2e-5)


def test_a_shape_is_that_of_its_lags():
    """(T1 - T2)^2/(T1 + T2)^2; zeta and omega_n of lags 3 and 1 in units of their sum."""
    np.testing.assert_allclose(lags_of(jnp.array(0.25), jnp.array(4.0)), [3, 1], rtol=1e-15)
    zeta, omega_n = damping(jnp.array(0.25))
    np.testing.assert_allclose([zeta, omega_n], [2 / np.sqrt(3), 4 / np.sqrt(3)], rtol=1e-15)
    np.testing.assert_allclose(damping(jnp.array(-0.36)), [0.8, 2], rtol=1e-15)
    for shape, lags in ((1.5, [4, 0]), (1.0, [4, 0]), (0.0, [2, 2]), (-0.5, [2, 2])):
        np.testing.assert_array_equal(lags_of(jnp.array(shape), jnp.array(4.0)), lags)
    slope = jax.jacfwd(lags_of)(jnp.array(0.0), jnp.array(4.0))
    assert np.isfinite(slope).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_ends_have_times(dtype):
    lowest, equal, highest = shape_ends(dtype)
    assert lowest.dtype == highest.dtype == dtype and -1 < lowest < equal == 0 < highest < 1
    shapes = np.full(SHAPES.size, equal, dtype)  # of a length that is compiled already
    shapes[:2] = lowest, highest
    found = compiled(shapes)
    assert np.isfinite(found).all() and (np.diff(found, axis=1) > 0).all()
    one_lag = -np.log1p(-np.array(LEVELS))
    np.testing.assert_allclose(found[1], one_lag, rtol=30 * float(jnp.finfo(dtype).eps) ** 0.5)
