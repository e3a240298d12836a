"""Records, batches and numbers that the tests of the point methods share."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from stepax import METHODS, StepRecord


SYSTEMS = {
    "S1": [0.5],
    "S2": [0.5, 0.5],
    "S3": [0.1, 1.0],
    "S4": [0.5] * 5,
    "S5": [0.2, 0.4, 0.6, 0.8, 1.0],
}
"""The lags of Jakoubek (2009), tables 4 to 8."""
SAMPLES = 4001
LANES = 24


def chain(t, lags):
    """Unit step response in NumPy: equal lags, or lags well apart, by partial fractions."""
    lags, t = np.array([T for T in lags if T > 0]), np.maximum(t, 0.0)
    if len(lags) == 0:
        return np.where(t > 0, 1.0, 0.0)
    if np.ptp(lags) < 1e-12 * lags[0]:
        return special.gammainc(len(lags), t / lags[0])
    if len(lags) == 2:  # exact for any distance
        slow, fast = max(lags), min(lags)
        decay = -np.expm1(-t * (1 / fast - 1 / slow)) / (1 / fast - 1 / slow)
        return -np.expm1(-t / slow) - np.exp(-t / slow) * decay / slow
    weights = [np.prod([a / (a - b) for b in lags if b != a]) for a in lags]
    return 1 - sum(w * np.exp(-t / a) for w, a in zip(weights, lags, strict=True))


def oscillation(t, zeta, omega_n):
    """Unit step response of an underdamped plant."""
    t = np.maximum(t, 0.0)
    root = np.sqrt(1 - zeta**2)
    phase = omega_n * root * t
    return 1 - np.exp(-zeta * omega_n * t) * (np.cos(phase) + zeta / root * np.sin(phase))


def row(response, end, *, gain=2.0, offset=0.0, step_size=1.0, step_time=0.0, unit=1.0, dead=0.0,
        delay=0.0, samples=SAMPLES):  # fmt: skip
    """One record with known levels: a response of unit gain, sampled up to `end`, transformed."""
    t = np.linspace(0.0, end, samples)
    y = offset + gain * step_size * response(t - dead)
    final = offset + gain * step_size
    return t * unit + step_time, y, step_time, step_size, offset, final, delay * unit


def system_row(name, length=10, **options):
    lags = SYSTEMS[name]
    return row(lambda t: chain(t, lags), length * sum(lags), **options)


def transformed(system, length=10):
    """The same plant told in other units: rows and what was changed; last, a delayed plant."""
    d = 0.3 * sum(SYSTEMS[system])
    changes = [
        {},
        {"gain": 1.0},
        {"gain": -2.5},
        {"step_size": 3.0},
        {"step_size": -0.4, "gain": 0.7},
        {"unit": 60.0},
        {"offset": 40.0},
        {"step_time": 12.0, "offset": -7.0},
        {"delay": d, "dead": d},
        {"dead": d},
    ]
    return [system_row(system, length, **change) for change in changes], changes


def check_invariance(result, changes):
    """All but the last, whose dead time is not taken off: parameters in the units of the row."""
    own = {name: getattr(result.model, name) for name in fields(result.model)}
    for k, change in enumerate(changes[:-1]):
        assert result.status._value[k] == result.status._value[0]
        unit, d = change.get("unit", 1.0), change.get("delay", 0.0)
        for name in own.keys() & {"lags", "T"}:
            np.testing.assert_allclose(own[name][k], unit * own[name][0], rtol=2e-6, atol=1e-8)
        for name, factor in (("zeta", 1.0), ("omega_n", 1 / unit), ("n", 1)):
            if name in own:
                np.testing.assert_allclose(own[name][k], factor * own[name][0], rtol=2e-6)
        delay = unit * (own["delay"][0] + d)
        np.testing.assert_allclose(own["delay"][k], delay, atol=3e-6 * unit)
        np.testing.assert_allclose(own["gain"][k], change.get("gain", 2.0), rtol=1e-12)
        np.testing.assert_allclose(own["offset"][k], change.get("offset", 0.0), atol=1e-12)


@functools.cache
def compiled(name, **options):
    """A method over a batch of rows."""

    def one(t, y, step_time, step_size, initial, final, delay):
        record = StepRecord(t, y, step_time, step_size, initial, final)
        return METHODS[name](record, delay=delay, **options)

    return jax.jit(jax.vmap(one))


def run(name, rows, lanes=LANES, dtype=np.float64, **options):
    """Results of the rows; the batch is filled with the last one, so that it compiles once."""
    assert len(rows) <= lanes
    rows = rows + [rows[-1]] * (lanes - len(rows))
    columns = (np.array(x, dtype) for x in zip(*rows, strict=True))
    return jax.tree.map(np.asarray, compiled(name, **options)(*columns))


def fields(model):
    """Names of a model's parameters, its order among them."""
    return [field.name for field in dataclasses.fields(model)]


def lags_of(model, k):
    """Lags of lane k, the zeros left out."""
    own = fields(model)
    if "lags" in own:
        return [float(x) for x in model.lags[k] if x > 0]
    return [float(model.T[k])] * (int(model.n[k]) if "n" in own else 1)


def squared_error(unit_response, system, delay=0.0):
    """Integral of the squared error against a system, both of gain 2, by quadrature."""
    end = 10 * sum(system)
    edges = np.concatenate([np.linspace(0, delay, 20), np.linspace(delay, end, 400)])
    nodes, weights = np.polynomial.legendre.leggauss(10)
    half = 0.5 * np.diff(edges)[:, None]
    t = edges[:-1, None] + half * (1 + nodes)
    error = 2 * (unit_response(t - delay) - chain(t, system))
    return float(np.sum(half * weights * error**2))


def parameters(model):
    """The real parameters of a batch of models, one row a lane."""
    values = [jnp.asarray(getattr(model, name)) for name in fields(model)]
    return jnp.concatenate([x.reshape(*model.gain.shape, -1) for x in values], axis=-1)


def gradient(name, systems, length=10, size=1e-5, samples=300):
    """Of a weighted sum of the parameters along a smooth change of the samples: reverse, and
    by differences. Finite, too, for plants of first order and of equal lags, where curves end."""
    names = [*systems, "S1", "S2"]
    rows = [system_row(system, length, samples=samples) for system in names]
    t, y = (np.array([r[i] for r in rows]) for i in (0, 1))
    wave = y * (2 - y) * np.sin(t + np.arange(len(rows))[:, None])

    def total(y, t):
        values = parameters(METHODS[name](StepRecord(t, y, initial=0.0, final=2.0)).model)
        return jnp.sum((1 + jnp.arange(values.size) % 3) * values)

    both = jax.jit(jax.vmap(jax.value_and_grad(total)))
    value, slope = map(np.asarray, both(y, t))
    assert np.isfinite(slope[np.isfinite(value)]).all() and np.isfinite(value[: len(systems)]).all()
    ahead, behind = (np.asarray(both(y + s * size * wave, t)[0]) for s in (1, -1))
    kept = slice(len(systems))
    return np.sum(slope * wave, axis=1)[kept], ((ahead - behind) / (2 * size))[kept]
