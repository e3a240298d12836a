"""The box of the axes: where the frame, the ground or the grid of a plot ends."""

from itertools import product
from typing import NamedTuple

import numpy as np


EDGE = 12
"""Least difference of neighbours, of 255, at an edge: the pale ground of a plot on white has 20."""

SHORTEST = 0.3
"""Share of the picture that the shortest line of a box covers."""


class Box(NamedTuple):
    """Edges of the axes in pixels, whose centres are at whole numbers, from the upper left corner.

    `line`: half the thickness of the frame, 0 where there is none.
    """

    left: float
    top: float
    right: float
    bottom: float
    line: float = 0.0

    @property
    def inside(self) -> tuple[slice, slice]:
        """Rows and columns within the frame."""
        edge = self.line + 0.5  # half a pixel more: the frame may be blurred
        rows = slice(int(np.ceil(self.top + edge)), int(np.floor(self.bottom - edge)) + 1)
        return rows, slice(int(np.ceil(self.left + edge)), int(np.floor(self.right - edge)) + 1)


class _Lines(NamedTuple):
    """Straight edges in one direction: the row of each, where it starts and where it ends."""

    row: np.ndarray
    start: np.ndarray
    end: np.ndarray

    def kept(self, which: np.ndarray) -> "_Lines":
        return _Lines(*(part[which] for part in self))


def find_box(pixels: np.ndarray) -> Box | None:
    """The axes in a picture, or None.

    Long straight edges in both directions are gathered by their extent: those of a frame, of a
    coloured ground and of a grid all end at the box. The box is the pair of extents that most
    lines agree with.
    """
    height, width = pixels.shape[:2]
    planes = [np.ascontiguousarray(pixels[:, :, i]) for i in range(3)]
    across, down = _lines(planes), _lines([np.ascontiguousarray(plane.T) for plane in planes])
    reach = 3 + 0.004 * max(height, width)
    found = []
    for x, y in product(_extents(across, reach), _extents(down, reach)):
        if x == (0, width - 1) and y == (0, height - 1):
            continue  # the rim of the picture
        rows = _rows(across, x, y, reach)
        columns = _rows(down, y, x, reach)
        sides = sum(_near(rows, edge, reach) for edge in y)
        sides += sum(_near(columns, edge, reach) for edge in x)
        # Two spines make a corner; a grid without a frame has no sides but many lines.
        corner = _near(rows, y[1], reach) and _near(columns, x[0], reach)
        if rows.size and columns.size and (corner or (rows.size > 4 and columns.size > 4)):
            area = (x[1] - x[0]) * (y[1] - y[0])
            found.append((sides, rows.size + columns.size, area, x, y))
    if not found:
        return _between_lines(pixels, across, reach)
    most, lines, largest = (max(box[i] for box in found) for i in range(3))
    # A label beside a line makes it longer, and a picture may have a rim of its own: of boxes that
    # are as well marked the smallest, unless it is a small part, as the frame of a legend.
    good = [box for box in found if box[0] == most and box[1] >= 0.5 * lines]
    good = [box for box in good if box[2] > 0.3 * largest] or found
    *_, x, y = min(good, key=lambda box: box[2])
    return _refined(pixels, x, y, reach)


def _between_lines(pixels: np.ndarray, across: _Lines, reach: float) -> Box | None:
    """The box between the first and the last of at least three horizontal lines of one extent.

    Spreadsheets draw no vertical ones.
    """
    for x in _extents(across, reach):
        rows = _rows(across, x, (0, pixels.shape[0]), reach)
        apart = rows[np.append(True, np.diff(np.sort(rows)) > reach)] if rows.size else rows
        if apart.size >= 3:
            box = _refined(pixels, x, (int(rows.min()), int(rows.max())), reach)
            return box._replace(left=x[0] - 0.5, right=x[1] + 0.5)
    return None


def _lines(planes: list[np.ndarray]) -> _Lines:
    """Edges of red, green or blue: rows whose neighbours differ; a blurred one spreads over two."""
    rises, falls = (np.zeros(planes[0].shape, bool) for _ in range(2))
    for plane in planes:  # of bytes, whose differences must not be negative
        above, below = plane[:-2], plane[2:]
        larger = np.maximum(above, below)
        rises[1:-1] |= larger - above > EDGE
        falls[1:-1] |= larger - below > EDGE
    # The edge of a line goes one way, noise goes both.
    found = [_joined(one & ~other) for one, other in ((rises, falls), (falls, rises))]
    return _Lines(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _joined(change: np.ndarray) -> _Lines:
    """Long runs of changes in a row, over short gaps."""
    width = change.shape[1]
    row, start, end = runs_of(change)
    if not row.size:
        return _Lines(row, start, end)
    # Dashes and crossing lines leave gaps, no longer than the dashes; what is left must be more
    # line than gap, unlike text. A tick label is as near to the frame, but its strokes are shorter.
    length = end - start + 1
    mark = 2 + 0.002 * width  # a tick mark or a line across
    gap = np.maximum(mark, 0.6 * np.minimum(length[1:], length[:-1]))
    gap = np.minimum(gap, mark + 0.012 * width)
    joins = np.append(False, (row[1:] == row[:-1]) & (start[1:] - end[:-1] <= gap + 1))
    first = np.flatnonzero(~joins)
    last = np.append(first[1:], row.size) - 1
    filled = np.add.reduceat(length, first)
    length = end[last] - start[first] + 1
    long = (length >= SHORTEST * width) & (filled > 0.6 * length)
    return _Lines(row[first][long], start[first][long], end[last][long])


def runs_of(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, first and last column of each run of true values."""
    padded = np.zeros((mask.shape[0], mask.shape[1] + 2), bool)
    padded[:, 1:-1] = mask
    turn = np.flatnonzero(padded[:, 1:] != padded[:, :-1])  # starts and ends alternate
    row, column = np.divmod(turn, mask.shape[1] + 1)
    return row[::2], column[::2], column[1::2] - 1


def _extents(lines: _Lines, reach: float) -> list[tuple[int, int]]:
    """Extents that lines share, from the most frequent on; at most 8, which no plot needs."""
    left = lines
    extents: list[tuple[int, int]] = []
    while left.row.size and len(extents) < 8:
        pairs, counts = np.unique(np.stack([left.start, left.end]), axis=1, return_counts=True)
        start, end = (int(x) for x in pairs[:, np.argmax(counts)])
        extents.append((start, end))
        left = left.kept((abs(left.start - start) > reach) | (abs(left.end - end) > reach))
    return extents


def _rows(lines: _Lines, extent: tuple[int, int], span: tuple[int, int], reach: float):
    """Rows of the lines of one extent within a span."""
    same = (abs(lines.start - extent[0]) <= reach) & (abs(lines.end - extent[1]) <= reach)
    rows = lines.row[same]
    return rows[(rows >= span[0] - reach) & (rows <= span[1] + reach)]


def _near(rows: np.ndarray, edge: int, reach: float) -> bool:
    return bool(np.any(abs(rows - edge) <= reach))


def _refined(pixels: np.ndarray, x: tuple[int, int], y: tuple[int, int], reach: float) -> Box:
    """The box to a fraction of a pixel: the middle of the frame's lines, or where a ground ends."""
    turned = pixels.swapaxes(0, 1)
    columns = [_edge(turned, place, y, reach) for place in x]
    rows = [_edge(pixels, place, x, reach) for place in y]
    line = max(thickness for _, thickness in columns + rows) / 2
    return Box(columns[0][0], rows[0][0], columns[1][0], rows[1][0], line)


def _edge(pixels: np.ndarray, row: int, span: tuple[int, int], reach: float) -> tuple[float, float]:
    """Place and thickness of the line, or of the change without one, beside a row."""
    far = int(np.ceil(reach)) + 2
    first, last = max(row - far, 0), min(row + far, pixels.shape[0] - 1)
    margin = (span[1] - span[0]) // 20
    band = pixels[first : last + 1, span[0] + margin : span[1] - margin].astype(float)
    profile = np.median(band, axis=1)
    before, after = profile[0], profile[-1]
    line = np.minimum(np.abs(profile - before).max(axis=1), np.abs(profile - after).max(axis=1))
    peak = int(np.argmax(line))
    strength = line[peak]
    across = np.abs(after - before).max()
    if strength > max(EDGE, 0.55 * across):
        near = line > 0.1 * strength
        start = peak - int(np.argmin(np.append(near[peak::-1], False)) - 1)
        end = peak + int(np.argmin(np.append(near[peak:], False)) - 1)
        weight = line[start : end + 1]
        centre = float(weight @ np.arange(start, end + 1) / weight.sum())
        return first + centre, float(weight.sum() / strength)
    if across > EDGE:  # where the ground changes: a pixel in between belongs to both
        share = np.abs(profile - before).max(axis=1) / across
        return first + float(np.sum(1 - np.clip(share, 0, 1))) - 0.5, 0.0
    return float(row) - 0.5, 0.0
