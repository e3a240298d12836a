"""Tick marks along the lower and the left edge of a box, outside or inside it."""

from typing import NamedTuple

import numpy as np

from ._box import Box


INK = 15
"""Least difference from the ground, of 255, of a mark: a white grid on a pale ground has 21."""

LONGEST = 0.05
"""Share of the box that the longest mark has; what is longer is a grid or a curve."""

UNEVEN = 1.5
"""Pixels by which a mark may lie off an even spacing; placed on whole pixels, they do by one."""


class Ticks(NamedTuple):
    """Places of the marks on each axis, in pixels, from the lowest value on.

    `sharp`: for each axis, whether they were drawn on the middles of pixels. `hidden`: thickness of
    a frame in the colour of the paper, which only shows in that the marks do not touch the ground.
    """

    x: np.ndarray
    y: np.ndarray
    sharp: tuple[bool, bool] = (False, False)
    hidden: int = 0


class _Marks(NamedTuple):
    """Marks along one edge: see `Ticks`."""

    place: np.ndarray
    sharp: bool
    hidden: int = 0


def tick_marks(pixels: np.ndarray, box: Box) -> Ticks:
    """The major tick marks of both axes; without any, the lines of a grid; else empty."""
    x = _along(pixels, box.left, box.right, box.bottom, box.top, box.line)
    turned = pixels.swapaxes(0, 1)[:, ::-1]  # the left edge below, values rising to the right
    last = turned.shape[1] - 1
    turned = turned[::-1]
    down = turned.shape[0] - 1
    y = _along(
        turned, last - box.bottom, last - box.top, down - box.left, down - box.right, box.line
    )
    return Ticks(x.place, last - y.place, (x.sharp, y.sharp), max(x.hidden, y.hidden))


def _along(
    pixels: np.ndarray, left: float, right: float, edge: float, top: float, line: float
) -> _Marks:
    """Columns of the marks along the lower edge of a box."""
    most = int(LONGEST * (edge - top)) + 3
    clear = line + 0.1
    below, above = int(np.ceil(edge + clear)), int(np.floor(edge - clear))
    first, last = max(int(left) - 2, 0), int(np.ceil(right)) + 3
    outside = pixels[below : below + 2 * most, first:last]
    for hidden in (0,) if line else (0, 1, 2):  # a frame in the colour of the paper lies between
        marks = first + _majors(*_marks(outside[hidden:], 2, most))
        marks = marks[(marks >= left - UNEVEN) & (marks <= right + UNEVEN)]
        if marks.size >= 2:
            return _Marks(*_evened(marks), hidden)
    first, last = int(np.ceil(left + clear)), int(np.floor(right - clear)) + 1
    inside = pixels[max(above - 2 * most + 1, 0) : above + 1, first:last][::-1]
    for least, longest in ((2, most), (len(inside), len(inside))):  # marks, or the lines of a grid
        marks = first + _majors(*_marks(inside, least, longest))
        if marks.size >= 2:
            return _Marks(*_evened(_with_corners(marks, left, right)))
    return _Marks(np.zeros(0), False)


def _marks(strip: np.ndarray, least: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Middles and lengths of what hangs from the first row of a strip, and is no longer."""
    none = np.zeros(0), np.zeros(0)
    if strip.shape[0] < 2:
        return none
    ground = np.median(strip.reshape(-1, 3), axis=0)
    ink = np.abs(strip - ground).max(axis=2)
    length = np.argmin(np.vstack([ink > INK, np.zeros(ink.shape[1], bool)]), axis=0)
    # A mark of one row may be the rim of the frame.
    marked = np.concatenate([[False], (length >= least) & (length <= most), [False]])
    start, end = np.flatnonzero(np.diff(marked.astype(int))).reshape(-1, 2).T
    if not start.size:
        return none
    found = []
    for a, b in zip(start, end, strict=True):
        reach = int(length[a:b].max())
        weight = ink[: max(reach - 1, 1), a:b].sum(axis=0)  # its end may be faint
        found.append((float(weight @ np.arange(a, b) / weight.sum()), reach, b - a))
    middle, reach, width = np.array(found).T
    narrow = width <= max(3, 2 * np.median(width))
    return middle[narrow], reach[narrow]


def _majors(middle: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """The longest marks that are evenly spaced, without the minor ones; else the longest two.

    Minor marks are little more than half as long; noise may have made a few too long.
    """
    for longest in np.unique(reach)[::-1]:
        chosen = middle[(reach >= 0.8 * longest) | (reach >= longest - 1)]
        even = _without_stray(chosen)
        if even is not None:
            return even
    for longest in np.unique(reach)[::-1]:
        chosen = middle[reach >= 0.8 * longest]
        if chosen.size >= 2:
            return chosen
    return middle


def _evened(marks: np.ndarray) -> tuple[np.ndarray, bool]:
    """Marks where they ought to be, and whether they were on the middles of pixels."""
    sharp = float(np.mean(np.abs(marks - np.rint(marks)) < 0.2)) > 0.7
    even = _evenly(marks) if marks.size > 2 else None
    return marks if even is None else even, sharp


def _evenly(marks: np.ndarray) -> np.ndarray | None:
    """Marks on the line through all of them, where they are evenly spaced up to whole pixels."""
    step = np.median(np.diff(marks))
    place = np.rint((marks - marks[0]) / step)
    slope, start = np.polyfit(place, marks, 1)
    even = start + slope * place
    return even if np.all(np.abs(even - marks) < UNEVEN) else None


def _without_stray(marks: np.ndarray) -> np.ndarray | None:
    """Evenly spaced marks; one of four or more may be something else, as where a curve begins."""
    if marks.size < 3:
        return None
    if _evenly(marks) is not None:
        return marks
    for stray in range(marks.size if marks.size > 3 else 0):
        rest = np.delete(marks, stray)
        if _evenly(rest) is not None:
            return rest
    return None


def _with_corners(marks: np.ndarray, left: float, right: float) -> np.ndarray:
    """Marks inside the box, and those that its corners hide.

    Those are where the next mark would be. If that holds of both corners, the axis was made to end
    at its marks, and whole pixels excuse some; of one it may be chance.
    """
    step = marks[1] - marks[0]
    off = np.abs([marks[0] - step - left, marks[-1] + step - right])
    near = off < (2 * UNEVEN if off.max() < 2 * UNEVEN else 0.75)
    return np.concatenate([[left][: int(near[0])], marks, [right][: int(near[1])]])
