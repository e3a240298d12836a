"""A page as one HTML file that needs nothing beside it; host code.

matplotlib's SVG is always inside: it shows without scripts and on paper. Where the extra
`stepax[app]` is installed, Bokeh's pictures take its place on a screen. Every text is escaped, and
the page's own policy forbids it to load anything.
"""

import json
from collections.abc import Callable
from html import escape
from typing import Any

from ..models._notation import transfer_function
from ..plots._live import has_bokeh
from ._page import Advice, Block, Code, Drawing, Facts, Formula, Grid, Lines, Page
from ._style import STYLE
from ._svg import inline_svg


POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:"
"""What the page may load: nothing. Scripts are added where there are any."""


def html(page: Page, live: bool | None = None) -> str:
    """The page. `live`: with Bokeh's pictures; None: where Bokeh is installed."""
    writer = _Writer(has_bokeh() if live is None else live)
    parts = "\n".join(
        f"<section><h2>{escape(part.heading)}</h2>\n{writer.blocks(part.blocks)}</section>"
        for part in page.parts
    )
    scripts = writer.scripts()
    policy = POLICY + ("; script-src 'unsafe-inline'" if scripts else "")
    about = "".join(f"<p>{escape(line)}</p>" for line in page.about)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="stepax">
<title>{escape(page.title)}</title>
<style>{STYLE}</style>
</head>
<body>
<header><h1>{escape(page.title)}</h1><div class="about">{about}</div></header>
<main>
{parts}
</main>
{scripts}</body>
</html>
"""


class _Writer:
    """Blocks as HTML; it counts the pictures and keeps the live ones for the end of the page."""

    def __init__(self, live: bool):
        self._live = live
        self._count = 0
        self._items: list[str] = []

    def blocks(self, blocks: list[Block]) -> str:
        """Blocks one after another; small pictures stand side by side."""
        written = ""
        small: list[str] = []
        for block in [*blocks, None]:
            if isinstance(block, Drawing) and block.wide == block.narrow:
                small.append(self._drawing(block))
                continue
            if small:
                written += f'<div class="plots">{"".join(small)}</div>\n'
                small = []
            if block is not None:
                written += self._block(block) + "\n"
        return written

    def _block(self, block: Block) -> str:
        kinds: dict[type, Callable[[Any], str]] = {
            Formula: _formula, Lines: _lines, Facts: _facts, Grid: _grid, Code: _code,
            Advice: _advice, Drawing: self._drawing,
        }  # fmt: skip
        return kinds[type(block)](block)

    def _drawing(self, block: Drawing) -> str:
        self._count += 1
        name, label = f"p{self._count}", escape(block.caption)
        wide = inline_svg(block.draw(block.wide), name, label)
        still = f'<div class="wide">{wide}</div>'
        if block.narrow == block.wide:
            still = f"<div>{wide}</div>"
        else:
            narrow = inline_svg(block.draw(block.narrow), f"{name}n", label)
            still += f'<div class="narrow">{narrow}</div>'
        if self._live and block.live is not None:
            self._items.append(_item(block.live(), f"live-{name}"))
            still = f'<div class="still">{still}</div><div class="live" id="live-{name}"></div>'
        return f"<figure>{still}<figcaption>{label}</figcaption></figure>"

    def scripts(self) -> str:
        """Bokeh itself, and what it draws; nothing where no picture is live."""
        if not self._items:
            return ""
        from bokeh.resources import Resources

        bundle = Resources(mode="inline", components=["bokeh"]).render_js()
        items = ",\n".join(self._items)
        return (
            f"{bundle}\n<script>\ndocument.documentElement.classList.add('drawn');\n"
            f"for (const item of [{items}]) Bokeh.embed.embed_item(item);\n</script>\n"
        )


def _item(model: Any, place: str) -> str:
    """A picture of Bokeh's for an element of the page, as a literal inside a script."""
    from bokeh.core.types import ID
    from bokeh.embed import json_item

    text = json.dumps(json_item(model, ID(place)), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _formula(block: Formula) -> str:
    return f'<div class="formula">{transfer_function(block.model, "mathml")}</div>'


def _lines(block: Lines) -> str:
    return "".join(f"<p>{escape(line)}</p>" for line in block.lines)


def _facts(block: Facts) -> str:
    rows = [(_text(name), _text(value)) for name, value in block.facts]
    if block.large:
        cells = "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in rows)
        return f'<dl class="facts large">{cells}</dl>'
    cells = "".join(f"<dt>{name}</dt><dd>{value}</dd>" for name, value in rows)
    return f'<dl class="facts">{cells}</dl>'


def _text(text: str) -> str:
    """Text with the square of a unit as it is written."""
    return escape(text).replace("^2", "²")


LONG = 40
"""Characters from which on a cell is a sentence, which needs some width to be read."""


def _grid(block: Grid) -> str:
    def cell(tag: str, place: int, value: str | Formula) -> str:
        if isinstance(value, Formula):
            return f"<{tag}>{transfer_function(value.model, 'mathml')}</{tag}>"
        kind = "number" if place in block.numbers else "long" if len(value) > LONG else ""
        said = _text(value) if tag == "th" else escape(value)
        return f'<{tag} class="{kind}">{said}</{tag}>'.replace(' class=""', "")

    head = "".join(cell("th", i, name) for i, name in enumerate(block.columns))
    body = "".join(
        "<tr>" + "".join(cell("td", i, value) for i, value in enumerate(row)) + "</tr>\n"
        for row in block.rows
    )
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="scroll">{table}</div>'


def _code(block: Code) -> str:
    return "".join(
        f'<div class="code"><span>{escape(language)}</span><pre>{escape(text)}</pre></div>'
        for language, text in block.snippets
    )


def _advice(block: Advice) -> str:
    items = "".join(
        f"<li><b>{escape(sentence)}</b>{escape(do)}</li>" for sentence, do in block.notes
    )
    return f'<ul class="notes">{items}</ul>'
