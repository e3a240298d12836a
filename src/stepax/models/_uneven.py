"""Responses to inputs sampled at uneven times: a matrix for every interval."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arrays import Samples, Scalar
from ._realisation import AbstractRealisation
from ._sampled import times


CHUNK = 128
"""Intervals whose matrices are held at one time, in derivatives too."""


def uneven_response(
    realisation: AbstractRealisation,
    delay: Scalar,
    t: Samples,
    u: Samples,
    hold: str,
    at: Float[Array, " outputs"] | None = None,
) -> Array:
    """Response to samples at times that increase, put off by a dead time.

    At those times, or `at` others up to the last. A matrix takes the state over each interval,
    another from its beginning to the output.
    """
    at = t if at is None else at
    intervals = jnp.diff(t)
    slopes = jnp.diff(u) / intervals if hold == "first" else jnp.zeros_like(u[1:])
    states = _states(realisation, intervals, jnp.stack([slopes, u[:-1]], axis=1))
    # the output is that of the state a dead time ago, just before a sample that falls on it
    seen = at - delay - realisation.later
    place = jnp.clip(jnp.searchsorted(t, seen) - 1, 0, t.shape[0] - 2)
    elapsed = seen - t[place]

    @jax.checkpoint
    def read(rows):
        moved = jax.vmap(realisation.transition)(rows[0])
        return times(jnp.einsum("j,kji->ki", realisation.readout, moved)[:, None], rows[1])

    chunks = _chunks((jnp.maximum(elapsed, 0), states[place][:, :, None]))
    y = jax.lax.map(read, chunks).reshape(-1)[: at.shape[0]]
    return jnp.where(elapsed > 0, y, 0)


def _states(
    realisation: AbstractRealisation, intervals: Samples, inputs: Float[Array, "intervals 2"]
) -> Float[Array, "intervals states"]:
    """States at the beginning of each interval, slope and value of the input before them."""

    @jax.checkpoint
    def chunk(state, rows):
        moves = jax.vmap(realisation.transition)(rows[0])

        def step(state, row):
            full = jnp.concatenate([row[1], state])
            return times(row[0][2:], full), full

        return jax.lax.scan(step, state, (moves, rows[1]))

    start = jnp.zeros(realisation.readout.shape[0] - 2, jnp.result_type(intervals, inputs))
    start = start.astype(jnp.result_type(start, realisation.readout))
    _, states = jax.lax.scan(chunk, start, _chunks((intervals, inputs)))
    return states.reshape(-1, states.shape[-1])[: intervals.shape[0]]


def _chunks(rows):
    """Arrays cut into pieces of `CHUNK` rows, zeros behind the last."""

    def cut(x):
        short = -x.shape[0] % CHUNK
        padded = jnp.concatenate([x, jnp.zeros((short, *x.shape[1:]), x.dtype)])
        return padded.reshape(-1, CHUNK, *x.shape[1:])

    return jax.tree.map(cut, rows)
