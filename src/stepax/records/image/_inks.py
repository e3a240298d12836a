"""The colours that a plot is drawn in, and how much of each pixel the curve's colour covers.

A pixel at the rim of a stroke is a mixture: ground + coverage (ink - ground). What is grey in it,
a grid behind or black text beside, is left aside for a coloured ink by looking at its chroma alone,
the part of red, green and blue across the axis of greys.
"""

from typing import Any, NamedTuple

import numpy as np


CHROMA = np.array([[1.0, -0.5, -0.5], [0.0, 3**0.5 / 2, -(3**0.5) / 2]]) * (2 / 3)
"""Red, green, blue -> two axes across that of the greys; pure red is (2/3, 0)."""

FAINT = 0.12
"""Chroma below which a pixel tells no hue: JPEG at quality 40 has 0.05 where there is none."""

BINS = 72
"""Hues that are told apart when inks are looked for: 5 degrees; matplotlib's are 10 apart."""

WIDEST = np.pi / 3
"""Hue that is no mixture with an ink any more, where no other ink is nearer."""

FARTHEST = 0.7
"""Hue, in radians, within which a colour is the one asked for: what is called blue has 0.6."""

SPAN = 0.4
"""Share of the box's width that a curve spans; an arrow or a word does not."""


class Ink(NamedTuple):
    """A colour of curves: red, green, blue from 0 to 1, and whether it is grey, white or black."""

    color: tuple[float, float, float]
    grey: bool

    @property
    def name(self) -> str:
        """The colour as #rrggbb."""
        return "#" + "".join(f"{round(255 * x):02x}" for x in self.color)


class Drawing(NamedTuple):
    """What is drawn within the box: red, green and blue less the ground's, from 0 to 1."""

    ground: np.ndarray
    marks: np.ndarray
    chroma: np.ndarray

    @property
    def darkness(self) -> np.ndarray:
        """Difference in lightness from the ground, towards its opposite."""
        grey = self.marks.mean(axis=2)
        return -grey if self.ground.mean() > 0.5 else grey


def drawing(pixels: np.ndarray) -> Drawing:
    """What is drawn on the ground, whose colour is the most frequent one."""
    coarse = (pixels >> 4).astype(np.int32)
    key = (coarse[:, :, 0] << 8) | (coarse[:, :, 1] << 4) | coarse[:, :, 2]
    most = np.bincount(key.ravel(), minlength=4096).argmax()
    ground = np.median(pixels[key == most], axis=0).astype(np.float32) / 255
    marks = pixels.astype(np.float32) / 255 - ground
    return Drawing(ground, marks, marks @ CHROMA.T.astype(np.float32))


def coloured_inks(drawn: Drawing) -> list[Ink]:
    """Inks with a hue that span the box, the strongest first."""
    size = np.hypot(drawn.chroma[:, :, 0], drawn.chroma[:, :, 1])
    seen = size > FAINT
    if not np.any(seen):
        return []
    hue = np.arctan2(drawn.chroma[:, :, 1], drawn.chroma[:, :, 0])[seen]
    weight, column = size[seen], np.nonzero(seen)[1]
    inks = []
    for low, high in _peaks(hue, weight):
        member = (hue - low) % (2 * np.pi) < (high - low) % (2 * np.pi)
        strong = member & (weight > 0.3 * weight[member].max())
        columns = np.unique(column[strong])
        if columns.size < 0.1 * size.shape[1] or np.ptp(columns) < SPAN * size.shape[1]:
            continue
        # The middle of a stroke has its full colour; of a thin one hardly any pixel has.
        core = member & (weight >= np.quantile(weight[strong], 0.9))
        color = np.clip(drawn.ground + np.median(drawn.marks[seen][core], axis=0), 0, 1)
        inks.append((float(weight[member].sum()), Ink(tuple(color.tolist()), False)))
    return [ink for _, ink in sorted(inks, reverse=True)]


def _peaks(hue: np.ndarray, weight: np.ndarray) -> list[tuple[float, float]]:
    """Ranges of hue around each peak of their histogram, up to the valleys beside it."""
    place = np.floor((hue + np.pi) / (2 * np.pi) * BINS).astype(int) % BINS
    counts = np.bincount(place, weight, BINS)
    smooth = (np.roll(counts, 1) + 2 * counts + np.roll(counts, -1)) / 4
    before, after = np.roll(smooth, 1), np.roll(smooth, -1)
    # Mixtures of two inks make small peaks between them.
    tops = np.flatnonzero((smooth > before) & (smooth >= after) & (smooth > 0.03 * smooth.max()))
    ranges = []
    for i, top in enumerate(tops):
        edges = []
        for other, way in ((tops[i - 1], -1), (tops[(i + 1) % tops.size], 1)):
            steps = int((way * (other - top)) % BINS) or BINS // 2
            steps = min(steps, BINS // 2)
            path = (top + way * np.arange(steps + 1)) % BINS
            lowest = int(np.argmin(smooth[path]))
            edges.append((top + way * lowest) / BINS * 2 * np.pi - np.pi)
        ranges.append((edges[0], edges[1] + 2 * np.pi / BINS))
    return ranges


def grey_ink(drawn: Drawing) -> Ink | None:
    """The darkest ink without a hue (on a dark ground the lightest) besides straight lines."""
    rows, columns = _straight_lines(drawn)
    level = np.where(rows[:, None] | columns[None, :], 0, drawn.darkness)
    size = np.hypot(drawn.chroma[:, :, 0], drawn.chroma[:, :, 1])
    level = np.where(size > FAINT, 0, level)
    strongest = level.max(axis=0)
    marked = strongest > FAINT
    if marked.sum() < 0.1 * marked.size or np.ptp(np.flatnonzero(marked)) < SPAN * marked.size:
        return None
    # Text is darker or as dark, in a few columns; a curve is in most.
    tone = float(np.median(strongest[marked]))
    sign = -1 if drawn.ground.mean() > 0.5 else 1
    color = np.clip(drawn.ground + sign * tone, 0, 1)
    return Ink(tuple(color.tolist()), True)


def match_ink(drawn: Drawing, inks: list[Ink], color: Any, name: str) -> Ink:
    """The ink of a colour that was asked for, or a `ValueError` with those there are."""
    from PIL import ImageColor

    if not isinstance(color, str):
        raise TypeError(f'color must be "#rrggbb" or a name, got {color!r}.')
    try:
        wanted = ImageColor.getrgb(color.strip().lower().removeprefix("tab:"))[:3]
    except ValueError:
        raise ValueError(f'color must be "#rrggbb" or a name, got {color!r}.') from None
    rgb = np.array(wanted) / 255
    chroma = CHROMA @ rgb
    if np.hypot(*chroma) < FAINT:
        grey = grey_ink(drawn)
        near = [] if grey is None else [grey]
    else:
        near = [ink for ink in inks if _hue_between(chroma, _chroma(ink, drawn)) < FARTHEST]
    if not near:
        known = ", ".join(ink.name for ink in inks) or "none"
        raise ValueError(f"{name} has no curve in {color}; colours of its curves: {known}.")
    return min(near, key=lambda ink: float(np.linalg.norm(np.array(ink.color) - rgb)))


def _hue_between(a: np.ndarray, b: np.ndarray) -> float:
    turn = np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)
    return abs(float(turn))


def coverage(drawn: Drawing, ink: Ink, others: list[Ink]) -> np.ndarray:
    """Share of each pixel that an ink covers, from 0 to 1, without the lines of a grid."""
    if not ink.grey:
        return _coloured_coverage(drawn, ink, others)
    size = np.hypot(drawn.chroma[:, :, 0], drawn.chroma[:, :, 1])
    share = _towards(drawn, ink) - size / FAINT
    # what is darker is another ink; the middle of a thin stroke is darker than its usual column
    share = np.where(share > 1.6, 0, np.clip(share, 0, 1))
    return _without_lines(drawn, share)


def lightness_coverage(drawn: Drawing, ink: Ink, covered: np.ndarray) -> np.ndarray:
    """The same near what an ink covers, for pictures whose hues are blurred: by the whole colour.

    JPEG and WebP keep the chroma of two by two pixels only.
    """
    from scipy import ndimage

    share = _without_lines(drawn, np.clip(_towards(drawn, ink), 0, 1))
    near = ndimage.maximum_filter(covered, (5, 3)) > 0.5 * covered.max()
    return np.where(near, share, 0)


def _towards(drawn: Drawing, ink: Ink) -> np.ndarray:
    """How far each pixel is on the way from the ground to an ink."""
    way = np.array(ink.color, np.float32) - drawn.ground
    return drawn.marks @ (way / (way @ way))


def _without_lines(drawn: Drawing, share: np.ndarray) -> np.ndarray:
    """Coverage less that of the straight lines of a grid."""
    behind = np.zeros_like(share)
    for lines, level, view in zip(
        _straight_lines(drawn), (share, share.T), (behind, behind.T), strict=True
    ):
        for i in np.flatnonzero(lines):
            marked = level[i][level[i] > FAINT / 2]
            view[i] = np.maximum(view[i], np.median(marked) if marked.size else 0)
    # A line as dark as the ink hides it; of a paler one the rest is told apart.
    clear = (share - behind) / np.maximum(1 - behind, 0.3)
    return np.where(behind < 0.7, np.clip(clear, 0, 1), 0)


def _coloured_coverage(drawn: Drawing, ink: Ink, others: list[Ink]) -> np.ndarray:
    """From the hue a pixel is split between the inks on both sides of it.

    q = a c + b d for the chroma c and d of two inks at angles u and v gives
    a = |q| sin(v - angle(q)) / (|c| sin(v - u)).
    """
    own = _chroma(ink, drawn)
    angle = np.arctan2(own[1], own[0])
    q = drawn.chroma @ np.array([[own[0], -own[1]], [own[1], own[0]]], np.float32)
    along, across = q[:, :, 0], q[:, :, 1]  # turned so that the ink's own hue is 0, times |c|
    square = float(own @ own)
    turns = [np.arctan2(*_chroma(other, drawn)[::-1]) - angle for other in others]
    turns = [(turn + np.pi) % (2 * np.pi) - np.pi for turn in turns]
    above = min([turn for turn in turns if turn > 0] + [WIDEST])
    below = min([-turn for turn in turns if turn < 0] + [WIDEST])
    share = along - np.where(across > 0, across / np.tan(above), -across / np.tan(below))
    return np.clip(share / square, 0, 1)


def _chroma(ink: Ink, drawn: Drawing) -> np.ndarray:
    return CHROMA @ (np.array(ink.color) - drawn.ground)


def _straight_lines(drawn: Drawing) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of lines through the whole box, as a grid has."""
    mark = np.abs(drawn.marks).max(axis=2) > FAINT / 2
    return _through(mark), _through(mark.T)


def _through(mark: np.ndarray) -> np.ndarray:
    """Which rows are marked in every tenth of their length, a third of them in all."""
    parts = [part.mean(axis=1) > 0.15 for part in np.array_split(mark, 10, axis=1)]
    return np.all(parts, axis=0) & (mark.mean(axis=1) > 0.3)
