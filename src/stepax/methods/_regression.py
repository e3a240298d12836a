r"""Second order plus dead time by linear regression on integrals of the record.

The differential equation $y'' + a_1 y' + a_2 y = b_1 u' + b_2 u(t - L)$, integrated twice from a
rest before the step, is linear in all that is sought, for t >= L:

$$ y = -a_1 I_1 - a_2 I_2 + c_0 + c_1 t + c_2 t^2/2, $$

with $I_1 = \int_0^t y$, $I_2 = \int_0^t I_1$ and
$c_2 = b_2$, $c_1 = b_1 - b_2 L$, $c_0 = b_2 L^2/2 - b_1 L$.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .._arrays import Samples, Scalar, safe_sqrt
from .._orthonormal import orthonormal
from .._result import Identification
from .._status import Status
from ..models._plants import SOPDT, SOPDTZero
from ..records._areas import RunningArea, running_area
from ..records._record import StepRecord
from ._reading import Delay, Reading, Span, own_delay


POWERS = (-2, -1, 0, 1, 2)
"""Powers of time that serve as instruments: they know nothing of the noise."""

ROUNDS = 3
"""Regressions, each on the rows after the dead time that the one before found."""


class Equation(NamedTuple):
    """Coefficients of the integrated equation, in the end of the record as the unit of time."""

    a1: Scalar
    a2: Scalar
    c0: Scalar
    c1: Scalar
    c2: Scalar


def wang_guo_zhang(
    record: StepRecord,
    *,
    gain: Float[ArrayLike, ""] | None = None,
    zero: bool = False,
    instruments: bool = False,
    start: float = 0.05,
    span: Span = None,
    delay: Delay = 0.0,
) -> Identification:
    r"""Second order plus dead time by regression on integrals (Wang, Guo, Zhang 2001).

    Least squares for $a_1, a_2, c_0, c_1, c_2$; $\omega_n = \sqrt{a_2}$,
    $\zeta = a_1/(2\omega_n)$, $K = c_2/a_2$, and $L = -c_1/c_2$, or with a zero the root of
    $b_2 L^2/2 + c_1 L + c_0 = 0$ that fits the record better. Rows count from where the response
    has risen by `start` of its largest value, or from L if that is later.

    **Options:** `gain`: known gain of the plant, then $c_2 = K a_2$ (a known final level of the
    record says the same); `zero`: with a zero, a `SOPDTZero`; `instruments`: instead of least
    squares, which noise in the integrals biases, instrumental variables, the powers of time from
    -2 to 2 (Wang, Zhang 2001), which scatter more; `span`: LOESS first; `delay`: dead time known
    beforehand, on top of which L comes.

    **Status:** a negative L is left out (`delay_dropped`); coefficients of no stable plant refuse
    with `not_stable`. Under mismatch of the model the result depends on `start`. Standard errors
    are NaN: the method has none.
    """
    reading = Reading(record, span, delay)
    late = reading.safe.step_time + reading.delay
    safe = eqx.tree_at(lambda r: r.step_time, reading.safe, late)
    known = gain is not None or record.final is not None
    away = jnp.where(safe.after_step, safe.y - reading.initial, 0)
    scale = away[jnp.argmax(jnp.abs(away))]
    if gain is not None:
        scale = safe.step_size * gain
    elif known:
        scale = reading.final - reading.initial
    scale = jnp.where(scale == 0, 1, scale)
    y = jnp.where(safe.elapsed >= 0, away / scale, 0)
    area = running_area(safe, y)
    first = jax.lax.stop_gradient(area.onset(jnp.asarray(start, y.dtype), safe.count))
    found = _regression(area, y, safe.after_step, first, known, instruments)
    return _conclude(reading, area, found, scale, known, zero)


def _regression(
    area: RunningArea, y: Samples, rows: Array, first: Scalar, known: bool, instruments: bool
) -> Equation:
    """Coefficients by the rows after `first` and after the dead time that comes out."""
    t = jnp.clip(area.t / area.end, 0, 1)
    once = area.below / area.end
    parts = 0.5 * jnp.diff(t) * (once[1:] + once[:-1])
    twice = jnp.append(jnp.zeros_like(parts[:1]), jnp.cumsum(parts))
    square = 0.5 * t**2
    if known:  # c2 = a2 for a gain of 1
        columns = [-once, square - twice, jnp.ones_like(t), t]
    else:
        columns = [-once, -twice, jnp.ones_like(t), t, square]
    table = jnp.stack(columns, axis=1)

    def again(first, _):
        used = rows & (t >= first)
        chosen, values = jnp.where(used[:, None], table, 0), jnp.where(used, y, 0)
        if instruments:
            safe = jnp.where(used, t, 1)
            powers = [jnp.where(used, safe**k, 0) for k in POWERS[-table.shape[1] :]]
            beside = jnp.stack(powers, axis=1)
        else:
            beside = orthonormal(list(chosen.T), 1.0, 0.0).q.T  # least squares
        solution = jnp.linalg.solve(beside.T @ chosen, beside.T @ values)
        found = Equation(*solution, *([solution[1]] if known else []))
        late = jax.lax.stop_gradient(-found.c1 / found.c2)
        late = jnp.where(jnp.isfinite(late), jnp.clip(late, first, 0.8), first)
        return late, found

    _, found = jax.lax.scan(again, first / area.end, length=ROUNDS)
    return jax.tree.map(lambda x: x[-1], found)


def _conclude(
    reading: Reading,
    area: RunningArea,
    found: Equation,
    scale: Scalar,
    known: bool,
    zero: bool,
) -> Identification:
    # In units of the record: what is less, as of a ramp, is rounding of the sums.
    least = jnp.finfo(scale.dtype).eps ** 0.5
    stable = (found.a1 > least) & (found.a2 > least) & (found.c2 > 0) & jnp.isfinite(found.c0)
    a1, a2, c0, c1, c2 = (jnp.where(stable, x, y) for x, y in zip(found, _HARMLESS, strict=True))
    omega_n = jnp.sqrt(a2)
    zeta, omega_n = 0.5 * a1 / omega_n, omega_n / area.end
    status = Status.where(stable, Status.successful, Status.not_stable)
    level = c2 / a2
    reading.final = reading.initial + jnp.where(known, 1, level) * scale
    if not zero:
        own = own_delay(-c1 / c2 * area.end, area.end)
        return reading.conclude(SOPDT(zeta=zeta, omega_n=omega_n), status, own=own)
    root = safe_sqrt(jnp.maximum(c1**2 - 2 * c2 * c0, 0))
    error = functools.partial(_with_zero, reading, area, zeta, omega_n, level)
    delays, leads = jnp.stack([root - c1, -root - c1]) / c2, jnp.stack([root, -root]) / c2
    errors = jax.vmap(error)(delays * area.end, leads * area.end)
    best = jnp.argmin(errors)
    model = SOPDTZero(zeta=zeta, omega_n=omega_n, lead=leads[best] * area.end)
    return reading.conclude(model, status, own=own_delay(delays[best] * area.end, area.end))


_HARMLESS = (2.0, 1.0, 0.0, 0.0, 1.0)
"""Coefficients of a plant, where those found are of none."""


def _with_zero(
    reading: Reading,
    area: RunningArea,
    zeta: Scalar,
    omega_n: Scalar,
    level: Scalar,
    delay: Scalar,
    lead: Scalar,
) -> Scalar:
    """Squared error over the rows, in the unit of the response; a negative dead time is dropped."""
    model = SOPDTZero(zeta=zeta, omega_n=omega_n, lead=lead)
    residual = area.y - level * model.unit_response(area.t - jnp.maximum(delay, 0))
    rows = reading.safe.present & (area.t >= 0)
    return jnp.sum(jnp.where(rows, residual, 0) ** 2)
