"""What was read, drawn over the picture, so that a person can see that it is right."""

from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from ._finding import Finding


if TYPE_CHECKING:
    from PIL.Image import Image

BOX, MARK, CURVE = (0, 150, 60), (210, 0, 210), (230, 0, 30)
"""Colours of the box, the tick marks and the curve."""

PALE = 0.35
"""How much of the picture's own contrast is left."""


def overlay(found: Finding) -> "Image":
    """The picture, pale, with the box, the tick marks and the rows that were read.

    Small pictures are enlarged; columns that were left out are gaps.
    """
    from PIL import Image, ImageDraw

    picture, box = found.picture, found.box
    zoom = max(1, round(1200 / picture.width))
    pale = np.rint(255 - PALE * (255 - picture.pixels.astype(float))).astype(np.uint8)
    image = Image.fromarray(pale).resize((zoom * picture.width, zoom * picture.height))
    draw = ImageDraw.Draw(image)

    def place(x: float, y: float) -> tuple[float, float]:
        return zoom * (x + 0.5), zoom * (y + 0.5)

    draw.rectangle([place(box.left, box.top), place(box.right, box.bottom)], outline=BOX, width=2)
    length = max(6.0, 0.015 * picture.width)
    for x in found.ticks.x:
        draw.line([place(x, box.bottom), place(x, box.bottom + length)], fill=MARK, width=2)
    for y in found.ticks.y:
        draw.line([place(box.left - length, y), place(box.left, y)], fill=MARK, width=2)
    if found.stroke is not None:
        width = max(2, zoom)
        read = np.stack([found.stroke.column, found.stroke.row], axis=1)
        for piece in np.split(read, np.flatnonzero(np.diff(read[:, 0]) > 1) + 1):
            dots = [place(*dot) for dot in piece.tolist()]
            draw.line(dots if len(dots) > 1 else dots + dots, fill=CURVE, width=width)
    return image


def overlay_bytes(found: Finding) -> bytes:
    """The overlay as a PNG file."""
    buffer = BytesIO()
    overlay(found).save(buffer, format="PNG")
    return buffer.getvalue()
