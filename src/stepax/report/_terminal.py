"""How a comparison looks in a terminal; host code."""

from rich.console import Group
from rich.text import Text

from ..summary._layout import report as report, table as table
from . import _content
from ._told import Ranking


def comparison_report(comparison: Ranking, group: str = "all") -> Group:
    """Ranking of the methods that gave a model of a group, and why others gave none."""
    said = _content.comparison_content(comparison, group)
    return Group(table(said.ranking), *(Text(note) for note in said.notes))
