"""Records, batches and numbers that the tests of the point methods share."""

import functools
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

from stepax import METHODS, StepRecord, _contour


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


def system_row(name, **options):
    lags = SYSTEMS[name]
    return row(lambda t: chain(t, lags), 10 * sum(lags), **options)


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


def lags_of(model, k):
    """Lags of lane k, the zeros left out."""
    own = type(model).__dataclass_fields__
    if "lags" in own:
        return [float(x) for x in model.lags[k] if x > 0]
    return [float(model.T[k])] * (int(model.n[k]) if "n" in own else 1)


def squared_error(lags, system, delay=0.0):
    """Integral of the squared error of a model against a system, both of gain 2, by quadrature."""
    end = 10 * sum(system)
    edges = np.concatenate([np.linspace(0, delay, 20), np.linspace(delay, end, 400)])
    nodes, weights = np.polynomial.legendre.leggauss(10)
    half = 0.5 * np.diff(edges)[:, None]
    t = edges[:-1, None] + half * (1 + nodes)
    error = 2 * (chain(t - delay, lags) - chain(t, system))
    return float(np.sum(half * weights * error**2))


def parameters(model):
    """The real parameters of a batch of models, one row a lane."""
    values = [jnp.asarray(getattr(model, name)) for name in type(model).__dataclass_fields__]
    return jnp.concatenate([x.reshape(*model.gain.shape, -1) for x in values], axis=-1)


@pytest.fixture(scope="module", autouse=True)
def quick_compilation():
    """The poles in a loop, as on the command line: compiling is most of the time of these tests."""
    with pytest.MonkeyPatch.context() as patch:
        if not os.environ.get("STEPAX_TEST_OPTIMISED"):
            patch.setattr(_contour, "_looped", True)
        yield
