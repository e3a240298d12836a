r"""From characteristic times to a chain: the exact inverses of the lookup curves.

Nothing is tabulated: an inverse is a root in the spread coordinate c of `models/_spread.py`, found
to rounding error and differentiable.
"""

import functools
import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from .._arrays import Scalar, as_real, nan_where
from .._status import Status, refused
from ..models._plants import Hudzovic, Sani
from ..models._spread import (
    DEFAULT_ORDERS,
    AbstractSpreadChain,
    chain_with_spread,
    check_orders,
    check_spread_chain,
)
from ._times import (
    FIRST_ORDER_LAM,
    LEVELS,
    equal_lag_ends,
    inflection_bracket,
    inflection_equation,
    tangent_line,
    three_times,
)


class Lookup(NamedTuple):
    """What `lookup` returns: the model (NaN parameters if refused) and its `Status`."""

    model: AbstractSpreadChain
    status: Status


class _Ends(NamedTuple):
    """Range of a measured ratio over the orders: per-order equal-lag ends, first-order end."""

    equal_lags: np.ndarray
    first_order: float


def _select(value: Scalar, orders: tuple[int, ...], ends: _Ends, tolerance: float):
    """Smallest order whose range, widened by a relative tolerance, contains a ratio.

    A ratio rises or falls from the first-order end to the equal-lag end. **Returns:** order, its
    equal-lag end, and the truth of: within tolerance of that end, of the first-order end, beyond
    the first order, beyond the last order.
    """
    rising = bool(ends.equal_lags[0] > ends.first_order)
    sign = 1.0 if rising else -1.0
    ends_of = jnp.asarray(ends.equal_lags, jnp.result_type(value))
    contains = sign * (value - ends_of) <= tolerance * ends_of
    index = jnp.argmax(contains)
    end = ends_of[index]
    scale = ends.first_order or 1.0
    before = sign * (ends.first_order - value)
    return (
        jnp.asarray(orders)[index],
        end,
        jnp.abs(value - end) <= tolerance * end,
        jnp.abs(before) <= tolerance * scale,
        before > tolerance * scale,
        ~jnp.any(contains),
    )


class _Ratio(NamedTuple):
    """A ratio of characteristic times, and one Newton step towards it.

    `value(plant)` is exact and differentiable. `newton(model, n, log_c, log_t)` starts from times
    that are only approximate and returns the ratio, its slope in log c, better times, and the
    slope of the times in log c: the inversion improves c and the times together.
    """

    value: Callable[[AbstractSpreadChain], Array]
    newton: Callable[..., tuple[Array, Array, Array, Array]]


def _invert(model, ratio: _Ratio, value, n, end, first_order, interior) -> Scalar:
    """r at which the ratio of an order n chain has a value, for values inside its range.

    Newton's method for log c, with the distance to the first-order end on a logarithmic scale,
    where every curve is close to straight.
    """
    value = jnp.where(interior, value, 0.5 * (end + first_order))
    log_c = _spread_of(value, n, end, model, ratio, first_order)
    return chain_with_spread(model, log_c, n).r


@functools.partial(jax.custom_jvp, nondiff_argnums=(3, 4, 5))
def _spread_of(value, n, end, model, ratio: _Ratio, first_order: float):
    eps = jnp.finfo(value.dtype).eps
    small = jnp.sqrt(eps) / 10
    lowest, highest = -25.0, jnp.log1p(-8 * eps)

    def share(x):
        x = (x - first_order) / (end - first_order)
        return jnp.log(jnp.maximum(x, eps))

    def step(state):
        log_c, log_t, _, steps = state
        x, slope, better_t, slope_t = ratio.newton(model, n, log_c, log_t)
        slope = slope / (x - first_order)
        move = (share(value) - share(x)) / jnp.where(slope > 0, slope, 1)
        move = jnp.where(steps < SETTLING_STEPS, 0, jnp.clip(move, -1, 1))
        new = jnp.clip(log_c + move, lowest, highest)
        new_t = better_t + slope_t * (new - log_c)
        error = jnp.maximum(jnp.abs(new - log_c), jnp.max(jnp.abs(new_t - log_t)))
        return new, new_t, error, steps + 1

    def unfinished(state):
        *_, error, steps = state
        return (steps <= SETTLING_STEPS) | ((error > small) & (steps < MAX_STEPS))

    start = jnp.clip(share(value), lowest, highest)
    log_t = jnp.zeros((len(LEVELS),), start.dtype)
    state = (start, log_t, jnp.full_like(start, jnp.inf), 0)
    return jax.lax.while_loop(unfinished, step, state)[0]


@_spread_of.defjvp
def _spread_of_jvp(model, ratio, first_order, primals, tangents):
    """Implicit function theorem: d log c = d value / (d ratio / d log c)."""
    value, n, end = primals
    log_c = _spread_of(value, n, end, model, ratio, first_order)
    _, slope = jax.jvp(
        lambda x: ratio.value(chain_with_spread(model, x, n)), (log_c,), (jnp.ones_like(log_c),)
    )
    return log_c, tangents[0] / slope


SETTLING_STEPS = 4
"""Newton steps on the times alone before c moves."""
MAX_STEPS = 40


def _newton_levels(model, n, log_c, log_t):
    """lam by one Newton step on each level time."""

    def parameters(log_c):
        plant = chain_with_spread(model, log_c, n)
        return {"T": plant.T, "r": plant.r}

    own, change = jax.jvp(parameters, (log_c,), (jnp.ones_like(log_c),))
    g, slope_t, (slope_c,) = model(**own, n=n).slopes(jnp.exp(log_t), [change])
    slope_t = slope_t * jnp.exp(log_t)
    eps = jnp.finfo(g.dtype).eps
    g = jnp.clip(g, eps, 1 - eps)
    levels = np.array(LEVELS)
    distance = jnp.log(g / (1 - g)) - jnp.asarray(np.log(levels / (1 - levels)), g.dtype)
    slope_t = jnp.maximum(slope_t, eps)
    better = log_t - jnp.clip(distance * g * (1 - g) / slope_t, -2, 2)
    along = -slope_c / slope_t
    t, dt = jnp.exp(better), jnp.exp(better) * along
    lam = (t[2] - t[0]) / t[1]
    return lam, (dt[2] - dt[0]) / t[1] - lam * along[1], better, along


def _newton_tangent(model, n, log_c, log_t):
    """Tu/Tg: stationary in the time of the inflection, which takes one Newton step on its own."""

    def at(log_c, t):
        plant = chain_with_spread(model, log_c, n)
        g, slope = plant.response_and_slope(t)
        return slope - g

    if chain_with_spread(model, log_c, n).inflection() is not None:
        ratio = lambda x: _tu_tg(chain_with_spread(model, x, n))  # noqa: E731
        value, slope = jax.jvp(ratio, (log_c,), (jnp.ones_like(log_c),))
        return value, slope, log_t, jnp.zeros_like(log_t)
    plant = chain_with_spread(model, log_c, n)
    lower, upper = inflection_bracket(plant)
    x = jnp.clip(log_t[0], lower, upper)
    value, slope = inflection_equation(plant.lags, x)
    x = jnp.clip(x - value / jnp.where(slope > 0, slope, 1), lower, upper)
    value, slope = jax.jvp(lambda c: at(c, jnp.exp(x)), (log_c,), (jnp.ones_like(log_c),))
    return value, slope, jnp.full_like(log_t, x), jnp.zeros_like(log_t)


def _lam(plant: AbstractSpreadChain) -> Array:
    t10, t50, t90 = three_times(plant)
    return (t90 - t10) / t50


def _tu_tg(plant: AbstractSpreadChain) -> Array:
    return tangent_line(plant)[0]


def _formula_t50(plant: AbstractSpreadChain) -> Array:
    """Sani's eq. 2.17 over T, with a sum for the quotient (1 - r^n)/(1 - r)."""
    return math.log(2) - 1 + jnp.sum(plant.lags / plant.T)


def _newton_formula(model, n, log_c, log_t):
    value, slope = jax.jvp(
        lambda x: _formula_lam(chain_with_spread(model, x, n)), (log_c,), (jnp.ones_like(log_c),)
    )
    return value, slope, log_t, jnp.zeros_like(log_t)


def _formula_lam(plant: AbstractSpreadChain) -> Array:
    """Sani's eq. 2.19: eq. 2.18 over eq. 2.17."""
    lags = plant.lags / plant.T
    return 1.315 * jnp.sqrt(3.8 * jnp.sum(lags**2) - 1) / _formula_t50(plant)


_LAM = _Ratio(_lam, _newton_levels)
_TU_TG = _Ratio(_tu_tg, _newton_tangent)
_FORMULA = _Ratio(_formula_lam, _newton_formula)


def _formula_ends(orders: tuple[int, ...]) -> _Ends:
    n = np.array(orders, float)
    return _Ends(
        1.315 * np.sqrt(3.8 * n - 1) / (math.log(2) - 1 + n), 1.315 * math.sqrt(2.8) / math.log(2)
    )


def _solve(model, orders, tolerance, ratio, ends, value, time_at_unit, time, valid) -> Lookup:
    """Order and r from a ratio of times, T from one time; everything in one batchable pass."""
    n, end, at_end, at_first, beyond_first, beyond_last = _select(value, orders, ends, tolerance)
    interior = valid & ~(at_end | at_first | beyond_first | beyond_last)
    r = _invert(model, ratio, value, n, end, ends.first_order, interior)
    r = jnp.where(at_end, model.r_at_equal_lags, jnp.where(at_first, 0.0, r))
    T = time / time_at_unit(model(T=jnp.ones_like(r), r=r, n=n))
    reached = model.reaches_first_order
    first = Status.at_first_order if reached else Status.beyond_first_order
    status = Status.successful
    for condition, meaning in (
        (at_end, Status.at_equal_lags),
        (at_first, first),
        (beyond_first, Status.beyond_first_order),
        (beyond_last, Status.beyond_last_order),
        (~valid, Status.invalid_times),
    ):
        status = Status.where(condition, meaning, status)
    return Lookup(nan_where(refused(status), model(T=T, r=r, n=n)), status)


def lookup(
    model: type[Hudzovic] | type[Sani],
    *,
    Tu: ArrayLike | None = None,
    Tg: ArrayLike | None = None,
    t10: ArrayLike | None = None,
    t50: ArrayLike | None = None,
    t90: ArrayLike | None = None,
    orders: Iterable[int] = DEFAULT_ORDERS,
    formula: bool = False,
    tolerance: float = 1e-6,
) -> Lookup:
    r"""Model from times read by hand: (`Tu`, `Tg`) or (`t10`, `t50`, `t90`).

    The order is the smallest one whose curve contains the measured ratio (Murray 2016, eqs.
    2.15-2.16, with the ends set right: both families end at equal lags), r is the exact inverse of
    the curve there, and T = Tg (1/Tg)(r, n) or t50 (1/t50)(r, n). Differentiable in every time.

    **Arguments:**

    - `model`: the class `Hudzovic` or `Sani`.
    - `Tu`, `Tg`: dead-time-like and rise-like time of the tangent at the inflection.
    - `t10`, `t50`, `t90`: times from the step to 10, 50 and 90 % of the change. One unit of time.
    - `orders`: which to consider, within 2..8.
    - `formula`: with t10, t50, t90 and `Sani`, use Sani's interpolation formulae 2.17-2.19
        (errors up to 1.7 % in lam and 3.4 % in t50) instead of the exact curves.
    - `tolerance`: relative width by which each order's range is widened at its equal-lag end;
        inside it r is that end, with derivative 0 and a warning. More with noisy times.

    **Returns:** `Lookup(model, status)`: gain 1, offset 0, delay 0. At the first-order end
    (Tu/Tg = 0, lam = ln 9/ln 2) Sani gives r = 0 with a warning and Hudzovic refuses; beyond it,
    and beyond the last order's equal lags, both refuse, with NaN parameters.
    """
    check_spread_chain(model)
    orders = check_orders(orders)
    by_tangent, by_levels = (Tu, Tg), (t10, t50, t90)
    given = [[x is not None for x in times] for times in (by_tangent, by_levels)]
    if sorted(map(tuple, given)) not in ([(False,) * 3, (True,) * 2], [(False,) * 2, (True,) * 3]):
        raise TypeError("lookup takes either Tu and Tg, or t10, t50 and t90.")
    if formula and (not model.has_formulae or all(given[0])):
        raise ValueError("formula=True is for Sani with t10, t50 and t90.")

    times = [as_real(x) for x in (by_tangent if all(given[0]) else by_levels)]
    if any(x.ndim for x in times):
        shapes = ", ".join(str(x.shape) for x in times)
        raise ValueError(f"lookup takes single times, got shapes {shapes}; batch with jax.vmap.")
    dtype = jnp.result_type(*times)
    times = [x.astype(dtype) for x in times]
    tolerance = max(tolerance, 32 * float(jnp.finfo(dtype).eps))
    return _lookup(model, times, orders, formula, tolerance)


@eqx.filter_jit
def _lookup(model, times: list[Array], orders: tuple[int, ...], formula: bool, tolerance: float):
    """`lookup` for checked arguments: two times are Tu and Tg, three are t10, t50, t90."""
    finite = jnp.all(jnp.isfinite(jnp.stack(times)))
    tangent_ends, level_ends = equal_lag_ends(orders)
    if len(times) == 2:
        Tu, Tg = times
        valid = finite & (Tg > 0)
        value = Tu / jnp.where(valid, Tg, 1)
        return _solve(
            model, orders, tolerance, _TU_TG, _Ends(tangent_ends, 0.0), value,
            lambda plant: 1 / tangent_line(plant)[1], Tg, valid,
        )  # fmt: skip
    a, b, c = times
    valid = finite & (a > 0) & (b > a) & (c > b)
    value = (c - a) / jnp.where(valid, b, 1)
    if formula:
        return _solve(
            model, orders, tolerance, _FORMULA, _formula_ends(orders), value,
            _formula_t50, b, valid,
        )  # fmt: skip
    return _solve(
        model, orders, tolerance, _LAM, _Ends(level_ends, FIRST_ORDER_LAM), value,
        lambda plant: three_times(plant)[1], b, valid,
    )  # fmt: skip
