"""Responses to sampled inputs of a plant without a finite state: equal lags of a real order."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._arrays import Samples, Scalar
from ._sampled import dead_time, put_off


Response = Callable[[Array], Array]
"""Of time: to a step, or to a ramp of slope 1."""
ROWS = 64
"""Outputs that are summed up at one time."""


def convolved_response(
    step: Response,
    mean: Callable[[Samples, Scalar], Samples],
    delay: Scalar,
    interval: Scalar,
    u: Samples,
    hold: str,
) -> Samples:
    """On an even grid by Fourier transforms, N log N.

    The moves of the input are convolved, not itself: they keep the absolute error of the response.
    A move along a line is answered by the `mean` of the response over an interval.
    """
    count = u.shape[0]
    whole, phase = dead_time(delay, interval, count)
    t = interval * (jnp.arange(count) + phase)
    moves = jnp.diff(u)
    if hold == "zero":
        y = _convolve(step(t), jnp.concatenate([u[:1], moves]))
    else:
        y = u[0] * step(t) + _convolve(mean(t, interval), jnp.append(moves, 0))
    return put_off(y, whole + 1)


def _convolve(kernel: Samples, moves: Samples) -> Samples:
    """Causal convolution."""
    count = kernel.shape[0]
    length = 1 << (2 * count - 1).bit_length()
    spectrum = jnp.fft.rfft(kernel, length) * jnp.fft.rfft(moves, length)
    return jnp.fft.irfft(spectrum, length)[:count]


def superposed_response(
    step: Response,
    ramp: Response,
    delay: Scalar,
    t: Samples,
    u: Samples,
    hold: str,
    at: Float[Array, " outputs"] | None = None,
) -> Array:
    """At uneven times, or `at` others, one response for every sample: N^2 in time, N in memory."""
    if hold == "zero":
        parts = [(step, jnp.diff(u, prepend=0))]
    else:
        slopes = jnp.diff(u) / jnp.diff(t)
        turns = jnp.concatenate([jnp.diff(slopes, prepend=0), 0 * u[:1]])
        parts = [(step, jnp.where(jnp.arange(u.shape[0]) == 0, u, 0)), (ramp, turns)]

    def output(time):
        since = time - t - delay
        return sum(jnp.sum(response(since) * moves) for response, moves in parts)

    return jax.lax.map(jax.checkpoint(output), t if at is None else at, batch_size=ROWS)
