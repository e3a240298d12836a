"""A prior in a fit: against a minimum found by SciPy, and what else knows of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

import stepax
from stepax import FOPDT, SOPDT, StepRecord, refine


T = np.linspace(0.0, 14.0, 90)  # the plant has done half of its way
PLANT = FOPDT(T=15.0, gain=2.0, offset=1.0, delay=2.0)
PRIOR = {"gain": (2.1, 0.1), "T": (14.0, 3.0)}


def noisy(seed, sigma=0.02):
    y = np.asarray(PLANT.step_response(T))
    return y + sigma * np.random.default_rng(seed).standard_normal(T.size)


@jax.jit
def fitted(y, prior):
    return refine(StepRecord(T, y), PLANT, prior=prior)


def model(T_, gain, offset, delay):
    return offset - gain * np.expm1(-np.maximum(T - delay, 0) / T_)


def test_the_optimum_is_that_of_the_posterior():
    """Noise level of the fit before, then the penalised sum of squares by Nelder and Mead."""
    y = noisy(0)
    result = fitted(y, PRIOR)
    noise = float(result.details["noise_level"])
    assert 0.015 < noise < 0.025

    def loss(p):
        off = (p[1] - 2.1) / 0.1, (p[0] - 14.0) / 3.0
        return np.sum((y - model(*p)) ** 2) + noise**2 * np.sum(np.square(off))

    found = np.array([getattr(result.model, k) for k in ("T", "gain", "offset", "delay")], float)
    best = minimize(loss, found, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-15})
    assert loss(found) <= best.fun * (1 + 1e-9)
    np.testing.assert_allclose(found, best.x, rtol=2e-5)


def test_a_prior_narrows_what_the_record_does_not_tell():
    y = noisy(1)
    free, known = refine(StepRecord(T, y), PLANT), fitted(y, {"gain": (2.01, 0.02), "T": (14, 1e6)})
    weight = 1 / np.array([free.std["gain"], 0.02]) ** 2  # two measurements of one number
    np.testing.assert_allclose(known.std["gain"], np.sum(weight) ** -0.5, rtol=0.05)
    mean = np.average([free.model.gain, 2.01], weights=weight)
    assert abs(known.model.gain - mean) < 0.2 * known.std["gain"]
    exact = fitted(y, {"gain": (2.0, 1e-6), "T": (14, 1e6)})
    held = refine(StepRecord(T, y), PLANT, ("gain",))
    for name in ("T", "offset", "delay"):
        np.testing.assert_allclose(getattr(exact.model, name), getattr(held.model, name), rtol=1e-4)
        np.testing.assert_allclose(exact.std[name], held.std[name], rtol=0.02)


@pytest.mark.long
def test_a_vague_prior_changes_nothing():
    y = noisy(2)
    free = refine(StepRecord(T, y), PLANT)
    vague = fitted(y, {"gain": (2.0, 1e6), "T": (14, 1e6)})
    for name in ("T", "gain", "offset", "delay"):
        np.testing.assert_allclose(getattr(vague.model, name), getattr(free.model, name), rtol=1e-5)
        np.testing.assert_allclose(vague.std[name], free.std[name], rtol=1e-3)
    np.testing.assert_allclose(vague.details["aicc"], free.details["aicc"], rtol=1e-6)


@pytest.mark.long
def test_derivatives_in_the_prior_and_in_the_data():
    y, h = noisy(3), 1e-5

    def gain(value, std, scale):
        result = fitted(y * scale, {"gain": (value, std), "T": (14.0, 3.0)})
        return result.model.gain

    point = (2.1, 0.1, 1.0)
    slopes = jax.jit(jax.grad(gain, argnums=(0, 1, 2)))(*point)
    for k, slope in enumerate(slopes):
        up, down = (gain(*[x + s * h * (i == k) for i, x in enumerate(point)]) for s in (1, -1))
        np.testing.assert_allclose(slope, (up - down) / (2 * h), rtol=1e-4)


@pytest.mark.long
def test_intervals_cover_over_plants_drawn_from_the_prior():
    """Each plant with its gain drawn, and its noise: 95 % intervals of both hold it."""
    draw = np.random.default_rng(4)
    gains = 2 + 0.1 * draw.standard_normal(400)
    g = np.asarray(FOPDT(T=15.0, delay=2.0).step_response(T))
    y = 1 + gains[:, None] * g + 0.02 * draw.standard_normal((400, T.size))
    batch = jax.jit(jax.vmap(lambda y: fitted(y, {"gain": (2.0, 0.1)})))(y)
    off = np.abs(np.asarray(batch.model.gain) - gains) / np.asarray(batch.std["gain"])
    assert 0.92 < np.mean(off < 1.98) < 0.98


@pytest.mark.long
def test_methods_take_it():
    record = StepRecord(T, noisy(5))
    result = stepax.identify(record, "sopdt_fit", prior={"gain": (2.0, 0.05)})
    assert isinstance(result.model, SOPDT) and abs(result.model.gain - 2.0) < 0.15
    auto = stepax.identify(record, prior={"gain": (2.0, 0.05)})
    assert abs(auto.model.gain - 2.0) < 0.15


@pytest.mark.parametrize(
    ("prior", "error", "words"),
    [
        ({"zeta": (1.0, 0.1)}, ValueError, "FOPDT has no parameter 'zeta'"),
        ({"gain": 2.0}, TypeError, "a pair"),
        ({"gain": (2.0, 0.0)}, ValueError, "positive"),
        ({"gain": (np.nan, 1.0)}, ValueError, "finite"),
        ([2.0], TypeError, "name parameters"),
        ({"delay": (1.0, 0.1)}, ValueError, "says nothing"),
    ],
)
def test_what_is_no_prior(prior, error, words):
    with pytest.raises(error, match=words):
        stepax.identify(StepRecord(T, noisy(6)), "fopdt_fit", prior=prior, fixed=("delay",))


def test_a_known_level_leaves_nothing_to_say():
    record = StepRecord(T, jnp.asarray(noisy(7)), initial=1.0, final=3.0)
    with pytest.raises(ValueError, match="says nothing"):
        refine(record, PLANT, prior={"gain": (2.0, 0.1)})
