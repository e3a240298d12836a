"""Responses to sampled inputs, both holds: against SciPy, mpmath and brute force."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath as mp
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


@rational
def test_lines_between_samples_agree_with_scipy(model):
    y = signal.lsim(model.to_scipy(), U, T, interp=True)[1]
    y[0] = 0  # SciPy lets a plant without a lag jump with its input at the first sample
    assert np.allclose(model.respond(T, U, "first"), model.offset + y, rtol=0, atol=1e-10)


def matrices(A, dt, digits=60):
    """e^(A dt) by squaring in many digits."""
    with mp.workdps(digits):
        short = mp.eye(A.rows)
        for k in range(30, 0, -1):
            short = mp.eye(A.rows) + A * (dt / mp.mpf(2) ** 40 / k) * short
        for _ in range(40):
            short = short * short
        return np.array(short.tolist(), dtype=np.longdouble)


def chain_in_many_digits(lags, dt, delay, u, hold):
    """Sample by sample in 64 bits of mantissa with matrices of 60 digits."""
    with mp.workdps(60):
        A = mp.zeros(len(lags) + 2)
        A[1, 0] = 1
        for k, lag in enumerate(mp.mpf(float(x)) for x in lags):
            A[k + 2, k + 1], A[k + 2, k + 2] = 1 / lag, -1 / lag
        whole = int(mp.floor(mp.mpf(delay) / mp.mpf(dt)))
        rest = mp.mpf(dt) * (whole + 1) - mp.mpf(delay)
        over, part = matrices(A, mp.mpf(dt)), matrices(A, rest)[-1]
    u, state = u.astype(np.longdouble), np.zeros(len(lags) + 2, np.longdouble)
    y = np.zeros(u.size, np.longdouble)
    for k in range(u.size - 1):
        state[0] = (u[k + 1] - u[k]) / dt if hold == "first" else 0
        state[1] = u[k]
        if k + whole + 1 < u.size:
            y[k + whole + 1] = part @ state
        state = over @ state
    return y.astype(float)


CHAINS = {
    "equal": [1.5] * 8,
    "nearly equal": [1.0, 1 + 1e-9, 1 + 1e-6, 1.001],
    "stiff": [1e5, 0.1, 3e4, 0.11],
}


def check_chain(lags, count, delay):
    u = np.sign(np.random.default_rng(0).normal(size=count))
    for hold in ("zero", "first"):
        truth = chain_in_many_digits(lags, 0.125, delay, u, hold)
        y = PTn(lags=np.array(lags), delay=delay).respond(np.arange(count) * 0.125, u, hold)
        assert np.max(np.abs(y - truth)) <= 1e-10 * np.max(np.abs(truth))


@pytest.mark.parametrize("lags", CHAINS.values(), ids=CHAINS)
def test_no_digits_are_lost(lags):
    """Equal lags, nearly equal ones, a ratio of a million; a dead time between samples."""
    check_chain(lags, 300, 0.7)


@pytest.mark.long
@pytest.mark.parametrize("lags", CHAINS.values(), ids=CHAINS)
def test_no_digits_are_lost_in_long_records(lags):
    check_chain(lags, 100_000, 0.7)


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("name", ["Hudzovic", "SOPDTZero", "IPDT"])
def test_slopes_against_differences(name, hold):
    """With respect to parameters, a dead time between samples, and the input; both modes."""
    t, h = jnp.arange(40) * 0.25, 1e-6
    u = jnp.asarray(np.random.default_rng(3).normal(size=40))
    model = dataclasses.replace(MODELS[name], delay=jnp.asarray(0.6))
    numbers, order = eqx.partition(model, eqx.is_inexact_array)

    @jax.jit
    def last(numbers, u):
        return jnp.sum(eqx.combine(numbers, order).respond(t, u, hold)[-7:])

    way = (jax.tree.map(jnp.ones_like, numbers), jnp.cos(t))
    ends = [last(*jax.tree.map(lambda x, d, s=s: x + s * d, (numbers, u), way)) for s in (h, -h)]
    difference = (ends[0] - ends[1]) / (2 * h)
    _, forward = jax.jvp(last, (numbers, u), way)
    backward = jax.grad(last, (0, 1))(numbers, u)
    inner = sum(jnp.vdot(a, b) for a, b in zip(*map(jax.tree.leaves, (backward, way)), strict=True))
    assert np.isclose(forward, difference, rtol=1e-6)
    assert np.isclose(inner, forward, rtol=1e-11)


def test_what_respond_is_not_given():
    model = FOPDT(T=1.0)
    for t, u in ((T, U[:-1]), (T[None], U[None]), (T, np.stack([U, U]))):
        with pytest.raises(ValueError, match=r"for several use jax\.vmap"):
            model.respond(t, u)
    with pytest.raises(ValueError, match=r"increase.*jax\.vmap"):
        model.respond(T[::-1], U)
    with pytest.raises(ValueError, match="'zero', 'first'"):
        model.respond(T, U, "second")
    traced = jax.jit(lambda t, u: model.respond(t, u))
    assert np.all(np.isnan(traced(T[::-1], U)))
    for t in (T, UNEVEN):
        assert np.allclose(traced(t, U), model.respond(t, U), rtol=0, atol=1e-13)
