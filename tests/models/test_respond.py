"""Responses to sampled inputs: zero-order hold, against scipy and brute force."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from stepax import FOPDT, IPDT, SOPDT, EqualLag, Hudzovic, PTn, Sani, SOPDTZero


MODELS = {
    "Hudzovic": Hudzovic(T=1.0, r=0.3, n=3, gain=-2.0, offset=5.0),
    "Sani": Sani(T=2.0, r=0.3, n=3, gain=1.5),
    "EqualLag": EqualLag(T=1.0, n=3, offset=-1.0),
    "EqualLag, real n": EqualLag(T=1.0, n=2.5),
    "PTn": PTn(lags=np.array([2.0, 0.0, 0.7])),
    "FOPDT": FOPDT(T=1.7, gain=3.0),
    "SOPDT": SOPDT(zeta=0.3, omega_n=1.2),
    "SOPDTZero": SOPDTZero(zeta=0.3, omega_n=1.2, lead=-0.7, gain=1.5, offset=2.0),
    "IPDT": IPDT(T=0.7, gain=-0.4, offset=3.0),
    "IPDT, no lag": IPDT(T=0.0, gain=2.0),
}
T = np.linspace(0, 9, 12)
UNEVEN = np.cumsum(np.random.default_rng(1).uniform(0, 1.5, 12)) - 3.0
U = np.random.default_rng(2).normal(size=12)

families = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
rational = pytest.mark.parametrize(
    "model", [m for k, m in MODELS.items() if "real" not in k], ids=lambda m: type(m).__name__
)


@families
def test_unit_step_gives_the_step_response(model):
    y = model.respond(T, np.ones_like(T))
    assert np.allclose(y, model.step_response(T), rtol=0, atol=1e-12)
    later = model.respond(T + 100, np.ones_like(T))  # at rest before its first sample
    assert np.allclose(later, y, rtol=0, atol=1e-11)


@families
def test_deviation_is_linear_in_the_input(model):
    other = np.sin(T)
    y, y_other = (model.respond(T, u) - model.offset for u in (U, other))
    both = model.respond(T, 3 * U - 2 * other) - model.offset
    assert np.allclose(both, 3 * y - 2 * y_other, rtol=0, atol=1e-11)
    assert np.allclose(model.respond(T, np.zeros_like(T)), model.offset)


@rational
def test_even_sampling_agrees_with_scipy(model):
    """The plant discretised exactly for a zero-order hold, as a difference equation."""
    plant = model.to_scipy().to_ss()
    discrete = signal.cont2discrete((plant.A, plant.B, plant.C, plant.D), T[1], method="zoh")
    y = signal.dlsim(discrete, U)[1][:, 0]
    assert np.allclose(model.respond(T, U), model.offset + y, rtol=0, atol=1e-10)


@rational
def test_continuous_simulation_of_scipy_agrees(model):
    """Its integration by a matrix exponential, the input held between samples."""
    plant = model.to_scipy()
    y = signal.lsim(plant, U, T, interp=False)[1]
    assert np.allclose(model.respond(T, U), model.offset + y, rtol=0, atol=1e-10)


@families
def test_uneven_sampling_superposes_steps(model):
    model = dataclasses.replace(model, delay=0.9)
    y = np.full(UNEVEN.shape, float(model.offset))
    for start, move in zip(UNEVEN, np.diff(U, prepend=0), strict=True):
        y += move * np.asarray(model.step_response(UNEVEN - start) - model.offset)
    assert np.allclose(model.respond(UNEVEN, U), y, rtol=0, atol=1e-11)


def test_hold_lasts_until_the_next_sample():
    """A pulse of one sample, then 0: the exact decay of a first-order lag."""
    t = np.array([0.0, 0.5, 2.0, 2.1])
    y = FOPDT(T=2.0).respond(t, np.array([1.0, 0.0, 0.0, 7.0]))
    peak = 1 - np.exp(-0.25)
    assert np.allclose(y, [0, peak, peak * np.exp(-0.75), peak * np.exp(-0.8)], rtol=1e-13)


def test_respond_is_differentiable_and_batched():
    """Slopes with respect to a parameter and the input, over a batch of inputs."""
    t, inputs, h = jnp.asarray(UNEVEN), jnp.stack([U, U[::-1]]), 1e-6

    def last(T, u):
        return FOPDT(T=T, delay=0.5).respond(t, u)[-1]

    batch = jax.jit(jax.vmap(jax.value_and_grad(last, (0, 1)), (None, 0)))
    y, (by_T, by_u) = batch(1.3, inputs)
    difference = (batch(1.3 + h, inputs)[0] - batch(1.3 - h, inputs)[0]) / (2 * h)
    assert np.allclose(by_T, difference, rtol=0, atol=1e-8)
    assert np.allclose(jnp.sum(by_u * inputs, axis=1), y, rtol=0, atol=1e-12)
