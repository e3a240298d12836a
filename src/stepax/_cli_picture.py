"""A picture of a plot on the command line: its options, its record, and `trace`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer


if TYPE_CHECKING:
    from .records._record import StepRecord
    from .records.image._finding import Finding

PANEL = "Pictures of a plot"

Pair = tuple[float, float] | None
Edges = tuple[float, float, float, float] | None


def _option(kind: Any, text: str) -> Any:
    """An option of pictures: its type and its help."""
    return Annotated[kind, typer.Option(help=text, rich_help_panel=PANEL)]


OPTIONS: dict[str, Any] = {
    "x_range": _option(Pair, "Values at the left and right edge of the axes."),
    "y_range": _option(Pair, "Values at the lower and upper edge."),
    "x_ticks": _option(Pair, "Values of the first and last tick mark on x."),
    "y_ticks": _option(Pair, "Values of the first and last tick mark on y."),
    "point": _option(list[str] | None, "A known point, PX,PY=X,Y in pixels and values; repeat it."),
    "color": _option(str | None, "Colour of the curve, #rrggbb or a name."),
    "box": _option(Edges, "Left, top, right, bottom edge of the axes in pixels."),
    "step_time": _option(str | None, "Time of the step, or auto. Default: 0."),
    "step_size": _option(float | None, "Size of the step. Default: 1."),
}
"""Options of pictures by the name of their argument."""


def picture_record(path: Path, picture: dict[str, Any]) -> "StepRecord":
    """The record of a picture."""
    return _traced(path, picture)[1]


def _traced(path: Path, picture: dict[str, Any]) -> tuple["Finding", "StepRecord"]:
    """What a picture shows, and its record."""
    from .records.image._trace import calibrated, read_picture, record_of

    found = read_picture(path, picture["color"], picture["box"])
    points = [_point(text) for text in picture["point"] or []]
    kinds = ("x_range", "y_range", "x_ticks", "y_ticks")
    axes = calibrated(found, points=points or None, **{kind: picture[kind] for kind in kinds})
    size = picture["step_size"]
    return found, record_of(
        found, axes, _step_time(picture["step_time"]), 1.0 if size is None else size
    )


def _step_time(text: str | None) -> float | None:
    """A time, or None for the one that is found."""
    if text is None:
        return 0.0
    if text.strip().lower() == "auto":
        return None
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"--step-time must be a number or auto, got {text!r}.") from None


def _point(text: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """A known point, "px,py=x,y"."""
    try:
        pixel, value = (tuple(float(x) for x in part.split(",")) for part in text.split("="))
    except ValueError:
        raise ValueError(f"--point must be PX,PY=X,Y, got {text!r}.") from None
    return pixel, value


def trace(
    picture: dict[str, Any],
    file: Annotated[Path, typer.Argument(help="PNG, JPEG, WebP or GIF picture of a plot.")],
    csv: Annotated[Path | None, typer.Option(help="Write time and output as CSV.")] = None,
    overlay: Annotated[
        Path | None, typer.Option(help="Write the picture with what was read, as PNG.")
    ] = None,
) -> tuple[list[str], list[Path]]:
    """Read the curve in a picture of a plot; without ranges or ticks, say what was found."""
    from .records.image._overlay import overlay_bytes
    from .records.image._trace import read_picture
    from .report._content import picture_lines
    from .report._files import check_kind_of, check_table, write_files

    for path in (csv, overlay):
        check_table(path, [file])
    check_kind_of(overlay, ".png")
    kinds = ("x_range", "y_range", "x_ticks", "y_ticks", "point")
    if csv is None and all(picture[kind] is None for kind in kinds):
        found = read_picture(file, picture["color"], picture["box"])
        lines, record = [found.sentence], None
    else:
        found, record = _traced(file, picture)
        lines = [found.sentence, *picture_lines(record)]
    contents: dict[Path, bytes] = {}
    if csv is not None and record is not None:
        rows = "".join(f"{t:.8g},{y:.8g}\n" for t, y in zip(record.t, record.y, strict=True))
        contents[csv] = f"time,output\n{rows}".encode()
    if overlay is not None:
        contents[overlay] = overlay_bytes(found)
    return lines, write_files(contents)
