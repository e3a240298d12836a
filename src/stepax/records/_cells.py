"""Values in the columns of a table: numbers and times, and rows that lack one; host code."""

import re
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ._labels import unit_of
from ._table import Table
from ._text import DATE, NUMBER


if TYPE_CHECKING:
    import pandas as pd

_DURATION = re.compile(r"(\d+ days? )?\d+:\d\d:\d\d(\.\d*)?")
_DAY = re.compile(r"\d{1,4}([-./])\d{1,2}\1\d{1,4}|[A-Za-z]{3}")
# What loggers write where there is no value: signs alone, or one of these words.
_MARK = re.compile(r"[^\w\s]+|(?i:n/?a|none|null|#n/a|error|bad)")
# Excel counts days from the end of 1899; a serial number of 2000 to 2050.
_SERIAL = re.compile(r"(?i:date|datum|fecha|timestamp)")
_SERIALS, _EPOCH = (36526.0, 55153.0), np.datetime64("1899-12-30")

MOST_MISSING = 0.1
"""Share of rows without a value above which a record is refused."""
DAY = 86400.0


class Times(NamedTuple):
    """Times of the rows: numbers as they stand, or from stamps the seconds since the first row.

    - `stamped`: whether they were dates or clock times.
    - `began`: the first row, in seconds since 1970; NaN where there are no dates.
    - `clock`: the first row in seconds since midnight.
    """

    values: np.ndarray
    stamped: bool = False
    began: float = np.nan
    clock: float = np.nan


def times_of(table: Table, column: int, dayfirst: bool = False) -> Times:
    """Times of a column; NaN where a cell is none."""
    import pandas as pd

    cells = table.columns[column]
    usual = cells.dropna()
    first = str(usual.iloc[0]).strip() if usual.size else ""
    if cells.dtype.kind == "m":
        return _of_clock(cells)
    if cells.dtype.kind == "M":
        return _of_dates(cells)
    if _is_numeric(cells) or NUMBER.fullmatch(first) or not DATE.match(first):
        values = _as_floats(cells)
        if _SERIAL.search(table.names[column]) and _are_serials(values):
            days = pd.Series(_EPOCH + (values * DAY * 1e3).round().astype("timedelta64[ms]"))
            return _of_dates(days)
        return Times(values)
    text = _as_text(cells)
    if _DURATION.fullmatch(first):
        return _of_clock(pd.to_timedelta(text, errors="coerce"))
    dates = _stamps(text, dayfirst)
    return _of_dates(dates) if _DAY.search(first) else _of_clock(dates - dates.dt.normalize())


def moment(value: Any, times: Times, name: str, dayfirst: bool = False) -> float:
    """A time that a user gave, on the axis of the record: a number, or a stamp if it has those."""
    import pandas as pd

    if not isinstance(value, str):
        return float(value)
    if NUMBER.fullmatch(value.strip()):
        return float(value.strip().replace(",", "."))
    stamp = pd.to_datetime(value, errors="coerce", dayfirst=dayfirst)
    if not times.stamped or pd.isna(stamp):
        kind = "a number, or a time such as those in the file" if times.stamped else "a number"
        raise ValueError(f"{name} must be {kind}, got {value!r}.")
    seconds = stamp.timestamp()
    if _DAY.search(value) and np.isfinite(times.began):
        return seconds - times.began
    later = seconds % DAY - times.clock
    return later + DAY if later < -DAY / 2 else later  # after midnight


def _of_dates(dates: "pd.Series") -> Times:
    """Seconds since the first row."""
    if dates.dt.tz is not None:
        dates = dates.dt.tz_convert("UTC").dt.tz_localize(None)
    first = _first(dates)
    if first is None:
        return Times(np.full(dates.size, np.nan), stamped=True)
    began = first.timestamp()
    values = (dates - first).dt.total_seconds().to_numpy(dtype=float)
    return Times(values, True, began, began % DAY)


def _of_clock(times: "pd.Series") -> Times:
    """Seconds since the first row of a clock without dates, which goes on after midnight."""
    first = _first(times)
    if first is None:
        return Times(np.full(times.size, np.nan), stamped=True)
    values = np.array((times - first).dt.total_seconds(), dtype=float)
    known = np.isfinite(values)
    # Back by half a day and more is another day; by less the clock was set, which is refused.
    values[known] += DAY * np.cumsum(np.diff(values[known], prepend=0.0) < -DAY / 2)
    return Times(values, True, clock=first.total_seconds() % DAY)


def _first(cells: "pd.Series") -> Any:
    """The first cell that is there."""
    known = cells.dropna()
    return known.iloc[0] if known.size else None


def _stamps(text: "pd.Series", dayfirst: bool) -> "pd.Series":
    """Dates in universal time; day before month if asked for or only that gives rising ones."""
    import pandas as pd

    forms = [("ISO8601", False), (None, False), (None, True)]
    tried: list[tuple[float, pd.Series]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pandas warns where it guesses the order of day and month
        for form, day in [("ISO8601", False), (None, True)] if dayfirst else forms:
            dates = pd.to_datetime(text, errors="coerce", utc=True, format=form, dayfirst=day)
            known = dates.dropna()
            rising = known.size > 0 and known.is_monotonic_increasing
            tried.append((known.size + 0.5 * rising, dates))
    return max(tried, key=lambda pair: pair[0])[1]


def _are_serials(values: np.ndarray) -> bool:
    """Whether numbers can be Excel's days: between 2000 and 2050, not whole."""
    known = values[np.isfinite(values)]
    low, high = _SERIALS
    inside = known.size > 0 and low < known.min() and known.max() < high
    return inside and bool(np.any(known != np.round(known)))


def numbers_of(table: Table, column: int) -> np.ndarray:
    """Numbers of a column, NaN where a cell is none."""
    return _as_floats(table.columns[column])


def missing_marks(table: Table, column: int) -> np.ndarray:
    """Cells that say that there is no value, such as `---`."""
    cells = table.columns[column]
    if cells.dtype.kind in "biufcmM":
        return np.zeros(cells.size, bool)
    text = cells.astype(str).str.strip()
    return text.str.fullmatch(_MARK.pattern).fillna(False).to_numpy(dtype=bool)


def refuse_missing(table: Table, column: int, values: np.ndarray, most: int = 0) -> None:
    """A sentence about the first cell without a finite number if there are more than `most`."""
    wrong = np.flatnonzero(~np.isfinite(values)).tolist()
    if len(wrong) <= most:
        return
    cells = table.columns[column].iloc[wrong[:1]]
    cell = cells.iloc[0]
    blank = cells.isna().all() or not str(cell).strip()
    more = f" {len(wrong)} of {values.size} rows lack one, more than a tenth." if most else ""
    raise ValueError(
        f"The column {table.names[column]!r} of {table.source} has"
        f" {'an empty or NaN cell' if blank else repr(str(cell))} {table.place(wrong[0])},"
        f" where a finite number is needed.{more}"
    )


def time_label(name: str, times: Times) -> str:
    """Name of the time axis, which from stamps is in seconds."""
    return f"{name} (s)" if times.stamped and unit_of(name) != "s" else name


def _is_numeric(cells: "pd.Series") -> bool:
    """Whether a column holds numbers or truth values, also those of pandas' own types."""
    return cells.dtype.kind in "biufc"


def _as_floats(cells: "pd.Series") -> np.ndarray:
    """Numbers of a column, NaN where a cell is none."""
    import pandas as pd

    if _is_numeric(cells) and not np.iscomplexobj(cells):
        return cells.to_numpy(dtype=float, na_value=np.nan)
    return np.asarray(pd.to_numeric(_as_text(cells), errors="coerce"), dtype=float)


def _as_text(cells: "pd.Series") -> "pd.Series":
    """Cells as text, a decimal comma as a point."""
    return cells.astype(str).str.strip().str.replace(r",(?=\d)", ".", regex=True)
