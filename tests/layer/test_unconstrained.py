"""Free numbers of every family: a bijection that no step leaves."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from stepax import (
    FOPDT,
    IPDT,
    SOPDT,
    EqualLag,
    Hudzovic,
    PTn,
    Sani,
    SOPDTZero,
    from_unconstrained,
    to_unconstrained,
)


LEVELS = {"gain": -3.0, "offset": 40.0, "delay": 2.7}
PLANTS = {
    "Hudzovic": Hudzovic(T=1.7, r=0.3, n=3, **LEVELS),
    "Hudzovic, array order": Hudzovic(T=1.7, r=0.1, n=jnp.asarray(5), **LEVELS),
    "Sani": Sani(T=1.7, r=0.3, n=3, **LEVELS),
    "EqualLag": EqualLag(T=1.7, n=3, **LEVELS),
    "EqualLag, real n": EqualLag(T=1.7, n=2.5, **LEVELS),
    "PTn": PTn(lags=np.array([2.0, 0.1, 0.7]), **LEVELS),
    "FOPDT": FOPDT(T=1.7, **LEVELS),
    "SOPDT": SOPDT(zeta=0.4, omega_n=0.6, **LEVELS),
    "SOPDTZero": SOPDTZero(zeta=1.4, omega_n=0.6, lead=-0.8, **LEVELS),
    "IPDT": IPDT(T=1.7, **LEVELS),
}
families = pytest.mark.parametrize("name", PLANTS)


def same(a, b, rtol=1e-13):
    return all(
        np.allclose(x, y, rtol=rtol, atol=0)
        for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    )


def moved(model, factor):
    """Another model of the family, with its own parameters of the dimension of time scaled."""
    times = [name for name in model.parameter_names if model.dimension(name) == "time"]
    changes = {name: getattr(model, name) * factor for name in times}
    if "omega_n" in model.parameter_names:
        changes["omega_n"] = model.omega_n / factor
    return dataclasses.replace(model, **changes)


@families
@pytest.mark.parametrize("factor", [1e-12, 1e-3, 1.0, 1e12])
def test_round_trip_from_the_model(name, factor):
    model = moved(PLANTS[name], factor)
    free = to_unconstrained(model)
    assert jax.tree.structure(free) == jax.tree.structure(model)
    assert same(from_unconstrained(free), model, rtol=1e-10)


@families
def test_round_trip_from_free_numbers(name):
    """Far beyond what is a logarithm too."""
    model, rng = PLANTS[name], np.random.default_rng(0)
    there_and_back = jax.jit(lambda x: to_unconstrained(from_unconstrained(x)))
    for scale in (0.3, 3.0, 30.0):
        free = jax.tree.map(
            lambda x, s=scale: x + s * rng.normal(size=x.shape) if eqx.is_inexact_array(x) else x,
            to_unconstrained(model),
        )
        back = there_and_back(free)
        numbers = eqx.filter(back, eqx.is_inexact_array)
        # n as a share of its range loses digits beside its end
        assert same(numbers, eqx.filter(free, eqx.is_inexact_array), rtol=1e-9)


@pytest.mark.parametrize("r", [1e-9, 1e-3, 0.5, 0.9, 1 - 1e-7])
def test_the_whole_range_of_a_shape(r):
    for model in (Sani(T=2.0, r=r, n=4), Hudzovic(T=2.0, r=r / 3, n=4)):
        assert same(from_unconstrained(to_unconstrained(model)), model, rtol=1e-7)
        again = from_unconstrained(to_unconstrained(model))
        assert np.allclose(1 - again.ratio, 1 - model.ratio, rtol=1e-7)


def test_ends_of_ranges_stay():
    """Exactly, and a gradient step leaves them there."""
    ends = [
        Hudzovic(T=2.0, r=0.0, n=4),
        Sani(T=2.0, r=0.0, n=4),
        Sani(T=2.0, r=1.0, n=4),
        EqualLag(T=2.0, n=40.0),
        PTn(lags=np.array([3.0, 0.0])),
        IPDT(T=0.0),
    ]
    t, kept = jnp.linspace(0.1, 20, 5), ("r", "n", "delay")
    for model in ends:
        free = to_unconstrained(model)
        slopes = eqx.filter_grad(lambda x, t: jnp.sum(from_unconstrained(x).step_response(t)))(
            free, t
        )
        assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(slopes))
        after = from_unconstrained(eqx.apply_updates(free, jax.tree.map(lambda x: -x, slopes)))
        for name in set(kept) & set(model.parameter_names):
            assert getattr(after, name) == getattr(model, name), (model, name)
    assert after.T == 0
    lags = from_unconstrained(to_unconstrained(ends[4])).lags
    assert lags[1] == 0 and np.isclose(lags[0], 3)


def trained(model, optimiser, steps, t, target, key):
    """Least free admissibility along the way, and the last free numbers, from a random start."""
    free = to_unconstrained(model)
    leaves, tree = jax.tree.flatten(eqx.filter(free, eqx.is_inexact_array))
    keys = jax.random.split(key, len(leaves))
    leaves = [x + 3 * jax.random.normal(k, x.shape, x.dtype) for k, x in zip(keys, leaves)]  # noqa: B905
    numbers, rest = jax.tree.unflatten(tree, leaves), eqx.filter(free, eqx.is_inexact_array, True)

    def loss(numbers):
        y = from_unconstrained(eqx.combine(numbers, rest)).step_response(t)
        return jnp.mean((y - target) ** 2)

    def step(carry, _):
        numbers, memory = carry
        value, slopes = jax.value_and_grad(loss)(numbers)
        updates, memory = optimiser.update(slopes, memory, numbers)
        numbers = optax.apply_updates(numbers, updates)
        model = from_unconstrained(eqx.combine(numbers, rest))
        finite = jnp.isfinite(value) & model.admissible
        for x in jax.tree.leaves(slopes):
            finite = finite & jnp.all(jnp.isfinite(x))
        return (numbers, memory), finite

    start = (numbers, optimiser.init(numbers))
    (numbers, _), finite = jax.lax.scan(step, start, length=steps)
    return jnp.all(finite), numbers


def check_training(name, rate, steps, starts):
    """Admissible at every step: the target is a record of another plant."""
    t = jnp.linspace(0, 30, 16)
    target = Sani(T=3.0, r=0.4, n=4, gain=2.0, offset=1.0, delay=1.5).step_response(t)
    keys = jax.random.split(jax.random.key(0), starts)
    run = jax.jit(
        jax.vmap(lambda key: trained(PLANTS[name], optax.adam(rate), steps, t, target, key)[0])
    )
    assert np.all(run(keys))


@families
def test_large_steps_stay_admissible(name):
    check_training(name, 1.0, 300, 4)


@pytest.mark.long
@pytest.mark.parametrize("rate", [0.1, 10.0])
@families
def test_ten_thousand_large_steps_stay_admissible(name, rate):
    check_training(name, rate, 10_000, 4)


def test_equal_lags_part_in_training():
    """They start with equal slopes; one step of any kind moves them apart."""
    t = jnp.linspace(0, 30, 40)
    target = PTn(lags=np.array([6.0, 1.0])).step_response(t)

    def train(free, optimiser, steps):
        def step(carry, _):
            free, memory = carry
            slopes = jax.grad(
                lambda x: jnp.mean((from_unconstrained(x).step_response(t) - target) ** 2)
            )(free)
            updates, memory = optimiser.update(slopes, memory)
            return (optax.apply_updates(free, updates), memory), None

        return jax.lax.scan(step, (free, optimiser.init(free)), length=steps)[0][0]

    free = to_unconstrained(PTn(lags=np.array([2.0, 2.0])))
    for optimiser in (optax.sgd(0.1), optax.adam(0.1)):
        lags = from_unconstrained(train(free, optimiser, 1)).lags
        assert abs(lags[0] - lags[1]) > 1e-7 * lags[0]
    lags = np.sort(from_unconstrained(train(free, optax.adam(0.02), 1500)).lags)
    assert np.allclose(lags, [1, 6], rtol=0.05), lags
