r"""Methods that integrate the record: areas, and the moments of the impulse response.

With the share y of the change, the impulse response y' of the plant has the moments

$$ \mu_1 = \int_0^\infty (1 - y)\,dt, \qquad m_k = k \int_0^\infty t^{k-1} (1 - y)\,dt, $$

from which its mean $\mu_1$, variance $\sigma^2 = m_2 - \mu_1^2$ and third cumulant follow: sums
over the lags and the dead time. Integrals run to the end of the record and no further: what the
response still lacks there is missing, and the higher the moment, the more it weighs. Noise
late in the record weighs as much.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .._arrays import Scalar
from .._result import Identification
from .._status import Status
from ..curves._second_order import lags_of
from ..models._plants import FOPDT, EqualLag, PTn
from ..models._responses import MAX_REAL_ORDER
from ..records._characterise import integrals
from ..records._record import StepRecord
from ._reading import Delay, Reading, Span, end_status, own_delay


class Moments(NamedTuple):
    """Mean, from step and known dead time, variance and third cumulant of the impulse response."""

    mean: Scalar
    variance: Scalar
    third: Scalar


def _moments(reading: Reading) -> Moments:
    """Moments, or harmless ones where they are not positive (`invalid_moments`)."""
    mean, m2, m3 = np.arange(1, 4) * reading.areas()
    variance = m2 - mean**2
    third = m3 - 3 * mean * m2 + 2 * mean**3
    positive = (mean > reading.delay) & (variance > 0)
    status = Status.where(positive, Status.successful, Status.invalid_moments)
    reading.remember(status, mean=mean, variance=variance)
    # Where they cannot be used those of one lag of 1, which every formula takes.
    return Moments(
        jnp.where(positive, mean - reading.delay, 1),
        jnp.where(positive, variance, 1),
        jnp.where(positive, third, 2),
    )


def area_fopdt(record: StepRecord, *, span: Span = None, delay: Delay = 0.0) -> Identification:
    r"""First order plus dead time from two areas.

    $A_0 = \int (1 - y)\,dt = L + T$, $A_1 = \int_0^{A_0} y\,dt$, $T = e A_1$, $L = A_0 - T$
    (Nishikawa et al. 1984; Astrom, Hagglund 1995). Little moved by noise, but A_0 wants a record
    that has settled and a final level that is right. **Options:** `span`: LOESS first; `delay`:
    dead time known beforehand, on top of which L comes. **Status:** a negative L is left out
    (`delay_dropped`); areas that are not positive refuse with `invalid_moments`. Standard errors
    are NaN: the method has none.
    """
    reading = Reading(record, span, delay)
    whole, *_ = reading.areas()
    (rest,) = integrals(reading.safe, (0,), whole)
    area = whole - rest
    positive = (whole > reading.delay) & (area > 0)
    status = Status.where(positive, Status.successful, Status.invalid_moments)
    T = jnp.where(positive, np.e * area, 1)
    own = own_delay(whole - reading.delay - T, whole)
    return reading.conclude(FOPDT(T=T), status, own=own, area=whole, area_below=area)


def moments_fopdt(record: StepRecord, *, span: Span = None, delay: Delay = 0.0) -> Identification:
    r"""First order plus dead time from two moments: $T = \sigma$, $L = \mu_1 - \sigma$.

    Options and status as in `area_fopdt`; moments that are not positive refuse with
    `invalid_moments`.
    """
    reading = Reading(record, span, delay)
    mean, variance, _ = _moments(reading)
    T = jnp.sqrt(variance)
    return reading.conclude(FOPDT(T=T), own=own_delay(mean - T, mean))


def moments_sopdt(
    record: StepRecord, *, tolerance: float = 0.5, span: Span = None, delay: Delay = 0.0
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
    reading = Reading(record, span, delay)
    mean, variance, third = _moments(reading)
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
    model = PTn(lags=lags_of(contrast, total * sigma))
    own = own_delay(mean - total * sigma, mean)
    return reading.conclude(model, status, own=own, skewness=skewness)


def moments_ptn(record: StepRecord, *, span: Span = None, delay: Delay = 0.0) -> Identification:
    r"""n equal lags from two moments: $n = \mu_1^2/\sigma^2$, rounded to 1..40, $T = \mu_1/n$.

    More than 40.5 refuse with `beyond_last_order`, less than 0.5 take one lag with the warning
    `at_curve_end`. Options and further status as in `area_fopdt`; there is no dead time but
    `delay`.
    """
    reading = Reading(record, span, delay)
    mean, variance, _ = _moments(reading)
    order = mean**2 / variance
    n = jnp.clip(jnp.round(order), 1, MAX_REAL_ORDER)
    status = Status.where(order < 0.5, Status.at_curve_end, Status.successful)
    status = Status.where(order <= MAX_REAL_ORDER + 0.5, status, Status.beyond_last_order)
    return reading.conclude(EqualLag(T=mean / n, n=n), status, order=order)
