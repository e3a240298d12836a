"""What a page says, as plain data: parts of blocks, in the order of reading; host code.

How it looks is the business of `_html`. Pictures are functions that draw: a page draws what it
shows, in the sizes that it needs.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from ..models._abstract import AbstractPlant


class Formula(NamedTuple):
    """A transfer function, to be typeset."""

    model: AbstractPlant


class Lines(NamedTuple):
    """Sentences, each a line of its own."""

    lines: list[str]


class Facts(NamedTuple):
    """Names and values; `large` for the few that matter most."""

    facts: list[tuple[str, str]]
    large: bool = False


class Grid(NamedTuple):
    """Rows of text and formulae under the names of their columns; `numbers`: columns of numbers."""

    columns: tuple[str, ...]
    rows: list[tuple[str | Formula, ...]]
    numbers: tuple[int, ...] = ()


class Code(NamedTuple):
    """Code to paste, each under the name of its language."""

    snippets: list[tuple[str, str]]


class Advice(NamedTuple):
    """What to mind, and what to do about it, which may be empty."""

    notes: list[tuple[str, str]]


class Drawing(NamedTuple):
    """A picture: what it shows, how it is drawn in a size in inches, and how as a live one.

    `wide` and `narrow`: sizes for paper and a screen, and for a phone.
    """

    caption: str
    draw: Callable[[tuple[float, float]], Any]
    live: Callable[[], Any] | None
    wide: tuple[float, float]
    narrow: tuple[float, float]


Block = Formula | Lines | Facts | Grid | Code | Advice | Drawing


class Part(NamedTuple):
    """A part of a page under its heading."""

    heading: str
    blocks: list[Block]


class Page(NamedTuple):
    """A page: its title, what it is about in a line or more, and its parts."""

    title: str
    about: list[str]
    parts: list[Part]
