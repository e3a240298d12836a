"""Standard errors of a record whose axes are uncertain, against fits of moved axes."""

import jax.numpy as jnp
import numpy as np
import pytest

from stepax import FOPDT, SOPDT, SOPDTZero, StepRecord, identify, refine


T = np.linspace(-2.0, 40.0, 211)
PLANTS = {
    "fopdt_fit": FOPDT(T=5.0, gain=2.0, offset=20.0, delay=3.0),
    "sopdt_fit": SOPDT(zeta=0.5, omega_n=0.4, gain=2.0, offset=20.0, delay=3.0),
    "sopdt_zero_fit": SOPDTZero(zeta=0.8, omega_n=0.4, lead=-2.0, gain=2.0, offset=20.0, delay=3.0),
}
AXES = {"scale_time": 1e-3, "scale_output": 2e-3, "stroke_time": 0.02, "stroke": 0.01}


def record(plant, seed=0, axes=None, stretch=(1.0, 1.0), shift=(0.0, 0.0)):
    noise = np.random.default_rng(seed).normal(0, 0.01, T.size)
    y = np.asarray(plant.step_response(T)) + noise
    details = {name: jnp.asarray(x) for name, x in (axes or {}).items()}
    t = stretch[0] * T + shift[0]
    return StepRecord(t, stretch[1] * y + shift[1], details=details)


def numbers(result):
    return np.array([float(getattr(result.model, name)) for name in result.free])


@pytest.mark.parametrize("method", PLANTS)
def test_covariance_is_that_of_moved_axes(method, quick_compilation):
    """What each cause adds is the square of how far the fit of a moved record goes."""
    plant = PLANTS[method]
    bare = identify(record(plant), method)
    with_axes = identify(record(plant, axes=AXES), method)
    added = np.asarray(with_axes.covariance - bare.covariance)
    h = 1e-4
    middle = float(bare.model.offset)
    moved = [
        identify(record(plant, stretch=(1 + h, 1.0)), method),
        identify(record(plant, stretch=(1.0, 1 + h), shift=(0.0, -h * middle)), method),
        identify(record(plant, shift=(h, 0.0)), method),
        identify(record(plant, shift=(0.0, h)), method),
    ]
    slopes = [(numbers(result) - numbers(bare)) / h for result in moved]
    expected = sum(s**2 * np.outer(v, v) for s, v in zip(AXES.values(), slopes, strict=True))
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    np.testing.assert_allclose(added, expected, atol=2e-3 * scale.max(), rtol=2e-2)
    for name, error in zip(with_axes.free, np.sqrt(np.diagonal(with_axes.covariance)), strict=True):
        assert float(with_axes.std[name]) == pytest.approx(error)


def test_refine_knows_them_too(quick_compilation):
    plant = PLANTS["fopdt_fit"]
    results = [refine(record(plant, axes=axes), FOPDT(T=4.0)) for axes in (None, AXES)]
    by_identify = identify(record(plant, axes=AXES), "fopdt_fit")
    bare, uncertain = (float(result.std["gain"]) for result in results)
    assert uncertain**2 - bare**2 == pytest.approx((2e-3 * 2.0) ** 2, rel=0.02)
    assert uncertain == pytest.approx(float(by_identify.std["gain"]), rel=1e-4)
