r"""Methods that integrate the record: areas, and the moments of the impulse response.

With the share y of the change, the impulse response y' of the plant has the moments

$$ \mu_1 = \int_0^\infty (1 - y)\,dt, \qquad m_k = k \int_0^\infty t^{k-1} (1 - y)\,dt, $$

from which its mean $\mu_1$, variance $\sigma^2 = m_2 - \mu_1^2$ and third cumulant follow: sums
over the lags and the dead time. Integrals run to the end of the record and no further: what the
response still lacks there is missing, and the higher the moment, the more it weighs. Noise
late in the record weighs as much.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from .._arrays import Scalar
from .._result import Identification
from .._status import Status, first_problem
from ..curves._second_order import lags_of
from ..models._plants import FOPDT, EqualLag, PTn
from ..models._responses import MAX_REAL_ORDER
from ..records._characterise import integrals
from ..records._record import StepRecord
from ._reading import end_status, finish, own_delay, readable


def _cumulants(safe: StepRecord, delay) -> tuple[Scalar, Scalar, Scalar, Status]:
    """Mean, counted from step and `delay`, variance and third cumulant of the impulse response."""
    mean, m2, m3 = np.arange(1, 4) * integrals(safe, (0, 1, 2))
    variance = m2 - mean**2
    third = m3 - 3 * mean * m2 + 2 * mean**3
    positive = (mean > delay) & (variance > 0)
    return (
        jnp.where(positive, mean - delay, 1),
        jnp.where(positive, variance, 1),
        jnp.where(positive, third, 2),
        Status.where(positive, Status.successful, Status.invalid_moments),
    )


def area_fopdt(
    record: StepRecord,
    *,
    span: float | None = None,
    delay: Float[ArrayLike, ""] = 0.0,
) -> Identification:
    r"""First order plus dead time from two areas.

    $A_0 = \int (1 - y)\,dt = L + T$, $A_1 = \int_0^{A_0} y\,dt$, $T = e A_1$, $L = A_0 - T$
    (Nishikawa et al. 1984; Astrom, Hagglund 1995). Little moved by noise, but A_0 wants a record
    that has settled and a final level that is right. **Options:** `span`: LOESS first; `delay`:
    dead time known beforehand, on top of which L comes. **Status:** a negative L is left out
    (`delay_dropped`); areas that are not positive refuse with `invalid_moments`. Standard errors
    are NaN: the method has none.
    """
    problem, safe = readable(record, span)
    (whole,) = integrals(safe, (0,))
    start = jnp.asarray(delay, whole.dtype)
    (rest,) = integrals(safe, (0,), whole)
    area = whole - rest
    positive = (whole > start) & (area > 0)
    T = jnp.where(positive, np.e * area, 1)
    raw = whole - start - T
    own, dropped = own_delay(raw, whole)
    valid = Status.where(positive, Status.successful, Status.invalid_moments)
    status = first_problem(problem, valid, dropped)
    details = {"area": whole, "area_below": area, "raw_delay": raw}
    return finish(record, safe, FOPDT(T=T), start + own, status, details)


def moments_fopdt(
    record: StepRecord,
    *,
    span: float | None = None,
    delay: Float[ArrayLike, ""] = 0.0,
) -> Identification:
    r"""First order plus dead time from two moments: $T = \sigma$, $L = \mu_1 - \sigma$.

    Options and status as in `area_fopdt`; moments that are not positive refuse with
    `invalid_moments`.
    """
    problem, safe = readable(record, span)
    mean, variance, _, valid = _cumulants(safe, delay)
    T = jnp.sqrt(variance)
    raw = mean - T
    own, dropped = own_delay(raw, mean)
    status = first_problem(problem, valid, dropped)
    details = {"mean": mean + delay, "variance": variance, "raw_delay": raw}
    return finish(record, safe, FOPDT(T=T), delay + own, status, details)


def moments_sopdt(
    record: StepRecord,
    *,
    tolerance: float = 0.5,
    span: float | None = None,
    delay: Float[ArrayLike, ""] = 0.0,
) -> Identification:
    r"""Two lags plus dead time from three moments.

    $T_1^2 + T_2^2 = \sigma^2$ and $2 (T_1^3 + T_2^3)$ is the third cumulant; with the skewness
    $\gamma$, $T_1 + T_2 = 2 \sigma \cos\theta$, $\cos 3\theta = -\gamma/2$ (the root of
    $s^3 - 3 \sigma^2 s + \gamma\sigma^3 = 0$ that has real lags); $L = \mu_1 - T_1 - T_2$.

    **Range:** skewness from sqrt(2) (equal lags) to 2 (one lag); beyond it by a relative
    `tolerance` (0.5: from 0.7071, that of eight equal lags, to 3) that end is taken, with the
    warning `at_curve_end`; below `beyond_second_order`, above `beyond_first_order`. Further options
    and status as in `area_fopdt`.
    """
    problem, safe = readable(record, span)
    mean, variance, third, valid = _cumulants(safe, delay)
    sigma = jnp.sqrt(variance)
    skewness = third / sigma**3
    least, most = 2**0.5, 2.0
    status = end_status(
        (1 - skewness / least, tolerance, Status.beyond_second_order),
        (skewness / most - 1, tolerance, Status.beyond_first_order),
    )
    inside = (skewness > least) & (skewness < most)
    angle = jnp.arccos(-0.5 * jnp.where(inside, skewness, 1.7)) / 3
    low = skewness <= least
    total = jnp.where(inside, 2 * jnp.cos(angle), jnp.where(low, least, 1.0))
    # (T1 - T2)^2 = 2 sigma^2 - (T1 + T2)^2
    contrast = jnp.where(inside, 2 / total**2 - 1, jnp.where(low, 0.0, 1.0))
    lags = lags_of(contrast, total * sigma)
    raw = mean - total * sigma
    own, dropped = own_delay(raw, mean)
    status = first_problem(problem, valid, status, dropped)
    details = {"mean": mean + delay, "variance": variance, "skewness": skewness, "raw_delay": raw}
    return finish(record, safe, PTn(lags=lags), delay + own, status, details)


def moments_ptn(
    record: StepRecord,
    *,
    span: float | None = None,
    delay: Float[ArrayLike, ""] = 0.0,
) -> Identification:
    r"""n equal lags from two moments: $n = \mu_1^2/\sigma^2$, rounded to 1..40, $T = \mu_1/n$.

    More than 40.5 refuse with `beyond_last_order`, less than 0.5 take one lag with the warning
    `at_curve_end`. Options and further status as in `area_fopdt`; there is no dead time but
    `delay`.
    """
    problem, safe = readable(record, span)
    mean, variance, _, valid = _cumulants(safe, delay)
    order = mean**2 / variance
    n = jnp.clip(jnp.round(order), 1, MAX_REAL_ORDER)
    status = Status.where(order < 0.5, Status.at_curve_end, Status.successful)
    status = Status.where(order <= MAX_REAL_ORDER + 0.5, status, Status.beyond_last_order)
    status = first_problem(problem, valid, status)
    details = {"mean": mean + delay, "variance": variance, "order": order}
    return finish(record, safe, EqualLag(T=mean / n, n=n), delay, status, details)
