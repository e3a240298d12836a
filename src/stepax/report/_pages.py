"""Pages of one result, of a comparison, and of several files: what they say, as plain data."""

from collections.abc import Sequence

from .._notes import Identified
from ..models._notation import number
from ..plots._comparison import plot_ranking, plot_responses
from ..plots._live import live_bars, live_responses
from ..plots._model import plot_model
from ..records._abstract import AbstractRecord
from ..records._labels import Units
from ..summary._content import content, record_line
from ._content import comparison_content
from ._origin import Origin, provenance
from ._page import Block, Drawing, Formula, Grid, Page, Part
from ._parts import result_parts
from ._told import FileOutcome, Ranking


MOST_PICTURES = 60
"""Files of which a page has a picture each: of more it would be too large to be sent."""

SMALL = (4.6, 3.6)
"""Size in inches of pictures that stand side by side."""


def result_page(result: Identified, method: str | None = None, origin: Origin = Origin()) -> Page:  # noqa: B008 (immutable)
    """The page of one result; `method`: how the model was found, in other words than its name."""
    parts = result_parts(result, method, origin.step)
    return Page(
        _title(result.record),
        _about(result.record, origin),
        [*parts, provenance([result.record], origin)],
    )


def comparison_page(
    comparison: Ranking,
    group: str = "all",
    origin: Origin = Origin(),  # noqa: B008 (immutable)
) -> Page:
    """The page of a comparison: the ranking, its pictures, and the best model in full.

    A `ValueError` where no method of the group gives a model.
    """
    record, kept = comparison.record, comparison.models(group)
    if not kept:
        raise ValueError(f"{record.labels.source or 'Record'}: no method gives a model to report.")
    said, entries = comparison_content(comparison, group), comparison.entries(group)
    rows = [
        (*row[:-1], Formula(model.result.model))
        for row, model in zip(said.ranking.rows, kept, strict=True)
    ]
    height = 0.9 + 0.16 * len(entries)  # all methods go on a page of paper, beside the responses
    pictures: list[Block] = [
        Drawing(
            "Record, the best models with the marks that their methods read, and residuals.",
            lambda size: plot_responses(record, entries, size=size),
            lambda: live_responses(record, entries, with_input=False),
            (9.0, 6.0),
            (4.6, 6.4),
        ),
        Drawing(
            "J, the integral of the squared error, on a logarithmic axis: shorter is better.",
            lambda size: plot_ranking(record, entries, title="", size=size),
            lambda: live_bars(record, entries),
            (9.0, height),
            (4.6, height),
        ),
    ]
    parts = [Part("Responses and errors", pictures)]
    parts.append(Part("Ranking", [Grid(said.ranking.columns, rows, said.ranking.numbers)]))
    best = result_parts(kept[0].result, kept[0].method, origin.step)
    parts += [part._replace(heading=f"{kept[0].method}: {part.heading}") for part in best]
    if said.notes:
        told: list[tuple[str | Formula, ...]] = [tuple(x.split(": ", 1)) for x in said.notes]
        parts.append(Part("Methods to mind, or without a model", [Grid(("method", "why"), told)]))
    methods = "1 method gives a model" if len(kept) == 1 else f"{len(kept)} methods give a model"
    about = [*_about(record, origin), f"{methods}; the best is {kept[0].method}."]
    title = f"{_title(record)}: methods compared"
    return Page(title, about, [*parts, provenance([record], origin)])


def files_page(
    outcomes: Sequence[FileOutcome],
    origin: Origin = Origin(),  # noqa: B008 (immutable)
) -> Page:
    """The page of several files: a row for each, small pictures, and all parameters."""
    good = [file for file in outcomes if file.has_model and file.result is not None]
    drawn: list[Block] = [_small(file) for file in good[:MOST_PICTURES]]
    columns = ("file", "model", "fit, %", "RMSE", "G(s)", "notes")
    models = Grid(columns, [_file_row(file) for file in outcomes], numbers=(2, 3))
    parameters = [
        (file.source, *row) for file in good for row in content(file.result).parameters.rows
    ]
    names = ("file", "parameter", "value", "std. error", "95 % interval", "unit")
    parts = [Part("Models", [models])]
    if good:
        parts.append(Part("Records and models", drawn))
        parts.append(Part("Parameters", [Grid(names, parameters, numbers=(2, 3, 4))]))
    about = [f"{len(outcomes)} files, {len(good)} of them with a model."]
    if len(good) > MOST_PICTURES:
        about.append(f"The pictures are those of the first {MOST_PICTURES}.")
    parts.append(provenance([file.result.record for file in good], origin))
    return Page("Models of step responses", about, parts)


def _title(record: AbstractRecord) -> str:
    return record.labels.source or "Step response"


def _about(record: AbstractRecord, origin: Origin) -> list[str]:
    return [record_line(record), *([origin.remark] if origin.remark else [])]


def _small(file: FileOutcome) -> Drawing:
    """The record and the model of one of several files."""
    result = file.result

    def draw(size: tuple[float, float]):
        return plot_model(result.record, result.model, title="", size=size)

    said = f"{file.source}: {file.method}, fit {number(result.fit_percent)} %"
    return Drawing(said, draw, None, SMALL, SMALL)


def _file_row(file: FileOutcome) -> tuple[str | Formula, ...]:
    """One file: its model and how good it is, or why there is none."""
    if not file.has_model or file.result is None:
        return (file.source, "", "", "", "", file.reason)
    said, result = content(file.result), file.result
    unit = Units.of(result.record.labels).output
    rmse = f"{number(result.rmse)} {unit}".rstrip()
    figures = (type(result.model).__name__, number(result.fit_percent), rmse)
    return (file.source, *figures, Formula(result.model), " ".join(said.notes))
