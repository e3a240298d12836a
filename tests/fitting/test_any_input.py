"""Fits to records of any input: what is found, how certain, and how it moves with the data."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.fits import START, TRUE

import stepax
from stepax import METHODS, SOPDT, InputRecord, Status, StepRecord, refine, refused, stack_records
from stepax.fitting._solver import BoundedLevenbergMarquardt
from stepax.records._record import predict


pytestmark = pytest.mark.usefixtures("quick_compilation")

T = np.linspace(0.0, 60.0, 240)
RANDOM = np.random.default_rng(3)
U = np.repeat(2.0 + 3.0 * RANDOM.integers(0, 2, 30), 8)
"""A pseudo-random binary input."""
OWN_MOTION, TREND = (1.5, -2.5), 0.04
COMPILED = eqx.filter_jit(refine)


def simulated(plant, noise=0.0, seed=0, moving=False, **options):
    record = InputRecord(T, T, U, **options)
    y = np.asarray(predict(plant, record))
    if moving:
        motions = zip(OWN_MOTION, plant.own_motions(jnp.asarray(T)), strict=False)
        y = y + sum(x * np.asarray(motion) for x, motion in motions) + TREND * T
    return dataclasses.replace(
        record, y=y + noise * np.random.default_rng(seed).normal(size=T.size)
    )


def own(model):
    return {name: np.asarray(getattr(model, name)) for name in model.parameter_names}


@pytest.mark.parametrize(
    "family", ["SOPDT", *(pytest.param(x, marks=pytest.mark.long) for x in TRUE)]
)
def test_noise_free_record_gives_the_plant_back(family):
    result = COMPILED(simulated(TRUE[family]), START[family])
    assert bool(result.status == Status.successful), Status[result.status]
    for name, value in own(result.model).items():
        np.testing.assert_allclose(value, getattr(TRUE[family], name), rtol=1e-5, err_msg=name)


@pytest.mark.parametrize(
    "family", ["SOPDT", *(pytest.param(x, marks=pytest.mark.long) for x in TRUE)]
)
def test_state_and_drift_are_found_with_the_plant(family):
    if family == "EqualLag":
        pytest.skip("a real order has no state")
    result = COMPILED(
        simulated(TRUE[family], moving=True), START[family], at_rest=False, drift=True
    )
    assert not bool(refused(result.status)), Status[result.status]
    for name, value in own(result.model).items():
        np.testing.assert_allclose(value, getattr(TRUE[family], name), rtol=1e-4, err_msg=name)
    np.testing.assert_allclose(result.details["trend"], TREND, rtol=1e-4)
    motion = result.details["own_motion"]
    expected = np.pad(OWN_MOTION, (0, 8))[: motion.size]  # of further lags there is none
    np.testing.assert_allclose(motion, expected, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(result.predict(T), result.record.y, atol=1e-5)


def test_errors_are_those_of_a_fit_of_all_numbers_by_scipy():
    """The numbers that were eliminated are free there, like all others."""
    plant = TRUE["SOPDT"]
    record = simulated(plant, noise=0.2, moving=True, at_rest=False, drift=True)
    result = COMPILED(record, START["SOPDT"])
    names = ["zeta", "omega_n", "gain", "offset", "delay"]

    @jax.jit
    def residual(x):
        model = SOPDT(**dict(zip(names, x[:5], strict=True)))
        return record.y - predict(model, dataclasses.replace(record, found=x[5:]))

    start = [*(float(getattr(plant, name)) for name in names), TREND, *OWN_MOTION]
    oracle = least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose([getattr(result.model, x) for x in names], oracle.x[:5], rtol=1e-5)
    jacobian = np.asarray(jax.jacfwd(residual)(jnp.asarray(oracle.x)))
    covariance = np.linalg.inv(jacobian.T @ jacobian) * 2 * oracle.cost / (T.size - 8)
    std = [float(result.std[name]) for name in names]
    np.testing.assert_allclose(std, np.sqrt(np.diag(covariance))[:5], rtol=1e-3)
    assert int(result.details["parameters"]) == 8


@pytest.mark.long
def test_own_motions_of_equal_lags():
    """Nearly the same columns do not spoil what is found."""
    plant = stepax.PTn(lags=[4.0, 4.0, 4.0], gain=2.0, offset=5.0, delay=2.0)
    record = simulated(plant, noise=0.01, moving=True, at_rest=False)
    start = stepax.EqualLag(T=5.0, n=3, delay=1.0)
    model = COMPILED(record, start, drift=True).model
    np.testing.assert_allclose([model.T, model.gain, model.delay], [4.0, 2.0, 2.0], rtol=0.02)


def test_a_sampled_step_is_a_step():
    plant = TRUE["SOPDT"]
    u = np.where(T >= 4.0, 3.0, 1.0)
    first = int(np.argmax(u > 1))
    step = StepRecord(T, T, T[first], 2.0)
    y = np.asarray(predict(plant, step)) + 0.1 * RANDOM.normal(size=T.size)
    by_step = METHODS["sopdt_fit"](StepRecord(T, y, T[first], 2.0))
    by_input = METHODS["sopdt_fit"](InputRecord(T, y, u))
    for name, value in own(by_input.model).items():
        np.testing.assert_allclose(value, getattr(by_step.model, name), rtol=1e-5)
        np.testing.assert_allclose(by_input.std[name], by_step.std[name], rtol=1e-3)


@pytest.mark.long
def test_padding_and_weights_of_a_batch():
    records = [simulated(TRUE["SOPDT"], 0.1, seed) for seed in range(2)]
    shorter = InputRecord(T[:150], np.asarray(records[1].y)[:150], U[:150])
    fit = lambda record: METHODS["sopdt_fit"](record)  # noqa: E731
    batch = jax.jit(jax.vmap(fit))(stack_records([records[0], shorter]))
    alone = [fit(records[0]), fit(shorter)]
    for lane, single in enumerate(alone):
        for name, value in own(single.model).items():
            np.testing.assert_allclose(getattr(batch.model, name)[lane], value, rtol=1e-6)
            np.testing.assert_allclose(batch.std[name][lane], single.std[name], rtol=1e-5)
    weights = (np.arange(T.size) < 150) * 1.0
    gaps = np.where(weights > 0, records[1].y, np.nan)
    weighed = fit(InputRecord(T, gaps, U, weights=weights))
    np.testing.assert_allclose(weighed.model.omega_n, alone[1].model.omega_n, rtol=1e-5)


@pytest.mark.parametrize(
    "row, moving",
    [
        ("y", False),
        *(pytest.param("u", moving, marks=pytest.mark.long) for moving in (False, True)),
    ],
)
def test_derivatives_in_the_data_are_differences(row, moving):
    """Damping, gain and dead time, in a direction of the data.

    To the end: a search that ends where the cost is flat leaves a share of 1e-4 of a difference.
    """
    record = simulated(TRUE["SOPDT"], 0.1, moving=moving)
    way = jnp.asarray(np.random.default_rng(7).normal(size=T.size))
    to_the_end = BoundedLevenbergMarquardt(rtol=1e-15)

    @jax.jit
    def found(h):
        moved = {row: jnp.asarray(getattr(record, row)) + h * way}
        record_there = dataclasses.replace(record, **moved)
        result = refine(
            record_there, TRUE["SOPDT"], at_rest=not moving, solver=to_the_end, errors=False
        )
        return jnp.stack([result.model.zeta, result.model.gain, result.model.delay])

    slope = jax.jit(jax.jacfwd(found))(0.0)
    h = 1e-4
    np.testing.assert_allclose(slope, (found(h) - found(-h)) / (2 * h), rtol=1e-6, atol=1e-7)


def test_what_cannot_be_asked_is_said():
    record = simulated(TRUE["SOPDT"], 0.1)
    with pytest.raises(ValueError, match="at_rest and drift are options of a fit"):
        refine(StepRecord(T, record.y), START["SOPDT"], drift=True)
    with pytest.raises(ValueError, match="needs a plant at rest"):
        refine(record, START["SOPDT"], drift=True, loss="huber")


@pytest.mark.long
@pytest.mark.parametrize("at_rest", [True, False])
@pytest.mark.parametrize("method", ["fopdt_fit", "sopdt_fit"])
def test_prbs_gives_the_plant_within_three_standard_errors(method, at_rest):
    """5 % noise, 1000 draws: each parameter in at least 99 % of them."""
    plant = {
        "fopdt_fit": stepax.FOPDT(T=6.0, gain=2.0, offset=5.0, delay=3.31),
        "sopdt_fit": SOPDT(zeta=0.4, omega_n=0.5, gain=2.0, offset=5.0, delay=2.2),
    }[method]
    random = np.random.default_rng(5)
    t = np.linspace(0.0, 100.0, 500)
    u = 1.0 + 2.0 * np.repeat(random.integers(0, 2, 50), 10)
    clean = np.asarray(predict(plant, InputRecord(t, t, u)))
    if not at_rest:
        clean = clean + 1.5 * np.asarray(plant.own_motions(jnp.asarray(t))[-1])
    y = clean + 0.05 * np.std(clean) * random.normal(size=(1000, t.size))

    def fit(y):
        result = METHODS[method](InputRecord(t, y, u, at_rest=at_rest))
        return result.model, result.std

    model, std = jax.jit(jax.vmap(fit))(jnp.asarray(y))
    for name, error in std.items():
        away = np.abs(np.asarray(getattr(model, name)) - float(getattr(plant, name)))
        assert np.mean(away <= 3 * np.asarray(error)) >= 0.99, name
