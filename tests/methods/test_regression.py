"""Regression on integrals against exact plants, and what its options change."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from stepax import METHODS, SOPDT, SOPDTZero, Status, StepRecord


pytestmark = pytest.mark.usefixtures("quick_compilation")
T = np.linspace(0, 20, 401)
PLANTS = [
    SOPDT(zeta=0.3, omega_n=1.3, gain=2.0, delay=1.2),
    SOPDT(zeta=0.8, omega_n=1.0, gain=-0.5, delay=3.0),
    SOPDT(zeta=1.5, omega_n=1.3, gain=1.0, delay=0.4),
]
ZEROS = [
    SOPDTZero(zeta=0.8, omega_n=1.0, lead=-1.0, delay=1.0),
    SOPDTZero(zeta=0.8, omega_n=1.0, lead=2.0, delay=1.0),
    SOPDTZero(zeta=0.4, omega_n=1.0, lead=0.7, delay=0.5, gain=-3.0),
]


def response(plant):
    return np.asarray(plant.step_response(jnp.asarray(T)))


@functools.cache
def compiled(known, **options):
    def one(y, gain):
        more = {"gain": gain} if known else {}
        record = StepRecord(T, y, initial=0.0)
        return METHODS["wang_guo_zhang"](record, **more, **options)

    return jax.jit(jax.vmap(one))


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("options", [{}, {"instruments": True}, {"zero": True}])
def test_exact_plants_are_found(options, known):
    """To the error of the trapezoid rule; without a zero in the plant its lead comes out 0."""
    plants = ZEROS if "zero" in options else PLANTS
    gains = np.array([float(plant.gain) for plant in plants])
    result = compiled(known, **options)(np.stack([response(p) for p in plants]), gains)
    assert (result.status._value == Status.successful._value).all()
    names = ("zeta", "omega_n", "gain", "delay") + (("lead",) if "zero" in options else ())
    for name in names:
        expected = [float(getattr(plant, name)) for plant in plants]
        np.testing.assert_allclose(getattr(result.model, name), expected, rtol=3e-3, atol=2e-3)


def test_instruments_take_the_bias_of_noise():
    """White noise in the integrals biases least squares; its mean over many sequences shows it."""
    plant = PLANTS[1]
    y = response(plant) - 0.05 * np.random.default_rng(2).standard_normal((400, T.size))
    gains = np.full(len(y), float(plant.gain))
    plain = np.nanmean(compiled(False)(y, gains).model.zeta)
    without = np.nanmedian(compiled(False, instruments=True)(y, gains).model.zeta)
    assert abs(without - 0.8) < 0.5 * abs(plain - 0.8)


def test_a_ramp_has_no_stable_model():
    y = np.stack([0.2 * T**2, response(PLANTS[0])])
    status = compiled(False)(y, np.ones(2)).status._value
    assert list(status) == [Status.not_stable._value, Status.successful._value]


def test_derivatives_and_single_precision():
    y = np.stack([response(plant) for plant in PLANTS[:2]])
    wave = y * np.sin(T + np.arange(2)[:, None])

    def total(y):
        model = METHODS["wang_guo_zhang"](StepRecord(T, y, initial=0.0)).model
        return jnp.sum(jnp.stack(jax.tree.leaves(model)) * (1 + jnp.arange(5)))

    both = jax.jit(jax.vmap(jax.value_and_grad(total)))
    slope = np.sum(np.asarray(both(y)[1]) * wave, axis=1)
    ahead, behind = (np.asarray(both(y + h * wave)[0]) for h in (1e-6, -1e-6))
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, rtol=1e-5)
    record = StepRecord(T.astype(np.float32), y[1].astype(np.float32), initial=0.0)
    model = METHODS["wang_guo_zhang"](record).model
    np.testing.assert_allclose(model.zeta, 0.8, rtol=2e-2)
