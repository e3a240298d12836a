"""What a picture of a plot shows."""

from typing import NamedTuple

from ._box import Box
from ._inks import Ink
from ._picture import Picture
from ._stroke import Stroke
from ._ticks import Ticks


class Finding(NamedTuple):
    """What a picture shows: the axes, their tick marks, colours of curves, and the curve's stroke.

    `ink` and `stroke` are None where the colour has to be chosen. Columns and rows of `stroke` are
    counted in the whole picture.
    """

    picture: Picture
    box: Box
    ticks: Ticks
    inks: list[Ink]
    ink: Ink | None = None
    stroke: Stroke | None = None
    step_column: float | None = None

    @property
    def sentence(self) -> str:
        """What was found, in one sentence."""
        box, names = self.box, ", ".join(ink.name for ink in self.inks)
        edges = f"x = {box.left:g} to {box.right:g} and y = {box.top:g} to {box.bottom:g}"
        curve = f"curves in {names}" if self.stroke is None else f"a curve in {names}"
        if self.stroke is not None and self.ink is not None:
            columns = f"{self.stroke.column.size} columns"
            curve = f"a curve in {self.ink.name}, {self.stroke.width:.1f} pixels thick, {columns}"
            others = [ink.name for ink in self.inks if ink is not self.ink]
            curve += f", beside {', '.join(others)}" if others else ""
        return (
            f"{self.picture.name}, {self.picture.width} x {self.picture.height} pixels, has axes"
            f" at pixels {edges}, {self.ticks.x.size} tick marks on x and {self.ticks.y.size} on y,"
            f" and {curve}."
        )
