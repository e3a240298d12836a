"""Roots of increasing functions against SciPy and mpmath, with their derivatives."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from scipy.optimize import brentq

from stepax.curves._roots import clamped_root, increasing_root


LOWER, UPPER = -10.0, 10.0
LEVELS = np.array([-9.0, -1.0, 0.0, 1.0, 2.5, 300.0])


def root(level):
    """Of x + e^x - level: x = level - W(e^level) with Lambert's W."""

    def value_and_slope(x):
        return x + jnp.exp(x) - level, 1 + jnp.exp(x)

    ends = jnp.full_like(level, LOWER), jnp.full_like(level, UPPER)
    return increasing_root(value_and_slope, *ends, jnp.zeros_like(level))


compiled = jax.jit(root)


def test_roots_of_a_row():
    found = compiled(jnp.asarray(LEVELS))
    oracle = [brentq(lambda x, a=a: x + np.exp(x) - a, LOWER, UPPER, xtol=1e-15) for a in LEVELS]
    np.testing.assert_allclose(found, oracle, rtol=1e-14, atol=1e-14)
    with mpmath.workdps(30):
        exact = [float(a - mpmath.lambertw(mpmath.exp(mpmath.mpf(a)))) for a in LEVELS]
    np.testing.assert_allclose(found, exact, rtol=1e-14, atol=1e-14)


def test_each_element_goes_its_own_way():
    together = compiled(jnp.asarray(LEVELS))
    np.testing.assert_array_equal(jax.jit(jax.vmap(root))(LEVELS), together)


def test_in_float32():
    found = compiled(jnp.asarray(LEVELS, jnp.float32))
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, compiled(jnp.asarray(LEVELS)), rtol=1e-6, atol=2e-7)


@pytest.mark.parametrize("transform", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_first_and_second_derivatives(transform):
    """dx/da = 1/(1 + e^x) and d2x/da2 = -e^x/(1 + e^x)^3; the first also by differences."""
    levels = jnp.asarray(LEVELS)
    first = jax.vmap(transform(root))
    x, slope, curvature = jax.jit(
        lambda a: (root(a), first(a), jax.vmap(transform(jax.grad(root)))(a))
    )(levels)
    np.testing.assert_allclose(slope, 1 / (1 + np.exp(x)), rtol=1e-12)
    np.testing.assert_allclose(curvature, -np.exp(x) / (1 + np.exp(x)) ** 3, rtol=1e-10)
    h = 1e-4
    difference = (compiled(levels + h) - compiled(levels - h)) / (2 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-7)


def test_flat_tails_are_bisected():
    """Newton's first step from the tail of tanh would lead to 1e6 and beyond."""

    def value_and_slope(x):
        return jnp.tanh(x - 3), 1 / jnp.cosh(x - 3) ** 2

    ends = jnp.array(LOWER), jnp.array(UPPER)
    found = jax.jit(lambda x: increasing_root(value_and_slope, *ends, x))(jnp.array(-9.0))
    np.testing.assert_allclose(found, 3, rtol=1e-14)


def test_without_a_sign_change_a_bracket_end():
    beyond = jnp.array([-1e4, 0.0, 1.0, 2.0, 3.0, 1e9])  # as many as before: nothing compiles anew
    found = compiled(beyond)
    np.testing.assert_allclose(found[jnp.array([0, -1])], [LOWER, UPPER], atol=1e-8)


# A root, or an end


@jax.jit
@jax.vmap
def clamped(level):
    """Of x + x^3 between 0 and 1, with its derivatives in both modes."""

    def both(level):
        x, low, high = clamped_root(lambda x: x + x**3 - level, jnp.array(0.0), jnp.array(1.0))
        return x, (low, high)

    x, slope, ends = jax.jvp(both, (level,), (jnp.ones_like(level),), has_aux=True)
    return x, slope, jax.grad(both, has_aux=True)(level)[0], *ends


def test_a_clamped_root_inside_and_at_its_ends():
    levels = np.array([-0.5, 0.0, 1e-9, 0.3, 1.0, 2 - 1e-9, 2.0, 7.0])
    x, forward, reverse, low, high = map(np.asarray, clamped(levels))
    inside = (levels > 0) & (levels < 2)
    oracle = [brentq(lambda x, a=a: x + x**3 - a, 0, 1, xtol=1e-16) for a in levels[inside]]
    np.testing.assert_allclose(x[inside], oracle, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(x[~inside], [0, 0, 1, 1])
    np.testing.assert_allclose(forward, np.where(inside, 1 / (1 + 3 * x**2), 0), rtol=1e-12)
    np.testing.assert_allclose(reverse, forward, rtol=1e-14)
    np.testing.assert_array_equal([low, high], [-levels, 2 - levels])
