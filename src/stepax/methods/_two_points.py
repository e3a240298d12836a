r"""First order, or equal lags, plus dead time through two points of the response.

A model of n equal lags T and dead time L reaches the share q of its change at $L + x_q T$, with
the quantile $x_q$ of the gamma distribution: $P(n, x_q) = q$. Two points give

$$ T = \frac{t_b - t_a}{x_b - x_a}, \qquad
   L = \frac{x_b}{x_b - x_a}\, t_a - \frac{x_a}{x_b - x_a}\, t_b. $$

The methods differ in their levels, in n, and in how the authors rounded the constants.
"""

import functools
from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy import special

from .._arrays import Scalar
from .._result import Identification, judged
from ..models._plants import FOPDT, EqualLag
from ..models._responses import MAX_ORDER
from ..models._spread import check_orders
from ..records._record import StepRecord
from ._reading import Delay, Reading, Span, is_exact, own_delay


class TwoPoints(NamedTuple):
    """Levels a < b, order n, and the constants as printed: T = k (t_b - t_a), L = a t_a + b t_b."""

    levels: tuple[float, float]
    order: int
    printed: tuple[float, float, float]


VITECKOVA_LEVELS = (0.33, 0.70)
TWO_POINTS = {
    # Viteckova (Jakoubek 2009, eqs. 2-5)
    "viteckova_1": TwoPoints(VITECKOVA_LEVELS, 1, (1.245, 1.498, -0.498)),
    "viteckova_2": TwoPoints(VITECKOVA_LEVELS, 2, (0.794, 1.937, -0.937)),
    # Sundaresan, Krishnaswamy (1978; Jakoubek 2009, eqs. 23, 24)
    "sundaresan_krishnaswamy": TwoPoints((0.353, 0.853), 1, (0.67, 1.3, -0.29)),
    # Alfaro (2006), method 123c
    "alfaro_1": TwoPoints((0.25, 0.75), 1, (0.910, 1.262, -0.262)),
    "alfaro_2": TwoPoints((0.25, 0.75), 2, (0.5776, 1.5552, -0.5552)),
    # Smith (1972): T = 1.5 (t63.2 - t28.3), L = t63.2 - T
    "smith_1972": TwoPoints((0.283, 0.632), 1, (1.5, 1.5, -0.5)),
    # Broida (1969)
    "broida": TwoPoints((0.28, 0.40), 1, (5.5, 2.8, -1.8)),
    # Chen, Yang (2000)
    "chen_yang": TwoPoints((0.33, 0.67), 1, (1.4, 1.54, -0.54)),
    # Ho, Hang, Cao (1995)
    "ho": TwoPoints((0.35, 0.85), 1, (0.67, 1.3, -0.29)),
}


@functools.cache
def exact_constants(levels: tuple[float, float], order: int) -> tuple[float, float, float]:
    """The constants of the formula from the quantiles of the gamma distribution."""
    early, late = (float(x) for x in special.gammaincinv(order, levels))
    return 1 / (late - early), late / (late - early), -early / (late - early)


def lag_and_delay(name: str, exact: bool, early: Scalar, late: Scalar) -> tuple[Scalar, Scalar]:
    """T and L of one of `TWO_POINTS` from its two times; L may be negative."""
    formula = TWO_POINTS[name]
    constants = exact_constants(formula.levels, formula.order) if exact else formula.printed
    return _evaluate(constants, early, late)


def _evaluate(constants, early: Scalar, late: Scalar) -> tuple[Scalar, Scalar]:
    scale, of_early, of_late = constants
    return scale * (late - early), of_early * early + of_late * late


def _two_points(name: str, record, constants, span, delay) -> Identification:
    exact, formula = is_exact(constants), TWO_POINTS[name]
    reading = Reading(record, span, delay)
    early, late = reading.times(formula.levels)
    T, L = lag_and_delay(name, exact, early, late)
    model = FOPDT(T=T) if formula.order == 1 else EqualLag(T=T, n=formula.order)
    return reading.conclude(model, own=own_delay(L, late))


def viteckova_1(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Viteckova's first order plus dead time, from the times at 33 and 70 %.

    T = 1.245 (t70 - t33), L = 1.498 t33 - 0.498 t70 (Jakoubek 2009, eqs. 2, 3). A negative L is
    left out, T stays: warning `delay_dropped`, with L in `.details["raw_delay"]`.

    **Options:** `constants`: "printed", or "exact" for those recomputed to all digits. `span`:
    LOESS first. `delay`: dead time known beforehand; times count from it, and L comes on top.
    **Status:** a level that is not reached gives `levels_not_crossed`, a `delay` beyond the first
    level `invalid_times`. Standard errors are NaN: the method has none.
    """
    return _two_points("viteckova_1", record, constants, span, delay)


def viteckova_2(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Viteckova's two equal lags plus dead time, from the times at 33 and 70 %.

    T = 0.794 (t70 - t33), L = 1.937 t33 - 0.937 t70 (Jakoubek 2009, eqs. 4, 5). Where L is
    negative and left out, T is biased: a plant of first order is better served by `viteckova_1`.
    Options and status as in `viteckova_1`.
    """
    return _two_points("viteckova_2", record, constants, span, delay)


def sundaresan_krishnaswamy(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Sundaresan's and Krishnaswamy's first order plus dead time, from 35.3 and 85.3 %.

    T = 0.67 (t85.3 - t35.3), L = 1.3 t35.3 - 0.29 t85.3 (1978; Jakoubek 2009, eqs. 23, 24): the
    authors' optimum over higher orders, rounded, and not exact for a first-order plant. Its
    weights add up to 1.01, so that a record delayed by d delays L by 1.01 d. "exact" constants
    (0.6748, 1.2938, -0.2938) run through both points. Options and status as in `viteckova_1`.
    """
    return _two_points("sundaresan_krishnaswamy", record, constants, span, delay)


def alfaro_1(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Alfaro's first order plus dead time, from the times at 25 and 75 %.

    T = 0.910 (t75 - t25), L = 1.262 t25 - 0.262 t75 (Alfaro 2006, method 123c): within a few per
    cent of the least-squares optimum on plants of order two to five. Options and status as in
    `viteckova_1`.
    """
    return _two_points("alfaro_1", record, constants, span, delay)


def alfaro_2(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Alfaro's two equal lags plus dead time, from the times at 25 and 75 %.

    T = 0.5776 (t75 - t25), L = 1.5552 t25 - 0.5552 t75 (Alfaro 2006, method 123c). Options and
    status as in `viteckova_1`.
    """
    return _two_points("alfaro_2", record, constants, span, delay)


def smith_1972(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Smith's first order plus dead time, from the times at 28.3 and 63.2 %.

    T = 1.5 (t63.2 - t28.3), L = t63.2 - T (C. L. Smith 1972, "Digital Computer Process Control"):
    the levels of T/3 and T. Options and status as in `viteckova_1`.
    """
    return _two_points("smith_1972", record, constants, span, delay)


def broida(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Broida's first order plus dead time, from the times at 28 and 40 %.

    T = 5.5 (t40 - t28), L = 2.8 t28 - 1.8 t40 (Broida 1969). The levels are close together: it
    magnifies noise, and puts T high for plants of higher order. Options and status as in
    `viteckova_1`.
    """
    return _two_points("broida", record, constants, span, delay)


def chen_yang(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Chen's and Yang's first order plus dead time, from the times at 33 and 67 %.

    T = 1.4 (t67 - t33), L = 1.54 t33 - 0.54 t67 (Chen, Yang 2000). The printed constants are
    rounded so far that a first-order plant gets a dead time of 0.018 T. Options and status as in
    `viteckova_1`.
    """
    return _two_points("chen_yang", record, constants, span, delay)


def ho(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Ho's, Hang's and Cao's first order plus dead time, from the times at 35 and 85 %.

    T = 0.67 (t85 - t35), L = 1.3 t35 - 0.29 t85 (1995): the constants of Sundaresan and
    Krishnaswamy, with rounded levels. Options and status as in `viteckova_1`.
    """
    return _two_points("ho", record, constants, span, delay)


def viteckova(
    record: StepRecord,
    *,
    order: int | None = None,
    orders: Iterable[int] = range(1, MAX_ORDER + 1),
    span: Span = None,
    delay: Delay = 0.0,
) -> Identification:
    r"""Viteckova's method for any number of equal lags plus dead time: 33 and 70 %, n by J.

    T and L as in `viteckova_1` with the exact constants of each order (Jakoubek 2009 has n = 1
    and 2); of `orders`, within 1..8, the one is kept whose J on the record is smallest, L left out
    where it is negative. `order` takes one whole n instead, of any size. `span`, `delay` and
    status as in `viteckova_1`. The derivatives are those at the order kept.
    """
    reading = Reading(record, span, delay)
    early, late = reading.times(VITECKOVA_LEVELS)

    def fit(n, constants) -> Identification:
        T, L = _evaluate(constants, early, late)
        return reading.conclude(EqualLag(T=T, n=n), own=own_delay(L, late))

    if order is not None:
        if isinstance(order, bool) or not isinstance(order, int | np.integer) or order < 1:
            raise ValueError(f"order must be a whole number of at least 1, got {order!r}.")
        return fit(int(order), exact_constants(VITECKOVA_LEVELS, int(order)))
    known = check_orders(orders, least=1)
    table = jnp.asarray([exact_constants(VITECKOVA_LEVELS, n) for n in known], early.dtype)
    choices = jnp.asarray(known)
    J = jax.vmap(lambda n, row: judged(record, [fit(n, row)])[0].J)
    best = _smallest(J(choices, table))
    return fit(choices[best], table[best])


def _smallest(J: Array) -> Array:
    """Place of the smallest J, of which some may be NaN."""
    return jnp.argmin(jnp.where(jnp.isnan(J), jnp.inf, jax.lax.stop_gradient(J)))
