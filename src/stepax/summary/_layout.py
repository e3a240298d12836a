"""How a summary looks: in a terminal by rich, in a notebook as HTML; host code.

rich is imported where something is laid out: `import stepax` does without it.
"""

from html import escape
from typing import TYPE_CHECKING

from .._notes import Identified, in_python
from . import _content


if TYPE_CHECKING:
    import rich.console
    import rich.table


def report(
    result: Identified, method: str | None = None, step: int | None = None
) -> "rich.console.Group":
    """What an identification says; `step` is the number that was asked for, None for the first."""
    return _laid_out(_content.content(result, method, step))


def _laid_out(said: _content.Content) -> "rich.console.Group":
    from rich.console import Group
    from rich.text import Text

    lines = [Text(line) for line in said.heading]
    if said.ranking:
        lines.append(Text(_ranking(said)))
    quality = Text(", ".join(f"{name} {value}" for name, value in said.quality))
    verdict = [Text(said.verdict, style="green")] if said.verdict else []
    notes = [Text(f"Note: {note}", style="yellow") for note in said.notes]
    return Group(*lines, table(said.parameters), quality, *verdict, *notes)


def table(content: _content.Table) -> "rich.table.Table":
    """Rows of text, numbers flush right; brackets in them are no styles of rich's."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    laid = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(content.columns):
        laid.add_column(Text(column), justify="right" if i in content.numbers else "left")
    for row in content.rows:
        laid.add_row(*(Text(cell) for cell in row))
    return laid


def as_text(result: Identified) -> str:
    """The record and the report as the command prints them, without colours, for Python."""
    from io import StringIO

    from rich.console import Console

    # As wide as a paper; a sentence breaks between words where it is longer.
    out = Console(file=StringIO(), width=100, no_color=True, force_terminal=False)
    out.print(_content.record_line(result.record), markup=False, highlight=False)
    out.print(_laid_out(_in_python(result)))
    lines = out.file.getvalue().splitlines()  # pyright: ignore[reportAttributeAccessIssue]
    return "\n".join(line.rstrip() for line in lines)


def as_html(result: Identified) -> str:
    """The same for a notebook: a heading, the table of parameters, quality and notes."""
    said = _in_python(result)
    columns = said.parameters.columns
    side = ["right" if i in said.parameters.numbers else "left" for i in range(len(columns))]

    def row(tag: str, cells: tuple[str, ...]) -> str:
        filled = zip(side, cells, strict=True)
        inner = "".join(f'<{tag} style="text-align:{s}">{escape(x)}</{tag}>' for s, x in filled)
        return f"<tr>{inner}</tr>"

    first, *others = [_content.record_line(result.record), *said.heading]
    quality = ", ".join(f"{name} {value}" for name, value in said.quality)
    below = [_ranking(said)] * bool(said.ranking) + [quality] + [said.verdict] * bool(said.verdict)
    parts = [f"<div>{escape(first)}</div>"]
    parts += [f"<div><b>{escape(line)}</b></div>" for line in others]
    parts += ["<table><thead>", row("th", columns), "</thead><tbody>"]
    parts += [row("td", cells) for cells in said.parameters.rows]
    parts += ["</tbody></table>"]
    parts += [f"<div>{escape(line)}</div>" for line in below]
    if said.notes:
        parts += ["<ul>", *(f"<li>{escape(note)}</li>" for note in said.notes), "</ul>"]
    return "\n".join(parts)


def _in_python(result: Identified) -> _content.Content:
    """What an identification says to those who called it, not the command."""
    said = _content.content(result)
    return said._replace(notes=[in_python(note) for note in said.notes])


def _ranking(said: _content.Content) -> str:
    """AICc of the families that were compared."""
    return "AICc: " + ", ".join(f"{name} {aicc}" for name, aicc in said.ranking)
