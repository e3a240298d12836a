"""A figure as SVG inside a page; host code."""

import re
from io import StringIO
from typing import Any


UNWANTED = dict.fromkeys(("Date", "Creator", "Format", "Type"))


def inline_svg(figure: Any, name: str, label: str) -> str:
    """The figure as an element of a page, as wide as its place; `name` keeps its ids apart.

    Text stays text, which a reader can copy and a screen reader say (`label` names the picture,
    and is escaped already). matplotlib escapes what it writes.
    """
    import matplotlib

    out = StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "stepax"}):
        figure.savefig(out, format="svg", metadata=UNWANTED)
    text = out.getvalue()
    head, body = text[text.index("<svg") :].split(">", 1)
    view = re.search(r'viewBox="[^"]*"', head)
    assert view is not None
    # ids stand in attributes alone: a quotation mark in a text is escaped
    body = re.sub(r'\bid="', f'id="{name}-', body)
    body = re.sub(r'(xlink:href="|url\()#', rf"\1#{name}-", body)
    body = body.replace("xlink:href", "href")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {view[0]} role="img" aria-label="{label}">{body}'
    )
