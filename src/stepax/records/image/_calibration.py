"""From pixels to values: by the edges of the box, by tick marks, or by points that are known."""

from typing import Any, NamedTuple

import numpy as np

from ._box import Box
from ._ticks import Ticks


PLACED = 0.29
"""Standard deviation of a line's place in pixels: drawn on whole pixels it is off by up to half."""


class Axis(NamedTuple):
    """Value = start + unit times pixel. `relative`: standard deviation of `unit` over `unit`."""

    start: float
    unit: float
    relative: float

    def value(self, pixel: Any) -> Any:
        """Value at a pixel, or at many."""
        return self.start + self.unit * pixel

    @property
    def deviation(self) -> float:
        """Standard deviation of where a value lies, in units of the values."""
        return PLACED * abs(self.unit)


def axis_of(
    name: str,
    edges: tuple[float, float],
    marks: np.ndarray,
    given: dict[str, Any],
    points: Any,
) -> Axis | None:
    """Calibration of the axis `name`, x or y, or None if nothing is given for it.

    `edges`, `marks`: places of the lowest value first. `given`: `range`, `ticks`, or None of both.
    """
    pairs = {kind: pair for kind, pair in given.items() if pair is not None}
    if len(pairs) > 1:
        raise ValueError(f"Give {name}_range or {name}_ticks, not both.")
    if "range" in pairs:
        return _between(edges, _pair(f"{name}_range", pairs["range"]))
    if "ticks" in pairs:
        values = _pair(f"{name}_ticks", pairs["ticks"])
        if marks.size < 2:
            raise ValueError(
                f"{name}_ticks needs two tick marks on the axis {name}, {marks.size} were found:"
                f" give {name}_range, the values at the edges of the axes, or points."
            )
        return _between((float(marks[0]), float(marks[-1])), values)
    return None if points is None else _through(name, points)


def _pair(name: str, values: Any) -> tuple[float, float]:
    """Two rising numbers."""
    try:
        low, high = (float(value) for value in values)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be two numbers, got {values!r}.") from None
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise ValueError(
            f"{name} goes from a smaller to a larger number, left to right and bottom to top, got"
            f" ({low:g}, {high:g})."
        )
    return low, high


def _between(places: tuple[float, float], values: tuple[float, float]) -> Axis:
    length = places[1] - places[0]
    unit = (values[1] - values[0]) / length
    return Axis(values[0] - unit * places[0], unit, 2**0.5 * PLACED / abs(length))


def _through(name: str, points: Any) -> Axis:
    """The line through known points, by least squares if they are more than two."""
    try:
        table = np.array(points, float)
    except (TypeError, ValueError):
        table = np.zeros(0)
    if table.ndim != 3 or table.shape[1:] != (2, 2) or not np.all(np.isfinite(table)):
        raise TypeError("points must be pairs of pixel and value: [((px, py), (x, y)), ...].")
    pixel, value = table[:, :, 0 if name == "x" else 1].T
    spread = pixel - pixel.mean()
    length = float(np.sqrt(spread @ spread))
    if length == 0 or np.ptp(value) == 0:
        raise ValueError(f"points need two different places and values on the axis {name}.")
    unit = float(spread @ value) / length**2
    if unit == 0 or (unit > 0) != (name == "x"):
        way = "right" if name == "x" else "top"
        raise ValueError(f"points: values on the axis {name} must rise to the {way}.")
    return Axis(float(value.mean() - unit * pixel.mean()), unit, PLACED / length)


def places(box: Box, ticks: Ticks, blurred: bool) -> dict[str, tuple[Any, np.ndarray]]:
    """Edges and tick marks of both axes, the lowest value first.

    Agg, which draws matplotlib's pictures, moves a sharp line of one, three, ... pixels from x to
    floor(x + 1/2) + 1/2, half a pixel to the right and down on average; the curve, which is
    blurred at its rim, stays where it is. Where `blurred`, that is undone.
    """

    half = 0.5 * blurred

    def freed(edges: np.ndarray, outwards: np.ndarray) -> np.ndarray:
        if box.line == 0 and ticks.hidden:  # a frame was drawn over the rim of the ground
            return edges + outwards * ticks.hidden / 2 - half
        sharp = box.line > 0 and np.all(np.abs(edges - np.rint(edges)) < 0.2)
        return edges - half * bool(sharp)

    x_edges = freed(np.array([box.left, box.right]), np.array([-1, 1]))
    y_edges = freed(np.array([box.bottom, box.top]), np.array([1, -1]))
    x_marks, y_marks = (
        marks - half * sharp for marks, sharp in zip(ticks[:2], ticks.sharp, strict=True)
    )
    return {"x": (tuple(x_edges), x_marks), "y": (tuple(y_edges), y_marks)}
