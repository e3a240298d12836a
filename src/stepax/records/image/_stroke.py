"""The middle of a stroke in each column of a picture, and how certain it is."""

from typing import NamedTuple

import numpy as np

from ._path import candidates, cheapest, stroke_width


STEEP = 2.0
"""Rows a column from which a stroke is read row by row."""

BLOB, REST = 1.6, 0.7
"""Shares of the thickness that a stroke has by its slope: beyond them a marker, a crossing or the
end of a dash is read. Where a slope changes it is off by a third; `test_markers_are_left_out`."""

ROUGH = 0.5
"""Noise of a curve, in pixels, from which its thickness tells nothing: markers and dashes have 0.2,
a trace whose noise can be seen has 1."""

REACH = 3
"""Columns over which a slope is taken: a dash on a steep part is one or two wide."""

FEWEST = 20
"""Columns of the least curve."""


class Stroke(NamedTuple):
    """What was read: in pixels from the upper left corner of the box's inside.

    - `column`, `row`: the middle of the stroke; every column at most once.
    - `deviation`: standard deviation of `row`.
    - `width`: thickness across the stroke. `blurred`: its rim is neither covered nor free, as it
        is where a drawing is smoothed.
    """

    column: np.ndarray
    row: np.ndarray
    deviation: np.ndarray
    width: float
    blurred: bool


def is_step(stroke: Stroke) -> bool:
    """Whether a curve is a step of an input: it lies on two levels."""
    levels = np.quantile(stroke.row, [0.02, 0.98])
    near = np.abs(stroke.row[:, None] - levels) < 1 + stroke.width / 2
    on = near.mean(axis=0)
    apart = levels[1] - levels[0] > 4 * stroke.width
    return bool(apart and on.min() > 0.03 and near.any(axis=1).mean() > 0.97)


class _Column(NamedTuple):
    """A way through the columns: the run of the stroke in each."""

    column: np.ndarray
    top: np.ndarray
    bottom: np.ndarray
    total: np.ndarray
    row: np.ndarray

    def kept(self, which: np.ndarray) -> "_Column":
        return _Column(*(part[which] for part in self))


def trace(covered: np.ndarray, fine: np.ndarray, error: float) -> Stroke | None:
    """The curve that covers the pixels of a box; None where there is none.

    `covered` tells where the curve is, `fine` how much of each pixel it covers: two pictures of
    the same, of which the second may hold other things beside the curve. `error`: standard
    deviation of the middle of a level stroke, in pixels.
    """
    runs = candidates(covered)
    column, place = cheapest(runs, stroke_width(runs))
    share = np.ascontiguousarray(fine.T)
    top, bottom = (x[column, place].astype(int) for x in (runs.top, runs.bottom))
    total, row = _middles(share, column, top, bottom)
    way = _Column(column, top, bottom, total, row).kept(total > 0.5)
    if way.column.size < FEWEST:
        return None
    least, most = _slopes(way)
    thickness = way.total / np.sqrt(1 + least**2)
    # of level parts; markers are on less than a third of the columns, ends of dashes too
    width = float(np.quantile(thickness[least <= np.median(least)], 0.3))
    expected = np.sqrt(1 + np.stack([least, most]) ** 2) * width
    rough = _roughness(way.column, way.row)
    sound = np.ones(way.column.size, bool)
    if rough < ROUGH:
        sound = (way.total > REST * expected[0]) & ~_beside_gaps(way.column, round(width / 2))
        blob = way.total > BLOB * expected[1] + 0.5
        reach = 3 + 2 * round(width / 2)  # the rim of a marker is thin
        sound &= np.convolve(blob, np.ones(reach), "same") < 0.5
    if np.count_nonzero(sound) < FEWEST:
        return None
    row = _rows_of_steep_parts(share, way, width)
    excess = np.maximum(way.total - expected[0], 0)
    # The place of a column is as uncertain as that of a row; a stroke that is thicker than it
    # should be may have its middle anywhere in what is too much.
    square = error**2 * (1 + (0.5 * (least + most)) ** 2) + excess**2 / 12
    deviation = np.sqrt(square + rough**2)
    marked = fine[fine > 0.1]
    blurred = bool(np.mean(marked < 0.9) > 0.1)
    return Stroke(way.column[sound], row[sound], deviation[sound], width, blurred)


def _roughness(column: np.ndarray, row: np.ndarray) -> float:
    """Noise of the curve itself: of it every column has the same, however well it can be read.

    From fourth differences, which a smooth curve has next to none of, over three columns, as noise
    that is drawn as a line is the same from column to column; the median, as bends have some.
    """
    rows = np.interp(np.arange(column[0], column[-1] + 1), column, row)
    rows = rows[: rows.size // 3 * 3].reshape(-1, 3).T
    return 1.4826 * float(np.median(np.abs(np.diff(rows, 4, axis=1)))) / 70**0.5


def _middles(
    share: np.ndarray, column: np.ndarray, top: np.ndarray, bottom: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coverage and its centre in the runs and the two rows beside, where blurred rims are."""
    height = share.shape[1]
    first, last = np.maximum(top - 2, 0), np.minimum(bottom + 2, height - 1)
    rows = np.arange(height)
    total, moment = np.empty(column.size), np.empty(column.size)
    for i, (c, a, b) in enumerate(zip(column.tolist(), first.tolist(), last.tolist(), strict=True)):
        part = share[c, a : b + 1]
        total[i] = part.sum()
        moment[i] = part @ rows[a : b + 1]
    return total, moment / np.maximum(total, 1e-9)


def _slopes(way: _Column) -> tuple[np.ndarray, np.ndarray]:
    """The smaller and the larger absolute slope on both sides of each column.

    The smaller one over `REACH` columns, so that it does not stay within a dash; the larger one
    also to the neighbour, so that it sees the peaks of noise.
    """
    far, near = _one_sided(way, REACH), _one_sided(way, 1)
    return far.min(axis=0), np.maximum(far, near).max(axis=0)


def _one_sided(way: _Column, reach: int) -> np.ndarray:
    """Absolute slopes to the columns so many places before and after; at the ends the other one."""
    slope = np.abs(way.row[reach:] - way.row[:-reach]) / (way.column[reach:] - way.column[:-reach])
    before = np.concatenate([slope[:reach], slope])
    return np.stack([before, np.concatenate([slope, slope[-reach:]])])


def _beside_gaps(column: np.ndarray, reach: int) -> np.ndarray:
    """Columns at the ends of what is between gaps: a dash is cut across, not along a column."""
    gap = np.flatnonzero(np.diff(column) > 1)
    near = np.zeros(column.size, bool)
    for end in gap.tolist():
        near |= (column > column[end] - reach) & (column <= column[end])
        near |= (column >= column[end + 1]) & (column < column[end + 1] + reach)
    return near


def _rows_of_steep_parts(share: np.ndarray, way: _Column, width: float) -> np.ndarray:
    """The rows of a way, in steep parts found the other way round: the middle of each row.

    There a column holds many rows, whose mean is not where the curve passes the column's middle.
    """
    row = way.row.copy()
    slope = np.diff(way.row) / np.diff(way.column)
    steep = np.concatenate([[False], np.abs(slope) > STEEP, [False]])
    start, end = np.flatnonzero(np.diff(steep.astype(int))).reshape(-1, 2).T
    for a, b in zip(start, end, strict=True):
        # Up and down within a few rows is noise, of which the mean of a column is the better value.
        if abs(way.row[b] - way.row[a]) < 6 * width or np.ptp(np.sign(slope[a:b])) > 0:
            continue
        beside = 1 + int(np.ceil(width))
        part = way.kept(np.arange(max(a - beside, 0), min(b + beside + 1, way.column.size)))
        # At the ends, where it bends, a row holds part of what comes before or after.
        low, high = sorted((float(way.row[a]), float(way.row[b])))
        first, last = round(low + 0.75 * width), round(high - 0.75 * width)
        places, rows = _middles_of_rows(share, part, width, first, last)
        inside = np.arange(a, b + 1)
        column = way.column[inside]
        after = np.clip(np.searchsorted(places, column), 1, places.size - 1)
        # between two rows that were read, and not across a gap
        near = (places[after - 1] <= column) & (column <= places[after])
        near &= places[after] - places[after - 1] < 1.5
        row[inside[near]] = np.interp(column[near], places, rows)
    return row


def _middles_of_rows(
    share: np.ndarray, way: _Column, width: float, first: int, last: int
) -> tuple[np.ndarray, np.ndarray]:
    """Columns, rising, where a steep part of a stroke passes rows from `first` to `last`."""
    part = share[way.column[0] : way.column[-1] + 1, first : last + 1]
    columns = np.arange(way.column[0], way.column[-1] + 1)
    own = np.zeros(part.shape, bool)
    for column, top, bottom in zip(way.column, way.top, way.bottom, strict=True):
        own[column - columns[0], max(top - first - 1, 0) : max(bottom - first + 2, 0)] = True
    part = np.where(own, part, 0)
    total = part.sum(axis=0)
    # A row of a steep stroke holds its thickness or an eighth more; at a turn or at the end of a
    # dash it holds something else.
    good = (total > REST * width) & (total < 1.3 * width + 0.5)
    good &= np.maximum(part[0], part[-1]) < 0.1
    rows = first + np.flatnonzero(good)
    places = (columns @ part)[good] / total[good]
    if rows.size < 2:
        return np.array([np.inf, 0]), np.zeros(2)
    if way.row[-1] < way.row[0]:
        rows, places = rows[::-1], places[::-1]
    return np.maximum.accumulate(places), rows
