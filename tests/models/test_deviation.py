"""The integral of a squared deviation to infinity, against closed forms and quadrature."""

import itertools

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from scipy import integrate

from stepax import FOPDT, SOPDT, EqualLag, PTn
from stepax.models._deviation import squared_deviation


def test_one_lag_against_another_in_closed_form():
    """(1/2)(T1 - T2)^2/(T1 + T2) for e^(-t/T1) - e^(-t/T2), times the gain and the step squared."""
    exact = 0.5 * (3.0 - 0.01) ** 2 / (3.0 + 0.01) * 2.0**2 * 5.0**2
    ours = squared_deviation(FOPDT(T=3.0, gain=2.0), FOPDT(T=0.01, gain=2.0), 5.0)
    np.testing.assert_allclose(ours, exact, rtol=1e-10)


def test_what_differs_before_the_dead_times_counts():
    """0.1^2 for 5, then a lag of 1: 0.1^2/2."""
    model = FOPDT(T=1.0, gain=1.9, offset=1.1, delay=5.0)
    plant = FOPDT(T=1.0, gain=2.0, offset=1.0, delay=5.0)
    np.testing.assert_allclose(squared_deviation(model, plant), 0.055, rtol=1e-9)


def test_lags_far_apart_need_few_panels():
    ours = squared_deviation(FOPDT(T=1e-8), FOPDT(T=1.0))
    np.testing.assert_allclose(ours, 0.5 * (1 - 1e-8) ** 2 / (1 + 1e-8), rtol=1e-9)


def test_levels_that_agree_in_float32_are_the_same():
    model = FOPDT(T=np.float32(2.0), gain=np.float32(2.2), offset=np.float32(1.1))
    plant = FOPDT(T=np.float32(1.0), gain=np.float32(2.2000003), offset=np.float32(1.1))
    assert np.isfinite(squared_deviation(model, plant))


@pytest.mark.parametrize(
    ("model", "plant"),
    [
        (EqualLag(T=0.7565, n=4, gain=2.0), PTn(lags=[0.2, 0.4, 0.6, 0.8, 1.0], gain=2.0)),
        (FOPDT(T=1.3, delay=1.37), EqualLag(T=0.5, n=5)),
        (SOPDT(zeta=0.02, omega_n=3.0, delay=0.5), FOPDT(T=2.0)),
        (EqualLag(T=0.5, n=2.5), PTn(lags=[1e-6, 1.0])),
    ],
    ids=["chains", "dead time", "oscillation", "stiff"],
)
def test_the_integral_against_adaptive_quadrature(model, plant):
    def square(t):
        return float(jnp.squeeze(model.step_response(t) - plant.step_response(t))) ** 2

    response = jax.jit(lambda t: (model.step_response(t) - plant.step_response(t)) ** 2)
    edges = sorted({0.0, float(model.delay), 1e-5, *np.linspace(0.1, 40.0, 80)})
    edges = [*edges, *np.linspace(41.0, 800.0, 760)]
    oracle = sum(
        integrate.fixed_quad(lambda t: np.asarray(response(t)), a, b, n=24)[0]
        for a, b in itertools.pairwise(edges)
    )
    np.testing.assert_allclose(squared_deviation(model, plant), oracle, rtol=1e-7)
    assert square(0.0) == 0


def test_the_integral_of_table_8_of_jakoubek():
    """Latzel's model with T = 0.7565, n = 4 for lags 0.2 to 1: J from residues at 30 digits."""
    mpmath.mp.dps = 30
    lags = [mpmath.mpf(k) / 5 for k in range(1, 6)]
    T = mpmath.mpf("0.7565")

    def deviation(t):
        weights = [
            lag**4 / mpmath.fprod(lag - other for other in lags if other != lag) for lag in lags
        ]
        plant = sum(w * mpmath.exp(-t / lag) for w, lag in zip(weights, lags, strict=True))
        model = mpmath.exp(-t / T) * sum((t / T) ** k / mpmath.factorial(k) for k in range(4))
        return 2 * (plant - model)

    exact = mpmath.quad(lambda t: deviation(t) ** 2, [0, 1, 3, 6, 12, 60])
    ours = squared_deviation(
        EqualLag(T=0.7565, n=4, gain=2.0), PTn(lags=[0.2, 0.4, 0.6, 0.8, 1.0], gain=2.0)
    )
    np.testing.assert_allclose(ours, float(exact), rtol=1e-9)
