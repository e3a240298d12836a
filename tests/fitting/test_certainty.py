"""Standard errors and the information criterion against SciPy and dense formulae."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.optimize import curve_fit
from tests.fits import COMPILED, START, STEP_SIZE, STEP_TIME, TRUE, T, simulated

from stepax import FOPDT, METHODS, SOPDT, Status, StepRecord, refine
from stepax.fitting._certainty import student_95
from stepax.fitting._fitted import aicc
from stepax.records._record import predict


PLANT = TRUE["FOPDT"]


def jacobian(result):
    """Of the prediction, dense: rows by free parameters."""

    def prediction(numbers):
        free = dict(zip(result.free, numbers, strict=True))
        fixed = {k: getattr(PLANT, k) for k in result.std if k not in free}
        return predict(FOPDT(**free, **fixed), result.record, result.record.t)

    numbers = jnp.stack([getattr(result.model, name) for name in result.free])
    return np.asarray(jax.jit(jax.jacfwd(prediction))(numbers))


def coloured(phi, seed):
    """Noise whose autocorrelation is phi^k after k rows."""
    white = np.random.default_rng(seed).standard_normal(T.size) * np.sqrt(1 - phi**2)
    noise = [white[0] / np.sqrt(1 - phi**2)]
    for w in white[1:]:
        noise.append(phi * noise[-1] + w)
    return np.array(noise)


def test_aicc_is_the_formula():
    """AIC + 2k(k + 1)/(N - k - 1), with N ln(RSS/N) for a Gaussian likelihood."""
    for square, count, k in ((2.0, 50, 3), (1e-9, 12, 5), (7e4, 4000, 1)):
        aic = count * np.log(square / count) + 2 * k
        expected = aic + 2 * k * (k + 1) / (count - k - 1)
        np.testing.assert_allclose(aicc(jnp.array(square), count, k), expected, rtol=1e-14)
    assert np.isfinite(aicc(jnp.array(1.0), 3, 4))  # fewer rows than parameters


def test_white_noise_as_scipy():
    result = COMPILED(simulated(PLANT, noise=0.05), START["FOPDT"])
    assert not result.details["residuals_correlated"]
    names = result.free

    def response(t, *numbers):
        return np.asarray(
            predict(FOPDT(**dict(zip(names, numbers, strict=True))), result.record, t)
        )

    start = [float(getattr(result.model, name)) for name in names]
    best, covariance = curve_fit(response, T, np.asarray(result.record.y), start)
    np.testing.assert_allclose(start, best, rtol=1e-5)
    size = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose([result.std[name] for name in names], size, rtol=1e-3)
    scaled = (np.asarray(result.covariance) - covariance) / size / size[:, None]
    assert np.max(np.abs(scaled)) < 2e-3


def test_correlated_residuals_by_the_dense_formula():
    """sigma^2 A^-1 (J' R J) A^-1 with the matrix R of all pairs of rows."""
    record = simulated(PLANT)
    noisy = eqx.tree_at(lambda r: r.y, record, record.y + 0.05 * coloured(0.7, seed=1))
    result = COMPILED(noisy, START["FOPDT"])
    phi = float(result.details["residual_autocorrelation"])
    assert bool(result.details["residuals_correlated"]) and 0.5 < phi < 0.9
    J = jacobian(result)
    R = phi ** np.abs(np.subtract.outer(np.arange(T.size), np.arange(T.size)))
    inverse = np.linalg.inv(J.T @ J)
    middle = inverse @ (J.T @ R @ J) @ inverse
    residual = np.asarray(noisy.y - result.predict(T))
    freedom = T.size - np.trace(inverse @ (J.T @ R @ J))
    np.testing.assert_allclose(result.covariance, middle * np.sum(residual**2) / freedom, rtol=1e-7)
    plain = np.sqrt(np.diag(inverse * np.sum(residual**2) / (T.size - J.shape[1])))
    assert np.all(np.array([result.std[name] for name in result.free]) > 1.5 * plain)


def test_a_parameter_on_a_bound_has_no_error_and_the_others_hold_with_it_fixed():
    """A lag that the record starts in the middle of: the dead time ends at 0."""
    plant = FOPDT(T=8.0, gain=-2.0, offset=5.0)
    for seed in range(8):  # about half of the draws end on the bound
        record = simulated(plant, noise=0.05, seed=seed)
        result = COMPILED(record, START["FOPDT"])
        if float(result.model.delay) == 0:
            break
    assert float(result.model.delay) == 0 and np.isnan(result.std["delay"])
    place = result.free.index("delay")
    assert np.isnan(result.covariance[place]).all() and np.isnan(result.covariance[:, place]).all()
    fixed = COMPILED(record, FOPDT(T=5.0), fixed=("delay",))
    for name in fixed.free:
        np.testing.assert_allclose(result.std[name], fixed.std[name], rtol=1e-5)


def test_what_a_record_does_not_tell():
    """A gain from a record far too short, a damping far above 2: a verdict, with the names."""
    slow = FOPDT(T=2000.0, gain=20.0)
    result = COMPILED(simulated(slow, noise=0.05), FOPDT(T=500.0, gain=5.0))
    assert bool(result.status == Status.not_identifiable)
    told = dict(zip(result.free, np.asarray(result.details["identifiable"]), strict=True))
    assert not told["gain"] and told["offset"]

    creeping = SOPDT(zeta=4.0, omega_n=0.8, gain=2.0, offset=5.0)
    result = COMPILED(simulated(creeping, noise=0.1), START["SOPDT"])
    told = dict(zip(result.free, np.asarray(result.details["identifiable"]), strict=True))
    assert not told["zeta"] and told["gain"]


def test_students_quantile():
    freedom = jnp.array([3.0, 4.0, 6.0, 8.0, 20.0, 1e6])
    exact = stats.t.ppf(0.975, np.asarray(freedom))
    found = jax.vmap(student_95)(freedom)
    np.testing.assert_allclose(found, exact, rtol=2e-3)
    np.testing.assert_allclose(found[2:], exact[2:], rtol=1e-4)


def test_negative_correlation_makes_no_error_smaller():
    """Residuals that alternate: the usual formula, and no word of correlation."""
    record = simulated(PLANT)
    wave = 0.05 * (-1.0) ** np.arange(T.size)
    result = COMPILED(eqx.tree_at(lambda r: r.y, record, record.y + wave), START["FOPDT"])
    assert float(result.details["residual_autocorrelation"]) == 0
    assert not result.details["residuals_correlated"]
    found = jacobian(result)
    variance = float(jnp.sum((result.record.y - result.predict(T)) ** 2)) / (T.size - 4)
    usual = np.sqrt(variance * np.diag(np.linalg.inv(found.T @ found)))
    np.testing.assert_allclose([result.std[name] for name in result.free], usual, rtol=1e-5)


def few_rows(family, rows, count, noise=0.02):
    """Errors over standard errors of simulated records of few rows, and how many are successful."""
    plant, method = TRUE[family], METHODS[f"{family.lower()}_fit"]
    t = jnp.linspace(0.0, 45.0, rows)
    clean = plant.step_response(t - STEP_TIME)

    def one(key):
        y = clean + 2 * noise * jax.random.normal(key, t.shape)
        result = method(StepRecord(t, y, STEP_TIME, 1.0))
        away = {name: getattr(result.model, name) - getattr(plant, name) for name in result.std}
        return away, result.std, result.status == Status.successful

    keys = jax.random.split(jax.random.key(1), count)
    return jax.jit(lambda keys: jax.lax.map(one, keys, batch_size=50))(keys)


@pytest.mark.long
@pytest.mark.parametrize("rows", [10, 12, 20])
@pytest.mark.parametrize("family", ["FOPDT", "SOPDT"])
def test_intervals_of_few_rows_cover_the_truth(family, rows):
    away, std, usual = few_rows(family, rows, 1000)
    usual = np.asarray(usual)
    half = stats.t.ppf(0.975, rows - len(std))
    shares = {
        name: np.mean(np.abs(np.asarray(away[name]))[usual] <= half * np.asarray(std[name])[usual])
        for name in std
    }
    print(f"\n{family}, {rows} rows: {100 * usual.mean():.1f} % successful:", end=" ")
    print(", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items()))
    assert usual.mean() > 0.95
    assert all(0.92 <= share <= 0.97 for share in shares.values())


@pytest.mark.parametrize("late, delay", [(1.0, 2.0), (3.0, 2.0), (1.0, 0.0), (1.0, 0.5)])
@pytest.mark.parametrize("initial", [None, 5.0])
def test_a_record_that_begins_after_the_step(late, delay, initial):
    """A known level tells all; without it no dead time that ended before the first row is told."""
    t = np.arange(late, 60.0)
    noise = 0.01 * np.random.default_rng(0).standard_normal(t.size)
    y = 5 + 8 * (1 - np.exp(-np.maximum(t - delay, 0) / 8)) + noise
    result = METHODS["fopdt_fit"](StepRecord(t, y, 0.0, 4.0, initial=initial))
    np.testing.assert_allclose(result.model.T, 8, rtol=0.02)
    if initial is not None or delay > late:
        assert bool(result.status == Status.successful)
        np.testing.assert_allclose(result.model.delay, delay, atol=0.05)
        np.testing.assert_allclose(result.model.gain, 2, rtol=0.01)
    else:
        told = dict(zip(result.free, np.asarray(result.details["identifiable"]), strict=True))
        assert bool(result.status == Status.not_identifiable) and float(result.model.delay) == 0
        assert not told["gain"] and not told["offset"] and told["T"]


@pytest.mark.long
@pytest.mark.parametrize("phi", [0.0, 0.8])
@pytest.mark.parametrize("family", TRUE)
def test_intervals_cover_the_truth(family, phi):
    """95 % intervals of 2 000 records; those not interior and identifiable are counted apart."""
    plant = TRUE[family]
    clean = jnp.asarray(simulated(plant).y)

    def noise(key):
        white = jax.random.normal(key, T.shape) * jnp.sqrt(1 - phi**2)
        white = white.at[0].divide(jnp.sqrt(1 - phi**2))
        return jax.lax.scan(lambda e, w: (phi * e + w,) * 2, jnp.zeros(()), white)[1]

    def covered(key):
        record = StepRecord(T, clean + 0.02 * noise(key), STEP_TIME, STEP_SIZE)
        result = refine(record, START[family])
        inside = {
            name: jnp.abs(getattr(result.model, name) - getattr(plant, name)) <= 1.96 * std
            for name, std in result.std.items()
        }
        return inside, result.status == Status.successful

    inside, usual = jax.jit(lambda keys: jax.lax.map(covered, keys, batch_size=50))(
        jax.random.split(jax.random.key(7), 2000)
    )
    print(f"\n{family}, phi = {phi}: {100 * float(np.mean(usual)):.1f} % interior:", end=" ")
    assert np.mean(usual) > 0.9
    shares = {name: np.mean(np.asarray(hits)[usual], axis=0) for name, hits in inside.items()}
    print(", ".join(f"{name} {np.round(100 * share, 1)} %" for name, share in shares.items()))
    for name, share in shares.items():
        low, high = (0.93, 0.97) if phi == 0 else (0.88, 1)
        assert np.all((share >= low) & (share <= high)), name
