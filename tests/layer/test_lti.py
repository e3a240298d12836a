"""A plant as a layer: in one pass, in pieces, in training."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from stepax import FOPDT, IPDT, SOPDT, EqualLag, Hudzovic, LTILayer, PTn, SOPDTZero


DT, N = 0.25, 1007
T = np.arange(N) * DT
U = np.cumsum(np.random.default_rng(0).normal(size=N)) / 5 + 1
PLANTS = {
    "Hudzovic": Hudzovic(T=1.0, r=0.2, n=4, delay=1.6, gain=2.0, offset=3.0),
    "PTn": PTn(lags=np.array([3.0, 0.0, 1e-9, 3.0, 1e3])),
    "PTn, no lag": PTn(lags=np.array([0.0]), delay=0.3),
    "FOPDT": FOPDT(T=20.0, delay=3 * DT),
    "SOPDT": SOPDT(zeta=0.2, omega_n=1.5, delay=0.1),
    "SOPDTZero": SOPDTZero(zeta=0.7, omega_n=1.5, lead=-1.0),
    "IPDT": IPDT(T=2.0, delay=1.9, gain=0.1),
}
families = pytest.mark.parametrize("name", PLANTS)
holds = pytest.mark.parametrize("hold", ["zero", "first"])


@families
@holds
def test_one_pass_is_the_response_of_the_model(name, hold):
    y = LTILayer(PLANTS[name], hold=hold)(U, DT)
    assert np.allclose(y, PLANTS[name].respond(T, U, hold), rtol=1e-13, atol=0)


EVERY = [
    (name, hold, size) for name in PLANTS for hold in ("zero", "first") for size in (1, 7, 1000)
]
SOME = [
    ("Hudzovic", "first", 1),
    ("Hudzovic", "zero", 7),
    ("SOPDT", "first", 7),
    ("IPDT", "zero", 1000),
]


@pytest.mark.parametrize(
    ("name", "hold", "size"),
    [case if case in SOME else pytest.param(*case, marks=pytest.mark.long) for case in EVERY],
)
def test_pieces_are_one_pass(name, hold, size):
    layer = LTILayer(PLANTS[name], hold=hold, buffer=8)
    whole = layer(U, DT)
    state, parts = layer.rest(DT), []
    for start in range(0, 60 if size == 1 else N, size):
        y, state = layer.run(U[start : start + size], DT, state)
        parts.append(y)
    y = np.concatenate(parts)
    scale = np.max(np.abs(whole - layer.model.offset))
    assert np.allclose(y, whole[: y.size], rtol=0, atol=1e-12 * scale)
    assert state.begun and not state.delay_too_long


def test_a_piece_of_nothing():
    layer = LTILayer(PLANTS["FOPDT"], buffer=3)
    y, state = layer.run(U[:0], DT, layer.rest(DT))
    assert y.shape == (0,) and not state.begun
    assert layer(U[:1], DT).shape == (1,) and layer(U[:0], DT).shape == (0,)


def test_one_sample_at_a_time_inside_a_scan():
    layer = LTILayer(PLANTS["Hudzovic"], buffer=6)

    @jax.jit
    def run(layer, u):
        def step(state, u):
            y, state = layer.run(u[None], DT, state)
            return state, y[0]

        return jax.lax.scan(step, layer.rest(DT), u)[1]

    assert np.allclose(run(layer, jnp.asarray(U)), layer(U, DT), rtol=0, atol=1e-11)


def test_a_dead_time_longer_than_the_buffer():
    """An error that says how long it must be; traced NaN, and the reason in the state."""
    layer = LTILayer(FOPDT(T=2.0, delay=1.1), buffer=3)
    with pytest.raises(ValueError, match="buffer=4"):
        layer.rest(DT)
    with pytest.raises(ValueError, match="buffer=4"):
        layer.run(U, DT, LTILayer(FOPDT(T=2.0), buffer=3).rest(DT))

    @jax.jit
    def run(delay):
        layer = LTILayer(FOPDT(T=2.0, delay=delay), buffer=3)
        return layer.run(jnp.asarray(U), DT, layer.rest(DT))

    y, state = run(1.1)
    assert np.all(np.isnan(y)) and state.delay_too_long
    y, state = run(0.99)
    assert np.all(np.isfinite(y)) and not state.delay_too_long


def test_a_real_order_runs_in_one_pass_only():
    layer = LTILayer(EqualLag(T=1.0, n=2.5))
    assert layer(U, DT).shape == (N,)
    with pytest.raises(ValueError, match="no finite state"):
        layer.rest(DT)


def test_what_a_layer_is_not_given():
    with pytest.raises(ValueError, match=r"'zero', 'first', got 'second'"):
        LTILayer(FOPDT(T=1.0), hold="second")
    with pytest.raises(ValueError, match="buffer must be a whole number"):
        LTILayer(FOPDT(T=1.0), buffer=-1)
    layer = LTILayer(FOPDT(T=1.0))
    for call in (lambda u: layer(u, DT), lambda u: layer.run(u, DT, layer.rest(DT))):
        with pytest.raises(ValueError, match=r"shape \(2, 3\).*jax\.vmap"):
            call(np.ones((2, 3)))


def test_batches_of_plants_and_of_signals():
    """One compiled call; plants of several orders are padded with lags of 0."""
    lags = jnp.array([[2.0, 1.0, 0.0], [3.0, 0.0, 0.0]])
    signals = jnp.stack([U[:40], U[40:80]])
    layers = LTILayer(PTn(lags=lags, delay=jnp.array([0.1, 0.6])), buffer=4)
    axes = eqx.filter(layers, eqx.is_array)
    axes = jax.tree.map(lambda x: 0 if x.shape[:1] == (2,) else None, axes)

    def both(layer, u):
        return layer(u, DT), layer.run(u, DT, layer.rest(DT))[0]

    whole, pieces = jax.jit(jax.vmap(jax.vmap(both, (None, 0)), (axes, None)))(layers, signals)
    assert whole.shape == (2, 2, 40)
    assert np.allclose(whole, pieces, rtol=0, atol=1e-12)
    for k, delay in enumerate((0.1, 0.6)):
        one = LTILayer(PTn(lags=lags[k], delay=delay))(signals[1], DT)
        assert np.allclose(whole[k, 1], one, rtol=0, atol=1e-12)


@holds
def test_slopes_of_a_piece(hold):
    """Of what comes out later, with respect to parameters, inputs and the state before."""
    model = PLANTS["Hudzovic"]
    layer = LTILayer(model, hold=hold, buffer=8)
    _, state = layer.run(U[:50], DT, layer.rest(DT))

    @jax.jit
    def last(T, delay, u, inner):
        changed = dataclasses.replace(model, T=T, delay=delay)
        here = dataclasses.replace(state, inner=inner)
        return LTILayer(changed, hold=hold, buffer=8).run(u, DT, here)[0][-1]

    at = (jnp.asarray(1.1), jnp.asarray(1.63), jnp.asarray(U[50:80]), state.inner)
    h = 1e-6
    for k, slope in enumerate(jax.jit(jax.grad(last, (0, 1, 2, 3)))(*at)):
        way = jnp.ones_like(at[k])
        ends = [last(*at[:k], at[k] + s * h * way, *at[k + 1 :]) for s in (1, -1)]
        assert np.isclose(jnp.sum(slope), (ends[0] - ends[1]) / (2 * h), rtol=1e-6, atol=1e-8)
