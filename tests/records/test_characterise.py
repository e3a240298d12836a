"""Crossing times and tangents against closed forms, and the five lookup methods on records."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, special

from stepax import (
    FOPDT,
    METHODS,
    SOPDT,
    Hudzovic,
    Sani,
    Status,
    StepRecord,
    crossing_times,
    tangent,
)


pytestmark = pytest.mark.usefixtures("quick_compilation")

SAMPLES = 2000
LEVELS = np.array([0.1, 0.5, 0.9])
PLANT = {"T": 2.0, "r": 0.2, "n": 4}
END = 60.0  # 99.9 % of the plant and more
LANES = 12


@functools.cache
def compiled_crossings(levels=tuple(LEVELS), span=None):
    """Of a batch: t, y, step_time, initial, final."""

    def one(t, y, step_time, initial, final):
        record = StepRecord(t, y, step_time, initial=initial, final=final)
        return crossing_times(record, jnp.array(levels), span)

    return jax.jit(jax.vmap(one))


@functools.cache
def compiled_tangent():
    def one(t, y, step_time, initial, final):
        return tangent(StepRecord(t, y, step_time, initial=initial, final=final))

    return jax.jit(jax.vmap(one))


def beta_quantiles(T, r, n, levels=LEVELS):
    """Level times of Hudzovic's plant: 1 - exp(-r t/T) is beta distributed, (n, 1/r - n + 1)."""
    x = special.betaincinv(n, (1 - (n - 1) * r) / r, levels)
    return -np.log1p(-x) * T / r


def sampling(samples=SAMPLES, even=True, end=END, before=0.0):
    t = np.linspace(-before, end, samples)
    if not even:
        h = t[1] - t[0]
        t[1:-1] += np.random.default_rng(3).uniform(-0.3 * h, 0.3 * h, samples - 2)
    return t


def response(plant, t):
    return np.asarray(plant.step_response(jnp.asarray(t)))


def records(samples=SAMPLES, before=0.0):
    """Even and uneven times x step at 0 and at 12.3 x two pairs of levels."""
    rows = []
    for even in (True, False):
        for step_time in (0.0, 12.3):
            for initial, final in ((0.0, 1.0), (40.0, -3.0)):
                t = sampling(samples, even, before=before)
                y = initial + (final - initial) * response(Hudzovic(**PLANT), t)
                rows.append((t + step_time, y, step_time, initial, final))
    return tuple(map(np.array, zip(*rows, strict=True)))


# ---- crossing times


@pytest.mark.parametrize("before", [0.0, 7.0])
def test_crossing_times_of_a_smooth_record(before):
    times = compiled_crossings()(*records(before=before))
    expected = beta_quantiles(**PLANT)
    assert np.allclose(times, np.tile(expected, (len(times), 1)), rtol=1e-8, atol=0)


def test_any_levels_in_any_shape():
    t = sampling()
    record = StepRecord(t, response(Hudzovic(**PLANT), t), initial=0, final=1)
    levels = [0.02, 0.28, 0.353, 0.632, 0.853, 0.98]
    expected = beta_quantiles(**PLANT, levels=np.array(levels))
    times = jax.jit(lambda record: crossing_times(record, levels))(record)
    assert np.allclose(times, expected, rtol=1e-7, atol=0)
    shape = jax.eval_shape(lambda record: crossing_times(record, 0.632), record).shape
    assert shape == ()


def test_crossings_of_an_oscillation_are_the_first():
    zeta, omega_n = 0.15, 0.9
    damped = omega_n * np.sqrt(1 - zeta**2)

    def g(t):
        swing = np.cos(damped * t) + zeta * omega_n / damped * np.sin(damped * t)
        return 1 - np.exp(-zeta * omega_n * t) * swing

    t = sampling()
    y = np.array([g(t), 5 - 2 * response(SOPDT(zeta=zeta, omega_n=omega_n), t)])
    lanes = np.array([t, t]), y, np.zeros(2), np.array([0.0, 5.0]), np.array([1.0, 3.0])
    expected = [optimize.brentq(lambda t: g(t) - q, 0, np.pi / damped, xtol=1e-13) for q in LEVELS]  # noqa: B023
    times = compiled_crossings()(*lanes)
    assert np.allclose(times, np.array([expected, expected]), rtol=1e-7, atol=0)


def test_levels_never_crossed():
    t, y, step_time, initial, _ = records()
    final = initial + 1.5 * (records()[4] - initial)  # the record ends at 2/3 of that
    times = np.asarray(compiled_crossings()(t, y, step_time, initial, final))
    assert np.isfinite(times[:, :2]).all() and np.isnan(times[:, 2]).all()
    falls = np.asarray(compiled_crossings()(t, y, step_time, initial, 2 * initial - final))
    assert np.isnan(falls).all()


def test_noise_biases_crossings_less_than_the_first_crossing():
    """Where the response is slow, noise crosses a level early as often as late."""
    t = sampling(400)
    clean = response(Hudzovic(**PLANT), t)
    y = clean + 0.01 * np.random.default_rng(5).normal(size=(3000, t.size))
    ones = np.ones(len(y))
    times = np.asarray(compiled_crossings()(np.tile(t, (len(y), 1)), y, 0 * ones, 0 * ones, ones))
    first = np.stack([t[np.argmax(y >= q, axis=1)] for q in LEVELS], axis=1)
    expected = beta_quantiles(**PLANT)
    bias, bias_of_first = (np.mean(x, axis=0) - expected for x in (times, first))
    assert np.abs(bias).max() < 0.25 * np.abs(bias_of_first).max()
    assert (np.abs(bias)[1:] < 0.25 * np.abs(bias_of_first)[1:]).all()


def monotone_regression(y):
    """Pool adjacent violators, one sample after the other."""
    pools = []
    for value in y:
        pools.append([value, 1])
        while len(pools) > 1 and pools[-2][0] >= pools[-1][0]:
            (a, m), (b, n) = pools[-2:]
            pools[-2:] = [[(m * a + n * b) / (m + n), m + n]]
    return np.repeat(*map(np.array, zip(*pools, strict=True)))


def test_noisy_crossings_are_those_of_the_monotone_regression():
    t = sampling(250, end=25)
    y = response(Hudzovic(**PLANT), t) + 0.05 * np.random.default_rng(7).normal(size=(50, t.size))
    ones = np.ones(len(y))
    times = np.asarray(compiled_crossings()(np.tile(t, (len(y), 1)), y, 0 * ones, 0 * ones, ones))
    for row, found in zip(y, times, strict=True):
        row = np.where(t > 0, row, 0)
        regression = monotone_regression(row[: np.argmax(row) + 1])
        for level, time in zip(LEVELS, found, strict=True):
            above = np.argmax(regression >= level)
            assert t[above - 1] - 0.1 <= time <= t[above] + 0.1


def test_late_noise_does_not_move_a_level():
    """A drop in the tail below the level, and back."""
    t = sampling(400)
    y = np.tile(response(Hudzovic(**PLANT), t), (2, 1))
    y[1, 200] = 0.4
    lanes = np.stack([t, t]), y, np.zeros(2), np.zeros(2), np.ones(2)
    clean, dropped = np.asarray(compiled_crossings()(*lanes))
    assert np.array_equal(clean, dropped)


def test_smoothing_first_helps_with_noise():
    t = sampling(400)
    y = response(Hudzovic(**PLANT), t) + 0.01 * np.random.default_rng(6).normal(size=(8, t.size))
    zeros = np.zeros(8)
    lanes = np.tile(t, (8, 1)), y, zeros, zeros, zeros + 1
    rough = np.asarray(compiled_crossings()(*lanes))
    smoothed = np.asarray(compiled_crossings(span=0.08)(*lanes))
    error, of_rough = (np.std(x - beta_quantiles(**PLANT)[None]) for x in (smoothed, rough))
    assert error < of_rough and np.isfinite(smoothed).all()


# ---- tangent


def hudzovic_tangent(T, r, n):
    """Closed form: E(t_i) = (n-1) T, slope = prod(1/T_k) exp(-m t_i) E^(n-1)/(n-1)!."""
    rates = (1 - np.arange(n) * r) / T
    t = np.log(1 / (1 - (n - 1) * r)) * T / r
    d = r / T
    e = -np.expm1(-d * t) / d
    slope = np.prod(rates) * np.exp(-rates[-1] * t) * e ** (n - 1) / special.factorial(n - 1)
    g = special.betainc(n, rates[-1] / d, -np.expm1(-d * t))
    return {"Tu": t - g / slope, "Tg": 1 / slope, "t_inflection": t}


@pytest.mark.parametrize(("samples", "accuracy"), [(250, 1e-5), (SAMPLES, 1e-8)])
def test_tangent_of_a_smooth_record(samples, accuracy):
    lanes = records(samples)
    found = compiled_tangent()(*lanes)
    expected = hudzovic_tangent(**PLANT)
    for name in ("Tu", "Tg"):
        assert np.allclose(getattr(found, name), expected[name], rtol=accuracy, atol=0)
    assert np.allclose(found.t_inflection, expected["t_inflection"], rtol=30 * accuracy, atol=0)
    change = lanes[4] - lanes[3]
    assert np.allclose(found.slope * expected["Tg"], change, rtol=accuracy, atol=0)
    height = lanes[3] + change * (expected["t_inflection"] - expected["Tu"]) / expected["Tg"]
    assert np.allclose(found.y_inflection, height, rtol=100 * accuracy, atol=0)


def test_no_tangent_without_a_rise():
    t, y, step_time, initial, final = records()
    found = compiled_tangent()(t, 0 * y + initial[:, None], step_time, initial, final)
    assert np.isnan(found.Tu).all() and np.isnan(found.Tg).all()


# ---- derivatives


@functools.cache
def compiled_derivatives(function, reverse):
    """Value, derivative along a change of the samples; a seed and its reverse derivative."""

    def characteristics(y, t):
        record = StepRecord(t, y, initial=0, final=1)
        if function is tangent:
            line = tangent(record)
            return jnp.stack([line.Tu, line.Tg])
        return crossing_times(record, jnp.array(LEVELS))

    def one(y, t, direction):
        value, forward = jax.jvp(lambda y: characteristics(y, t), (y,), (direction,))
        if not reverse:
            return value, forward
        _, pull = jax.vjp(lambda y: characteristics(y, t), y)
        seed = jnp.arange(1.0, value.size + 1)
        return value, forward, seed, pull(seed)[0]

    return jax.jit(jax.vmap(one))


@pytest.mark.parametrize(
    ("function", "reverse"),
    [
        (crossing_times, True),
        (tangent, False),
        pytest.param(tangent, True, marks=pytest.mark.long),
    ],
)
def test_derivatives_with_respect_to_the_samples(function, reverse):
    t = np.tile(sampling(250), (3, 1))
    y = response(Hudzovic(**PLANT), t)
    waves = np.sin(t / 3 + np.arange(3)[:, None]) * y
    run = compiled_derivatives(function, reverse)
    _, forward, *back = run(y, t, waves)
    h = 1e-5
    difference = (run(y + h * waves, t, waves)[0] - run(y - h * waves, t, waves)[0]) / (2 * h)
    assert np.allclose(forward, difference, rtol=1e-5, atol=1e-6)
    if back:
        seed, by_sample = back
        products = np.sum(forward * seed, axis=1), np.sum(by_sample * waves, axis=1)
        assert np.allclose(*products, rtol=1e-9, atol=1e-11)


# ---- methods


METHOD_NAMES = [
    "hudzovic_tu_tg",
    "hudzovic_t10_t50_t90",
    "sani_tu_tg",
    "sani_t10_t50_t90",
    "sani_interpolation",
]
methods = pytest.mark.parametrize("name", METHOD_NAMES)


@functools.cache
def compiled_method(name):
    def one(t, y, step_time, step_size, initial, final, delay):
        record = StepRecord(t, y, step_time, step_size, initial, final)
        return METHODS[name](record, delay=delay)

    return jax.jit(jax.vmap(one))


def run_method(name, rows):
    """Results of up to LANES records; the rest of the lanes repeats the last."""
    rows = rows + [rows[-1]] * (LANES - len(rows))
    return compiled_method(name)(*map(np.array, zip(*rows, strict=True)))


def record_of(plant, end=END, step_time=0.0, step_size=1.0, even=True, delay=0.0):
    """A plant's record (gain, offset and dead time are the plant's), levels known."""
    t = sampling(SAMPLES, even, end)
    unit = np.asarray(plant.unit_response(jnp.asarray(t - float(plant.delay))))
    initial, gain = float(plant.offset), float(plant.gain)
    final = initial + step_size * gain
    y = initial + step_size * gain * unit
    return t + step_time, y, step_time, step_size, initial, final, delay


def own_records(family):
    """Records of the method's own family, whose order is the smallest that fits."""
    shapes = {Hudzovic: [(2, 0.5), (3, 0.12), (4, 0.08)], Sani: [(2, 0.5), (3, 0.8), (4, 0.85)]}
    plants, rows = [], []
    for n, r in shapes[family]:
        for options, levels in (
            ({}, {}),
            ({"step_time": 12.0, "step_size": 3.0}, {"gain": -2.5, "offset": 40.0}),
            ({"even": False, "step_size": 3.0}, {"gain": 0.2, "offset": -7.0}),
            ({"delay": 1.5, "step_time": -4.0}, {"delay": 1.5, "gain": 4.0, "offset": 1.0}),
        ):
            plant = family(T=2.0, r=r, n=n, **levels)
            plants.append(plant)
            rows.append(record_of(plant, 45.0, **options))  # pyright: ignore[reportArgumentType]
    return plants, rows


@methods
def test_methods_recover_plants_of_their_family(name):
    family = Hudzovic if "hudzovic" in name else Sani
    plants, rows = own_records(family)
    result = run_method(name, rows)
    assert (result.status == Status.successful).all()
    assert isinstance(result.model, family)
    for parameter in ("gain", "offset", "delay"):
        expected = [float(getattr(p, parameter)) for p in plants]
        assert np.allclose(getattr(result.model, parameter), expected, rtol=1e-12, atol=1e-12)
    if name == "sani_interpolation":
        check_formulae(result)
        return
    assert np.asarray(result.model.n).tolist() == [p.n for p in plants]
    # The kink of a dead time lies inside the record: the samples around it cost the tangent's
    # method nothing, for the inflection comes later.
    assert np.allclose(result.model.T, 2.0, rtol=1e-6, atol=0)
    assert np.allclose(result.model.r, [float(p.r) for p in plants], rtol=0, atol=1e-6)
    assert np.allclose(result.fit_percent, 100, rtol=0, atol=1e-3)


def check_formulae(result):
    """Murray 2016, eqs. 2.17 and 2.18, at the times that were read."""
    delay = np.asarray(result.model.delay)
    t10, t50, t90 = (np.asarray(result.details[k]) - delay for k in ("t10", "t50", "t90"))
    for k in range(LANES):
        n, r, T = (np.asarray(getattr(result.model, x))[k] for x in ("n", "r", "T"))
        powers = r ** np.arange(n)
        assert np.allclose(t50[k], T * (np.log(2) - 1 + powers.sum()), rtol=1e-9, atol=0)
        rise = 1.315 * T * np.sqrt(3.8 * (powers**2).sum() - 1)
        assert np.allclose(t90[k] - t10[k], rise, rtol=1e-9, atol=0)
        assert 0 < r < 1
    assert (np.asarray(result.rmse / np.abs(result.model.gain)) < 0.1).all()


def refused_records():
    """Name -> record that no lookup method can use."""
    t, y, *rest = record_of(Hudzovic(**PLANT))
    hole, back, endless = y.copy(), t.copy(), t.copy()
    hole[700] = np.nan
    back[5] = back[4]
    endless[-1] = np.inf
    return {
        "nonfinite_data": [(t, hole, *rest), (endless, y, *rest)],
        "time_not_increasing": [(back, y, *rest), (t[::-1], y, *rest)],
        "constant_output": [(t, 0 * y + 4, *rest)],
        "no_step": [(t, y, 0.0, 0.0, *rest[2:])],
        "step_outside_record": [(t, y, 100.0, *rest[1:])],
        "too_few_samples": [(t, y, t[-5], *rest[1:])],
    }


@methods
def test_refusals_are_statuses_and_leave_their_neighbours_alone(name):
    good = own_records(Hudzovic if "hudzovic" in name else Sani)[1][0]
    wanted, rows = ["successful"], [good]
    for status, bad in refused_records().items():
        wanted += [status] * len(bad)
        rows += bad
    result = run_method(name, rows)
    alone = run_method(name, [good])
    for k, status in enumerate(wanted):
        assert result.status._value[k] == getattr(Status, status)._value, status
        numbers = [result.model.T[k], result.model.r[k], result.model.gain[k], result.rmse[k]]
        assert np.isfinite(numbers).all() if k == 0 else np.isnan(numbers).all()
    for a, b in zip(jax.tree.leaves(result), jax.tree.leaves(alone), strict=True):
        assert np.array_equal(a[0], b[0], equal_nan=True)


@methods
def test_records_that_no_member_of_the_family_fits(name):
    first = record_of(FOPDT(T=3.0))
    late = record_of(FOPDT(T=3.0, delay=20.0))
    t, y, *rest = record_of(Hudzovic(**PLANT))
    short = (t, y, *rest[:3], 2.0, 0.0)
    result = run_method(name, [first, late, short])
    status = result.status._value
    if name != "sani_interpolation":
        expected = Status.beyond_first_order if "hudzovic" in name else Status.at_first_order
        assert status[0] == expected._value
        assert np.isnan(result.model.T[0]) if "hudzovic" in name else result.model.r[0] == 0
    assert status[1] == Status.beyond_last_order._value
    if "tu_tg" not in name:
        assert status[2] == Status.levels_not_crossed._value
    assert np.isnan(result.model.T[1])


def test_three_samples():
    result = jax.jit(METHODS["sani_interpolation"])(StepRecord([0, 1, 2], [0, 0.5, 1]))
    assert result.status == Status.too_few_samples
    assert np.isnan(result.model.T) and np.isnan(result.rmse)


def test_unknown_levels_are_read_off_the_record():
    """Estimated from the last sample, at which 1 - g is about 1e-13."""
    t = sampling(end=150.0)
    y = 5 - 3 * response(Hudzovic(**PLANT), t)
    times = jax.jit(lambda t, y: crossing_times(StepRecord(t, y), jnp.array(LEVELS)))(t, y)
    assert np.allclose(times, beta_quantiles(**PLANT), rtol=1e-6, atol=0)
