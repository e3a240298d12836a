r"""Two real lags read off charts: Harriott's, Smith's, and the first branch of Strejc's method.

The charts are computed, not read: the curve of two lags of sum 1 over their shape (see
`_second_order.py`), inverted to rounding error.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._arrays import Scalar
from .._result import Identification
from .._status import Status
from ..curves._roots import clamped_root
from ..curves._second_order import damping, lags_of, level_times, shape_ends, unit_response
from ..models._plants import SOPDT, PTn
from ..records._characterise import interpolated, relative_response
from ..records._record import StepRecord
from ._reading import Delay, Reading, Span, end_status, is_exact, own_delay
from ._two_points import VITECKOVA_LEVELS, lag_and_delay


class Chart(NamedTuple):
    """How two lags are read off a response.

    The time of `level` is about `total` times the sum of the lags, whatever their ratio; the
    height at `height_at` times the sum tells the ratio. Heights from `lowest` to `highest` are
    taken, beyond the curve as its end.
    """

    level: float
    total: float
    height_at: float
    lowest: float
    highest: float


HARRIOTT = Chart(level=0.73, total=1.3, height_at=0.5, lowest=0.25, highest=0.41)
HARRIOTT_LEVELS = (*VITECKOVA_LEVELS, HARRIOTT.level)
STREJC = Chart(level=0.72, total=1.2564, height_at=0.3574, lowest=0.155, highest=0.310)


class TwoLags(NamedTuple):
    """Two lags, the larger first, where the height was read (from the step), and the status."""

    lags: Array
    details: dict[str, Scalar]
    status: Status


def two_lags(reading: Reading, chart: Chart, time: Scalar, start: Scalar, exact: bool) -> TwoLags:
    r"""Sum and ratio of two lags from the `time` of the chart's level, counted from step + `start`.

    As printed, the sum is time/total. In truth the curves of different ratios do not meet in one
    point: `exact` solves for both unknowns at once, level and height on the same response.
    """
    safe = reading.safe
    relative, t = relative_response(safe), safe.elapsed
    _, equal_lags, one_lag = shape_ends(time.dtype)
    height_at = jnp.asarray(chart.height_at, time.dtype)

    def total(shape: Scalar) -> Scalar:
        return time / (level_times((chart.level,), shape)[0] if exact else chart.total)

    def point(shape: Scalar) -> tuple[Scalar, Scalar]:
        at = start + height_at * total(shape)
        return at, interpolated(t, relative, at, safe.count)

    def excess(shape: Scalar) -> Scalar:
        return unit_response(height_at, shape) - point(shape)[1]

    shape, _, high = clamped_root(excess, equal_lags, one_lag)
    at, height = point(shape)
    ends = jnp.stack([equal_lags, one_lag])
    first, last = jax.vmap(lambda end: unit_response(height_at, end))(ends)
    status = end_status(
        (first - height, first - chart.lowest, Status.beyond_second_order),
        (height - last, chart.highest - last, Status.beyond_first_order),
    )
    lags = lags_of(jnp.where(high <= 0, 1, shape), total(shape))
    return TwoLags(lags, {"t_read": at, "y_read": height}, status)


def harriott(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Harriott's two lags plus dead time: sum from t73, ratio from the height at half the sum.

    L = 1.937 t33 - 0.937 t70, left out where negative (warning `delay_dropped`); then, on times
    from L on, T1 + T2 = t73/1.3 and T1/(T1 + T2) from the curve of y((T1 + T2)/2) (Harriott 1964;
    Jakoubek 2009, eqs. 9-11 and figure 4, which do not say that L comes off t73 and back onto the
    time of the height). t73/(T1 + T2) is really 1.276..1.309: constants="exact" solves for both
    lags at once, with the exact L.

    **Range:** the curve runs from 0.2642 (equal lags) to 0.3935 (one lag). Heights down to 0.25
    and up to 0.41 are taken as its ends, with the warning `at_curve_end`; lower ones refuse with
    `beyond_second_order`, higher ones with `beyond_first_order`. Options and further status as in
    `viteckova_1`. Near equal lags the two lags are ill-determined, their sum is not.
    """
    exact = is_exact(constants)
    reading = Reading(record, span, delay)
    t33, t70, t73 = reading.times(HARRIOTT_LEVELS)
    _, L = lag_and_delay("viteckova_2", exact, t33, t70)
    own = own_delay(L, t73)
    found = two_lags(reading, HARRIOTT, t73 - own.kept, reading.delay + own.kept, exact)
    return reading.conclude(PTn(lags=found.lags), found.status, own=own, **found.details)


SMITH_LEVELS = (0.20, 0.60)


def smith_ratio(shape: Scalar) -> tuple[Scalar, Scalar]:
    """Smith's curve t20/t60 over the shape, and t60 in the unit of time of that shape."""
    t20, t60 = level_times(SMITH_LEVELS, shape)
    return t20 / t60, t60


def smith(
    record: StepRecord,
    *,
    dead_time: bool = False,
    underdamped: bool = False,
    tolerance: float = 2e-3,
    constants: str = "printed",
    span: Span = None,
    delay: Delay = 0.0,
) -> Identification:
    r"""Smith's two lags from the times at 20 and 60 %: damping from t20/t60, then T from t60.

    Smith (1972; Jakoubek 2009, eqs. 12, 13 and figure 6, whose two curves are computed here):
    exact for two lags without a dead time.

    **Options:** `dead_time=True` first takes off L = 1.937 t33 - 0.937 t70 (Jakoubek's eq. 11;
    `constants` says in which digits), which the paper announces and eq. (12) does not have; a
    negative L is left out with `delay_dropped`. `underdamped=True` goes on to the oscillating part
    of the curve and gives a `SOPDT`, always, whose damping ends at about eps^(-1/4) (8000).
    `span`, `delay` as in `viteckova_1`.

    **Range:** t20/t60 from 0.243529 (one lag) to 0.407646 (equal lags), underdamped to 0.555087
    (no damping). Beyond an end by up to `tolerance`, relative, that end is taken with the warning
    `at_curve_end`; further out `beyond_first_order` (below) or `beyond_second_order` (above).
    """
    exact = is_exact(constants)
    reading, own = Reading(record, span, delay), None
    if dead_time:
        t20, t33, t60, t70 = reading.times(sorted((*SMITH_LEVELS, *VITECKOVA_LEVELS)))
        own = own_delay(lag_and_delay("viteckova_2", exact, t33, t70)[1], t70)
        t20, t60 = t20 - own.kept, t60 - own.kept
    else:
        t20, t60 = reading.times(SMITH_LEVELS)

    ratio = t20 / t60
    no_damping, equal_lags, one_lag = shape_ends(ratio.dtype)
    last = no_damping if underdamped else equal_lags
    shape, low, high = clamped_root(lambda x: ratio - smith_ratio(x)[0], last, one_lag)
    status = end_status(
        (low / (ratio - low), tolerance, Status.beyond_second_order),
        (-high / (ratio - high), tolerance, Status.beyond_first_order),
    )
    total = t60 / smith_ratio(shape)[1]
    if underdamped:
        zeta, omega_n = damping(shape)
        model = SOPDT(zeta=zeta, omega_n=omega_n / total)
    else:
        model = PTn(lags=lags_of(jnp.where(high <= 0, 1, shape), total))
    return reading.conclude(model, status, own=own)
