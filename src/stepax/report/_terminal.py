"""How a report looks in a terminal: tables and colours; host code."""

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from .._compare import Comparison
from .._result import Identification
from . import _content


def report(result: Identification, method: str, step: int | None = None) -> Group:
    """What an identification says; `step` is the number that was asked for, None for the first."""
    said = _content.content(result, method, step)
    lines = [Text(line) for line in said.heading]
    if said.ranking:
        lines.append(Text("AICc: " + ", ".join(f"{name} {aicc}" for name, aicc in said.ranking)))
    quality = Text(", ".join(f"{name} {value}" for name, value in said.quality))
    verdict = [Text(said.verdict, style="green")] if said.verdict else []
    notes = [Text(f"Note: {note}", style="yellow") for note in said.notes]
    return Group(*lines, table(said.parameters), quality, *verdict, *notes)


def comparison_report(comparison: Comparison, group: str = "all") -> Group:
    """Ranking of the methods that gave a model of a group, and why others gave none."""
    said = _content.comparison_content(comparison, group)
    return Group(table(said.ranking), *(Text(note) for note in said.notes))


def table(content: _content.Table) -> Table:
    """Rows of text, numbers flush right; brackets in them are no styles of rich's."""
    laid = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(content.columns):
        laid.add_column(Text(column), justify="right" if i in content.numbers else "left")
    for row in content.rows:
        laid.add_row(*(Text(cell) for cell in row))
    return laid
