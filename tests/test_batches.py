"""Batches: a queue of lanes gives what one record gives, in groups, nested, differentiated."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from stepax import FOPDT, METHODS, StepRecord, _batches, over_devices, refine
from stepax._batches import in_groups, with_batch


T = np.linspace(-2.0, 40.0, 60)


def outputs(count: int, noise: float = 0.02) -> np.ndarray:
    draw = np.random.default_rng(0)
    lag, delay = draw.uniform(2, 9, (count, 1)), draw.uniform(0, 6, (count, 1))
    g = -np.expm1(-np.maximum(T - delay, 0) / lag)
    return g + noise * draw.standard_normal(g.shape)


def fitted(y, method="fopdt_fit"):
    result = METHODS[method](StepRecord(T, y), errors=False)
    return result.model.T, result.model.delay, result.rmse, result.status


def test_nested_batches_are_one():
    sizes = []

    def together(leaves, batched, size):
        sizes.append((size, batched))
        axes = (_batches.axes_of(batched),)
        return jax.vmap(alone, in_axes=axes, axis_size=size)(leaves)

    def alone(leaves):
        x, y, z = leaves
        return {"sum": x + y + z, "twice": 2 * jnp.sum(x)}

    call = with_batch(alone, together)
    x, y, z = jnp.arange(6.0).reshape(2, 3), jnp.arange(3.0), jnp.asarray(5.0)
    inner = jax.vmap(lambda x, y: call([x, y, z]))
    found = jax.vmap(inner, in_axes=(0, None))(x, y)
    np.testing.assert_array_equal(found["sum"], np.asarray(x) + np.asarray(y) + 5.0)
    np.testing.assert_array_equal(found["twice"], 2 * x)
    assert sizes[-1] == (6, (True, True, False))
    assert call([x[0], y, z])["sum"].shape == (3,)


def test_groups_change_nothing(monkeypatch):
    def function(x, factor, name):
        assert name == "static"
        return {"y": jnp.sin(x) * factor, "name": name}

    grouped = in_groups(function)
    x, factor = jnp.linspace(0, 3, 20), jnp.asarray(2.0)
    every = jax.vmap(lambda x: grouped(x, factor, "static")["y"])
    monkeypatch.setattr(_batches, "GROUP", 7)
    np.testing.assert_allclose(every(x), 2 * np.sin(x), rtol=1e-15)
    slope = jax.grad(
        lambda factor: jnp.sum(jax.vmap(lambda x: grouped(x, factor, "static")["y"])(x))
    )
    np.testing.assert_allclose(slope(factor), np.sum(np.sin(x)), rtol=1e-14)
    np.testing.assert_allclose(
        jax.vmap(jax.grad(lambda x: grouped(x, factor, "static")["y"]))(x),
        2 * np.cos(x),
        rtol=1e-14,
    )


@pytest.fixture(scope="module")
def one_by_one():
    y = outputs(40)
    y[7, 3] = np.nan
    y[11] = 1.0
    alone = jax.jit(fitted)
    return y, jax.tree.map(lambda *x: np.stack(x), *[alone(row) for row in y])


def check(found, expected):
    *numbers, status = found
    *known, code = expected
    for x, y in zip(numbers, known, strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(jax.tree.leaves(status)[0], jax.tree.leaves(code)[0])


def test_a_batch_is_the_records_one_by_one(one_by_one, monkeypatch):
    y, expected = one_by_one
    check(jax.jit(jax.vmap(fitted))(y), expected)
    assert np.isnan(expected[0][[7, 11]]).all()
    monkeypatch.setattr(_batches, "GROUP", 16)
    check(jax.jit(lambda y: jax.vmap(fitted)(y))(y), expected)
    nested = jax.jit(jax.vmap(jax.vmap(fitted)))(y.reshape(4, 10, -1))
    check(jax.tree.map(lambda x: x.reshape(40), nested), expected)


def test_the_gradient_of_a_batch_of_fits_inside_a_loss():
    y = outputs(6)

    def loss(scale):
        start = FOPDT(T=5.0, delay=2.0)
        models = jax.vmap(lambda y: refine(StepRecord(T, scale * y), start).model)(jnp.asarray(y))
        return jnp.sum(models.gain * models.T)

    step = 1e-4
    slope = (loss(1 + step) - loss(1 - step)) / (2 * step)
    np.testing.assert_allclose(jax.grad(loss)(1.0), slope, rtol=1e-6)


def test_over_devices_on_one():
    call = over_devices(jax.vmap(lambda x: {"twice": 2 * x}))
    np.testing.assert_array_equal(call(jnp.arange(5.0))["twice"], 2 * np.arange(5.0))


TWO = """
import jax, numpy as np
jax.config.update("jax_enable_x64", True); jax.config.update("jax_num_cpu_devices", 2)
from stepax import METHODS, StepRecord, over_devices
t = np.linspace(0, 30, 50); T = np.linspace(2, 8, 7)[:, None]
y = 1 - np.exp(-t / T)
def fit(y):
    result = METHODS["fopdt_fit"](StepRecord(t, y))
    return result.model.T, result.std["T"]
found, errors = over_devices(jax.vmap(fit))(y)
assert found.shape == (7,) and np.allclose(found, T[:, 0], rtol=1e-6), found
assert np.all(errors < 1e-6), errors
"""


@pytest.mark.long
def test_over_two_devices_with_an_odd_number_of_records():
    """With standard errors: LAPACK's QR would never return there."""
    subprocess.run([sys.executable, "-c", TWO], check=True, timeout=600)
