"""Where the fits to a sampled input start: the best of a grid of shapes, each with any dead time.

Nothing can be read off such a record as off a step response. But for a given shape all dead times
that are a whole number of sampling intervals cost one convolution and one correlation.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._arrays import Samples
from ..models._abstract import AbstractPlant
from ..models._plants import FOPDT, IPDT, SOPDT, SOPDTZero
from ..models._spread import chain_with_spread
from ..models._units import in_unit
from ..records._input import InputRecord
from ..records._record import usable_record


ROWS = 512
"""Even spans of time over whose means shapes are compared."""

LONGEST_DELAY = 0.5
"""Of the record: beyond it too few rows tell the response."""

TIMES = np.geomspace(1 / 500, 1.0, 14)
"""Sums of lags, or periods, over the length of the record, a factor of 1.6 apart.

`test_prbs_of_any_plant` has plants between them: from there the solver finds the optimum."""

DAMPINGS = (0.1, 0.3, 0.7, 1.5)

WITH_ZERO = list(itertools.product((0.5, 1.5), TIMES[::2], (-1.0, -0.3, 0.4, 1.5)))
"""Dampings, periods, and leads over the period."""

UNREST = 0.25
"""Share of the record that is left out where the plant does not begin at rest."""


def first_order_start(record: InputRecord, fixed: Sequence[str]) -> FOPDT:
    """Time constants of the grid."""
    return _best(record, fixed, lambda x: FOPDT(T=x[0]), [(x,) for x in TIMES])


def second_order_start(record: InputRecord, fixed: Sequence[str]) -> SOPDT:
    """Dampings and periods of the grid."""

    def plant(x: Array) -> SOPDT:
        return SOPDT(zeta=x[0], omega_n=jnp.sqrt(1 + 4 * x[0] ** 2) / x[1])

    return _best(record, fixed, plant, itertools.product(DAMPINGS, TIMES))


def chain_start(model: Any, record: InputRecord, n: Array, fixed: Sequence[str]) -> Any:
    """Chains of medium spread, as for a step."""
    chain = chain_with_spread(model, jnp.log(jnp.asarray(0.6, record.y.dtype)), n)

    def plant(x: Array) -> Any:
        return dataclasses.replace(chain, T=chain.T * x[0])

    return _best(record, fixed, plant, [(x,) for x in TIMES])


def zero_start(record: InputRecord, fixed: Sequence[str]) -> SOPDTZero:
    """Dampings, periods and leads of the grid."""

    def plant(x: Array) -> SOPDTZero:
        omega_n = jnp.sqrt(1 + 4 * x[0] ** 2) / x[1]
        return SOPDTZero(zeta=x[0], omega_n=omega_n, lead=x[2] * x[1])

    return _best(record, fixed, plant, WITH_ZERO)


def integrating_start(record: InputRecord, fixed: Sequence[str]) -> IPDT:
    """Lags of the grid."""
    return _best(record, fixed, lambda x: IPDT(T=x[0]), [(x,) for x in TIMES])


class _Spans(eqx.Module):
    """Means over even spans: the input, the output across its line, what rows count.

    The unit of time is the length of the record.
    """

    u: Samples
    spectrum: Array
    basis: Float[Array, "k spans"]
    first: int = eqx.field(static=True)

    @classmethod
    def of(cls, record: InputRecord) -> "_Spans":
        """Of a usable record."""
        size, y = min(ROWS, record.t.size), record.y
        first = 0 if record.at_rest else int(UNREST * size)
        counts = np.arange(size) >= first
        basis = [counts / np.sqrt(np.sum(counts))]
        if record.drift:
            line = counts * (np.arange(size) - (first + size - 1) / 2)
            basis.append(line / np.sqrt(line @ line))
        basis = jnp.asarray(np.stack(basis), y.dtype)
        held = record.u[:-1] if record.hold == "zero" else (record.u[:-1] + record.u[1:]) / 2
        u = _means((held - record.u[0]) / record.input_size, record, size)
        y = _means((y[:-1] + y[1:]) / 2, record, size) * jnp.asarray(counts, y.dtype)
        return cls(u, _spectrum(y - (basis @ y) @ basis), basis, first)

    def explained(self, plant: AbstractPlant) -> Float[Array, " delays"]:
        """How much of the sum of squares a plant explains with each dead time, in spans."""
        size = self.u.size
        # a mean input acts as a held one; the mean output of a span is about that of its middle
        since = (jnp.arange(size) + 0.5).astype(self.u.dtype) / size
        kernel = jnp.diff(plant.unit_response(since), prepend=0)
        moved = _row(_spectrum(kernel) * _spectrum(self.u), size)
        back = jnp.conj(_spectrum(moved))
        onto, *along = (
            _row(back * x, size) for x in (self.spectrum, *(_spectrum(row) for row in self.basis))
        )
        squares = jnp.append(jnp.zeros_like(moved[:1]), jnp.cumsum(moved**2))
        late = np.arange(size)
        square = squares[size - late] - squares[np.maximum(self.first - late, 0)]
        own = square - sum(x**2 for x in along)
        usable = own > 1e-6 * squares[-1]
        return jnp.where(usable, onto**2 / jnp.where(usable, own, 1), 0)


def _spectrum(row: Samples) -> Array:
    return jnp.fft.rfft(row, 1 << (2 * row.size - 1).bit_length())


def _row(spectrum: Array, size: int) -> Array:
    return jnp.fft.irfft(spectrum)[:size]


def _means(values: Samples, record: InputRecord, size: int) -> Array:
    """Means over even spans of what has these values between one row and the next."""
    area = jnp.append(jnp.zeros_like(values[:1]), jnp.cumsum(values * jnp.diff(record.t)))
    ends = jnp.asarray(np.arange(size + 1) / size, values.dtype)
    at_ends = jnp.interp(record.t[0] + record.duration * ends, record.t, area)
    return jnp.diff(at_ends) * size / record.duration


def _best(
    record: InputRecord,
    fixed: Sequence[str],
    plant: Callable[[Array], Any],
    shapes: Iterable[Sequence[float]],
) -> Any:
    """Of a grid of shapes the one that explains most, in the unit of time of the record."""
    _, safe = usable_record(record)
    spans, grid = _Spans.of(safe), jnp.asarray(np.array(list(shapes)), record.y.dtype)
    explained = jax.lax.map(lambda x: spans.explained(plant(x)), grid)
    late, size = np.arange(spans.u.size), spans.u.size
    allowed = late == 0 if "delay" in fixed else late <= LONGEST_DELAY * size
    best = jnp.argmax(jnp.where(allowed, explained, -1))
    unit = safe.duration
    found = in_unit(plant(grid[best // size]), unit)
    found = dataclasses.replace(found, delay=(best % size) * unit / size)
    return jax.lax.stop_gradient(found)
