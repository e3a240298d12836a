"""Hudzovic's and Sani's lookups: characterise the record, then invert the lookup curves."""

from collections.abc import Iterable

from .._result import Identification
from ..curves._lookup import lookup
from ..curves._times import LEVELS
from ..models._plants import Hudzovic, Sani
from ..models._spread import DEFAULT_ORDERS
from ..records._record import StepRecord
from ._reading import Delay, Reading, Span


def _by_tangent(model: type[Hudzovic | Sani], record, span, delay, orders, tolerance):
    reading = Reading(record, span, delay)
    line = reading.tangent()
    found, status = lookup(model, Tu=line.Tu, Tg=line.Tg, orders=orders, tolerance=tolerance)
    return reading.conclude(found, status)


def _by_levels(model: type[Hudzovic | Sani], record, span, delay, orders, tolerance, formula=False):
    reading = Reading(record, span, delay)
    t10, t50, t90 = reading.times(LEVELS)
    found, status = lookup(
        model, t10=t10, t50=t50, t90=t90, orders=orders, formula=formula, tolerance=tolerance
    )
    return reading.conclude(found, status)


def hudzovic_tu_tg(
    record: StepRecord,
    *,
    span: Span = None,
    delay: Delay = 0.0,
    orders: Iterable[int] = DEFAULT_ORDERS,
    tolerance: float = 1e-6,
) -> Identification:
    r"""Hudzovic's model from the tangent at the inflection, Tu/Tg (Murray 2016, eq. 2.9).

    The smallest order whose curve Tu/Tg reaches the measured ratio (eq. 2.15), r from the exact
    inverse of that curve, T = Tg (1/Tg)(r, n). **Options:** `span`: LOESS before the slope is
    taken, necessary with noise; `delay`: dead time taken off Tu; `orders` and `tolerance` as in
    `lookup`. **Range:** 0 < Tu/Tg <= 0.6417 (n = 8). At equal lags a warning; at or below 0
    `beyond_first_order`, above `beyond_last_order`, without a tangent `no_inflection`. Standard
    errors are NaN: the method has none.
    """
    return _by_tangent(Hudzovic, record, span, delay, orders, tolerance)


def hudzovic_t10_t50_t90(
    record: StepRecord,
    *,
    span: Span = None,
    delay: Delay = 0.0,
    orders: Iterable[int] = DEFAULT_ORDERS,
    tolerance: float = 1e-6,
) -> Identification:
    r"""Hudzovic's model from the times at 10, 50 and 90 % (Murray 2016, eqs. 2.10, 2.16).

    The smallest order whose lam = (t90 - t10)/t50 falls to the measured one, r from the exact
    inverse, T = t50 (1/t50)(r, n). **Options** as in `hudzovic_tu_tg`. **Range:** 0.9277 (n = 8)
    <= lam < ln 9/ln 2 = 3.1699. Levels not crossed give `levels_not_crossed`.
    """
    return _by_levels(Hudzovic, record, span, delay, orders, tolerance)


def sani_tu_tg(
    record: StepRecord,
    *,
    span: Span = None,
    delay: Delay = 0.0,
    orders: Iterable[int] = DEFAULT_ORDERS,
    tolerance: float = 1e-6,
) -> Identification:
    r"""Sani's model from the tangent at the inflection, Tu/Tg (Murray 2016, eqs. 2.8, 2.9).

    As `hudzovic_tu_tg`, for lags T r^(k-1). **Range:** 0 <= Tu/Tg <= 0.6417 (n = 8); at 0 the plant
    is of first order: r = 0 with a warning.
    """
    return _by_tangent(Sani, record, span, delay, orders, tolerance)


def sani_t10_t50_t90(
    record: StepRecord,
    *,
    span: Span = None,
    delay: Delay = 0.0,
    orders: Iterable[int] = DEFAULT_ORDERS,
    tolerance: float = 1e-6,
) -> Identification:
    r"""Sani's model from the times at 10, 50 and 90 %, by the exact curves (Murray 2016, eq. 2.10).

    As `hudzovic_t10_t50_t90`, for lags T r^(k-1). **Range:** 0.9277 (n = 8) <= lam <= ln 9/ln 2; at
    the upper end r = 0 with a warning. (Murray's stored results use this name for the formulae,
    which are `sani_interpolation` here.)
    """
    return _by_levels(Sani, record, span, delay, orders, tolerance)


def sani_interpolation(
    record: StepRecord,
    *,
    span: Span = None,
    delay: Delay = 0.0,
    orders: Iterable[int] = DEFAULT_ORDERS,
    tolerance: float = 1e-6,
) -> Identification:
    r"""Sani's model from the times at 10, 50 and 90 %, by Sani's formulae (Murray 2016, 2.17-2.19).

    t50/T = ln 2 - 1 + sum r^k and (t90 - t10)/T = 1.315 sqrt(3.8 sum r^2k - 1), solved for r in
    [0, 1]. Errors of the formulae: up to 1.7 % in lam, 3.4 % in t50. **Range:** 0.9285 (n = 8) <=
    lam <= 3.1745.
    """
    return _by_levels(Sani, record, span, delay, orders, tolerance, formula=True)
