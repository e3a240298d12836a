"""From a picture of a plot to a record: what a picture shows, and what it is in values."""

from collections.abc import Sequence
from io import BufferedIOBase
from os import PathLike
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._labels import Labels
from .._record import MIN_SAMPLES, StepRecord
from .._table import opened
from ._box import Box, find_box
from ._calibration import Axis, axis_of, places
from ._finding import Finding
from ._inks import (
    Drawing,
    Ink,
    coloured_inks,
    coverage,
    drawing,
    grey_ink,
    lightness_coverage,
    match_ink,
)
from ._overlay import overlay_bytes
from ._picture import Picture, load
from ._stroke import Stroke, is_step, trace
from ._ticks import tick_marks


Pair = Any
"""Two numbers; what else is given is refused in a sentence."""
Number = Any

SHARP, BLURRED = 0.05, 0.2
"""Standard deviation in pixels of the middle of a level stroke, as measured on plots of known
curves: `test_the_stroke_is_as_certain_as_it_says`. JPEG and WebP blur it."""


def trace_image(
    path: str | PathLike | BufferedIOBase,
    *,
    x_range: Pair | None = None,
    y_range: Pair | None = None,
    x_ticks: Pair | None = None,
    y_ticks: Pair | None = None,
    points: Any = None,
    color: Any = None,
    box: Any = None,
    step_time: Number | None = 0.0,
    step_size: Number = 1.0,
    overlay: str | PathLike | None = None,
    time: str = "time",
    output: str = "output",
) -> StepRecord:
    r"""The record behind a picture of a plot: PNG, JPEG, WebP or GIF, with linear axes.

    In each column of pixels the middle of the curve's stroke is a row of the record,
    $\sum_i i a_i / \sum_i a_i$ over the rows i that it covers with shares $a_i$; steep parts are
    read row by row. The way through the columns is the cheapest one (dynamic programming, after
    Bellman 1957) that collects coverage and pays for jumps and bends. Columns where the stroke is
    hidden, or hides in a marker, are left out.

    **Arguments:**

    - `x_range`, `y_range`: values at the left and right, lower and upper edge of the axes' box.
    - `x_ticks`, `y_ticks`: values of the first and of the last (major) tick mark.
    - `points`: pixels that are known, `[((px, py), (x, y)), ...]`, two or more, for each axis that
        has neither range nor ticks. Pixels are counted from the upper left one, which is (0, 0).
    - `color`: of the curve, `"#rrggbb"` or a name; needed where several curves are drawn.
    - `box`: left, top, right and bottom edge of the axes in pixels, where they are not found.
    - `step_time`, `step_size`: of the input. None takes the time of a step that is drawn in
        another colour, else that at which the curve leaves the level of its beginning.
    - `overlay`: a PNG file to write: the picture, pale, with the axes, tick marks and curve as they
        were read. It is written before anything is calibrated.
    - `time`, `output`: names of the axes with units, such as "time (s)", for plots and reports.

    **Returns:** a `StepRecord` with `weights`, the inverse variances of the rows up to a factor,
    and in `.details`: `stroke`, the standard deviation of a level row, the place of the axes
    included, in output units; `stroke_time` that of a column in units of time; `scale_output` and
    `scale_time` the relative ones of the axes' scales, which the standard errors of fits include.
    Where the curve begins up to 2 % of the axis after the step, a row of almost no weight is
    added at the step.

    **Raises:** `OSError`, `TypeError` or `ValueError`, in one sentence; with no calibration given
    it says what was found.
    """
    found = read_picture(path, color, box)
    if overlay is not None:
        if Path(overlay).suffix.lower() != ".png":
            raise ValueError(f"overlay must end in .png, got {str(overlay)!r}.")
        Path(overlay).write_bytes(overlay_bytes(found))
    axes = calibrated(
        found, x_range=x_range, y_range=y_range, x_ticks=x_ticks, y_ticks=y_ticks, points=points
    )
    return record_of(found, axes, step_time, step_size, (time, output))


def read_picture(
    path: str | PathLike | BufferedIOBase,
    color: Any = None,
    box: Any = None,
) -> Finding:
    """What a picture shows, in pixels; `color` and `box` as in `trace_image`."""
    picture = load(opened(path))
    edges = find_box(picture.pixels) if box is None else _given_box(picture, box)
    if edges is None:
        raise ValueError(
            f"{picture.name}: no axes were found, neither a frame nor a grid; give"
            " box=(left, top, right, bottom) in pixels."
        )
    drawn = drawing(picture.pixels[edges.inside])
    found = Finding(picture, edges, tick_marks(picture.pixels, edges), coloured_inks(drawn))
    if color is not None:
        ink = match_ink(drawn, found.inks, color, picture.name)
        return _with_curve(found, drawn, ink)
    grey = None if found.inks else grey_ink(drawn)
    found = found._replace(inks=found.inks if grey is None else [grey])
    if not found.inks:
        raise ValueError(f"{picture.name}: there is no curve in the axes.")
    if len(found.inks) == 1:
        return _with_curve(found, drawn, found.inks[0])
    strokes = {ink: _stroke(found, drawn, ink) for ink in found.inks}
    steps = [ink for ink, stroke in strokes.items() if stroke is not None and is_step(stroke)]
    curves = [ink for ink, stroke in strokes.items() if stroke is not None and ink not in steps]
    if len(curves) != 1:
        return found
    return _with_curve(found, drawn, curves[0], steps)


def _given_box(picture: Picture, box: Any) -> Box:
    """The box that is given, in the picture."""
    try:
        left, top, right, bottom = (float(edge) for edge in box)
    except (TypeError, ValueError):
        raise TypeError(
            f"box must be four pixels: left, top, right, bottom; got {box!r}."
        ) from None
    inside = 0 <= left and right <= picture.width - 1 and 0 <= top and bottom <= picture.height - 1
    if not (inside and right - left >= 20 and bottom - top >= 20):
        raise ValueError(
            f"box must lie in the picture of {picture.width} x {picture.height} pixels, left before"
            f" right and top before bottom, got {box}."
        )
    return Box(left, top, right, bottom, 0.5)


def _with_curve(found: Finding, drawn: Drawing, ink: Ink, steps: Sequence[Ink] = ()) -> Finding:
    """The finding with its curve, and the column of a drawn step beside it."""
    stroke = _stroke(found, drawn, ink)
    if stroke is None:
        raise ValueError(f"{found.picture.name}: there is no curve in {ink.name} in the axes.")
    drawn_step = _stroke(found, drawn, steps[0]) if len(steps) == 1 else None
    column = None
    if drawn_step is not None:
        jump = int(np.argmax(np.abs(np.diff(drawn_step.row))))
        column = float(np.mean(drawn_step.column[jump : jump + 2]))
    return found._replace(ink=ink, stroke=stroke, step_column=column)


def _stroke(found: Finding, drawn: Drawing, ink: Ink) -> Stroke | None:
    """The stroke of an ink, in pixels of the whole picture."""
    covered = coverage(drawn, ink, [other for other in found.inks if other is not ink])
    lossy = found.picture.lossy
    fine = lightness_coverage(drawn, ink, covered) if lossy and not ink.grey else covered
    stroke = trace(covered, fine, BLURRED if lossy else SHARP)
    if stroke is None:
        return None
    rows, columns = found.box.inside
    stroke = stroke._replace(column=stroke.column + columns.start, row=stroke.row + rows.start)
    return _with_what_the_frame_hides(stroke, found.box)


def _with_what_the_frame_hides(stroke: Stroke, box: Box) -> Stroke:
    """A stroke that comes out of the lower or upper edge of the box ran along it before."""
    hidden = np.arange(int(np.ceil(box.left)), stroke.column[0])
    # what the frame cuts off of the first columns is left out, a column of a steep one
    reach = box.line + stroke.width / 2 + 1.5 + 1.5 * abs(stroke.row[1] - stroke.row[0])
    edges = [edge for edge in (box.bottom, box.top) if abs(stroke.row[0] - edge) < reach]
    if hidden.size < 3 or not edges:
        return stroke
    return stroke._replace(
        column=np.append(hidden, stroke.column),
        row=np.append(np.full(hidden.size, edges[0]), stroke.row),
        deviation=np.append(np.full(hidden.size, reach / 2), stroke.deviation),
    )


def calibrated(found: Finding, **given: Any) -> tuple[Axis, Axis]:
    """Both axes by what is given, or a sentence that says what was found and what to give."""
    if found.stroke is None:
        raise ValueError(f"{found.sentence} Give color, the one of the curve.")
    points, axes = given.pop("points", None), []
    for name, (edges, marks) in places(found.box, found.ticks, found.stroke.blurred).items():
        own = {kind: given.get(f"{name}_{kind}") for kind in ("range", "ticks")}
        axes.append(axis_of(name, edges, marks, own, points))
    if None in axes:
        missing = " and ".join(n for n, axis in zip("xy", axes, strict=True) if axis is None)
        raise ValueError(
            f"{found.sentence} For {missing} give the values at the edges of the axes (x_range,"
            " y_range), those of the first and the last tick mark (x_ticks, y_ticks), or points."
        )
    return axes[0], axes[1]


def record_of(
    found: Finding,
    axes: tuple[Axis, Axis],
    step_time: Number | None,
    step_size: Number,
    names: Sequence[str] = (),
) -> StepRecord:
    """The record of a finding; `names` of its axes, if they are known."""
    stroke, (x, y) = found.stroke, axes
    assert stroke is not None  # `calibrated` has asked
    t, values = x.value(stroke.column), y.value(stroke.row)
    weights = 1 / stroke.deviation**2
    weights = weights / np.median(weights)
    step_time = _time_of_step(found, t, values, x, step_time)
    edge = 0.02 * abs(x.unit) * (found.box.right - found.box.left)
    if t[0] - edge <= step_time < t[0]:
        # the frame hides the beginning, and a record begins at its step or before
        line = np.polyfit(t[:8] - t[0], values[:8], 1)
        t = np.append(step_time, t)
        values = np.append(np.polyval(line, step_time - t[1]), values)
        weights = np.append(1e-3 * weights.min(), weights)
    if not t[0] <= step_time or np.sum(t >= step_time) < MIN_SAMPLES:
        raise ValueError(
            f"{found.picture.name}: the curve goes from t = {t[0]:g} to {t[-1]:g}, which leaves out"
            f" the step at t = {step_time:g}: give step_time."
        )
    error = BLURRED if found.picture.lossy else SHARP
    details = {
        "stroke": float(np.hypot(error * y.unit, y.deviation)),
        "stroke_time": x.deviation,
        "scale_output": y.relative,
        "scale_time": x.relative,
    }
    return StepRecord(
        t,
        values,
        step_time,
        step_size,
        labels=Labels(found.picture.name, *names),
        details={name: jnp.asarray(value) for name, value in details.items()},
        weights=weights,
    )


def _time_of_step(found: Finding, t: np.ndarray, y: np.ndarray, x: Axis, given: Any) -> float:
    """The time that is given, that of a drawn step, or when the curve leaves its level."""
    if given is None and found.step_column is not None:
        return float(x.value(found.step_column))
    if given is None:
        return _leaving(found, t, y)
    try:
        time = float(given)
    except (TypeError, ValueError):
        time = float("nan")
    if not np.isfinite(time):
        raise ValueError(f"step_time must be a number, or None for the one found, got {given!r}.")
    return time


def _leaving(found: Finding, t: np.ndarray, y: np.ndarray) -> float:
    """When a curve leaves the level of its beginning.

    From where it is well away, at 5 deviations of the beginning or 1 % of its range, to the level
    along the straight line through there and three times as far.
    """
    first = max(8, t.size // 25)
    level = float(np.median(y[:first]))
    line = np.polyfit(t[:first], y[:first], 1)
    noise = 1.4826 * float(np.median(np.abs(y[:first] - np.polyval(line, t[:first]))))
    drift = abs(float(line[0])) * (t[first - 1] - t[0])
    limit = max(5 * noise, 0.01 * float(np.ptp(y)))
    away = np.abs(y - level) if drift < limit else np.zeros(t.size)
    for row in np.flatnonzero(away > limit):
        if row >= first and np.all(away[row : row + 5] > limit):
            later = row + int(np.argmax(away[row:] > 3 * limit))
            if away[later] <= away[row]:
                break
            slope = (away[later] - away[row]) / (t[later] - t[row])
            return float(t[row] - away[row] / slope)
    raise ValueError(
        f"{found.picture.name}: the curve does not stay level before it leaves its first value:"
        " give step_time."
    )
