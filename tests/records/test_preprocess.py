"""Smoothing, levels of noise and quantisation, against plain loops and known signals."""

import functools
import math
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from stepax import Hudzovic, noise_level, preprocess, sliding_average, smooth
from stepax.records._preprocess import estimate_levels, quantisation


SAMPLES = 60
spans = pytest.mark.parametrize("span", [0.1, 0.2, 0.35, 1.0])


@functools.cache
def compiled_smooth(span):
    return jax.jit(lambda t, y: smooth(t, y, span))


def uneven(seed=0, samples=SAMPLES):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(0.2, 3.0, samples)) - 5


def signal(seed=0, samples=SAMPLES):
    return np.random.default_rng(100 + seed).normal(size=samples)


def loess(t, y, at, span):
    """Cleveland (1979): tricube weights over the ceil(span N) nearest, local parabola."""
    count = math.ceil(span * len(t))
    values = []
    for x in at:
        nearest = np.argsort(np.abs(t - x), kind="stable")[:count]
        distance = np.abs(t[nearest] - x)
        weight = (1 - (distance / distance.max()) ** 3) ** 3
        basis = np.stack([np.ones(count), t[nearest] - x, (t[nearest] - x) ** 2], axis=1)
        root = np.sqrt(weight)[:, None]
        values.append(np.linalg.lstsq(root * basis, root[:, 0] * y[nearest], rcond=None)[0][0])
    return np.array(values)


# ---- LOESS


@spans
def test_smooth_is_loess(span):
    t, y = uneven(), signal()
    assert np.allclose(compiled_smooth(span)(t, y), loess(t, y, t, span), rtol=0, atol=1e-9)


@spans
def test_smooth_keeps_parabolas_up_to_the_ends(span):
    t = uneven()
    y = 3 - 2 * t + 0.25 * t * t
    assert np.allclose(compiled_smooth(span)(t, y), y, rtol=1e-10, atol=1e-10)


def test_smooth_is_linear_in_the_signal_and_takes_any_unit_of_time():
    t, y = uneven(), signal()
    function = compiled_smooth(0.2)
    once = function(t, y)
    assert np.allclose(function(t, 7 * y - 3), 7 * once - 3, rtol=0, atol=1e-11)
    assert np.allclose(function(1e-6 * t + 2, y), once, rtol=0, atol=1e-6)
    assert np.allclose(function(1e6 * t, y), once, rtol=0, atol=1e-11)


def test_smooth_reduces_noise():
    t = np.linspace(0, 10, SAMPLES)
    clean = np.sin(0.5 * t)
    smoothed = compiled_smooth(0.35)(t, clean + 0.1 * signal())
    assert np.std(smoothed - clean) < 0.06


def test_smooth_in_float32():
    t, y = uneven().astype(np.float32), signal().astype(np.float32)
    single = smooth(t, y)
    assert single.dtype == jnp.float32
    assert np.allclose(single, loess(t.astype(float), y.astype(float), t, 0.2), rtol=0, atol=1e-3)


@jax.jit
def smooth_by(span):
    """Of an uneven record, with a traced span."""
    t = jnp.sort(jax.random.uniform(jax.random.key(0), (80,))) * 20
    return smooth(t, jnp.tanh(t / 5) + 0.05 * jnp.sin(40 * t), span)


@pytest.mark.parametrize("span", [0.2, 0.35, 1.0])
def test_a_traced_span_smooths_as_a_known_one(span):
    t = jnp.sort(jax.random.uniform(jax.random.key(0), (80,))) * 20
    known = compiled_smooth(span)(t, jnp.tanh(t / 5) + 0.05 * jnp.sin(40 * t))
    assert np.allclose(smooth_by(span), known, rtol=0, atol=1e-12)


def test_a_traced_span_has_a_derivative():
    h, slope = 1e-6, jax.jit(jax.jacfwd(smooth_by))(0.331)
    difference = (smooth_by(0.331 + h) - smooth_by(0.331 - h)) / (2 * h)
    assert np.allclose(slope, difference, rtol=0, atol=1e-7) and np.abs(slope).max() > 0.1
    assert np.isnan(smooth_by(0.04)).all() and np.isnan(smooth_by(1.1)).all()


def test_smooth_under_vmap_and_grad():
    t = np.stack([uneven(k) for k in range(3)])
    y = np.stack([signal(k) for k in range(3)])
    rows = jax.jit(jax.vmap(smooth))(t, y)
    for row, alone in zip(rows, map(compiled_smooth(0.2), t, y), strict=True):
        assert np.allclose(row, alone, rtol=0, atol=1e-12)
    seeds = signal(9)

    @jax.jit
    def slopes(t, y):
        return jax.grad(lambda t, y: seeds @ smooth(t, y), argnums=(0, 1))(t, y)

    by_t, by_y = slopes(t[0], y[0])
    for k in (0, 7, SAMPLES - 1):
        h = 1e-5 * (np.arange(SAMPLES) == k)
        value = lambda t, y: seeds @ compiled_smooth(0.2)(t, y)  # noqa: E731
        difference = (value(t[0] + h, y[0]) - value(t[0] - h, y[0])) / 2e-5
        assert np.allclose(by_t[k], difference, rtol=1e-5, atol=1e-6)
        difference = (value(t[0], y[0] + h) - value(t[0], y[0] - h)) / 2e-5
        assert np.allclose(by_y[k], difference, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("span", [0.0, -0.1, 1.1, float("nan")])
def test_spans_out_of_range(span):
    with pytest.raises(ValueError, match="span must lie in"):
        smooth(uneven(), signal(), span)


def test_too_small_a_window():
    with pytest.raises(ValueError, match="at least 4"):
        smooth(uneven(), signal(), 0.05)


def test_unequal_lengths():
    """A sentence of our own, or of the type checker when that is on."""
    with pytest.raises((TypeError, ValueError)):
        smooth(uneven(), signal()[:-1])
    with pytest.raises((TypeError, ValueError)):
        preprocess(uneven()[None], signal()[None])


# ---- moving average


def moving_average(y, width):
    half = width // 2
    return [y[max(0, k - half) : k + half + 1].mean() for k in range(len(y))]


@pytest.mark.parametrize("width", [1, 2, 3, 10, 11, 59, 60, 119, 500])
def test_sliding_average(width):
    y = signal()
    assert np.allclose(sliding_average(y, width), moving_average(y, width), rtol=0, atol=1e-13)


def test_a_width_of_10_is_one_of_11():
    assert np.array_equal(sliding_average(signal(), 10), sliding_average(signal(), 11))


@pytest.mark.parametrize("width", [0, -1])
def test_widths_are_whole_numbers(width):
    with pytest.raises(ValueError, match="whole number"):
        sliding_average(signal(), width)


def test_batched_beside_loess_in_one_program():
    """Apart from this process, which a crash of XLA's would end."""
    code = """
import jax, numpy as np
from stepax import PTn, sliding_average, smooth

def both(t, y):
    y = y + PTn(lags=np.full(8, 0.1)).step_response(t)
    return sliding_average(y, 10).sum() + smooth(t, y, 0.2).sum()

jax.config.update("jax_enable_x64", True)
t = np.linspace(0, 1, 253) * np.linspace(1, 2, 512)[:, None]
y = np.random.default_rng(0).random(t.shape)
batch = jax.jit(lambda *rows: jax.lax.map(lambda row: both(*row), rows, batch_size=32))
for _ in range(10):
    assert np.all(np.isfinite(batch(t, y)))
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_sliding_average_takes_one_row():
    with pytest.raises((TypeError, ValueError)):
        sliding_average(np.zeros((2, 5)), 3)


# ---- preprocess


def test_preprocess_evaluates_at_the_times_it_returns():
    t, y = uneven(), signal()
    at, smoothed = preprocess(t, y, span=0.35)
    assert np.allclose(at, np.linspace(t[0], t[-1], SAMPLES), rtol=0, atol=1e-12)
    assert np.allclose(smoothed, loess(t, y, np.asarray(at), 0.35), rtol=0, atol=1e-9)
    parabola = lambda t: 1 + t - 0.1 * t * t  # noqa: E731
    at, smoothed = preprocess(t, parabola(t))
    assert np.allclose(smoothed, parabola(at), rtol=1e-10, atol=1e-10)


def test_preprocess_by_the_moving_average():
    t, y = uneven(), signal()
    at, smoothed = preprocess(t, y, smoother="average", width=7)
    expected = moving_average(np.interp(np.linspace(t[0], t[-1], SAMPLES), t, y), 7)
    assert np.allclose(smoothed, expected, rtol=0, atol=1e-11)
    assert np.allclose(np.diff(at), (t[-1] - t[0]) / (SAMPLES - 1), rtol=1e-10, atol=0)


@pytest.mark.parametrize("smoother", ["loess", "average"])
def test_preprocess_keeps_the_times_when_asked(smoother):
    t, y = uneven(), signal()
    at, smoothed = preprocess(t, y, smoother=smoother, equispaced=False)
    expected = loess(t, y, t, 0.2) if smoother == "loess" else moving_average(y, 11)
    assert np.array_equal(at, t)
    assert np.allclose(smoothed, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("smoother", ["loess", "average"])
def test_preprocess_under_transformations(smoother):
    t = np.stack([uneven(k) for k in range(2)])
    y = np.stack([signal(k) for k in range(2)])

    def energy(t, y):
        at, smoothed = preprocess(t, y, smoother=smoother)
        return jnp.sum(smoothed**2), (at, smoothed)

    slopes, (at, smoothed) = jax.jit(jax.vmap(jax.grad(energy, (0, 1), has_aux=True)))(t, y)
    assert all(np.isfinite(x).all() for x in slopes)
    expected = preprocess(t[1], y[1], smoother=smoother)
    assert np.allclose(at[1], expected[0], rtol=0, atol=1e-12)
    assert np.allclose(smoothed[1], expected[1], rtol=0, atol=1e-12)


def test_unknown_smoother():
    with pytest.raises(ValueError, match="'loess' or 'average', got 'spline'"):
        preprocess(uneven(), signal(), smoother="spline")


# ---- noise, quantisation, levels


def response(t):
    return Hudzovic(T=4.0, r=0.2, n=3).step_response(jnp.asarray(t))


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("sigma", [1e-3, 0.02, 3.0])
def test_noise_level_of_white_noise(even, sigma):
    t = np.linspace(0, 100, 2000) if even else uneven(1, 2000) / 32
    y = response(t) + sigma * signal(2, 2000)
    assert 0.9 * sigma < jax.jit(noise_level)(t, y) < 1.1 * sigma


def test_noise_level_of_a_smooth_record():
    t = np.linspace(0, 100, 2000)
    assert noise_level(t, np.asarray(response(t))) < 1e-7
    assert noise_level(t, 1 - t + t**2 - 0.01 * t**3) < 1e-8


def test_noise_level_scales_and_ignores_offsets():
    t, y = uneven(), signal()
    level = noise_level(t, y)
    assert np.allclose(noise_level(3 * t - 1, 40 - 5 * y), 5 * level, rtol=1e-9, atol=0)
    assert np.allclose(jax.jit(jax.vmap(noise_level))(t[None], y[None]), level, rtol=1e-12, atol=0)
    assert np.isfinite(jax.grad(noise_level, 1)(t, y)).all()


@pytest.mark.parametrize("step", [0.5, 0.05, 1 / 64])
def test_quantisation_of_rounded_data(step):
    y = np.asarray(response(np.linspace(0, 60, 1000))) * 3 - 1
    assert np.allclose(quantisation(jnp.round(y / step) * step), step, rtol=1e-9, atol=0)


def test_quantisation_of_continuous_data():
    assert quantisation(jnp.asarray(signal(3, 500))) == 0
    assert quantisation(response(np.linspace(0, 20, 500))) == 0
    assert quantisation(jnp.ones(50)) == 0


def test_levels_of_a_noise_free_record():
    """The last sample is nearer to the limit than any mean."""
    t = np.linspace(-5, 60, 500)
    y = 40 - 3 * np.asarray(response(t))
    initial, final = estimate_levels(jnp.asarray(t), jnp.asarray(y), jnp.asarray(0.0))
    assert np.allclose((initial, final), (40, y[-1]), rtol=1e-12, atol=0)


def test_levels_of_a_noisy_record():
    t = np.linspace(-50, 200, 2000)
    y = 40 - 3 * np.asarray(response(t)) + 0.1 * signal(4, 2000)
    initial, final = estimate_levels(jnp.asarray(t), jnp.asarray(y), jnp.asarray(0.0))
    assert np.allclose(initial, np.mean(y[t <= 0]), rtol=1e-12, atol=0)
    assert np.allclose(final, np.mean(y[-100:]), rtol=1e-12, atol=0)
