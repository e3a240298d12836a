"""Running areas against quadrature, and the oscillation read off them against its plant."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from stepax import SOPDT, StepRecord
from stepax.records._areas import FEWEST_LOBES, oscillation, running_area
from stepax.records._record import compact


pytestmark = pytest.mark.usefixtures("quick_compilation")
T = np.sort(np.random.default_rng(0).uniform(-2, 30, 300))
DAMPINGS = (0.05, 0.2, 0.4, 0.7)


def test_area_of_straight_lines_between_rows():
    y = np.where(T >= 0, np.sin(T), 0.0)
    area = running_area(StepRecord(T, y), jnp.asarray(y))
    x = np.linspace(0, T[-1], 77)

    def exact(x):
        at = np.append(T[(T > 0) & (T < x)], x)
        at = np.append(0.0, at)
        return np.trapezoid(np.interp(at, T, y), at)

    np.testing.assert_allclose(area(jnp.asarray(x)), [exact(v) for v in x], atol=1e-12)
    a, b = jnp.asarray(3.0), jnp.asarray([5.0, 9.0])
    expected = [2 * (v - 3) - (exact(v) - exact(3.0)) for v in (5.0, 9.0)]
    np.testing.assert_allclose(area.above(jnp.asarray(2.0), a, b), expected, atol=1e-12)
    np.testing.assert_allclose(area.mean(a, b[1]), (exact(9.0) - exact(3.0)) / 6, atol=1e-12)


@functools.cache
def compiled():
    def one(t, y, noise, rows):
        record = compact(StepRecord(t, y, rows=rows))
        area = running_area(record, jnp.where(record.elapsed >= 0, record.y, 0))
        onset = area.onset(jnp.asarray(0.2), record.count)
        return oscillation(area, onset, noise, record.count)

    return jax.jit(jax.vmap(one))


def found(noise=0.0, rows=None):
    """Of all dampings, with the last of the rows padding."""
    size, rows = 500, rows or 500
    t = np.linspace(0, 40, rows)
    t, more = np.append(t, np.full(size - rows, -1e3)), size - rows
    plants = [SOPDT(zeta=zeta, omega_n=1.0, delay=1.5) for zeta in DAMPINGS]
    y = np.stack([np.asarray(plant.step_response(jnp.asarray(t))) for plant in plants])
    y = y + noise * np.random.default_rng(1).standard_normal((len(plants), size))
    y[:, rows:] = np.nan if more else 0
    lanes = np.tile(t, (len(plants), 1)), y, np.full(len(plants), noise * np.sqrt(0.08))
    return compiled()(*lanes, np.full(len(plants), rows))


def test_period_and_level_of_an_oscillation():
    result = found()
    swings = np.asarray(result.lobes) >= FEWEST_LOBES
    assert list(swings) == [True, True, True, False]
    expected = 2 * np.pi / np.sqrt(1 - np.array(DAMPINGS[:3]) ** 2)
    np.testing.assert_allclose(result.period[:3], expected, rtol=2e-3)
    np.testing.assert_allclose(result.level[:3], 1.0, atol=2e-3)


def test_noise_moves_the_period_little():
    result = found(0.05)
    expected = 2 * np.pi / np.sqrt(1 - np.array(DAMPINGS[:2]) ** 2)
    np.testing.assert_allclose(result.period[:2], expected, rtol=0.05)
    np.testing.assert_allclose(result.level[:3], 1.0, atol=0.05)


def test_padding_changes_nothing():
    for ours, theirs in zip(found(rows=400), compiled_bare(400), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)


def compiled_bare(rows):
    """The same rows with nothing behind them."""
    t = np.linspace(0, 40, rows)
    plants = [SOPDT(zeta=zeta, omega_n=1.0, delay=1.5) for zeta in DAMPINGS]
    y = np.stack([np.asarray(plant.step_response(jnp.asarray(t))) for plant in plants])
    lanes = np.tile(t, (len(plants), 1)), y, np.zeros(len(plants))
    return compiled()(*lanes, np.full(len(plants), rows))
