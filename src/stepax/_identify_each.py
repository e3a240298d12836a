"""The front door for many records: a row for each, also for those that cannot be used."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ._compilation import coarse_rung
from ._identify import check_length, identify_filled
from ._notes import notes_of
from ._result import Identification
from ._status import Status, refused, status_name
from .records._abstract import AbstractRecord
from .records._preprocess import check_span
from .records._read import read_record


if TYPE_CHECKING:
    import pandas as pd

TOGETHER = 64
"""Records that are read before the first of them is identified: their lengths tell what to fill."""

ROWS_A_COMPILATION = 100_000
"""Rows of filling that take as long to fit as `identify` takes to compile: 5 s at 50 us a row."""

BAD_INPUT = (ValueError, TypeError, KeyError, OSError, ImportError)
"""What is raised for a record that cannot be used, always with a sentence."""


class Outcome(NamedTuple):
    """What became of one record: its source, the method kept, the result, or why there is none.

    `result` is None where the record could not be read, or is too short for the `span` asked for;
    `reason` is empty where there is a model.
    """

    source: str
    method: str
    result: Identification | None
    reason: str

    @property
    def has_model(self) -> bool:
        """Whether there is a model."""
        return not self.reason

    def row(self) -> dict[str, Any]:
        """One row of a table: numbers by name, what is not there left out."""
        row: dict[str, Any] = {"source": self.source, "method": self.method}
        if self.result is None:
            return row | {"status": "unreadable", "notes": self.reason}
        result = self.result
        row |= {"model": type(result.model).__name__, "status": status_name(result.status)}
        if not self.has_model:
            return row | {"notes": self.reason}
        for scalar in result.model.scalars:
            place = () if scalar.place is None else scalar.place
            std = np.asarray(result.std[scalar.name])
            row[scalar.label] = float(np.asarray(getattr(result.model, scalar.name))[place])
            row[f"{scalar.label}_std"] = float(std[place] if std.ndim else std)
        order = getattr(result.model, "n", None)
        if order is not None and "n" not in row:
            row["n"] = int(order)
        figures = {"fit_percent": result.fit_percent, "rmse": result.rmse, "J": result.J}
        row |= {name: float(x) for name, x in figures.items()}
        return row | {"notes": " ".join(notes_of(result))}


class Identifications(Sequence):
    """Results of many records, in their order; None for one that could not be read.

    `outcomes` has the reasons too, `to_frame()` a row for each record.
    """

    def __init__(self, outcomes: Iterable[Outcome]):
        self.outcomes = tuple(outcomes)

    def __len__(self) -> int:
        return len(self.outcomes)

    def __getitem__(self, place):
        if isinstance(place, slice):
            return Identifications(self.outcomes[place])
        return self.outcomes[place].result

    def to_frame(self) -> "pd.DataFrame":
        """One row a record: source, method, model, status, parameters and standard errors, notes.

        Parameters that a model does not have are NaN.
        """
        import pandas as pd

        return pd.DataFrame([outcome.row() for outcome in self.outcomes])


def identify_each(
    records: Iterable[AbstractRecord | str | PathLike],
    method: str = "auto",
    progress: bool = False,
    **options: Any,
) -> Identifications:
    """Models of many records, of any lengths: few compilations serve all.

    **Arguments:**

    - `records`: records or paths of files for `read_record`, a list or a generator.
    - `method`, `options`: as in `identify`, the same for all.
    - `progress`: show a progress bar on stderr.

    **Returns:** a list-like of `Identification`s with `.to_frame()`. A record that cannot be used
    is a row with its reason, never the end of the loop. A wrong method or option raises, as in
    `identify`.
    """
    known = list(records) if progress else records
    return Identifications(each_of(map(_source_and_reader, known), method, progress, options))


def _source_and_reader(
    record: AbstractRecord | str | PathLike,
) -> tuple[str, Callable[[], AbstractRecord]]:
    if isinstance(record, AbstractRecord):
        return record.labels.source, lambda: record
    if not isinstance(record, str | PathLike):
        raise TypeError(f"identify_each takes records and paths, got {type(record).__name__}.")
    return Path(record).name, partial(read_record, record)


def each_of(
    readers: Iterable[tuple[str, Callable[[], AbstractRecord]]],
    method: str,
    progress: bool,
    options: dict[str, Any] | None = None,
) -> Iterator[Outcome]:
    """What becomes of each record, told by its source and what reads it."""
    if not progress:
        return _outcomes(readers, method, options or {})
    from rich.console import Console
    from rich.progress import track

    readers = list(readers)
    outcomes = _outcomes(readers, method, options or {})
    return iter(track(outcomes, "Identifying", len(readers), console=Console(stderr=True)))


def _outcomes(readers: Iterable[Any], method: str, options: dict[str, Any]) -> Iterator[Outcome]:
    met: set[int] = set()
    if options.get("span") is not None:
        check_span(options["span"])  # wrong for all, while a record may be too short for it
    readers = iter(readers)
    while some := list(islice(readers, TOGETHER)):
        records = [(source, _read(read, options)) for source, read in some]
        sizes = [record.t.size for _, record in records if isinstance(record, AbstractRecord)]
        lengths = shared_lengths(sizes, met)
        met.update(lengths.values())
        for source, record in records:
            yield _outcome(source, record, method, options, lengths.__getitem__)


def shared_lengths(sizes: Iterable[int], met: Iterable[int]) -> dict[int, int]:
    """Size -> length that a record is filled up to, where programs for the lengths `met` exist.

    Compiling takes seconds, fitting milliseconds: one length serves all unless filling up to it
    costs more than another compilation.
    """
    count = Counter(coarse_rung(size) for size in sizes)
    lengths, known = {}, set(met)
    for own in sorted(count, reverse=True):
        length = min((x for x in known if x >= own), default=own)
        if count[own] * (length - own) > ROWS_A_COMPILATION:
            length = own
        known.add(length)
        lengths[own] = length
    return {size: lengths[coarse_rung(size)] for size in sizes}


def _read(read: Callable[[], AbstractRecord], options: dict[str, Any]) -> AbstractRecord | str:
    """One record, or why it cannot be used."""
    try:
        record = read()
        check_length(record, options)
    except BAD_INPUT as error:
        return str(error.args[0]) if error.args else str(error)
    return record


def _outcome(
    source: str, record: AbstractRecord | str, method: str, options, length: Callable[[int], int]
) -> Outcome:
    """What becomes of one record."""
    if isinstance(record, str):
        return Outcome(source, "", None, record)
    result = identify_filled(record, method, options, length)
    reason = Status[result.status] if bool(refused(result.status)) else ""
    return Outcome(source, result.method, result, reason)
