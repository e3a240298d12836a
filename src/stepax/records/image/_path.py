"""The way of a curve through the columns of a picture: the cheapest one, by dynamic programming.

In each column the runs of covered pixels are candidates. A way collects what its candidates cover
and pays for jumps and bends; it may leave columns out, which neither collects nor pays. So it goes
straight on at a crossing, over a gap, and past words, legends and grids.
"""

from typing import NamedTuple

import numpy as np

from ._box import runs_of


MOST = 10
"""Candidates of a column that are looked at, the largest ones."""

COVERED = 0.2
"""Coverage from which a pixel belongs to a candidate; noise of JPEG stays below."""

LONGEST_JUMP = 0.08
"""Most that a jump costs, as a share of the columns: a detour must be longer to pay."""

MOST_BENT = 0.8
"""Most that a bend costs of what a column gives: noise bends everywhere and leaves none out."""

LONGEST_GAP = 0.3
"""Share of the columns that a way can leave out at once."""

SMOOTHING = 0.15
"""Weight of the newest column in a way's slope, which outlasts a crossing: with 0.3 a way turns at
one of flat lines, `test_a_way_goes_straight_through_a_crossing`."""


class Runs(NamedTuple):
    """Candidates by column: (columns, MOST) of first and last row, sum and centre of coverage.

    Where a column has fewer, the sum is 0.
    """

    top: np.ndarray
    bottom: np.ndarray
    total: np.ndarray
    centre: np.ndarray


def candidates(covered: np.ndarray) -> Runs:
    """The largest runs of covered pixels in each column."""
    share = np.ascontiguousarray(covered.T)
    columns = share.shape[0]
    column, top, bottom = runs_of(share > COVERED)
    total, moment = sums_between(share, column, top, bottom)
    # The largest first within each column; what is beyond `MOST` is dropped.
    order = np.lexsort((-total, column))
    column, top, bottom = column[order], top[order], bottom[order]
    total, centre = total[order], (moment / total)[order] if total.size else total
    place = np.arange(column.size) - np.searchsorted(column, column)
    kept = place < MOST
    where = column[kept], place[kept]
    shape = columns, MOST
    tables = [np.zeros(shape) for _ in Runs._fields]
    for table, values in zip(tables, (top, bottom, total, centre), strict=True):
        table[where] = values[kept]
    return Runs(*tables)


def sums_between(
    share: np.ndarray, column: np.ndarray, top: np.ndarray, bottom: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sum of coverage, and of coverage times row, from `top` to `bottom` of columns."""
    rows = np.arange(share.shape[1])
    sums = []
    for values in (share, share * rows):
        running = np.zeros((share.shape[0], share.shape[1] + 1))
        np.cumsum(values, axis=1, out=running[:, 1:])
        sums.append(running[column, bottom + 1] - running[column, top])
    return sums[0], sums[1]


def stroke_width(runs: Runs) -> float:
    """Usual coverage of a column: the thickness of a level stroke, or a little more.

    The lower quartile over the columns of the largest candidate: steep parts have more, and dashes
    a little less at their ends.
    """
    largest = runs.total[:, 0]
    seen = largest[largest > 0.5]
    return max(float(np.quantile(seen, 0.25)), 1.0) if seen.size else 1.0


class _Ways(NamedTuple):
    """Ways so far: where each was last seen, its slope and thickness, and what it has gained."""

    column: np.ndarray
    place: np.ndarray
    top: np.ndarray
    bottom: np.ndarray
    centre: np.ndarray
    slope: np.ndarray
    thickness: np.ndarray
    gain: np.ndarray

    def best(self, count: int, now: int, longest: float) -> "_Ways":
        recent = np.where(now - self.column <= longest, self.gain, -np.inf)
        kept = np.argsort(-recent, kind="stable")[:count]
        return _Ways(*(part[kept] for part in self))


def cheapest(runs: Runs, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns of the best way, and which candidate it takes in each."""
    columns = runs.total.shape[0]
    most = max(LONGEST_JUMP * columns, 8.0)
    before = np.full((columns, MOST, 2), -1)
    ways = _Ways(*(np.zeros(0, int) for _ in range(2)), *(np.zeros(0) for _ in range(6)))
    finished = (0.0, -1, -1)
    for column in range(columns):
        place = np.flatnonzero(runs.total[column] > 0.35 * width)
        if not place.size:
            continue
        new = _reached(ways, runs, column, place, width, most, before)
        best = int(np.argmax(new.gain))
        if new.gain[best] > finished[0]:
            finished = (float(new.gain[best]), column, int(place[best]))
        both = _Ways(*(np.concatenate(pair) for pair in zip(new, ways, strict=True)))
        ways = both.best(3 * MOST, column, LONGEST_GAP * columns)
    way = []
    column, place = finished[1:]
    while column >= 0:
        way.append((column, place))
        column, place = before[column, place]
    found = np.array(way[::-1], int).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _reached(
    ways: _Ways,
    runs: Runs,
    column: int,
    place: np.ndarray,
    width: float,
    most: float,
    before: np.ndarray,
) -> _Ways:
    """The best way to each candidate of a column."""
    top, bottom = runs.top[column, place], runs.bottom[column, place]
    centre = runs.centre[column, place]
    total = runs.total[column, place]
    gain = np.minimum(total / width, 1.0)
    slope, thickness = np.zeros(place.size), total.copy()
    if ways.gain.size:
        since = (column - ways.column)[:, None]
        ahead = ways.slope[:, None] * since
        # A steep stroke is a long run: what counts is the gap between runs, not between centres.
        # One row may be too pale to be seen.
        apart = np.maximum(top - ways.bottom[:, None], ways.top[:, None] - bottom) - 2
        moved = np.maximum(top - ways.bottom[:, None] - ahead, ways.top[:, None] + ahead - bottom)
        jump = np.maximum(np.minimum(apart, moved), 0) / max(width, 2.0)
        half = 0.5 * (bottom - top + ways.bottom[:, None] - ways.top[:, None]) + width
        bend = np.abs(centre - ways.centre[:, None] - ahead) / (half + 0.5 * (since - 1))
        cost = np.minimum(jump + MOST_BENT * gain * np.minimum(bend, 1.0), most)
        reached = ways.gain[:, None] - cost
        best = np.argmax(reached, axis=0)
        rows = np.arange(place.size)
        better = reached[best, rows] > 0
        gain = gain + np.where(better, reached[best, rows], 0)
        step = (centre - ways.centre[best]) / since[best, 0]
        # after the first column of a way there is no slope yet to smooth
        fresh = before[ways.column[best], ways.place[best], 0] < 0
        # where another line joins, the middle of both says nothing of the way's own slope
        joined = total > 1.3 * ways.thickness[best] + 0.5
        share = np.where(fresh, 1.0, np.where(joined, 0.0, SMOOTHING))
        slope = np.where(better, ways.slope[best] + share * (step - ways.slope[best]), 0)
        grown = ways.thickness[best] + SMOOTHING / 3 * (total - ways.thickness[best])
        thickness = np.where(better, grown, total)
        before[column, place[better], 0] = ways.column[best][better]
        before[column, place[better], 1] = ways.place[best][better]
    return _Ways(np.full(place.size, column), place, top, bottom, centre, slope, thickness, gain)
