"""Methods that read the tangent at the inflection: slopes need a noise-free or smoothed record."""

import math

import jax.numpy as jnp

from .._arrays import Scalar
from .._result import Identification
from .._status import Status
from ..curves._roots import clamped_root
from ..curves._second_order import lags_of, shape_ends
from ..models._plants import FOPDT, PTn
from ..records._record import StepRecord
from ._reading import Delay, Reading, Span, end_status, own_delay


ONE_LAG = 1 - math.exp(-1)
"""Share of its change that a lag T has gone at the time T."""


def ziegler_nichols_tangent(
    record: StepRecord, *, span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""First order plus dead time from the tangent at the inflection: L = Tu, T = Tg.

    Ziegler, Nichols (1942). Exact for a first-order plant; for plants of higher order T is far too
    large. **Options:** `span`: LOESS first, necessary with noise; `delay`: dead time known
    beforehand, on top of which L comes. **Status:** `no_inflection` without a tangent, a negative
    L is left out with the warning `delay_dropped`. Standard errors are NaN: the method has none.
    """
    reading = Reading(record, span, delay)
    line = reading.tangent()
    return reading.conclude(FOPDT(T=line.Tg), own=own_delay(line.Tu, line.Tg))


def tangent_63(record: StepRecord, *, span: Span = None, delay: Delay = 0.0) -> Identification:
    r"""First order plus dead time: L = Tu of the tangent, T = t63 - L at the share 1 - 1/e.

    Miller (1967); Astrom, Hagglund (1995). The response is met at 63.2 %, which serves plants of
    higher order far better than the tangent alone. Options and status as in
    `ziegler_nichols_tangent`; a level that is not reached gives `levels_not_crossed`.
    """
    reading = Reading(record, span, delay)
    line = reading.tangent()
    (t63,) = reading.times((ONE_LAG,))
    own = own_delay(line.Tu, line.Tg)
    negative = Status.where(t63 > own.kept, Status.successful, Status.invalid_times)
    return reading.conclude(FOPDT(T=t63 - own.kept), negative, own=own)


def oldenbourg_sartorius(
    record: StepRecord, *, span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Two lags from the tangent at the inflection, exactly.

    With $T_A = T_g$ and the sum of the lags $T_C = (1 - y_i) T_g = T_u + T_g - t_i$,

    $$ \frac{T_A}{T_C} = \frac{q^{-q/(1-q)}}{1+q}, \qquad q = T_2/T_1 $$

    (Oldenbourg, Sartorius 1948), solved for q. **Range:** T_A/T_C from 1 (one lag) to e/2 (equal
    lags); beyond it by up to 1 % that end, with the warning `at_curve_end`; further out
    `beyond_first_order` or `beyond_second_order`. `span` and `delay` as in
    `ziegler_nichols_tangent`; there is no dead time but `delay`, on which the lags do not depend.
    """
    reading = Reading(record, span, delay)
    line = reading.tangent()
    total = line.Tu + line.Tg - line.t_inflection
    negative = Status.where(total > 0, Status.successful, Status.invalid_times)
    total = jnp.where(total > 0, total, 1)
    measured = jnp.log(line.Tg / total)
    _, equal_lags, one_lag = shape_ends(total.dtype)
    shape, low, high = clamped_root(lambda x: measured - _log_ratio(x), equal_lags, one_lag)
    status = end_status(
        (low, 0.01, Status.beyond_second_order), (-high, 0.01, Status.beyond_first_order)
    )
    lags = lags_of(jnp.where(high <= 0, 1, shape), total)
    return reading.conclude(PTn(lags=lags), negative, status)


def _log_ratio(shape: Scalar) -> Scalar:
    r"""$\ln(T_A/T_C) = \mathrm{artanh}(k)/k + \ln(1 - k^2)/2 - \ln 2$, $k^2$ the shape.

    The formula of the source, written in k = (1 - q)/(1 + q), in which it is even.
    """
    small = shape < 0.1
    near = jnp.where(small, shape, 0)
    series = jnp.zeros_like(shape)
    for j in range(16, -1, -1):
        series = 1 / (2 * j + 1) + near * series
    root = jnp.sqrt(jnp.where(small, 0.5, shape))
    quotient = jnp.where(small, series, jnp.arctanh(root) / root)
    return quotient + 0.5 * jnp.log1p(-shape) - math.log(2)
