"""What leaves the app: a report, JSON, code or a picture, as the bytes of a file."""

import json
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from .._compare import Comparison, Row
from ..models._notation import transfer_function
from ..report._content import to_json
from ..report._html import html
from ..report._origin import Origin
from ..report._pages import comparison_page
from ._state import State


KINDS = ("report", "JSON", "code", "picture")
"""What can be exported."""

LANGUAGES = ("text", "latex", "python-control", "scipy", "matlab")


class Export(NamedTuple):
    """A file: its name, its kind for a browser, its content."""

    name: str
    kind: str
    content: bytes


def exported(state: State, kind: str, shown: tuple[str, ...] = (), chart: str = "bar") -> Export:
    """One of `KINDS`; `shown`: methods whose rows are shown, all if none is; `chart` of J."""
    comparison = state.comparison
    if comparison is None or not comparison.models():
        raise ValueError("There is no model to export: load a record and compare methods.")
    stem = Path(comparison.record.labels.source or "record").stem
    rows = [row for row in comparison.models() if row.method in shown or not shown]
    if kind == "report":
        page = html(comparison_page(comparison, origin=Origin("stepax app", _by_hand(state))))
        return Export(f"{stem}.html", "text/html", page.encode())
    if kind == "JSON":
        data = [to_json(row.result, row.method) for row in rows]
        text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
        return Export(f"{stem}.json", "application/json", text.encode())
    if kind == "code":
        return Export(f"{stem}_models.txt", "text/plain", _code(rows).encode())
    kept = Comparison(comparison.record, tuple(rows))
    buffer = BytesIO()
    (kept.plot(kind="pie") if chart == "pie" else kept.plot()).savefig(buffer, format="png")
    return Export(f"{stem}.png", "image/png", buffer.getvalue())


def _by_hand(state: State) -> str:
    """What a person set, in a sentence for the report; empty where nothing was."""
    given = {**state.levels, **state.marks}
    if not given:
        return ""
    return "Set by hand: " + ", ".join(f"{name} = {x:.6g}" for name, x in given.items()) + "."


def _code(rows: list[Row]) -> str:
    """All models in every language."""
    text = ""
    for row in rows:
        text += f"{row.method}, fit {row.fit_percent:.2f} %\n"
        for language in LANGUAGES:
            try:
                written = transfer_function(row.result.model, language)
            except ValueError as error:  # a real order
                written = str(error.args[0])
            text += f"  {language}: {written}\n"
        text += "\n"
    return text
