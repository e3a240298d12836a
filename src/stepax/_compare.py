"""Several methods on one record, ranked; host code."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import numpy as np

from ._compilation import quick_compilation, side_by_side
from ._identify import aicc_of, filled_record, identify, parameter_count, refuse_tracers
from ._result import Identification, conclude
from ._status import Status, refused, status_name
from .methods import FITS, METHODS, ROWS, SCANS, as_by_hand, read_by_all
from .methods._method import Method
from .methods._reading import ByHand
from .models._abstract import AbstractPlant
from .models._deviation import squared_deviation
from .models._notation import transfer_function
from .records._abstract import AbstractRecord
from .records._input import InputRecord, refuse_other_input
from .records._record import StepRecord, predict
from .records._thin import thinned


if TYPE_CHECKING:
    import pandas as pd

    from .plots._comparison import Entry

GROUPS = ("all", "first", "second", "nth")
"""Groups of models that a comparison can be narrowed to."""
KINDS = ("response", "bar", "pie")
"""Pictures of a comparison."""


class Row(NamedTuple):
    """One method in a `Comparison`: its result, how good it is, and why not where it refused.

    `about` the method: its group, and what of the details a plot can mark.
    """

    method: str
    result: Identification
    model: str
    J: float
    rmse: float
    fit_percent: float
    parameters: int
    aicc: float
    status: str
    reason: str
    about: Method

    @property
    def has_model(self) -> bool:
        """Whether the method gave a model."""
        return not bool(refused(self.result.status))

    def is_of(self, group: str) -> bool:
        """Whether the method's models, also where it refused, are of a group."""
        return group in ("all", self.about.group)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Methods on one record, ranked by J, refusals last."""

    record: AbstractRecord
    rows: tuple[Row, ...]

    @property
    def best(self) -> Identification:
        """Result of the first row."""
        return self.rows[0].result

    def models(self, group: str = "all") -> tuple[Row, ...]:
        """Rows that have a model, of one group.

        "first": first order plus dead time; "second": two poles; "nth": any number of lags.
        """
        check_group(group)
        return tuple(row for row in self.rows if row.has_model and row.is_of(group))

    def to_frame(self) -> "pd.DataFrame":
        """One row per method, as a DataFrame of what can be printed."""
        import pandas as pd

        return pd.DataFrame(self.rows, columns=Row._fields).drop(columns=["result", "about"])

    def show_models(self, style: str = "text") -> str:
        """All transfer functions, one line per method, as "text" or "latex"."""
        width = max(len(row.method) for row in self.rows)
        return "\n".join(
            f"{row.method:{width}}  "
            + (transfer_function(row.result.model, style) if row.has_model else row.reason)
            for row in self.rows
        )

    def entries(self, group: str = "all") -> list["Entry"]:
        """The models of a group as pictures take them, the best first."""
        from .plots._comparison import Entry

        return [
            Entry(r.method, r.result.model, r.fit_percent, r.J, level_marks(r), tangent_ends(r))
            for r in self.models(group)
        ]

    def report(self, path: str | PathLike, group: str = "all") -> None:
        """Write a page to hand over: one HTML file with the ranking and the best model in full.

        As `Identification.report`, for the models of a group.
        """
        from .report._files import write_page
        from .report._html import html
        from .report._pages import comparison_page

        write_page(html(comparison_page(self, group)), Path(path))

    def plot(self, group: str = "all", kind: str = "response", **options: Any):
        """Models of a group as a matplotlib figure.

        `kind`: "response": record, models, the marks that each method reads, residuals and J;
        "bar": J of every method on a logarithmic axis; "pie": the share of each in the sum of J.
        **Options:** `title`, instead of the name of the file; `size` in inches; `count`, how many
        models a response shows, at most 7.
        """
        from .plots._comparison import MOST_DRAWN, plot_comparison, plot_ranking

        check_kind(kind)
        rows = self.models(group)
        if not rows:
            what = "model" if group == "all" else f"model of {_GROUP_NAMES[group]}"
            raise ValueError(f"The comparison has no {what} to draw.")
        entries = self.entries(group)
        if kind == "response":
            count = min(options.get("count", MOST_DRAWN), len(rows))
            title = _title(self.record, group, f"best {count} of {len(rows)} models")
            return plot_comparison(self.record, entries, **{"title": title, **options})
        title = _title(self.record, group, f"{len(rows)} models ranked by J")
        return plot_ranking(self.record, entries, kind=kind, **{"title": title, **options})


def compare(
    record: StepRecord | InputRecord,
    methods: Sequence[str] | None = None,
    plant: AbstractPlant | None = None,
    *,
    all_rows: bool = False,
    marks: Mapping[str, float] | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Comparison:
    r"""Several methods on one record, ranked by J (integral of the squared error).

    **Arguments:** `methods`: names, by default all of `METHODS`, or of a record of another input
    than a step all fits. `plant`: the true plant, if known
    (a simulation); then J is the integral of the squared deviation from its response from the step
    to infinity, and RMSE and fit count the deviation from it at the times of the record.
    `all_rows`: as in `identify`.
    `marks`: times that a person read off the record, from the step, which point methods use instead
    of their own: by the names that results have them under in `.details`, such as
    `{"t33": 8.1, "Tu": 2.5}`. Levels read by hand belong into the record (`initial`, `final`).
    `progress`: called with how many parts of the work are done, and how many there are.

    **Returns:** `Comparison`; equal J are ranked by RMSE. Where a model and the plant settle at
    different levels J to infinity is infinite, and the reason says so. On the host only: traced,
    it raises a `TypeError`.
    """
    refuse_tracers(record, "compare")
    if isinstance(methods, str):
        raise TypeError(f"methods must be a sequence of names, such as methods=[{methods!r}].")
    step = isinstance(record, StepRecord)
    known = [name for name in METHODS if step or name in FITS]
    names = known if methods is None else list(methods)
    for name in names:
        if name not in METHODS:
            raise KeyError(f"Unknown method {name!r}; known are {', '.join(METHODS)}.")
        if name not in FITS:
            refuse_other_input(record, name)
    if not names:
        raise ValueError(f"compare needs at least one method; known are {', '.join(METHODS)}.")
    record = record if all_rows else thinned(record)
    by_hand = None if marks is None else as_by_hand(marks, record.t.dtype)
    results = _results(record, names, by_hand, progress)
    rows = [_row(name, results[name], plant) for name in names]
    rows.sort(key=lambda row: (np.isnan(row.J), row.J, row.rmse))
    return Comparison(record, tuple(rows))


def _results(
    record: StepRecord | InputRecord,
    names: Sequence[str],
    by_hand: ByHand | None,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Identification]:
    """Results by method: fits side by side, scans of the dead time and all others as one each."""
    chosen = [name for name in METHODS if name in names and name not in FITS]
    scans = tuple(name for name in chosen if name in SCANS)
    others = tuple(name for name in chosen if name not in SCANS)
    alone = [name for name in names if name not in chosen]

    def read(together: tuple[str, ...]) -> dict[str, Identification]:
        found = read_by_all(filled_record(record), together, by_hand)
        return {
            name: dataclasses.replace(
                x, record=record, details=x.details | record.details, method=name
            )
            for name, x in zip(together, found, strict=True)
        }

    def fit(name: str) -> dict[str, Identification]:
        return {name: identify(record, name, all_rows=True)}

    with quick_compilation():  # in this order both cores end at about one time
        readings = [partial(read, together) for together in (others, scans) if together]
        tasks = [*readings, *(partial(fit, name) for name in alone)]
        parts = side_by_side(tasks if progress is None else _told(tasks, progress))
    return {name: result for part in parts for name, result in part.items()}


def _told(
    tasks: Sequence[Callable[[], Any]], progress: Callable[[int, int], object]
) -> list[Callable[[], Any]]:
    """Tasks that tell when they are done."""
    done = count(1)

    def told(task: Callable[[], Any]) -> Any:
        result = task()
        progress(next(done), len(tasks))
        return result

    return [partial(told, task) for task in tasks]


def _row(name: str, result: Identification, plant: AbstractPlant | None) -> Row:
    about = ROWS[name]
    measured, J, reason = result, float(result.J), Status[result.status]
    if plant is not None and not bool(refused(result.status)):
        record = result.record
        clean = eqx.tree_at(lambda r: r.y, record, predict(plant, record, record.t))
        measured = conclude(clean, result.model, result.status)
        J = squared_deviation(result.model, plant, float(record.input_size))
        if np.isinf(J):
            reason += " It settles at another level than the plant."
    return Row(
        method=name,
        result=result,
        model=type(result.model).__name__,
        J=J,
        rmse=float(measured.rmse),
        fit_percent=float(measured.fit_percent),
        parameters=parameter_count(result, about.order_found),
        aicc=aicc_of(result, about.order_found),
        status=status_name(result.status),
        reason=reason,
        about=about,
    )


def check_group(group: str) -> None:
    """A `ValueError` for an unknown group of models."""
    if group not in GROUPS:
        raise ValueError(f"group must be one of {', '.join(GROUPS)}, got {group!r}.")


def check_kind(kind: str) -> None:
    """A `ValueError` for an unknown kind of picture."""
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}.")


# What a plot needs


_GROUP_NAMES = {"first": "first order", "second": "two poles", "nth": "nth order"}


def _title(record: AbstractRecord, group: str, what: str) -> str:
    """Record, what is shown of it, and the group where it is not all."""
    text = f"{record.labels.source or 'Record'}: {what}"
    return text if group == "all" else f"{text} ({_GROUP_NAMES[group]})"


def level_marks(row: Row) -> list[tuple[float, float]]:
    """Points of the response that a method reads: time and output."""
    return _on_record(row, row.about.marks(row.result.details))


def tangent_ends(row: Row) -> list[tuple[float, float]]:
    """Where a method's tangent meets the initial and the final level; empty if it has none."""
    return _on_record(row, row.about.tangent(row.result.details))


def _on_record(row: Row, points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Times from the step and shares of the change, on the record's axes."""
    model, record = row.result.model, row.result.record
    start, initial = float(record.start_time), float(model.offset)
    change = float(model.gain) * float(record.input_size)
    return [(start + time, initial + height * change) for time, height in points]
