"""Fits of the second order with a zero and of the integrator: from the record alone."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fits import COMPILED, START, STEP_SIZE, TRUE, T, simulated

from stepax import IPDT, METHODS, SOPDTZero, Status, StepRecord
from stepax.records._record import predict


FITS = {"SOPDTZero": "sopdt_zero_fit", "IPDT": "ipdt_fit"}
OWN = {"SOPDTZero": ("zeta", "omega_n", "lead"), "IPDT": ("T",)}
TIMES = np.linspace(0.0, 20.0, 200)

both = pytest.mark.parametrize("family", FITS)


def parameters(model, family):
    return {name: getattr(model, name) for name in (*OWN[family], "gain", "offset", "delay")}


def fitted(record, family, **options):
    """By the method, compiled."""
    return eqx.filter_jit(METHODS[FITS[family]])(record, **options)


def plants_with_a_zero(count, seed):
    """Log-uniform in damping, frequency and lead, whose sign is either; a dead time up to 3.

    Left out are plants that another one is hard to tell from on this record: a lag shorter than
    two samples, which trades places with the dead time, and a zero that nearly cancels a pole.
    """
    rng = np.random.default_rng(seed)
    while True:
        zeta, omega_n, lead = np.exp(rng.uniform(*np.log([[0.2, 0.5, 0.3], [3.0, 3.0, 6.0]])))
        lead, delay = lead * rng.choice([-1, 1]), rng.uniform(0, 3)
        poles = np.roots([1, 2 * zeta * omega_n, omega_n**2])
        if np.max(np.abs(poles)) < 5 and np.min(np.abs(1 + lead * poles)) > 0.5:
            yield {"zeta": zeta, "omega_n": omega_n, "lead": lead, "delay": delay}
            count -= 1
        if not count:
            return


def plants_that_integrate(count, seed):
    """Lags from three samples to 6, log-uniform; dead times up to 3."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield {"T": np.exp(rng.uniform(*np.log([0.3, 6.0]))), "delay": rng.uniform(0, 3)}


@both
def test_noise_free_records_give_the_plants_back(family):
    """50 of them in one batch, every parameter to 1e-6."""
    draw, gain = {
        "SOPDTZero": (plants_with_a_zero, 2.0),
        "IPDT": (plants_that_integrate, -0.5),
    }[family]
    rows = list(draw(50, seed=1))
    own = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    make = {"SOPDTZero": SOPDTZero, "IPDT": IPDT}[family]
    plants = jax.vmap(lambda own: make(**own, gain=gain, offset=1.0))(own)

    @jax.jit
    @jax.vmap
    def fit(plant):
        record = StepRecord(jnp.asarray(TIMES), plant.step_response(TIMES))
        return METHODS[FITS[family]](record, errors=False)

    result = fit(plants)
    for name, value in parameters(result.model, family).items():
        np.testing.assert_allclose(value, getattr(plants, name), rtol=1e-6, err_msg=name)


@both
def test_standard_errors_are_those_of_the_dense_formula(family):
    record = simulated(TRUE[family], noise=0.05)
    result = fitted(record, family)
    values = jnp.stack([getattr(result.model, name) for name in result.free])

    def prediction(numbers):
        model = type(result.model)(**dict(zip(result.free, numbers, strict=True)))
        return predict(model, record)

    J = np.asarray(jax.jit(jax.jacfwd(prediction))(values))
    residual = np.asarray(record.y - prediction(values))
    covariance = np.linalg.inv(J.T @ J) * (residual @ residual) / (T.size - values.size)
    size = np.sqrt(np.diag(covariance))
    scaled = (np.asarray(result.covariance) - covariance) / size / size[:, None]
    assert np.max(np.abs(scaled)) < 1e-6
    for name, value in parameters(TRUE[family], family).items():
        assert abs(getattr(result.model, name) - value) < 4 * result.std[name], name


@both
def test_known_levels(family):
    """`initial` is kept; `final` is the level of a plant that settles, and no level of a ramp."""
    plant = TRUE[family]
    first = float(plant.offset)
    levels = {"initial": first, "final": first + STEP_SIZE * float(plant.gain)}
    known = fitted(simulated(plant, 0.05, **levels), family)
    assert float(known.model.offset) == first and float(known.std["offset"]) == 0
    assert ("gain" in known.free) == (family == "IPDT")
    for name in OWN[family]:
        assert abs(getattr(known.model, name) - getattr(plant, name)) < 4 * known.std[name], name
    if family == "SOPDTZero":
        assert float(known.model.gain) == float(plant.gain)
    else:
        begins = fitted(simulated(plant, 0.05, initial=first), family)
        same = zip(jax.tree.leaves(known.model), jax.tree.leaves(begins.model), strict=True)
        assert all(np.allclose(a, b, rtol=1e-9) for a, b in same)


@both
def test_no_dead_time(family):
    plant = eqx.tree_at(lambda m: m.delay, TRUE[family], jnp.array(0.0))
    result = fitted(simulated(plant), family, fixed=("delay",))
    assert float(result.model.delay) == 0 == float(result.std["delay"])
    assert "delay" not in result.free
    for name in OWN[family]:
        np.testing.assert_allclose(getattr(result.model, name), getattr(plant, name), rtol=1e-6)


@pytest.mark.parametrize(("family", "name"), [("SOPDTZero", "lead"), ("IPDT", "T")])
def test_own_parameter_that_is_fixed(family, name):
    """At its own value the plant comes back; at 0 as well, where that is the plant."""
    value = getattr(TRUE[family], name)
    start = eqx.tree_at(lambda m: getattr(m, name), START[family], value)
    result = COMPILED(simulated(TRUE[family]), start, fixed=(name,))
    assert float(getattr(result.model, name)) == float(value) and float(result.std[name]) == 0
    for other, truth in parameters(TRUE[family], family).items():
        np.testing.assert_allclose(getattr(result.model, other), truth, rtol=1e-6, err_msg=other)

    none = eqx.tree_at(lambda m: getattr(m, name), TRUE[family], jnp.array(0.0))
    start = eqx.tree_at(lambda m: getattr(m, name), START[family], jnp.array(0.0))
    result = COMPILED(simulated(none), start, fixed=(name,))
    for other, truth in parameters(none, family).items():
        np.testing.assert_allclose(getattr(result.model, other), truth, rtol=1e-6, err_msg=other)


def test_no_lead_is_knowledge():
    """A second order without a zero: the lead is 0 within its error, and none of it is vague."""
    plant = eqx.tree_at(lambda m: m.lead, TRUE["SOPDTZero"], jnp.array(0.0))
    result = fitted(simulated(plant, noise=0.02), "SOPDTZero")
    told = dict(zip(result.free, np.asarray(result.details["identifiable"]), strict=True))
    assert told["lead"] and told["zeta"]
    assert abs(result.model.lead) < 4 * result.std["lead"]


def test_no_lag_is_on_the_bound():
    """A bare ramp."""
    plant = eqx.tree_at(lambda m: m.T, TRUE["IPDT"], jnp.array(0.0))
    result = fitted(simulated(plant), "IPDT")
    np.testing.assert_allclose(result.model.T + result.model.delay, plant.delay, rtol=1e-6)
    np.testing.assert_allclose(result.model.gain, plant.gain, rtol=1e-9)


@both
def test_huber_is_not_drawn_by_glitches(family):
    plant = TRUE[family]
    record = simulated(plant, noise=0.02)
    spoilt = eqx.tree_at(lambda r: r.y, record, record.y.at[jnp.array([40, 41, 120])].add(4.0))
    squares, robust = (fitted(spoilt, family, loss=loss) for loss in ("squares", "huber"))
    name = OWN[family][-1]
    truth = getattr(plant, name)
    assert abs(getattr(robust.model, name) - truth) < abs(getattr(squares.model, name) - truth)
    for name, value in parameters(plant, family).items():
        assert abs(getattr(robust.model, name) - value) < 4 * robust.std[name], name
    assert 0.015 < float(robust.details["noise_level"]) < 0.03


@both
def test_float32_follows_the_data(family):
    single = fitted(simulated(TRUE[family], noise=0.05, dtype=np.float32), family)
    double = fitted(simulated(TRUE[family], noise=0.05), family)
    assert bool(single.status == Status.successful)
    np.testing.assert_allclose(single.rmse, double.rmse, rtol=1e-3)
    for name, value in parameters(double.model, family).items():
        assert getattr(single.model, name).dtype == single.std[name].dtype == jnp.float32
        off = abs(float(getattr(single.model, name) - value))
        assert off < 0.05 * float(double.std[name]), name


# Plants well inside their ranges on a record of 20: the noise is 1.5 % of what the output moves by.
COVERED = {
    "SOPDTZero, inverse": SOPDTZero(zeta=0.8, omega_n=1.0, lead=-1.5, delay=1.3, gain=2, offset=5),
    "SOPDTZero, overshoot": SOPDTZero(zeta=1.5, omega_n=1.0, lead=6.0, delay=1.3, gain=2, offset=5),
    "IPDT": IPDT(T=2.0, delay=1.3, gain=0.5, offset=5),
}


@pytest.mark.long
@pytest.mark.parametrize("name", COVERED)
def test_intervals_cover_the_truth(name):
    """95 % intervals of all parameters over 1000 records of 200 rows with white noise."""
    plant, family = COVERED[name], name.split(",")[0]
    clean = plant.step_response(jnp.asarray(TIMES))
    sigma = 0.015 * (jnp.max(clean) - jnp.min(clean))

    def covered(key):
        y = clean + sigma * jax.random.normal(key, clean.shape)
        result = METHODS[FITS[family]](StepRecord(jnp.asarray(TIMES), y))
        inside = {
            k: jnp.abs(getattr(result.model, k) - value) <= 1.96 * result.std[k]
            for k, value in parameters(plant, family).items()
        }
        return inside, result.status == Status.successful

    inside, usual = jax.jit(lambda keys: jax.lax.map(covered, keys, batch_size=50))(
        jax.random.split(jax.random.key(11), 1000)
    )
    shares = {k: float(np.mean(hits)) for k, hits in inside.items()}
    print(f"\n{name}: {100 * float(np.mean(usual)):.1f} % successful:", end=" ")
    print(", ".join(f"{k} {100 * share:.1f} %" for k, share in shares.items()))
    for k, share in shares.items():
        assert 0.93 <= share <= 0.97, k
