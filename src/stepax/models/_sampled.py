r"""Responses to sampled inputs, exact for the hold, in time and memory of order N.

Between two samples the input is constant, or moves along a line, and the state of the plant is
carried over exactly (`_transition`). On an even grid that is one difference equation,

$$ x_{k+1} = F x_k + b u_k, \qquad y_k = c x_k + d u_k + e u_{k+1}, $$

where $y_k$ is the output a part of the interval after $t_k$: the dead time is a whole number of
intervals, by which the output is put off, and that part. A loop over samples leaves a processor
idle between them. So the equation is written for `BLOCK` samples at once, matrices of which are
the same for all blocks; only the state goes from block to block one by one.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arrays import Count, Samples, Scalar
from ._realisation import AbstractRealisation


BLOCK = 16
"""Samples at once: with more, products within the block cost more than steps between them."""
EXACT = jax.lax.Precision.HIGHEST
"""Of matrix products: accelerators multiply single precision with ten bits unless told so."""


class Difference(NamedTuple):
    """The difference equation of one sampling interval, on the state less `jump` times the input.

    That is 0 for a constant input; else it takes the input at the end of an interval out of the
    recursion.
    """

    F: Float[Array, "n n"]
    b: Float[Array, " n"]
    c: Float[Array, " n"]
    d: Scalar
    e: Scalar
    jump: Float[Array, " n"]


def difference_equation(
    plant: AbstractRealisation, interval: Scalar, phase: Scalar, hold: str
) -> Difference:
    """Of a plant sampled every `interval`; the output is that a share `phase` of it later."""
    whole, part = jax.vmap(plant.transition)(interval * jnp.stack([jnp.ones_like(phase), phase]))
    output = times(plant.readout, part)
    F, b, c, d = whole[2:, 2:], whole[2:, 1], output[2:], output[1]
    jump, e = whole[2:, 0] / interval, output[0] / interval
    if hold == "zero":
        return Difference(F, b, c, d, jnp.zeros_like(e), jnp.zeros_like(jump))
    return Difference(F, b - jump + times(F, jump), c, d - e + times(c, jump), e, jump)


def march(
    step: Difference, state: Float[Array, " n"], u: Samples
) -> tuple[Samples, Float[Array, " n"]]:
    """Outputs in the intervals after each sample, without the share of the next one; last state.

    The state is that which the equation is written for, at the first sample and one interval after
    the last.
    """
    count = u.shape[0]
    size = min(BLOCK, 1 << (count - 1).bit_length())
    blocks = -(-count // size)
    held = jnp.pad(u, (0, blocks * size - count)).reshape(blocks, size)
    rows, columns, powers = _powers(step, size)
    kernel = jnp.concatenate([step.d[None], times(rows[:-1], step.b)])

    def carry(x, moved):
        return times(powers[-1], x) + moved, x

    _, states = jax.lax.scan(carry, state, times(held, columns[:, ::-1].T))
    y = times(held, _toeplitz(kernel)) + times(states, rows.T)
    rest = count - (blocks - 1) * size
    last = times(columns[:, :rest][:, ::-1], held[-1, :rest])
    return y.reshape(-1)[:count], last + times(_power(powers, rest), states[-1])


def times(a: Array, b: Array) -> Array:
    """Product of matrices or vectors."""
    return jnp.matmul(a, b, precision=EXACT)


def _powers(step: Difference, size: int) -> tuple[Array, Array, list[Array]]:
    """Rows c F^j and columns F^j b, and F, F^2, F^4, ..., F^size, for a power of 2."""
    rows, columns, powers = step.c[None], step.b[:, None], [step.F]
    while rows.shape[0] < size:
        rows = jnp.concatenate([rows, times(rows, powers[-1])])
        columns = jnp.concatenate([columns, times(powers[-1], columns)], axis=1)
        powers.append(times(powers[-1], powers[-1]))
    return rows, columns, powers


def _power(powers: list[Array], exponent: int) -> Array:
    """F to an exponent >= 1, from its powers of 2."""
    wanted = [power for k, power in enumerate(powers) if exponent >> k & 1]
    return functools.reduce(times, wanted)


def _toeplitz(kernel: Array) -> Array:
    """The matrix that a row is multiplied by to be convolved with the kernel.

    Cut from copies of the kernel side by side: no indices, whose derivatives would be slow.
    """
    size = kernel.shape[0]
    row = jnp.concatenate([kernel, jnp.zeros_like(kernel)])
    return jnp.tile(row, size)[: size * (2 * size - 1)].reshape(size, 2 * size - 1)[:, :size]


def put_off(y: Samples, count: Count | int) -> Samples:
    """The same numbers, later by a count of places that follow from the data; zeros before."""
    behind = jnp.concatenate([jnp.zeros_like(y), y])
    return jax.lax.dynamic_slice_in_dim(behind, y.shape[0] - count, y.shape[0])


def even_response(
    realisation: AbstractRealisation, delay: Scalar, interval: Scalar, u: Samples, hold: str
) -> Samples:
    """Response to samples of the input every `interval`, put off by a dead time."""
    whole, phase = dead_time(delay + realisation.later, interval, u.shape[0])
    step = difference_equation(realisation, interval, phase, hold)
    y, _ = march(step, -step.jump * u[0], u)
    if hold == "first":
        y = y + step.e * jnp.roll(u, -1)  # that of the last interval is not asked for
    return put_off(y, whole + 1)


def dead_time(delay: Scalar, interval: Scalar, most: int) -> tuple[Count, Scalar]:
    """Whole intervals of a dead time, fewer than `most`, and what of one is left after its part."""
    late = delay / interval
    whole = jnp.floor(late)
    count = jnp.where(whole >= 0, jnp.minimum(whole, most - 1), 0)  # NaN is no whole number
    return count.astype(int), 1 - (late - whole)
