r"""Second order plus dead time through three points of the response.

A ratio of two time differences depends on the shape alone (`_second_order.py`); a difference then
tells the unit of time, and one of the times the dead time.
"""

import jax.numpy as jnp

from .._arrays import Scalar
from .._result import Identification
from .._status import Status
from ..curves._roots import clamped_root
from ..curves._second_order import damping, lags_of, level_times, shape_ends
from ..models._plants import SOPDT, PTn
from ..records._record import StepRecord
from ._reading import Delay, Reading, Span, end_status, is_exact, own_delay


def late_to_early(times) -> Scalar:
    """(t3 - t2)/(t2 - t1): it rises with the shape, from no damping to one lag."""
    first, second, third = times
    return (third - second) / (second - first)


def solve_shape(
    levels: tuple[float, float, float], times, lowest: Scalar, highest: Scalar, tolerance: float
) -> tuple[Scalar, Scalar, Scalar, Scalar, Status]:
    """Second-order response through three points.

    **Returns:** its shape, from `lowest` to `highest`; the unit of time of that shape; the dead
    time, of either sign; how far the ratio lies above that of `highest` (below 0 inside); and the
    status, at an end as far as a relative `tolerance`.
    """
    measured = late_to_early(times)

    def excess(shape: Scalar) -> Scalar:
        return late_to_early(level_times(levels, shape)) - measured

    shape, low, high = clamped_root(excess, lowest, highest)
    status = end_status(
        (low / (measured + low), tolerance, Status.beyond_second_order),
        (-high / (measured + high), tolerance, Status.beyond_first_order),
    )
    x = level_times(levels, shape)
    unit = (times[2] - times[0]) / (x[2] - x[0])
    return shape, unit, times[1] - unit * x[1], -high, status


ALFARO_LEVELS = (0.25, 0.50, 0.75)


def alfaro_overdamped(
    record: StepRecord,
    *,
    constants: str = "printed",
    tolerance: float = 2e-3,
    span: Span = None,
    delay: Delay = 0.0,
) -> Identification:
    r"""Alfaro's two lags plus dead time, from the times at 25, 50 and 75 %.

    a = (-0.6240 t25 + 0.9866 t50 - 0.3626 t75)/(0.3533 t25 - 0.7036 t50 + 0.3503 t75), T1 = (t75 -
    t25)/(0.9866 + 0.7036 a), T2 = a T1, L = t75 - (1.3421 + 1.3455 a) T1 (Alfaro 2006, method
    123c), a fit with errors of a few per cent; constants="exact" solves for two real lags instead.

    **Range:** 0 <= a <= 1, outside `beyond_first_order` or `beyond_second_order`; exact: from one
    lag to equal ones, beyond which by a relative `tolerance` in (t75 - t50)/(t50 - t25) that end is
    taken, with the warning `at_curve_end`. A negative L is left out (`delay_dropped`). `span`,
    `delay` and further status as in `viteckova_1`.
    """
    exact = is_exact(constants)
    reading = Reading(record, span, delay)
    times = reading.times(ALFARO_LEVELS)
    if exact:
        _, equal_lags, one_lag = shape_ends(times.dtype)
        shape, unit, L, beyond, status = solve_shape(
            ALFARO_LEVELS, times, equal_lags, one_lag, tolerance
        )
        lags = lags_of(jnp.where(beyond >= 0, 1, shape), unit)
    else:
        t25, t50, t75 = times
        below = 0.3533 * t25 - 0.7036 * t50 + 0.3503 * t75
        a = (-0.6240 * t25 + 0.9866 * t50 - 0.3626 * t75) / jnp.where(below == 0, 1, below)
        status = Status.where(a >= 0, Status.successful, Status.beyond_first_order)
        status = Status.where((a <= 1) & (below > 0), status, Status.beyond_second_order)
        a = jnp.clip(a, 0, 1)
        T = (t75 - t25) / (0.9866 + 0.7036 * a)
        lags, L = jnp.stack([T, a * T]), t75 - (1.3421 + 1.3455 * a) * T
    return reading.conclude(PTn(lags=lags), status, own=own_delay(L, times[2]))


RANGAIAH_LEVELS = (0.14, 0.55, 0.91)


def rangaiah_krishnaswamy(
    record: StepRecord,
    *,
    constants: str = "exact",
    tolerance: float = 2e-3,
    span: Span = None,
    delay: Delay = 0.0,
) -> Identification:
    r"""Rangaiah's and Krishnaswamy's second order plus dead time, from 14, 55 and 91 %.

    The damping from alpha = (t91 - t55)/(t55 - t14), then omega_n and L (Rangaiah, Krishnaswamy
    1994). By default, constants="exact", the response through the three points is solved for, with
    any damping; "printed" has the authors' polynomials, good to 0.1 % for zeta = 0.7..3 and outside
    that range with the warning `extrapolated`.

    **Range:** alpha from 0.6626 (no damping) to 2.4849 (one lag; there zeta ends at eps^-0.25,
    8000). Beyond it by a relative `tolerance` that end is taken, with the warning `at_curve_end`;
    further out `beyond_second_order` or `beyond_first_order`. A negative L is left out
    (`delay_dropped`). `span`, `delay` and further status as in `viteckova_1`.
    """
    exact = is_exact(constants)
    reading = Reading(record, span, delay)
    times = reading.times(RANGAIAH_LEVELS)
    if exact:
        no_damping, _, one_lag = shape_ends(times.dtype)
        shape, unit, L, _, status = solve_shape(
            RANGAIAH_LEVELS, times, no_damping, one_lag, tolerance
        )
        zeta, omega_n = damping(shape)
        omega_n = omega_n / unit
    else:
        zeta, tau, L, status = _rangaiah_polynomials(times)
        omega_n = 1 / tau
    return reading.conclude(SOPDT(zeta=zeta, omega_n=omega_n), status, own=own_delay(L, times[2]))


def _polynomial(x: Scalar, *coefficients: float) -> Scalar:
    total = jnp.zeros_like(x)
    for coefficient in reversed(coefficients):
        total = coefficient + x * total
    return total


def _rangaiah_polynomials(times) -> tuple[Scalar, Scalar, Scalar, Status]:
    """zeta, 1/omega_n, L and status by the formulae of the source."""
    alpha = late_to_early(times)
    below = alpha < 2.485
    alpha = jnp.where(below, alpha, 2.0)
    b = jnp.log(alpha / (2.485 - alpha))
    square = _polynomial(b, 0.50906, 0.51743, -0.076284, 0.041363, -0.0049224, 0.00021234)
    real = square > 0
    zeta = jnp.sqrt(jnp.where(real, square, 1))
    tau = (times[1] - times[0]) / _polynomial(zeta, 0.85818, -0.62907, 1.2897, -0.36859, 0.038891)
    L = times[1] - tau * _polynomial(zeta, 1.3920, -0.52536, 1.2991, -0.36014, 0.037605)
    made_for = (zeta >= 0.7) & (zeta <= 3)
    status = Status.where(made_for, Status.successful, Status.extrapolated)
    status = Status.where(real, status, Status.beyond_second_order)
    return zeta, tau, L, Status.where(below, status, Status.beyond_first_order)
