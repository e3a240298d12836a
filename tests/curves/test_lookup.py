"""Lookup against the curves that it inverts."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize
from tests.spread_curves import (
    EQUAL_LAGS,
    ORDERS,
    batched,
    curves,
    equal_lag_ends,
    families,
    grid,
)

from stepax import Hudzovic, PTn, Sani, Status, lookup, lookup_curves


pytestmark = pytest.mark.usefixtures("quick_compilation")

KINDS = ["tu_tg", "lam"]
TIMES = {"tu_tg": ("Tu", "Tg"), "lam": ("t10", "t50", "t90")}
FIRST_ORDER = {"tu_tg": 0.0, "lam": np.log(9) / np.log(2)}

kinds = pytest.mark.parametrize("kind", KINDS)


@functools.cache
def compiled_lookup(model, kind, derivative="forward", **options):
    """(n, T, r, status) of a batch of times, and the derivative along a direction.

    "forward": d(T, r) for a direction of the times; "reverse": for a direction of (T, r).
    """

    def parameters(times):
        found, status = lookup(model, **dict(zip(TIMES[kind], times, strict=True)), **options)
        return jnp.stack([found.T, found.r]), (found.n, found.T, found.r, status._value)  # pyright: ignore[reportAttributeAccessIssue]

    def one(times, direction):
        if derivative == "forward":
            _, along, found = jax.jvp(parameters, (times,), (direction,), has_aux=True)
        elif derivative == "reverse":
            _, pull, found = jax.vjp(parameters, times, has_aux=True)
            (along,) = pull(direction)
        else:
            along, found = direction, parameters(times)[1]
        return *found, along

    return jax.jit(jax.vmap(one))


class Found:
    """Lookups of a batch of times."""

    def __init__(self, model, kind, times, direction=None, derivative="forward", **options):
        times = np.asarray(times)
        if direction is None:
            direction = times
        function = compiled_lookup(model, kind, derivative, **options)
        self.n, self.T, self.r, self._status, self.along = batched(function, times, direction)

    def all_are(self, status):
        return (self._status == status._value).all()

    @property
    def refused(self):
        assert (np.isnan(self.T) == np.isnan(self.r)).all()
        return np.isnan(self.T)


def times_of(kind, table, T: float | np.ndarray = 1.0):
    """Times of plants from their four curves; t10 is any, lam alone counts."""
    tu_tg, inv_tg, lam, inv_t50 = table.T
    if kind == "tu_tg":
        return (np.stack([tu_tg, np.ones_like(tu_tg)]) / inv_tg * T).T
    return times_with_ratio(kind, lam) * (T / inv_t50)[:, None]


def times_with_ratio(kind, value):
    value = np.atleast_1d(np.asarray(value))
    one = np.ones_like(value)
    if kind == "tu_tg":
        return np.stack([value, one], axis=1)
    t10 = 0.5 * one
    return np.stack([t10, one, t10 + value], axis=1)


def ratio(kind, times):
    if kind == "tu_tg":
        return times[:, 0] / times[:, 1]
    return (times[:, 2] - times[:, 0]) / times[:, 1]


def inside(kind, value, amount):
    """A ratio moved towards the first-order end by a relative amount."""
    return value * (1 - amount if kind == "tu_tg" else 1 + amount)


# ---- inverses: where they lead


@families
@kinds
def test_lookup_returns_to_the_plant(model, kind):
    n, r = grid(model, np.linspace(0.05, 0.95, 19))
    table = curves(model, n, r)
    value = table[:, 0] if kind == "tu_tg" else -table[:, 2]
    ends = equal_lag_ends(kind) * (1 if kind == "tu_tg" else -1)
    smaller = np.concatenate([[FIRST_ORDER[kind] * ends[0] / abs(ends[0])], ends[:-1]])[
        n - 2
    ]  # end of the order below
    own = value > smaller + 1e-5 * np.abs(smaller)
    assert set(n[own]) == set(ORDERS)
    T = np.geomspace(1e-3, 1e5, own.sum())
    found = Found(model, kind, times_of(kind, table[own], T))
    assert found.all_are(Status.successful)
    assert (found.n == n[own]).all()
    assert np.allclose(found.r, r[own], rtol=0, atol=3e-11)
    assert np.allclose(found.T, T, rtol=3e-11, atol=0)


def sweep(kind, count):
    """Ratios over the whole range, dense at the first-order end and around every other."""
    first, last = FIRST_ORDER[kind], equal_lag_ends(kind)[-1]
    shares = [np.linspace(0, 1, count)[1:-1], 1 - np.geomspace(1e-5, 0.1, count // 4)]
    shares.append(np.geomspace(1e-3, 0.1, count // 4))
    around = [inside(kind, equal_lag_ends(kind), x) for x in (2e-6, 1e-5, 1e-4)]
    values = np.concatenate([first + s * (last - first) for s in shares] + around)
    ends = equal_lag_ends(kind)[None]
    within = np.abs(values[:, None] - ends) <= 1.5e-6 * ends  # those are equal lags by tolerance
    return values[~within.any(axis=1)]


def check_sweep(model, kind, count):
    times = times_with_ratio(kind, sweep(kind, count)) * 3.7
    found = Found(model, kind, times)
    assert found.all_are(Status.successful)
    table = curves(model, found.n, found.r)
    given = ratio(kind, times)
    reached = table[:, 0] if kind == "tu_tg" else table[:, 2]
    assert np.abs(reached - given).max() < 1e-12
    time, unit = (times[:, 1], table[:, 1] if kind == "tu_tg" else table[:, 3])
    assert np.allclose(found.T, time * unit, rtol=1e-11, atol=0)
    smallest = np.array([np.argmax(x) for x in contains(kind, given)]) + 2
    assert (found.n == smallest).all()


def contains(kind, value):
    sign = 1 if kind == "tu_tg" else -1
    return sign * value[:, None] <= sign * equal_lag_ends(kind)[None]


@families
@kinds
def test_curves_at_the_result_have_the_given_value(model, kind):
    check_sweep(model, kind, 300)


@pytest.mark.long
@families
@kinds
def test_curves_at_the_result_have_the_given_value_everywhere(model, kind):
    check_sweep(model, kind, 20_000)


@families
@kinds
def test_time_scales(model, kind):
    times = times_with_ratio(kind, sweep(kind, 120))
    one, seven = Found(model, kind, times), Found(model, kind, 7 * times)
    assert (one.n == seven.n).all()
    assert np.allclose(seven.T, 7 * one.T, rtol=1e-9, atol=0)
    assert np.allclose(seven.r, one.r, rtol=0, atol=1e-9)


# ---- inverses: the ends


@families
@kinds
def test_equal_lags_within_the_tolerance(model, kind):
    ends = equal_lag_ends(kind)
    for amount in (0.0, 5e-7, -5e-7):
        found = Found(model, kind, times_with_ratio(kind, inside(kind, ends, amount)))
        assert found.all_are(Status.at_equal_lags)
        assert (found.n == ORDERS).all()
        assert (found.r == (1.0 if model is Sani else 0.0)).all()
        assert (found.along[:, 1] == 0).all()
        assert np.allclose(found.T, EQUAL_LAGS[:, 1 if kind == "tu_tg" else 3], atol=6e-7, rtol=0)
        assert np.allclose(found.along[:, 0], found.T, rtol=1e-12, atol=0)  # T is homogeneous


@families
@kinds
def test_both_sides_of_the_tolerance(model, kind):
    ends = equal_lag_ends(kind)
    nearer = Found(model, kind, times_with_ratio(kind, inside(kind, ends, 2e-6)))
    assert nearer.all_are(Status.successful)
    assert (nearer.n == ORDERS).all()
    spread = 1 - nearer.r if model is Sani else nearer.r * (ORDERS - 1)
    assert ((spread > 0) & (spread < 0.05)).all()
    beyond = Found(model, kind, times_with_ratio(kind, inside(kind, ends[:-1], -2e-6)))
    assert beyond.all_are(Status.successful)
    assert (beyond.n == ORDERS[1:]).all()


@families
@kinds
def test_beyond_the_last_order(model, kind):
    last = equal_lag_ends(kind)[-1]
    values = inside(kind, last, np.array([-2e-6, -0.1, -0.4]))
    found = Found(model, kind, times_with_ratio(kind, values))
    assert found.all_are(Status.beyond_last_order) and found.refused.all()


@families
@kinds
def test_first_order(model, kind):
    first = FIRST_ORDER[kind]
    found = Found(model, kind, 2.0 * times_with_ratio(kind, [first, inside(kind, first, 5e-7)]))
    if model is Hudzovic:
        assert found.all_are(Status.beyond_first_order) and found.refused.all()
    else:
        assert found.all_are(Status.at_first_order)
        assert (found.r == 0).all()
        # One lag: Tg = T, t50 = T ln 2.
        assert np.allclose(found.T, 2 / (1 if kind == "tu_tg" else np.log(2)), rtol=1e-12, atol=0)


@families
@kinds
def test_beyond_the_first_order(model, kind):
    values = [-2e-6, -0.3] if kind == "tu_tg" else [FIRST_ORDER["lam"] * x for x in (1.00001, 2)]
    found = Found(model, kind, times_with_ratio(kind, values))
    assert found.all_are(Status.beyond_first_order) and found.refused.all()


nan, inf = np.nan, np.inf
INVALID = {
    "tu_tg": [(0.1, 0.0), (0.1, -1.0), (nan, 1.0), (0.1, nan), (0.1, inf), (inf, 1.0), (nan, nan)],
    "lam": [
        (1.0, 0.5, 2.0),
        (0.5, 1.0, 0.9),
        (0.5, 0.5, 1.0),
        (0.0, 1.0, 2.0),
        (-1.0, 1.0, 2.0),
        (nan, 1.0, 2.0),
        (0.1, nan, 2.0),
        (0.1, 1.0, nan),
        (0.1, 1.0, inf),
    ],
}


@families
@kinds
def test_invalid_times(model, kind):
    found = Found(model, kind, INVALID[kind])
    assert found.all_are(Status.invalid_times) and found.refused.all()


@families
@kinds
def test_a_refusal_leaves_its_neighbours_alone(model, kind):
    good = times_with_ratio(kind, sweep(kind, 40))
    bad = list(INVALID[kind])
    bad += times_with_ratio(kind, [FIRST_ORDER[kind], equal_lag_ends(kind)[-1]]).tolist()
    mixed = np.repeat(good, 2, axis=0)
    mixed[1::2] = np.resize(np.array(bad), good.shape)
    together, alone = Found(model, kind, mixed), Found(model, kind, good)
    assert together.refused[1::2].any()
    for name in ("n", "T", "r", "_status", "along"):
        assert np.isfinite(getattr(alone, name)).all()
        assert np.array_equal(getattr(together, name)[::2], getattr(alone, name))


# ---- inverses: derivatives


def interior_times(model, kind):
    """Times away from the ends of the orders, where r has a derivative."""
    n, r = grid(model, np.linspace(0.15, 0.85, 8))
    times = times_of(kind, curves(model, n, r), 2.5)
    value, ends = ratio(kind, times)[:, None], equal_lag_ends(kind)[None]
    return times[(np.abs(value / ends - 1) > 1e-2).all(axis=1)]


@families
@kinds
def test_derivatives(model, kind):
    times = interior_times(model, kind)
    for k in range(times.shape[1]):
        h = 1e-5 * times * (np.arange(times.shape[1]) == k)
        found, up, down = (Found(model, kind, times + s * h, h) for s in (0, 1, -1))
        difference = np.stack([up.T - down.T, up.r - down.r], axis=1) / 2
        assert np.isfinite(found.along).all()
        assert np.allclose(found.along, difference, rtol=2e-5, atol=2e-10)


def check_reverse(model, kind, **options):
    """The reverse derivative is the transpose of the forward one."""
    times = interior_times(model, kind)
    seeds = np.random.default_rng(1).normal(size=(len(times), 2))
    directions = times * np.random.default_rng(2).normal(size=times.shape)
    forward = Found(model, kind, times, directions, **options).along
    reverse = Found(model, kind, times, seeds, "reverse", **options).along
    products = np.sum(forward * seeds, axis=1), np.sum(reverse * directions, axis=1)
    assert np.isfinite(products).all()
    assert np.allclose(*products, rtol=1e-9, atol=1e-9)


def test_reverse_derivatives_by_the_tangent():
    check_reverse(Hudzovic, "tu_tg")


@pytest.mark.long
@pytest.mark.parametrize(("model", "kind"), [(Sani, "tu_tg"), (Sani, "lam"), (Hudzovic, "lam")])
def test_reverse_derivatives(model, kind):
    check_reverse(model, kind)


# ---- options


def test_only_the_orders_asked_for():
    ends = equal_lag_ends("lam")
    values = inside("lam", ends, 0.01)
    found = Found(Hudzovic, "lam", times_with_ratio("lam", values), derivative="", orders=(5, 3))
    assert found.n[:4].tolist() == [3, 3, 5, 5]
    reached = curves(Hudzovic, found.n[:4], found.r[:4])[:, 2]
    assert np.allclose(reached, values[:4], rtol=1e-12, atol=0)
    assert found.refused.tolist() == [False] * 4 + [True] * 3
    assert (found._status[4:] == Status.beyond_last_order._value).all()  # pyright: ignore[reportAttributeAccessIssue]


def test_a_wider_tolerance():
    ends = inside("tu_tg", equal_lag_ends("tu_tg"), -0.01)
    times = times_with_ratio("tu_tg", ends)
    found = Found(Hudzovic, "tu_tg", times, derivative="", tolerance=0.02)
    assert found.all_are(Status.at_equal_lags) and (found.n == ORDERS).all()


def formula_times(n, r):
    """Sani's eqs. 2.17 and 2.18 at T = 1: t50 and t90 - t10."""
    powers = r ** np.arange(n)
    return np.log(2) - 1 + powers.sum(), 1.315 * np.sqrt(3.8 * (powers**2).sum() - 1)


def formula_lam(n, r):
    t50, rise = formula_times(n, r)
    return rise / t50


def test_interpolation_formulae():
    values = np.linspace(0.93, 3.17, 100)
    times = 1.9 * times_with_ratio("lam", values)
    found = Found(Sani, "lam", times, formula=True)
    assert found.all_are(Status.successful)
    expected = []
    for value in values:
        n = next(n for n in ORDERS if formula_lam(n, 1.0) <= value)
        r = optimize.brentq(lambda r: formula_lam(n, r) - value, 0, 1, xtol=1e-14)  # noqa: B023
        expected.append((n, r, 1.9 / formula_times(n, r)[0]))
    n, r, T = np.array(expected).T
    assert (found.n == n).all()
    assert np.allclose(found.r, r, rtol=0, atol=1e-11)
    assert np.allclose(found.T, T, rtol=1e-11, atol=0)
    # Homogeneous: T scales with the times, r stays.
    assert np.allclose(found.along, np.stack([found.T, 0 * r], axis=1), rtol=1e-10, atol=1e-12)
    check_reverse(Sani, "lam", formula=True)


def test_interpolation_formulae_at_their_ends():
    values = [formula_lam(n, 1.0) for n in ORDERS]
    found = Found(Sani, "lam", times_with_ratio("lam", values), formula=True)
    assert found.all_are(Status.at_equal_lags) and (found.n == ORDERS).all()
    first = Found(Sani, "lam", times_with_ratio("lam", formula_lam(2, 0.0)), formula=True)
    assert first.all_are(Status.at_first_order) and (first.r == 0).all()
    beyond = Found(Sani, "lam", times_with_ratio("lam", [0.9, 0.6]), formula=True)
    assert beyond.all_are(Status.beyond_last_order) and beyond.refused.all()


def test_lookups_published_as_examples():
    """Murray 2016, figures 3-6: the plants whose curves are marked there (E35 of the notes)."""
    t50 = 1 / 0.20077
    for model, kind, times, n, r in (
        (Hudzovic, "tu_tg", (0.16529, 1.0), 3, 0.4),
        (Hudzovic, "lam", (0.1, t50, 0.1 + 1.76677 * t50), 3, 0.3479),
        (Sani, "tu_tg", (0.31658, 1.0), 4, 0.9),
        (Sani, "lam", (0.1, 1.0, 1.7026), 3, 0.8),
    ):
        found = Found(model, kind, [times])
        assert found.n[0] == n
        assert abs(found.r[0] - r) < 5e-4
    found = Found(Sani, "lam", [(0.1, 1.0, 1.7062)], formula=True)
    assert found.n[0] == 3 and abs(found.r[0] - 0.8) < 5e-4
    assert abs(found.T[0] - 0.4688) < 1e-4


def test_result_of_one_lookup():
    found = lookup(Hudzovic, Tu=0.16529 / 0.10733, Tg=1 / 0.10733)
    model, status = found
    assert isinstance(model, Hudzovic)
    assert (found.model, found.status) == (model, status)
    assert found.status == Status.successful
    assert (model.gain, model.offset, model.delay) == (1, 0, 0)
    assert abs(model.T - 1) < 1e-3 and abs(model.r - 0.4) < 1e-3 and model.n == 3


@pytest.mark.parametrize(
    ("model", "kind"),
    [
        (Hudzovic, "tu_tg"),
        (Sani, "lam"),
        pytest.param(Hudzovic, "lam", marks=pytest.mark.long),
        pytest.param(Sani, "tu_tg", marks=pytest.mark.long),
    ],
)
def test_lookup_in_float32(model, kind):
    values = sweep(kind, 60)
    away = (np.abs(values[:, None] / equal_lag_ends(kind)[None] - 1) > 0.01).all(axis=1)
    times = times_with_ratio(kind, values[away]) * 2.0
    double = Found(model, kind, times)
    single = Found(model, kind, times.astype(np.float32), derivative="")
    assert single.T.dtype == single.r.dtype == np.float32
    assert single.all_are(Status.successful) and (single.n == double.n).all()
    assert np.allclose(single.r, double.r, rtol=0, atol=0.01)
    table = curves(model, single.n, single.r.astype(float))
    reached = table[:, 0] if kind == "tu_tg" else table[:, 2]
    assert np.abs(reached - ratio(kind, times)).max() < 1e-4


# ---- mistakes


@pytest.mark.parametrize(
    "times",
    [
        {},
        {"Tu": 1.0},
        {"Tg": 1.0},
        {"t10": 1.0, "t50": 2.0},
        {"t50": 2.0, "t90": 3.0},
        {"Tu": 1.0, "Tg": 5.0, "t50": 2.0},
        {"Tu": 1.0, "t10": 1.0, "t50": 2.0, "t90": 3.0},
    ],
)
def test_times_of_one_kind(times):
    with pytest.raises(TypeError, match="either Tu and Tg, or t10, t50 and t90"):
        lookup(Hudzovic, **times)


def test_models_without_curves():
    """A sentence of our own, or of the type checker when that is on."""
    with pytest.raises(TypeError, match="Hudzovic"):
        lookup(PTn, Tu=1.0, Tg=5.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match="Hudzovic"):
        lookup_curves(PTn, 3, 0.1)  # pyright: ignore[reportArgumentType]


def test_a_batch_of_times_needs_vmap():
    with pytest.raises(ValueError, match="vmap"):
        lookup(Hudzovic, Tu=np.array([1.0, 2.0]), Tg=np.array([5.0, 5.0]))


@pytest.mark.parametrize("orders", [(), (1, 2), (2, 9), range(0)])
def test_orders_out_of_range(orders):
    with pytest.raises(ValueError, match="orders must be whole numbers from 2 to 8"):
        lookup(Hudzovic, Tu=1.0, Tg=5.0, orders=orders)


def test_formulae_only_where_they_exist():
    with pytest.raises(ValueError, match="formula=True is for Sani"):
        lookup(Hudzovic, t10=1.0, t50=2.0, t90=4.0, formula=True)
    with pytest.raises(ValueError, match="formula=True is for Sani"):
        lookup(Sani, Tu=1.0, Tg=4.0, formula=True)


def test_times_are_real_numbers():
    with pytest.raises(TypeError, match="real number"):
        lookup(Hudzovic, Tu=1j, Tg=5.0)  # pyright: ignore[reportArgumentType]
