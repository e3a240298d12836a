"""Equal lags by tables over their number: Latzel's, and Strejc's with its two-lag branch.

The tables are computed from the incomplete gamma function, and rounded as they are printed.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy import special

from .._arrays import Scalar
from .._result import Identification
from .._status import Status, first_problem
from ..curves._times import equal_lag_ends
from ..models._plants import EqualLag, PTn
from ..records._record import StepRecord
from ._charts import STREJC, two_lags
from ._reading import Delay, Reading, Span, is_exact, time_name


LATZEL_LEVELS = (0.10, 0.50, 0.90)
LATZEL_ORDERS = (2, 2.5, *range(3, 21))
STREJC_ORDERS = tuple(range(2, 11))


class LatzelTable(NamedTuple):
    """`mu`, t10/t90; `weights` of t10, t50, t90 (one row per order); both by order `n`."""

    n: np.ndarray
    mu: np.ndarray
    weights: np.ndarray


class StrejcTable(NamedTuple):
    """`ratio`, Tu/Tn, and `height` of the inflection as a share of the change, by order `n`."""

    n: np.ndarray
    ratio: np.ndarray
    height: np.ndarray


@functools.cache
def latzel_table(exact: bool = False) -> LatzelTable:
    """Table 1 of Jakoubek (2009): 1/x_q(n) for the quantiles of the gamma distribution."""
    n = np.array(LATZEL_ORDERS, float)
    x = special.gammaincinv(n[:, None], np.array(LATZEL_LEVELS))
    mu, weights = x[:, 0] / x[:, 2], 1 / x
    return LatzelTable(n, mu, weights) if exact else LatzelTable(n, mu.round(3), weights.round(3))


@functools.cache
def strejc_table(exact: bool = False) -> StrejcTable:
    """Table 3 of Jakoubek (2009): inflection at (n-1) T, height P(n, n-1), and its tangent."""
    n = np.array(STREJC_ORDERS, float)
    height = special.gammainc(n, n - 1)
    ratio, _ = equal_lag_ends(STREJC_ORDERS)
    return (
        StrejcTable(n, ratio, height) if exact else StrejcTable(n, ratio.round(3), height.round(3))
    )


def nearest(value: Scalar, table: np.ndarray) -> tuple[Array, Status]:
    """Place of the nearest entry of an ascending table, which has no derivative.

    The warning `at_curve_end` beyond its ends by more than half the interval there.
    """
    first = table[0] - 0.5 * (table[1] - table[0])
    last = table[-1] + 0.5 * (table[-1] - table[-2])
    inside = (value >= first) & (value <= last)
    place = jnp.argmin(jnp.abs(jax.lax.stop_gradient(value) - jnp.asarray(table, value.dtype)))
    return place, Status.where(inside, Status.successful, Status.at_curve_end)


def latzel(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Latzel's n equal lags from the times at 10, 50 and 90 %.

    n = 2, 2.5, 3, 4, ..., 20 is the order whose mu = t10/t90 is nearest, T = (a10 t10 + a50 t50 +
    a90 t90)/3 with a_q = 1/x_q(n) (Latzel 1988; Jakoubek 2009, eqs. 6-8 and table 1; the factor
    1/3 is missing there in eq. 7, and 70 % in the text means 90 %). `constants`: "printed" rounds
    mu and a to three decimals, with the entries of the paper's table that are not so set right
    (n = 2.5: 1.242, 0.217; n = 14: mu 0.500; n = 17: 0.083); "exact" does not.

    **Range:** mu from 0.118 to 0.565; beyond, the first or last order is taken, with the warning
    `at_curve_end`: a plant of first order gets two lags. n = 2.5 has no rational transfer function.
    `span`, `delay` and further status as in `viteckova_1`; there is no dead time but `delay`.
    """
    table = latzel_table(is_exact(constants))
    reading = Reading(record, span, delay)
    times = reading.times(LATZEL_LEVELS)
    place, end = nearest(times[0] / times[2], table.mu)
    n, weights = (jnp.asarray(x, times.dtype)[place] for x in (table.n, table.weights))
    model = EqualLag(T=jnp.mean(weights * times), n=n)
    return reading.conclude(model, end)


def strejc(
    record: StepRecord, *, constants: str = "printed", span: Span = None, delay: Delay = 0.0
) -> Identification:
    r"""Strejc's method: by Tu/Tn of the tangent two different lags, or n equal ones up to ten.

    Strejc (1959; Jakoubek 2009, eqs. 14-21, tables 2 and 3). Below Tu/Tn = 0.104 (printed as 0)
    two lags: T1 + T2 = t72/1.2564, T2/T1 from the height at 0.3574 (T1 + T2). From there on n =
    2..10 is the order whose Tu/Tn is nearest, and T = t_i/(n - 1) with the time t_i of the height
    y_i that the table gives for the inflection. Heights are shares of the change.

    `constants`: "printed" has the rounded constants, with y_i = 0.323 and 0.353 for n = 3 and 4
    (0.327 and 0.359 are misprints); "exact" the threshold 0.103638, the exact table, and two lags
    solved from level and height at once, since t72/(T1 + T2) is really 1.246..1.273.

    **Range:** the height runs from 0.1610 (equal lags) to 0.3005 (one lag). Heights down to 0.155
    and up to 0.310 are taken as these ends with the warning `at_curve_end`; lower ones refuse with
    `beyond_second_order`, higher ones with `beyond_first_order`. Tu/Tn above 0.805 gives ten lags
    with `at_curve_end`. Without a tangent `no_inflection`. With noise a `span` is necessary: slopes
    are useless without it. `.details`: `t72`, `t_read`, `y_read` of the first branch or `t_i`,
    `y_i` of the second, the others NaN. There is no dead time but `delay`.
    """
    exact = is_exact(constants)
    table = strejc_table(exact)
    reading = Reading(record, span, delay)
    line = reading.tangent()
    ratio = jax.lax.stop_gradient(line.Tu / line.Tg)
    threshold = float(table.ratio[0])
    two = ratio < threshold

    t72 = reading.crossings((STREJC.level,))
    pair = two_lags(reading, STREJC, t72.times[0], reading.delay, exact)

    place, end = nearest(jnp.maximum(ratio, threshold), table.ratio)
    n, height = (jnp.asarray(x, ratio.dtype)[place] for x in (table.n, table.height))
    t_i = reading.crossings(height[None])
    equal = jnp.where(np.arange(STREJC_ORDERS[-1]) < n, t_i.times[0] / (n - 1), 0)

    lags = jnp.where(two, jnp.pad(pair.lags, (0, STREJC_ORDERS[-1] - 2)), equal)
    branch = Status.where(
        two, first_problem(t72.status, pair.status), first_problem(t_i.status, end)
    )
    of_pair = {time_name(STREJC.level): t72.read[0]} | pair.details
    details = {name: jnp.where(two, x, jnp.nan) for name, x in of_pair.items()}
    for name, x in (("t_i", t_i.read[0]), ("y_i", height)):
        details[name] = jnp.where(two, jnp.nan, x)
    reading.remember(branch, **details)
    return reading.conclude(PTn(lags=lags))
