"""Preprocessing on plain arrays: smoothing, levels, noise estimate, local interpolation."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from .._arrays import Count, Samples, Scalar, as_real


def smooth(
    t: Float[ArrayLike, " samples"], y: Float[ArrayLike, " samples"], span: float | Scalar = 0.2
) -> Samples:
    r"""LOESS: local quadratic regression with tricube weights $(1 - |x|^3)^3$ (Cleveland 1979).

    The ceil(`span` N) samples nearest in time serve each point, scaled by the distance of the
    farthest, which gets weight 0; near the ends the window is one-sided. Uneven times are used as
    they are. Choose the span so that the rise covers several windows: with 0.2 the window is a
    fifth of the record.

    A traced span is differentiable: the window then grows continuously, from one number of nearest
    samples to the next, and time and memory as N^2. NaN where it is not in [4/N, 1].
    """
    t, y = _pair(t, y)
    return loess(t, y, t, span)


def loess(
    t: Samples, y: Samples, at: Samples, span: float | Scalar, count: Count | int | None = None
) -> Samples:
    """`smooth` at the times `at`, from the first `count` samples."""
    if isinstance(span, Tracer):
        return _loess_of_any_span(t, y, at, span, t.shape[0] if count is None else count)
    span, samples = float(span), t.shape[0]
    longest = window = window_of(samples, span)
    if count is not None and not isinstance(count, int):
        # A table, since a product in single precision may round up to another whole number.
        table = np.maximum(4, np.ceil(span * np.arange(samples + 1)))
        window = jnp.asarray(table.astype(int))[count]
    count = samples if count is None else count
    # In sorted times the nearest samples are contiguous; the window moves on when its first
    # sample is farther away than the one after its last.
    place = jnp.arange(samples)
    after = t[jnp.minimum(place + window, samples - 1)]
    starts = jnp.searchsorted(jnp.where(place + window < count, t + after, jnp.inf), 2 * at)
    reach = jnp.maximum(at - t[starts], t[jnp.minimum(starts + window, samples) - 1] - at)
    reach = jnp.where(reach > 0, reach, 1)

    def add(sums, k):
        row = jnp.minimum(starts + k, samples - 1)
        x = (t[row] - at) / reach
        moment = jnp.where(k < window, (1 - jnp.minimum(jnp.abs(x), 1) ** 3) ** 3, 0)
        moments = [moment]
        for _ in range(4):
            moment = moment * x
            moments.append(moment)
        terms = [*moments, *(m * y[row] for m in moments[:3])]
        return [total + term for total, term in zip(sums, terms, strict=True)], None

    sums, _ = jax.lax.scan(add, [jnp.zeros_like(at * y[0])] * 8, jnp.arange(longest))
    return _constant_term(sums)


def _loess_of_any_span(
    t: Samples, y: Samples, at: Samples, span: Scalar, count: Count | int
) -> Samples:
    """`loess` of a traced span: its reach is interpolated between two numbers of samples."""
    counts = jnp.arange(t.shape[0])[None, :] < count
    away = t[None, :] - at[:, None]
    nearest = jnp.sort(jnp.where(counts, jnp.abs(away), jnp.inf), axis=1)
    farthest = span * count - 1
    below = jnp.clip(jnp.floor(farthest).astype(int), 0, count - 1)
    above = jnp.minimum(below + 1, count - 1)
    usable = (farthest >= 3) & (span <= 1)
    share = jnp.where(usable, farthest - below, jnp.nan)
    reach = nearest[:, below] + share * (nearest[:, above] - nearest[:, below])
    x = away / jnp.where(reach == 0, 1, reach)[:, None]
    moment = jnp.where(counts, (1 - jnp.minimum(jnp.abs(x), 1) ** 3) ** 3, 0)
    moments = [moment]
    for _ in range(4):
        moments.append(moments[-1] * x)
    return _constant_term([jnp.sum(m, axis=1) for m in moments] + [m @ y for m in moments[:3]])


def _constant_term(sums: list[Samples]) -> Samples:
    """Value of the local parabola, of five sums of its moments and three of those with y."""
    s0, s1, s2, s3, s4, r0, r1, r2 = sums
    # The normal equations, eliminated from the quadratic coefficient down to the constant.
    a, b = s3 / s4, s2 / s4
    c = (s1 - s2 * a) / (s2 - s3 * a)
    return (r0 - b * r2 - c * (r1 - a * r2)) / (s0 - s2 * b - c * (s1 - s2 * a))


def check_span(span: float) -> None:
    """A `ValueError` for what no record can be smoothed with."""
    if not 0 < span <= 1:
        raise ValueError(f"span must lie in (0, 1], got {span!r}.")


def window_of(samples: int, span: float) -> int:
    """Number of samples in a window of LOESS; a `ValueError` if the record is too short for it."""
    check_span(span)
    count = math.ceil(span * samples)
    if count < 4:
        raise ValueError(
            f"span={span} of {samples} samples is a window of {count}: LOESS needs at least 4."
        )
    return count


def sliding_average(y: Float[ArrayLike, " samples"], width: int) -> Samples:
    """Centred moving average over 2 (width // 2) + 1 samples.

    At the ends the window shrinks to the samples that exist, so that the average stays centred on
    nothing but data (Murray 2016, appendix A.1.12).
    """
    y = as_real(y)
    if not isinstance(width, int) or width < 1:
        raise ValueError(f"width must be a whole number of at least 1, got {width!r}.")
    if y.ndim != 1:
        raise ValueError(f"y must be one row of numbers, got shape {y.shape}.")
    samples = y.shape[0]
    half = min(width // 2, samples - 1)
    rows = np.arange(samples)
    count = np.minimum(rows, half) + np.minimum(samples - 1 - rows, half) + 1
    # Not jnp.convolve: batched beside other work on its input, XLA's convolution crashes on a CPU.
    zero = np.zeros((), y.dtype)  # concrete: only then is the window a differentiable sum
    total = jax.lax.reduce_window(y, zero, jax.lax.add, (2 * half + 1,), (1,), [(half, half)])
    return total / jnp.asarray(count, y.dtype)


def preprocess(
    t: Float[ArrayLike, " samples"],
    y: Float[ArrayLike, " samples"],
    smoother: str = "loess",
    equispaced: bool = True,
    span: float = 0.2,
    width: int = 11,
) -> tuple[Samples, Samples]:
    """Smoothed signal at equispaced times (Murray 2016, section 3, appendix A.1.1).

    **Arguments:**

    - `smoother`: "loess" (`span`, see `smooth`) or "average" (`width`, see `sliding_average`; the
        signal is first interpolated linearly onto the equispaced times).
    - `equispaced`: return times evenly spaced from `t[0]` to `t[-1]`, as many as before, with the
        signal evaluated *there* (the original returned the new times with the old values).

    **Returns:** times and smoothed signal. Both smoothers flatten a rise that is shorter than
    their window.
    """
    t, y = _pair(t, y)
    at = jnp.linspace(t[0], t[-1], t.shape[0], dtype=t.dtype) if equispaced else t
    if smoother == "loess":
        return at, loess(t, y, at, span)
    if smoother == "average":
        return at, sliding_average(jnp.interp(at, t, y), width)
    raise ValueError(f"smoother must be 'loess' or 'average', got {smoother!r}.")


def _pair(t, y) -> tuple[Array, Array]:
    t, y = as_real(t), as_real(y)
    if t.ndim != 1 or t.shape != y.shape:
        raise ValueError(f"t and y must be rows of equal length, got {t.shape} and {y.shape}.")
    dtype = jnp.result_type(t, y)
    return t.astype(dtype), y.astype(dtype)


def lagrange_weights(nodes: list[Array], x: Array) -> list[Array]:
    """Weights of the values at `nodes` in the polynomial through them, evaluated at `x`."""
    weights = []
    for i, a in enumerate(nodes):
        weight = jnp.ones_like(x + a)
        for j, b in enumerate(nodes):
            if j != i:
                weight = weight * (x - b) / (a - b)
        weights.append(weight)
    return weights


def moving_mean(y: Samples, width: Count | int, count: Count | int) -> Samples:
    """`sliding_average` of the first `count` samples, whose width may be traced; 0 beyond them."""
    place = jnp.arange(y.shape[0])
    half = jnp.minimum(width // 2, count - 1)
    first, last = jnp.maximum(place - half, 0), jnp.minimum(place + half, count - 1)
    # of deviations from the first sample, whose sums stay small
    total = jnp.append(jnp.zeros_like(y[:1]), jnp.cumsum(jnp.where(place < count, y - y[0], 0)))
    mean = y[0] + (total[last + 1] - total[first]) / (last + 1 - first)
    return jnp.where(place < count, mean, 0)


def noise_level(t: Float[ArrayLike, " samples"], y: Float[ArrayLike, " samples"]) -> Scalar:
    r"""Standard deviation of the noise, from what neighbours do not predict.

    Each sample is predicted by the cubic through its two neighbours on either side; the residual,
    divided by $\sqrt{1 + \sum w_i^2}$, has the variance of white noise (the pseudo-residuals of
    Gasser, Sroka, Jennen-Steinmetz 1986, at order 3; uneven times are fine). Of a smooth
    noise-free record about $h^4 |y''''|/6$ remains. Coloured noise is underestimated.
    """
    t, y = _pair(t, y)
    return noise_of(t, y, t.shape[0])


def noise_of(t: Samples, y: Samples, count: Count | int) -> Scalar:
    """`noise_level` of the first `count` samples."""
    nodes = [t[:-4], t[1:-3], t[3:-1], t[4:]]
    values = [y[:-4], y[1:-3], y[3:-1], y[4:]]
    weights = lagrange_weights(nodes, t[2:-2])
    predicted = sum(w * v for w, v in zip(weights, values, strict=True))
    scale = jnp.sqrt(1 + sum(w * w for w in weights))
    square = ((y[2:-2] - predicted) / scale) ** 2
    if not isinstance(count, int):
        square = jnp.where(jnp.arange(square.shape[0]) < count - 4, square, 0)
    return jnp.sqrt(jnp.sum(square) / (count - 4))


def quantisation(y: Samples, count: Count | int | None = None) -> Scalar:
    """Smallest step between distinct values of a quantised signal; 0 for any other.

    A signal counts as quantised when fewer than a third of its samples are distinct values. Samples
    from `count` on repeat another one.
    """
    ordered = jnp.sort(y)
    gaps = jnp.diff(ordered)
    span = ordered[-1] - ordered[0]
    distinct = gaps > 1e-6 * span
    smallest = jnp.min(jnp.where(distinct, gaps, jnp.inf))
    few = 3 * (jnp.sum(distinct) + 1) < (y.shape[0] if count is None else count)
    return jnp.where(few & jnp.isfinite(smallest), smallest, 0)


def estimate_levels(
    t: Samples, y: Samples, step_time: Scalar, count: Count | int | None = None
) -> tuple[Scalar, Scalar]:
    """Levels before the step and at the end of the record, of its first `count` samples.

    Initial: the mean of all samples up to and including the step (the output is continuous
    there). Final: the mean of the last 5 % of the samples; of a noise-free record, whose noise
    estimate is below 1e-4 of its range, the last sample alone, which is nearer to the limit.
    Samples from `count` on come after the step and repeat the last one.
    """
    samples = y.shape[0]
    count = samples if count is None else count
    before = t <= step_time
    initial = jnp.sum(jnp.where(before, y, 0)) / jnp.maximum(jnp.sum(before), 1)
    initial = jnp.where(jnp.any(before), initial, y[0])
    clean = noise_of(t, y, count) < 1e-4 * (jnp.max(y) - jnp.min(y))
    table = np.maximum(1, np.ceil(0.05 * np.arange(samples + 1))).astype(int)
    if isinstance(count, int):
        mean = jnp.mean(y[count - int(table[count]) : count])
    else:
        place, tail = jnp.arange(samples), jnp.asarray(table)[count]
        end = (place >= count - tail) & (place < count)
        mean = jnp.sum(jnp.where(end, y, 0)) / tail
    return initial, jnp.where(clean, y[-1], mean)
