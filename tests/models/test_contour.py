"""The contour kernel: its weights, and properties of the chains that it evaluates."""

from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from mpmath import mp, mpf
from tests import caratheodory_fejer, oracle

import stepax
from stepax._compilation import FORM, quick_compilation
from stepax.models._contour import (
    _pairs,
    chain_derivatives,
    chain_response,
    chain_slopes,
    lag_power_response,
)


DTYPES = (np.float64, np.float32)
TIMES = np.array([-1, 0, 1e-9, 1e-5, 0.03, 0.3, 0.7, 1, 1.5, 2.5, 8, 50])
"""In units of the sum of the lags."""

response = jax.jit(chain_response)
exponents = st.one_of(st.just(0.0), st.floats(-12, 0), st.floats(-1e-6, 0))
chain_lags = st.lists(exponents.map(lambda x: 10.0**x), min_size=1, max_size=8)


def padded(lags):
    """Eight lags, for which the kernel is compiled once."""
    return np.array([*lags, *[0.0] * (8 - len(lags))])


def times(lags):
    return TIMES * np.sum(lags)


@pytest.mark.long
@pytest.mark.parametrize("dtype", DTYPES)
def test_weights_are_those_of_caratheodory_and_fejer(dtype):
    stored = np.array(_pairs(dtype))
    computed = np.array(caratheodory_fejer.poles_and_weights(len(stored)))
    assert np.all(np.abs(computed - stored) <= 1e-14 * np.abs(stored))


@pytest.mark.parametrize(
    ("dtype", "in_float64", "exactly"), [(np.float64, 2e-13, 2e-14), (np.float32, 3e-10, 3e-10)]
)
def test_weights_approximate_the_exponential(dtype, in_float64, exactly):
    """e^x for x <= 0; the second limit is that of the constants, rounded to float64, themselves."""
    x = -np.concatenate([[0], np.geomspace(1e-8, 1e8, 300)])
    poles, weights = np.array(_pairs(dtype)).T
    values = np.sum((weights * poles / (poles - x[:, None])).real, axis=1)
    assert np.max(np.abs(values - np.exp(x))) <= in_float64
    with mp.workdps(40):
        pairs = [(mpmath.mpmathify(z), mpmath.mpmathify(w)) for z, w in _pairs(dtype)]
        for point in map(mpf, x):
            terms = ((w * z / (z - point)).real for z, w in pairs)
            assert abs(mpmath.fsum(terms) - mpmath.exp(point)) <= exactly


def check_against_oracle(lags):
    t = times(lags)
    p = {f"lag{k}": oracle.exact(T) for k, T in enumerate(lags)} | {"n": len(lags)}
    truth = np.array([float(oracle.step_response("PTn", oracle.exact(x), p)) for x in t])
    assert np.max(np.abs(response(t, padded(lags)) - truth)) <= 1e-12
    lags, t = padded(lags).astype(np.float32), t.astype(np.float32)
    # single precision: the rounded lags and times move the response by about 1e-7
    assert np.max(np.abs(response(t, lags) - truth)) <= 1e-5


@settings(max_examples=25, deadline=None)
@given(chain_lags)
def test_random_chains(lags):
    check_against_oracle(lags)


@pytest.mark.long
@settings(max_examples=2000, deadline=None)
@given(chain_lags)
def test_many_random_chains(lags):
    check_against_oracle(lags)


@settings(max_examples=25, deadline=None)
@given(chain_lags, st.randoms(use_true_random=False))
def test_order_of_the_lags_does_not_matter(lags, random):
    t = times(lags)
    shuffled = random.sample(lags, len(lags))
    assert np.allclose(response(t, padded(shuffled)), response(t, padded(lags)), rtol=0, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(chain_lags, st.integers(0, 7))
def test_lag_of_zero_changes_nothing(lags, place):
    lags = lags[:7]
    with_zero = [*lags[:place], 0.0, *lags[place:]]
    t = times(lags)
    expected = response(t, padded(lags))
    assert np.allclose(response(t, padded(with_zero)), expected, rtol=0, atol=1e-12)


def test_number_of_zeros_does_not_matter():
    lags = [1.0, 1e-3, 0.4]
    t = times(lags)
    few = chain_response(jnp.asarray(t), jnp.asarray(lags))
    assert np.allclose(response(t, padded(lags)), few, rtol=0, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(chain_lags, st.integers(-40, 40))
def test_unit_of_time_does_not_matter(lags, exponent):
    unit = 2.0**exponent
    t, lags = times(lags), padded(lags)
    assert np.array_equal(response(unit * t, unit * lags), response(t, lags))


@settings(max_examples=25, deadline=None)
@given(chain_lags)
def test_response_is_between_0_and_1_and_rises(lags):
    y = np.asarray(response(times(lags), padded(lags)))
    assert np.all(y[:2] == 0)
    assert np.all((y >= -1e-12) & (y <= 1 + 1e-12))
    assert np.all(np.diff(y) >= -1e-12)


@pytest.mark.parametrize("position", [0.0, 1e-9, 0.5, 0.99, 1 - 1e-9])
@pytest.mark.parametrize("n", range(1, 9))
def test_closed_form_agrees(n, position):
    """Hudzovic's positive sum shares nothing with the contour but the model."""
    model = stepax.Hudzovic(T=1.7, r=position / max(n - 1, 1), n=n)
    lags = model.lags
    t = jnp.asarray(times(lags))
    contour = response(t, padded(np.asarray(lags)))
    assert np.allclose(contour, model.step_response(t), rtol=0, atol=1e-12)


@pytest.mark.parametrize("power", [0.3, 1.0, 1.5, 2.0])
def test_real_power_of_a_lag(power):
    """Against scipy's gamma distribution function."""
    from scipy.special import gammainc

    t = TIMES * 1.7
    expected = gammainc(power, np.maximum(t, 0) / 1.7)
    computed = lag_power_response(jnp.asarray(t), jnp.asarray(1.7), jnp.asarray(power))
    assert np.allclose(computed, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("lags", [[1.0, 2.0], [3.0, 1e-6, 0.5], [2.0] * 5])
@jax.disable_jit()
def test_derivatives_in_time_are_those_of_jvp(lags):
    """Times t^m, as the kernel gives them."""
    lags = jnp.asarray(lags)
    t = jnp.linspace(0.01, 5, 12) * jnp.sum(lags)

    def first(t):
        return jax.jvp(lambda t: chain_response(t, lags), (t,), (jnp.ones_like(t),))

    def second(t):
        return jax.jvp(lambda t: first(t)[1], (t,), (jnp.ones_like(t),))

    (g, slope), (_, curvature) = first(t), second(t)
    computed = chain_derivatives(t, lags, 2)
    for a, b in zip(computed, (g, t * slope, t**2 * curvature), strict=True):
        assert np.allclose(a, b, rtol=0, atol=1e-11)
    early = chain_derivatives(jnp.array([-1.0, 0.0]), lags, 2)
    assert np.all(np.array(early) == 0)


def has_products(function, *arguments):
    """Whether a jitted function, as the context now has it, has products for its sums."""
    return "dot_general" in function.lower(*arguments).as_text()


def has_products_in_own_context(*arguments):
    with quick_compilation():
        return has_products(*arguments)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("form", ["loop", "products"])
def test_all_forms_give_the_same_numbers(form, dtype):
    """A response, its slope and its change; with absent lags, of which one appears."""
    lags = jnp.asarray(padded([1.0, 0.5, 0.5, 1e-3]).astype(dtype))
    t, change = jnp.asarray(times(lags).astype(dtype)), jnp.linspace(-1, 1, 8, dtype=dtype)
    written = [*chain_derivatives(t, lags, 1), chain_slopes(t, lags, [change]).changes[0]]
    with FORM(form):
        others = [*chain_derivatives(t, lags, 1), chain_slopes(t, lags, [change]).changes[0]]
    # the same sum, fused differently: a few roundings of weights up to 280 (times a pole up to 30
    # in the slope and the change)
    eps, weight = jnp.finfo(dtype).eps, 300 if dtype is np.float64 else 10
    for a, b, pole in zip(written, others, (1, 30, 30), strict=True):
        assert np.max(np.abs(a - b)) <= 4 * weight * pole * eps


@pytest.mark.parametrize("form", ["written", "loop", "products"])
def test_second_derivatives_in_float32(form):
    """Of eight nearly equal lags, whose product at a pole is large, those of float64."""
    t = jnp.array([1e-3, 0.03, 0.3, 1.0, 4.0, 30.0])
    lags = jnp.linspace(0.9, 1.1, 8)

    def second(t, lags):
        with FORM(form):
            return jax.jacfwd(jax.jacrev(chain_response, 1), 1)(t, lags)

    exact = second(t, lags)
    found = second(t.astype(np.float32), lags.astype(np.float32))
    assert np.allclose(found, exact, rtol=0, atol=1e-4)


@pytest.mark.parametrize("form", ["written", "loop", "products"])
def test_change_of_the_lags(form):
    """Against differences of the response, and what the rule for derivatives gives, both modes."""
    lags, change = jnp.array([1.0, 0.3, 0.3, 0.02]), jnp.array([0.5, -1.0, 0.2, 1.0])
    t, h = jnp.linspace(0, 6, 40), 1e-5
    with FORM(form):
        (moved,) = chain_slopes(t, lags, [change]).changes
        differences = (
            chain_response(t, lags + h * change) - chain_response(t, lags - h * change)
        ) / (2 * h)
        assert np.allclose(moved, differences, rtol=0, atol=1e-7)
        assert np.allclose(moved, jax.jacfwd(chain_response, 1)(t, lags) @ change, atol=1e-12)
        assert np.allclose(moved, jax.jacrev(chain_response, 1)(t, lags) @ change, atol=1e-12)


def test_a_change_of_form_is_traced_anew():
    """Of a jitted function and the jitted kernel inside it; within a thread alone."""
    traced = []

    @jax.jit
    def slope(t, lags):
        traced.append(t)
        return jax.grad(chain_response)(t, lags)

    t, lags = jnp.asarray(1.0), jnp.ones(2)
    written = [slope(t, lags), slope(t, lags)]
    assert len(traced) == 1 and not has_products(slope, t, lags)
    with quick_compilation():
        assert has_products(slope, t, lags) and len(traced) == 2
        assert slope(t, lags) == pytest.approx(float(written[0]), abs=1e-12) and len(traced) == 2
        with ThreadPoolExecutor(1) as pool:
            assert not pool.submit(has_products, slope, t, lags).result()
            assert pool.submit(has_products_in_own_context, slope, t, lags).result()
    assert slope(t, lags) == written[1] and len(traced) == 2 and not has_products(slope, t, lags)


@pytest.mark.long
def test_second_derivatives_in_the_lags():
    """Against differences of the gradient; finite and symmetric also at a lag of 0."""
    t, h = jnp.asarray(2.5), 1e-5
    gradient = jax.vmap(jax.grad(chain_response, 1), (None, 0))
    hessian = jax.jit(jax.vmap(jax.hessian(chain_response, 1), (None, 0)))
    hessian = hessian(t, jnp.array([[1.0, 1.0], [1.0, 0.0]]))
    assert np.allclose(hessian, hessian.transpose(0, 2, 1), rtol=0, atol=1e-12)
    steps = jnp.array([[h, 0], [-h, 0], [0, h], [0, -h]])
    ahead0, behind0, ahead1, behind1 = gradient(t, 1 + steps)
    differences = jnp.stack([ahead0 - behind0, ahead1 - behind1]) / (2 * h)
    assert np.allclose(hessian[0], differences, rtol=0, atol=1e-8)
