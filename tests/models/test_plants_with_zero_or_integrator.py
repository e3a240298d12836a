"""What only the second order with a zero and the integrator with a lag have."""

import jax.numpy as jnp
import numpy as np
import pytest

from stepax import FOPDT, IPDT, SOPDT, SOPDTZero
from stepax.models._deviation import squared_deviation


LEVELS = {"gain": -3.0, "offset": 40.0, "delay": 2.7}
SECOND = {"zeta": 0.4, "omega_n": 0.6} | LEVELS
T = jnp.array([-1, 0, 2.7, 2.75, 3, 4, 5.5, 8, 12, 20, 40, 90])


def test_zero():
    assert np.array_equal(SOPDTZero(zeta=1, omega_n=2, lead=-0.8).zeros, [1.25])
    assert np.array_equal(SOPDTZero(zeta=1, omega_n=2, lead=0.8).zeros, [-1.25])
    no_lead = SOPDTZero(**SECOND, lead=0)
    assert no_lead.zeros.size == 0
    assert np.array_equal(no_lead.step_response(T), SOPDT(**SECOND).step_response(T))
    assert np.array_equal(no_lead.frequency_response(T), SOPDT(**SECOND).frequency_response(T))


def test_a_zero_over_a_pole_is_one_lag():
    """Lags of 4 and 1, and the lead as long as one of them."""
    for lead, T_left in [(1.0, 4.0), (4.0, 1.0)]:
        y = SOPDTZero(zeta=1.25, omega_n=0.5, lead=lead).step_response(T)
        assert np.allclose(y, FOPDT(T=T_left).step_response(T), rtol=0, atol=1e-14)


def test_corner_where_the_dead_time_ends():
    """A zero lets the response leave with a slope of gain lead omega_n^2."""
    slope = SOPDTZero(**SECOND, lead=-0.8).impulse_response(LEVELS["delay"] + 1e-9)
    assert np.allclose(slope, LEVELS["gain"] * -0.8 * 0.6**2, rtol=1e-6)
    assert SOPDTZero(**SECOND, lead=-0.8).impulse_response(LEVELS["delay"]) == 0


def test_integrator_ends_as_a_ramp():
    model = IPDT(T=1.7, **LEVELS)
    late = 1e4 + T
    ramp = model.offset + model.gain * (late - model.delay - model.T)
    assert np.allclose(model.step_response(late), ramp, rtol=1e-15)
    assert np.array_equal(model.poles, [0, -1 / 1.7])
    assert not model.settles


@pytest.mark.parametrize("gain", [-3.0, 2.0])
def test_integrator_has_an_infinite_static_gain(gain):
    model, infinite = IPDT(T=1.7, gain=gain), np.copysign(np.inf, gain)
    assert model.static_gain == infinite
    response = model.frequency_response(np.array([0.0, 1.0]))
    assert response[0].real == infinite and np.isnan(response[0].imag)
    assert np.isfinite(response[1])


def test_integrator_without_a_lag():
    model = IPDT(T=0.0, **LEVELS)
    ramp = model.offset + model.gain * np.maximum(T - model.delay, 0)
    assert np.allclose(model.step_response(T), ramp, rtol=0, atol=1e-13)
    assert np.array_equal(model.poles, [0]) and len(model.denominator()) == 1
    s = 1j * np.geomspace(0.01, 10, 7)
    expected = model.gain * np.exp(-s * model.delay) / s
    assert np.allclose(model.frequency_response(s.imag), expected, rtol=1e-13)
    tiny = IPDT(T=1e-300, **LEVELS)
    assert np.allclose(tiny.step_response(T), ramp, rtol=0, atol=1e-13)


def test_no_transient_of_an_integrator_to_integrate():
    """Against whatever plant, itself included."""
    for plant in (SOPDT(**SECOND), IPDT(T=1.7, **LEVELS)):
        assert squared_deviation(IPDT(T=1.7, **LEVELS), plant) == np.inf
        assert squared_deviation(plant, IPDT(T=1.7, **LEVELS)) == np.inf
