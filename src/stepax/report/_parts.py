"""Parts of a page that one result fills: model, pictures, parameters, notes, code."""

import numpy as np

from .._notes import Identified, advice_of
from .._status import refused
from ..models._abstract import AbstractPlant
from ..models._notation import transfer_function
from ..plots._autocorrelation import plot_autocorrelation
from ..plots._comparison import Entry
from ..plots._live import live_autocorrelation, live_responses
from ..plots._model import plot_model, predicted
from ..records._abstract import AbstractRecord
from ..records._record import rows_that_count
from ..records._residuals import Autocorrelation, autocorrelation
from ..summary._content import content
from ._page import Advice, Block, Code, Drawing, Facts, Formula, Grid, Lines, Part


LANGUAGES = (
    ("python-control (the dead time as Pade's approximation of order 3)", "python-control"),
    ("SciPy (the dead time stands beside)", "scipy"),
    ("MATLAB, Control System Toolbox", "matlab"),
)


def result_parts(result: Identified, method: str | None, step: int | None) -> list[Part]:
    """The parts of one result; of a refusal the record and the reason."""
    said, model = content(result, method, step), result.model
    advice, record = advice_of(result, step), rows_that_count(result.record)
    if bool(refused(result.status)):
        return [
            Part("No model", [Advice(advice)]),
            Part("Record", [_response_drawing(record, None)]),
        ]
    mind: list[Block] = [Advice(advice)] if advice else [Lines([said.verdict])]
    found = _residual_autocorrelation(record, model)
    first: list[Block] = [Lines(said.heading[:1]), Formula(model), Facts(said.quality, large=True)]
    grid: list[Block] = [Grid(said.parameters.columns, [*said.parameters.rows], (1, 2, 3))]
    if said.ranking:
        ranked = ", ".join(f"{name} {aicc}" for name, aicc in said.ranking)
        grid.append(Lines([f"AICc of the families tried, the best first: {ranked}."]))
    return [
        Part("Model", first),
        Part("Record, model and residuals", [_response_drawing(record, result)]),
        Part("Parameters", grid),
        Part("What to mind", mind),
        Part("How the residuals hang together", [_autocorrelation_drawing(found)]),
        Part("To paste", [Code(_snippets(model))]),
    ]


def _response_drawing(record: AbstractRecord, result: Identified | None) -> Drawing:
    """Record, model where there is one, input and residuals."""
    model, entries = None, []
    if result is not None:
        model = result.model
        entries = [Entry("model", model, float(result.fit_percent), float(result.J))]

    def draw(size: tuple[float, float]):
        return plot_model(record, model, title="", size=size, with_input=True)

    what = "The record" if model is None else "Record and model"
    return Drawing(
        f"{what}, the change of the input" + (", and what the model leaves." if model else "."),
        draw,
        (lambda: live_responses(record, entries)) if entries else None,
        (9.0, 6.2),
        (4.6, 6.4),
    )


def _residual_autocorrelation(record: AbstractRecord, model: AbstractPlant) -> Autocorrelation:
    """Of the residuals from the step on."""
    residuals = np.asarray(record.y) - predicted(model, record, np.asarray(record.t))
    return autocorrelation(residuals[np.asarray(record.after_step)])


def _autocorrelation_drawing(found: Autocorrelation) -> Drawing:
    expected = 0.05 * found.lags.size
    said = (
        "Autocorrelation of the residuals from the step on. The band holds 95 % of the lags where"
        f" rows are independent; here {found.outside} of {found.lags.size} lie outside it"
    )
    good = found.outside <= expected + 2 * expected**0.5
    said += ", as chance would have it." if good else ": the model or the noise has a memory."
    return Drawing(
        said,
        lambda size: plot_autocorrelation(found, size=size),
        lambda: live_autocorrelation(found),
        (9.0, 2.6),
        (4.6, 2.6),
    )


def _snippets(model: AbstractPlant) -> list[tuple[str, str]]:
    """Code by its language; what a language cannot say it says in a comment."""
    snippets = []
    for name, style in LANGUAGES:
        try:
            snippets.append((name, transfer_function(model, style)))
        except ValueError as error:  # a real order
            snippets.append((name, f"not to be had: {error.args[0]}"))
    return snippets
