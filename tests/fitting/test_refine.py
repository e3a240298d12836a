"""Refinement against SciPy, finite differences, and its own promises."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.fits import COMPILED, START, STEP_SIZE, STEP_TIME, TRUE, T, simulated

import stepax
from stepax import FOPDT, SOPDT, EqualLag, Hudzovic, PTn, Sani, Status, StepRecord, refine, refused
from stepax.fitting._problem import Problem


pytestmark = pytest.mark.usefixtures("quick_compilation")


def values(model, names):
    return {name: np.asarray(getattr(model, name)) for name in names}


@pytest.mark.parametrize("family", TRUE)
def test_noise_free_record_gives_the_plant_back(family):
    result = COMPILED(simulated(TRUE[family]), START[family])
    assert bool(result.status == Status.successful), Status[result.status]
    for name, value in values(result.model, result.std).items():
        np.testing.assert_allclose(value, getattr(TRUE[family], name), rtol=1e-5, err_msg=name)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_start_beside_the_optimum_goes_there(dtype):
    """Its cost differs by less than the rounding of the output's own square."""
    noise = 1e-7 if dtype == np.float64 else 1e-3
    record = simulated(TRUE["SOPDT"], noise=noise, dtype=dtype)
    best = COMPILED(record, START["SOPDT"])
    for errors in (0.0, 0.1, 0.3, 1.0, 3.0):
        zeta = best.model.zeta + errors * best.std["zeta"]
        found = COMPILED(record, dataclasses.replace(best.model, zeta=zeta))
        for name in ("zeta", "omega_n", "delay", "gain"):
            off = getattr(found.model, name) - getattr(best.model, name)
            assert abs(off) < 0.01 * best.std[name], (errors, name)


@pytest.mark.parametrize("family", TRUE)
def test_noisy_optimum_is_that_of_scipy(family):
    record = simulated(TRUE[family], noise=0.1)
    result = COMPILED(record, START[family])
    names = [name for name in result.std if name != "lags"]
    lags = family == "PTn"

    @jax.jit
    def residual(vector):
        numbers = dict(zip(names, vector, strict=False))
        if lags:
            numbers["lags"] = vector[-2:]
        model = type(result.model)(
            **numbers,
            **({"n": 4} if family == "Hudzovic" else {}),
            **({"n": 3} if family == "Sani" else {}),
        )
        return record.y - stepax._result.predict(model, record, record.t)

    start = [float(getattr(TRUE[family], name)) for name in names]
    start += [float(x) for x in TRUE[family].lags] if lags else []
    oracle = least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    cost = float(jnp.sum((record.y - result.predict(record.t)) ** 2))
    assert cost <= 2 * oracle.cost * (1 + 1e-6)


@pytest.mark.parametrize("family", ["FOPDT", "Sani", "PTn"])
def test_float32_follows_the_data(family):
    record = simulated(TRUE[family], noise=0.05, dtype=np.float32)
    result = COMPILED(record, START[family])
    own = result.model.lags if family == "PTn" else result.model.T
    assert result.rmse.dtype == own.dtype == jnp.float32
    double = COMPILED(simulated(TRUE[family], noise=0.05), START[family])
    np.testing.assert_allclose(result.rmse, double.rmse, rtol=1e-3)
    np.testing.assert_allclose(result.model.gain, double.model.gain, rtol=1e-3)


def test_fixed_parameters_and_known_levels_are_kept_exactly():
    plant = TRUE["FOPDT"]
    record = simulated(plant, noise=0.05)
    result = COMPILED(record, FOPDT(T=5.0, gain=-1.9, delay=3.1), fixed=("gain", "delay"))
    assert float(result.model.gain) == -1.9 and float(result.model.delay) == 3.1
    assert result.free == ("T", "offset")
    assert float(result.std["gain"]) == 0 == float(result.std["delay"])

    known = COMPILED(simulated(plant, 0.05, initial=5.0, final=-1.0), START["FOPDT"])
    assert float(known.model.offset) == 5.0 and float(known.model.gain) == -2.0
    assert known.free == ("T", "delay")

    tied = COMPILED(simulated(plant, 0.05, final=-1.0), START["FOPDT"])
    assert float(tied.model.offset + STEP_SIZE * tied.model.gain) == pytest.approx(-1.0, abs=1e-12)
    assert float(tied.std["offset"]) == pytest.approx(STEP_SIZE * float(tied.std["gain"]))

    own = COMPILED(record, FOPDT(T=8.0), fixed=("T",))
    assert float(own.model.T) == 8.0 and float(own.std["T"]) == 0


def test_equal_lags_are_an_optimum_on_the_bound():
    plant = Sani(T=4.0, r=1.0, n=3, gain=2.0, delay=2.0)
    result = COMPILED(simulated(plant, noise=0.02, seed=3), START["Sani"])
    for seed in range(8):  # about half of the draws end on the bound
        if float(result.model.r) == 1.0:
            break
        result = COMPILED(simulated(plant, noise=0.02, seed=seed), START["Sani"])
    assert float(result.model.r) == 1.0
    assert bool(result.status == Status.at_equal_lags)
    assert np.isnan(result.std["r"]) and np.isfinite(result.std["gain"])
    assert int(result.details["steps"]) < 30


@pytest.mark.parametrize("seed", range(4))
def test_a_second_lag_shorter_than_a_sample_has_two_minima(seed):
    """The optimum is as low as the best of SciPy's from 12 starts."""
    plant = SOPDT(zeta=3.2, omega_n=0.8, gain=2.0, offset=5.0, delay=2.3)
    record = simulated(plant, noise=0.1, seed=seed)
    result = COMPILED(record, START["SOPDT"])

    @jax.jit
    def residual(x):
        model = SOPDT(zeta=x[0], omega_n=x[1], gain=x[2], offset=x[3], delay=x[4])
        return record.y - stepax._result.predict(model, record, record.t)

    def least(lag, delay):
        zeta, omega_n = (7.8 + lag) / 2 / np.sqrt(7.8 * lag), 1 / np.sqrt(7.8 * lag)
        start, upper = [zeta, omega_n, 2.0, 5.0, delay], [200, 100, 10, 10, 50]
        return least_squares(
            residual, start, bounds=([0, 0, -10, -10, 0], upper), x_scale="jac", xtol=1e-12
        ).cost

    best = min(least(lag, delay) for lag in (0.02, 0.15, 0.6) for delay in (1.9, 2.15, 2.4, 2.7))
    cost = float(jnp.sum((record.y - result.predict(record.t)) ** 2)) / 2
    assert cost <= best * (1 + 1e-5)


@pytest.mark.parametrize("threshold", [None, 0.01], ids=["squares", "huber"])
@pytest.mark.parametrize("family", TRUE)
def test_products_are_those_of_the_jacobian(family, threshold):
    record = simulated(TRUE[family], noise=0.05)
    fit = Problem.of(record, START[family], jnp.ones_like(record.y), ())
    check_products(dataclasses.replace(fit, threshold=threshold and jnp.array(threshold)))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    ("fixed", "levels"),
    [
        (("gain",), {}),
        (("offset",), {}),
        (("gain", "offset"), {}),
        ((), {"final": -1.0}),
        ((), {"initial": 5.0, "final": -1.0}),
    ],
)
def test_products_with_known_levels_and_rows_left_out(fixed, levels, dtype):
    record = simulated(TRUE["FOPDT"], noise=0.05, dtype=dtype, **levels)
    weights = jnp.where(jnp.arange(record.y.size) % 7 == 0, 0, jnp.ones_like(record.y))
    check_products(Problem.of(record, START["FOPDT"], weights, fixed))


@pytest.mark.parametrize("unit", [1e-20, 1e20])
def test_products_do_not_depend_on_the_unit_of_the_output(unit):
    record = simulated(TRUE["FOPDT"], noise=0.05, dtype=np.float32)
    scaled = eqx.tree_at(lambda r: r.y, record, np.float32(unit) * record.y)
    weights, x = jnp.ones_like(record.y), jnp.array([-2.0, 0.1], np.float32)
    one, other = (
        Problem.of(r, START["FOPDT"], weights, ()).products(x)[0] for r in (record, scaled)
    )
    np.testing.assert_allclose(other, one, rtol=1e-3, atol=1e-4)


def check_products(fit):
    x = fit.start()
    tolerance = 1e-12 if x.dtype == np.float64 else 1e-5
    rows = eqx.filter_jit(
        lambda fit, x: jnp.column_stack([jax.jacrev(fit.residual)(x), fit.residual(x)])
    )(fit, x)
    here, levels, _ = eqx.filter_jit(Problem.products)(fit, x)
    np.testing.assert_allclose(here, rows.T @ rows, rtol=tolerance, atol=tolerance)
    # from levels that are far off by the size of the output, to the rounding of that
    far, found, doubt = eqx.filter_jit(Problem.products)(fit, x, fit.first_near)
    np.testing.assert_allclose(far, rows.T @ rows, rtol=100 * tolerance, atol=100 * tolerance)
    assert abs(far[-1, -1] - here[-1, -1]) <= doubt or fit.threshold is not None
    if fit.threshold is None:
        np.testing.assert_allclose(found, levels, rtol=100 * tolerance)


def test_huber_is_not_drawn_by_glitches():
    plant = TRUE["SOPDT"]
    clean = simulated(plant, noise=0.02)
    spoilt = eqx.tree_at(lambda r: r.y, clean, clean.y.at[jnp.array([40, 41, 120])].add(4.0))
    squares, robust = (COMPILED(spoilt, START["SOPDT"], loss=loss) for loss in ("squares", "huber"))
    assert abs(float(squares.model.gain) - 2) > 0.01
    for name in ("zeta", "omega_n", "gain", "offset", "delay"):
        off = abs(float(getattr(robust.model, name)) - float(getattr(plant, name)))
        assert off < 4 * float(robust.std[name]), name
    assert 0.015 < float(robust.details["noise_level"]) < 0.03

    # the oracle: SciPy's Huber loss at the same noise level
    names = list(robust.free)
    level = 1.345 * float(robust.details["noise_level"])

    def residual(vector):
        model = SOPDT(**dict(zip(names, vector, strict=True)))
        return np.asarray(spoilt.y - stepax._result.predict(model, spoilt, spoilt.t))

    start = [float(getattr(plant, name)) for name in names]
    tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-12)
    oracle = least_squares(residual, start, loss="huber", f_scale=level, x_scale="jac", **tight)
    ours = [float(getattr(robust.model, name)) for name in names]
    np.testing.assert_allclose(ours, oracle.x, rtol=1e-4)


def test_huber_survives_a_start_misled_by_glitches():
    """Two high rows right after the step, for which squares jump at once."""
    t = np.arange(-10, 120) * 0.02
    y = np.array(FOPDT(T=0.2, gain=1.26).step_response(t))
    y += 0.02 * np.random.default_rng(2).standard_normal(t.size)
    y[11:13] += 6.0
    squares, robust = (
        COMPILED(StepRecord(t, y), FOPDT(T=0.15), loss=loss) for loss in ("squares", "huber")
    )
    assert float(squares.model.T) < 0.01
    np.testing.assert_allclose(robust.model.T, 0.2, rtol=0.15)
    np.testing.assert_allclose(robust.model.gain, 1.26, rtol=0.02)


def test_weights_leave_rows_out():
    record = simulated(TRUE["FOPDT"], noise=0.05)
    kept = np.r_[0:60, 70:200]
    weights = jnp.zeros(200).at[kept].set(4.0)
    spoilt = eqx.tree_at(lambda r: r.y, record, record.y.at[60:70].set(1e3))
    weighted = COMPILED(spoilt, START["FOPDT"], weights=weights)
    short = StepRecord(record.t[kept], record.y[kept], STEP_TIME, STEP_SIZE)
    alone = COMPILED(short, START["FOPDT"])
    for name in alone.free:
        np.testing.assert_allclose(getattr(weighted.model, name), getattr(alone.model, name), 1e-6)


@pytest.mark.parametrize("family", ["Hudzovic", "EqualLag"])
def test_the_order_is_found(family):
    plants = {
        "Hudzovic": Hudzovic(T=3.0, r=0.1, n=4, gain=2.0, offset=5.0),
        "EqualLag": EqualLag(T=3.0, n=5, gain=2.0, offset=5.0),
    }
    start = {"Hudzovic": Hudzovic(T=5.0, r=0.2, n=2), "EqualLag": EqualLag(T=6.0, n=2)}
    record = simulated(plants[family], noise=0.001)
    result = COMPILED(record, start[family], ("delay",), order="auto")
    assert int(result.model.n) == int(plants[family].n)
    np.testing.assert_allclose(result.model.T, plants[family].T, rtol=2e-2)


def test_a_lag_of_0_is_none_and_stays_none():
    record = simulated(TRUE["PTn"], noise=0.05)
    two = COMPILED(record, START["PTn"])
    three = COMPILED(record, PTn(lags=[3.0, 0.0, 6.0], delay=1.0))
    np.testing.assert_allclose(three.model.lags, [*two.model.lags, 0], rtol=1e-5)
    np.testing.assert_allclose(three.std["lags"], [*two.std["lags"], 0], rtol=1e-4)
    np.testing.assert_allclose(three.details["aicc"], two.details["aicc"], rtol=1e-9)
    assert bool(three.status == Status.successful)
    assert np.isfinite(three.covariance).all()


def test_gradients_where_lags_are_equal():
    """Equal lags move together: d(sum of lags)/d(data) against differences, no noise."""
    start = PTn(lags=[7.0, 4.0, 2.0])
    record = simulated(EqualLag(T=4.0, n=3))
    weights = jnp.asarray(np.random.default_rng(3).standard_normal(T.size))

    def total(y):
        known = StepRecord(T, y, STEP_TIME, STEP_SIZE, initial=0.0, final=STEP_SIZE)
        return jnp.sum(refine(known, start, ("delay",), errors=False).model.lags)

    gradient = jax.jit(jax.grad(total))(record.y)
    assert jnp.max(jnp.abs(gradient)) < 10
    # the closed form: the slope of the response in the sum of its lags, all equal
    slope = jax.jit(
        jax.jacfwd(lambda s: STEP_SIZE * EqualLag(T=s / 3, n=3).step_response(T - STEP_TIME))
    )(12.0)
    np.testing.assert_allclose(gradient @ weights, slope @ weights / (slope @ slope), rtol=1e-4)


def test_weights_count_up_to_a_common_factor():
    record = simulated(TRUE["FOPDT"], noise=0.05)
    one = COMPILED(record, START["FOPDT"], weights=jnp.ones(T.size))
    tiny = COMPILED(record, START["FOPDT"], weights=jnp.full(T.size, 1e-30))
    np.testing.assert_allclose(tiny.model.T, one.model.T, rtol=1e-9)
    np.testing.assert_allclose(tiny.std["T"], one.std["T"], rtol=1e-6)


def test_ptn_fit_finds_the_number_of_lags():
    record = simulated(PTn(lags=[8.0, 5.0, 2.0], gain=2.0, offset=5.0), noise=0.0005)
    fit = stepax.METHODS["ptn_fit"]
    result = fit(record, fixed=("delay",))
    assert result.model.lags.shape == (5,) and not np.any(result.model.lags[3:])
    np.testing.assert_allclose(result.model.lags[:3], [8.0, 5.0, 2.0], rtol=0.05)
    assert np.isfinite(result.std["lags"]).all() and not np.any(result.std["lags"][3:])
    alone = fit(record, order=3, fixed=("delay",))
    np.testing.assert_allclose(alone.model.lags, result.model.lags[:3], rtol=1e-6)
    with pytest.raises(ValueError, match="order"):
        fit(record, order="many")


@pytest.mark.parametrize(
    ("model", "options", "word"),
    [
        (FOPDT(T=1.0), {"order": "auto"}, "FOPDT"),
        (START["Hudzovic"], {"order": "all"}, "auto"),
        (START["Hudzovic"], {"loss": "cauchy"}, "huber"),
    ],
)
def test_wrong_options_are_refused(model, options, word):
    with pytest.raises(ValueError, match=word):
        refine(simulated(TRUE["FOPDT"]), model, **options)


@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_a_dead_time_is_not_stalled_by_a_sample(noise):
    """No cost below ours on a fine grid of dead times, each with its best time constant."""
    plant, delays = TRUE["FOPDT"], jnp.linspace(2.0, 4.6, 27)

    @jax.jit
    def costs(record):
        def cost(model, fixed=()):
            fitted = refine(record, model, fixed, errors=False)
            return jnp.sum((record.y - fitted.predict(record.t)) ** 2)

        grid = jax.vmap(lambda delay: cost(FOPDT(T=8.0, delay=delay), ("delay",)))(delays)
        return cost(START["FOPDT"]), jnp.min(grid)

    for seed in range(20):
        ours, grid = costs(simulated(plant, noise, seed=seed))
        assert float(ours) <= float(grid) * (1 + 1e-9)


@pytest.mark.long
@pytest.mark.parametrize("family", TRUE)
def test_gradient_through_the_fit(family):
    """d(parameters)/d(data) by the implicit function theorem, both modes, against differences."""
    record = simulated(TRUE[family], noise=0.05)
    direction = np.random.default_rng(5).standard_normal(T.size)
    solver = stepax.BoundedLevenbergMarquardt(rtol=1e-22)  # differences need an exact optimum

    def parameters(y):
        fitted = refine(
            eqx.tree_at(lambda r: r.y, record, y), START[family], errors=False, solver=solver
        )
        own = [jnp.ravel(getattr(fitted.model, name.split("[")[0])) for name in fitted.free]
        return jnp.concatenate(own)

    compiled = jax.jit(parameters)
    forward = jax.jit(lambda y: jax.jvp(parameters, (y,), (direction,))[1])(record.y)
    h = 1e-4
    difference = (compiled(record.y + h * direction) - compiled(record.y - h * direction)) / (2 * h)
    np.testing.assert_allclose(forward, difference, rtol=1e-6, atol=1e-7)
    reverse = jax.jit(jax.grad(lambda y: parameters(y)[0]))(record.y)
    np.testing.assert_allclose(reverse @ direction, forward[0], rtol=1e-8)


def test_a_bad_lane_leaves_its_neighbours_alone():
    record = simulated(TRUE["FOPDT"], noise=0.05)
    bad = record.y.at[50].set(jnp.nan)
    constant = jnp.zeros_like(bad)

    def lag(y):
        fitted = refine(eqx.tree_at(lambda r: r.y, record, y), START["FOPDT"], errors=False)
        return fitted.model.T, fitted.status

    batch = jnp.stack([bad, record.y, constant])
    (lags, status) = jax.jit(jax.vmap(lag))(batch)
    np.testing.assert_array_equal(refused(status), [True, False, True])
    assert np.isnan(lags[0]) and np.isnan(lags[2])
    alone, _ = jax.jit(lag)(record.y)
    np.testing.assert_allclose(lags[1], alone, rtol=1e-9)
    gradients = jax.jit(jax.vmap(jax.grad(lag, has_aux=True)))(batch)[0]
    assert np.isfinite(gradients[1]).all()
    assert np.abs(gradients[1]).max() > 0


@pytest.mark.parametrize(
    ("fixed", "error"), [(("zeta",), ValueError), ("gain", TypeError)], ids=["unknown", "string"]
)
def test_wrong_names_are_refused(fixed, error):
    with pytest.raises(error, match="gain"):
        refine(simulated(TRUE["FOPDT"]), START["FOPDT"], fixed=fixed)


def test_the_least_cost_of_all_dead_times_under_heavy_noise():
    """30 % noise: the dead time of least cost may lie many samples from where a search begins."""
    random = np.random.default_rng(0)
    t = np.linspace(0.0, 60.0, 60)
    T, L = random.uniform(3, 9, (100, 1)), random.uniform(0, 10, (100, 1))
    y = -np.expm1(-np.maximum(t - L, 0) / T) + 0.3 * random.standard_normal((100, 60))
    fit = jax.vmap(lambda y: stepax.identify(StepRecord(t, y), "fopdt_fit", errors=False).model)
    model = jax.jit(fit)(y)

    def costs(g):
        """Of responses, a row each, with the best gain and offset for each record."""
        g = g - g.mean(-1, keepdims=True)
        z = y - y.mean(-1, keepdims=True)
        product = np.einsum("...t,rt->r...", g, z)
        return np.sum(z**2, -1).reshape(-1, *[1] * (g.ndim - 1)) - product**2 / np.sum(g**2, -1)

    lags, delays = np.geomspace(0.05, 200, 60), np.linspace(0, 0.95 * 60, 600)
    since = np.maximum(t - delays[:, None], 0)
    least = np.min([costs(-np.expm1(-since / lag)).min(-1) for lag in lags], axis=0)
    own = np.maximum(t - np.asarray(model.delay)[:, None], 0) / np.asarray(model.T)[:, None]
    found = np.diagonal(costs(-np.expm1(-own)))
    assert np.mean(found <= least * (1 + 1e-9)) >= 0.99  # 0.93 with the nearest five intervals
