"""Gain and offset of a fit: known, tied by a known final level, or found by regression."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arrays import Samples, Scalar, row_by_row, safe_sqrt
from ..models._abstract import AbstractPlant
from ..records._abstract import AbstractRecord
from ._beside import Beside


class Near(NamedTuple):
    """Levels at some point of a search, in units of the output."""

    offset: Scalar
    amplitude: Scalar


class Levels(eqx.Module):
    """What is known of the levels: each is None where it is to be found.

    `final` is the level that ties gain and offset together, neither being known by itself. `step`
    is the size of the input's step, or `input_size`: the amplitude is step times gain.
    """

    offset: Scalar | None
    gain: Scalar | None
    final: Scalar | None
    step: Scalar

    @classmethod
    def of(cls, record: AbstractRecord, model: AbstractPlant, fixed: tuple[str, ...]) -> "Levels":
        """What a record and the parameters to hold say; an integrating plant has no final level."""
        dtype, step = record.y.dtype, record.input_size
        final = record.final if model.settles else None
        offset = jnp.asarray(model.offset, dtype) if "offset" in fixed else record.initial
        gain = jnp.asarray(model.gain, dtype) if "gain" in fixed else None
        if final is not None and gain is not None and offset is None:
            offset = final - step * gain
        if final is not None and gain is None and offset is not None:
            gain = (final - offset) / step
        tied = final if offset is None and gain is None else None
        return cls(offset, gain, tied, step)

    @property
    def free(self) -> int:
        """Number of levels, offset and amplitude, that a regression would find."""
        if self.final is not None:
            return 1
        return (self.offset is None) + (self.gain is None)

    @property
    def found_names(self) -> set[str]:
        """Parameters that are found by themselves: with a tie the offset follows from the gain."""
        offset = {"offset"} if self.offset is None and self.final is None else set()
        return offset | ({"gain"} if self.gain is None else set())

    def regression(
        self, y: Samples, w: Samples, g: Samples, beside: Beside | None = None
    ) -> tuple[Scalar, Scalar]:
        """Offset and amplitude of least squares for a response g, weights w.

        With more `beside` the offset, a free one is part of that and 0 here.
        """
        if beside is not None:
            known = 0 * y[0] if self.offset is None else self.offset
            d, away = beside.across(g), beside.across(y - known)
            return known, _slope(w, d, away) if self.gain is None else self.step * self.gain
        if self.offset is not None and self.gain is not None:
            return self.offset, self.step * self.gain
        if self.gain is not None:
            amplitude = self.step * self.gain
            return w @ (y - amplitude * g) / jnp.sum(w), amplitude
        if self.offset is not None:
            return self.offset, _slope(w, g, y - self.offset)
        if self.final is not None:
            amplitude = _slope(w, g - 1, y - self.final)
            return self.final - amplitude, amplitude
        mean_g, mean_y = w @ g / jnp.sum(w), w @ y / jnp.sum(w)
        amplitude = _slope(w, g - mean_g, y - mean_y)
        return mean_y - amplitude * mean_g, amplitude

    def products(
        self, w: Samples, y: Samples, g: Samples, moves: list[Samples], near: Near, unit: Scalar
    ) -> tuple[Float[Array, "rows rows"], Near, Scalar]:
        r"""Inner products of the derivatives of the residual, where g moves, and of itself, last.

        The residual is r = y - offset - amplitude g in a unit, both levels of least squares: these
        come second, and by how much $\langle r, r\rangle$ may be wrong third. With a the amplitude
        in that unit, d the part of g that this belongs to, across a free offset as all that
        follows, and h a move,

        $$ r' = -a \left(h - \frac{\langle d, h\rangle}{\langle d, d\rangle} d\right)
                - \frac{\langle r, h\rangle}{\langle d, d\rangle} d, \qquad
           \langle r, d \rangle = 0 $$

        (Golub and Pereyra 1973), weights w in the inner products. All follow from those of the
        plain rows, one product of matrices, among them the residual of the levels `near`: what
        lacks there is a combination of d and a constant. So they hold for any, to all digits where
        it is near; else to the rounding of the square of that residual.
        """
        number, root = len(moves), safe_sqrt(w)
        offset, amplitude = near
        amplitude = amplitude if self.gain is None else self.step * self.gain
        across = self.offset is None and self.final is None
        if self.final is not None:
            offset, g = self.final, g - 1
        elif self.offset is not None:
            offset = self.offset
        residual, a = (y - offset - amplitude * g) / unit, amplitude / unit
        rows = row_by_row([root * row for row in (*moves, residual, g)])
        # Of its own in each lane: a root that lanes share makes XLA copy the rows three times.
        own = root + 0 * a
        p, sums, count = rows @ rows.T, rows @ own, jnp.sum(w)
        length = jnp.diagonal(p)
        if across:
            p = p - sums[:, None] * sums[None, :] / count
        h, r, d = slice(number), number, number + 1
        inverse = 1 / jnp.where(p[d, d] > 0, p[d, d], 1) if self.gain is None else 0.0
        more = p[r, d] * inverse  # of the amplitude
        a, by_residual = a + more, p[h, r] - more * p[h, d]
        cost = p[r, r] - more * p[r, d]
        normal = a**2 * (p[h, h] - inverse * p[h, d, None] * p[None, h, d])
        normal = normal + inverse * by_residual[:, None] * by_residual[None, :]
        rounding = 8 * jnp.finfo(g.dtype).eps * length  # what it may leave of a difference
        normal = normal + jnp.diag(a**2 * rounding[h])
        cost = jnp.maximum(cost, rounding[r] / 8)
        if across:
            offset = offset + unit * (sums[r] - more * sums[d]) / count
        gradient = -a * by_residual
        last = jnp.append(gradient, cost)
        products = jnp.block([[normal, gradient[:, None]], [last]])
        return products, Near(offset, unit * a), rounding[r]


def _slope(w: Samples, x: Samples, y: Samples) -> Scalar:
    """Slope of the weighted regression of y on x through 0."""
    wx = w * x
    square = wx @ x
    return wx @ y / jnp.where(square > 0, square, 1)
