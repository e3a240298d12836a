"""Which rows before a step count, and whether the output still moves when it comes; host code."""

from typing import NamedTuple

import numpy as np


SEEN = 0.015
"""Share of the response from which on a difference of halves matters: it moves the offset."""
STANDS_OUT = 4.5
"""Standard errors above which a difference is no noise: in one of 10^5 tries."""
FEWEST = 8
"""Rows before a step of which two halves are compared; fewer tell no rest from unrest."""
MOVES = 0.03
"""Share of the response that an earlier move must still have before it to be worth a warning."""


STANDS_ALONE = 20
"""Fewest rows after a step from which a response can be told."""
STILL_MOVES = 0.15
"""Move from the third to the last quarter after a step, over all of it: of less it is at rest.

Of a first-order response it is 0.19 where the rows end after one time constant, 0.13 after two."""


class Rest(NamedTuple):
    """Rows before a step that come too early, and the slope of the output at the step.

    - `unrest`: how many rows, from the first on, were before the plant came to rest.
    - `drift`: slope of the output before the step where it matters, else 0.
    """

    unrest: int
    drift: float


def rest_before(t: np.ndarray, y: np.ndarray, step_time: float) -> Rest:
    """What is known of the plant's rest before a step.

    The rows count from where the mean of their first half is that of their second: a warm-up or
    the tail of an earlier move is a difference, noise and a swing around one level are none.
    """
    count = int(np.sum(t < step_time))
    low, high = np.quantile(y[count:], [0.01, 0.99])
    last = y[count - 1] if count else low  # the change may be over within one row
    extent = float(max(high, last) - min(low, last))
    drift = _drift(t[:count], y[:count], extent, float(t[-1] - step_time))
    before = y[:count]
    noise, begin = _noise(y), 0
    while (rows := before.size - begin) >= FEWEST:
        first, second = np.split(before[begin:], [rows // 2])
        # of two means of half the rows each
        error = 2 * max(noise, _line(second)[1]) / rows**0.5
        # Once unrest is seen, no more of it is kept than the noise hides.
        least = max(SEEN * extent / (20 if begin else 1), STANDS_OUT * error / (2 if begin else 1))
        if abs(first.mean() - second.mean()) <= least:
            break
        begin += max(1, rows // 10)
    return Rest(begin, drift)


def comes_to_rest(y: np.ndarray) -> bool:
    """Whether the rows after a step are enough, and the output comes to rest within them."""
    if y.size < STANDS_ALONE:
        return False
    quarters = [part.mean() for part in np.array_split(y, 4)]
    return bool(abs(quarters[3] - quarters[2]) <= STILL_MOVES * np.ptp(y))


def _drift(t: np.ndarray, y: np.ndarray, extent: float, duration: float) -> float:
    """Slope before a step, 0 where it is noise or small beside the response.

    An exponential tail with a quarter of the response's length as time constant would still go
    slope times that far.
    """
    count = max(10, t.size // 5)
    if t.size < FEWEST:
        return 0.0
    change, scatter = _line(y[-count:])
    slope = change / float(t[-1] - t[-count:][0])
    # The change along the line through n rows has sqrt(12/n) of the error of one.
    significant = abs(change) > STANDS_OUT * scatter * (12 / min(count, t.size)) ** 0.5
    return slope if significant and abs(slope) * duration / 4 > MOVES * extent else 0.0


def _line(y: np.ndarray) -> tuple[float, float]:
    """Change along the line through the rows, and the scatter around it that counts in means.

    Of scatter with a correlation r from row to row that is sqrt((1 + r)/(1 - r)) of its standard
    deviation (Bartlett 1946).
    """
    x = np.linspace(-0.5, 0.5, y.size)
    change = float(x @ y / (x @ x))
    rest = y - y.mean() - change * x
    square = float(rest @ rest)
    r = float(rest[1:] @ rest[:-1]) / square if square else 0.0
    r = min(
        max(0.0, r + (1 + 4 * r) / y.size), 0.95
    )  # a line takes correlation away, as a fit does
    return change, (square / max(y.size - 2, 1) * (1 + r) / (1 - r)) ** 0.5


def _noise(y: np.ndarray) -> float:
    """Noise of the rows, of the median second difference; of a quantised output half a step."""
    bend = np.abs(np.diff(y, 2))
    gaps = np.diff(np.unique(y[-100_000:]))
    quantum = float(gaps[gaps > 1e-6 * np.ptp(y)].min(initial=np.inf)) if gaps.size else 0.0
    coarse = 3 * (gaps.size + 1) < min(y.size, 100_000) and np.isfinite(quantum)
    # 0.6745 is the median of the size of a normal number, sqrt(6) the noise of a difference
    return max(float(np.median(bend)) / (0.6745 * 6**0.5), quantum / 2 if coarse else 0.0)
