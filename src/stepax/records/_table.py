"""Tables of named columns, from a text table, a MAT file or a DataFrame, and their values.

Host code. What is wrong with a file or a cell is said in one sentence. pandas and scipy.io are
imported where a file is read: they would make `import stepax` a quarter slower.
"""

import csv
import importlib
import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from statistics import mode
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np


if TYPE_CHECKING:
    import pandas as pd

# What cells and headers look like. `test_text_formats` has a file for each branch here and below.
_BLANKS = r"\s+"
# One word, or a name with a unit in brackets: "T (deg C)" is one column of a table set with blanks.
_WORD = re.compile(r'"[^"]*"|[^\s(\[]\S*(?:\s*[(\[][^)\]]*[)\]])?|\S+')
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+|\d*,\d+)([eE][-+]?\d+)?")
# Of cells that are no number (12.5 fits, too); "3 days " is how pandas writes a duration.
_DATE = re.compile(r"\d{1,4}[-./:]\d|\d+ days? ")
_DURATION = re.compile(r"(\d+ days? )?\d+:\d\d:\d\d(\.\d*)?")
TIME_NAME = re.compile(r"^t(?![A-Za-z0-9])|(?i:(?<![a-z])(time|zeit|tiempo|tempo|čas|date|datum))")
# Bytes that no text has; 1A ended text files once, 1B begins colours of a terminal.
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x19\x7f]")


class Table(NamedTuple):
    """Named columns; messages count its rows as `word` (line or row) and `numbers`."""

    file: str
    names: list[str]
    columns: "list[pd.Series]"
    word: str
    numbers: Sequence[int]

    @property
    def source(self) -> str:
        """Name of the file, or what else was read."""
        return self.file or "DataFrame"

    def place(self, row: int) -> str:
        """Where a row is."""
        return f"in {self.word} {self.numbers[row]}"


# Sources


def frame_table(frame: "pd.DataFrame") -> Table:
    """Columns of a DataFrame, its index among them if it is named time or is no plain number."""
    index = frame.index
    if index.dtype.kind not in "iuO" or TIME_NAME.search(str(index.name)):
        frame = frame.reset_index()
    columns = [frame.iloc[:, i] for i in range(frame.shape[1])]
    names = [str(name).strip() for name in frame.columns]
    return Table("", names, columns, "row", range(1, len(frame) + 1))


def file_content(path: Path) -> bytes:
    """Bytes of a file that is not empty."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise FileNotFoundError(f"There is no file {path}.") from None
    except OSError as error:
        raise OSError(f"{path} cannot be read: {error.strerror}.") from None
    if not content.strip():
        raise ValueError(f"{path.name} is empty.")
    return content


def file_table(path: Path) -> Table:
    """Columns of a file, whose kind its content tells."""
    content = file_content(path)
    if path.suffix.lower() == ".mat" or content.startswith(b"MATLAB"):
        return _mat_table(path)
    return _text_table(path.name, content)


def _mat_table(path: Path) -> Table:
    """Vectors of a MAT file."""
    import pandas as pd

    try:
        variables = _mat_variables(path)
    except ImportError:
        raise ImportError(
            f"{path.name} is a MAT file of version 7.3: pip install h5py, or save it with -v7."
        ) from None
    except Exception:  # scipy has many for a damaged file
        raise ValueError(f"{path.name} is damaged, or not a MAT file.") from None
    vectors = {
        name: pd.Series(np.ravel(value))
        for name, value in variables.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "biufc" and name[0] != "_"
        if value.size > 1 and value.size == max(value.shape)
    }
    rows = range(1, 1 + max([column.size for column in vectors.values()], default=0))
    return Table(path.name, list(vectors), list(vectors.values()), "row", rows)


def _mat_variables(path: Path) -> dict[str, Any]:
    """Variables of a MAT file of any version."""
    from scipy.io import loadmat

    try:
        return loadmat(path)
    except NotImplementedError:  # version 7.3 is HDF5
        with importlib.import_module("h5py").File(path) as file:
            return {name: np.asarray(v) for name, v in file.items() if hasattr(v, "shape")}


def _text_table(source: str, content: bytes) -> Table:
    """Columns of a text table; blank lines and those that begin with # or % are left out."""
    lines = _decoded(source, content).split("\n")
    kept = [i for i, line in enumerate(lines) if line.strip() and line.lstrip()[0] not in "#%"]
    sample = [lines[i] for i in kept[1:100] or kept]  # without what may be a header
    if not sample:
        raise ValueError(f"{source} has no rows of data.")
    separator, decimal = _dialect(sample)
    width = mode(len(_split(line, separator)) for line in sample)
    header: list[str] = []
    comment = lines[kept[0] - 1].lstrip("#% \t") if kept[0] else ""
    if not _is_value(next(filter(None, _split(lines[kept[0]], separator)), "")):
        header = _header(lines[kept.pop(0)], separator, width)
    elif comment:
        names = _header(comment, separator, width)
        header = names if len(names) >= width and not any(map(_is_value, names)) else []
    if not kept:
        raise ValueError(f"{source} has a header but no rows of data.")
    header += [""] * (width - len(header))
    frame = _parsed(source, lines, kept, sep=separator, decimal=decimal, names=range(len(header)))
    columns = {i: frame.iloc[:, i] for i in range(len(header))}
    columns = {i: cells for i, cells in columns.items() if not _is_filler(header, i, cells)}
    names = [header[i] or str(i + 1) for i in columns]
    return Table(source, names, list(columns.values()), "line", [i + 1 for i in kept])


def _decoded(source: str, content: bytes) -> str:
    """Text of a file in UTF-8, UTF-16 with its mark, or Latin-1, with plain line ends."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = content.decode("utf-16", errors="replace")
    elif _CONTROL.search(content):
        raise ValueError(f"{source} is neither a text table nor a MAT file.")
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
    return text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n")


def _dialect(sample: list[str]) -> tuple[str, str]:
    """Separator of most rows of data, and the decimal sign."""
    common = [mark for mark in ";\t|," if sum(mark in line for line in sample) * 2 > len(sample)]
    blanks = [
        len(line.split()) > 1 and all(map(_NUMBER.fullmatch, line.split())) for line in sample
    ]
    separator = _BLANKS if not common or (common == [","] and mode(blanks)) else common[0]
    cells = [cell for line in sample for cell in _split(line, separator)]
    return separator, "," if any("," in c and _NUMBER.fullmatch(c) for c in cells) else "."


def _split(line: str, separator: str) -> list[str]:
    """Cells of a line, without the blanks and quotation marks around them."""
    line = line.strip(" ")[:100_000]  # csv refuses a cell of more
    if separator == _BLANKS:
        return [word.strip('"') for word in _WORD.findall(line)]
    cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip() for cell in cells]


def _header(line: str, separator: str, width: int) -> list[str]:
    """Names in a header, which may have another separator than the data."""
    names = _split(line, separator)
    others = [name.strip(' "') for name in re.split(r"[,;|\t]|\s{2,}", line.strip())]
    return others if len(names) != width == len(others) else names


def _is_value(cell: str) -> bool:
    """Whether a cell is a number, a date or a clock time, and not a name."""
    known = cell.strip("+-").casefold() in ("nan", "inf")
    return known or bool(_NUMBER.fullmatch(cell) or _DATE.match(cell))


def _is_filler(header: list[str], i: int, cells: "pd.Series") -> bool:
    """Whether a column is empty, or numbers the rows under no name (as pandas writes its index)."""
    counted = i == 0 and not header[0] and any(header) and _is_numeric(cells)
    return bool(cells.isna().all() or (counted and (cells.diff().iloc[1:] == 1).all()))


def _parsed(source: str, lines: list[str], kept: list[int], **dialect) -> "pd.DataFrame":
    """The kept lines, as numbers where a column has nothing else, else as text."""
    import pandas as pd

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # the first line is too long
            return pd.read_csv(
                io.StringIO("\n".join([lines[i] for i in kept])),
                header=None,
                index_col=False,
                skipinitialspace=True,
                skip_blank_lines=False,
                keep_default_na=False,
                na_values=[""],
                low_memory=False,
                **dialect,
            )
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        long, quote = re.search(r"line (\d+), saw", str(error)), re.search(r"row (\d+)", str(error))
        row = int(long[1]) - 1 if long else int(quote[1]) if quote else 0
        raise ValueError(
            f"Line {kept[row] + 1} of {source} does not fit a table of {len(dialect['names'])}"
            f" columns: {lines[kept[row]][:60]!r}."
        ) from None


# Values of columns


def finite_numbers(table: Table, column: int) -> np.ndarray:
    """Finite numbers of a column."""
    return _finite(table, column, _as_floats(table.columns[column]))


def increasing_times(table: Table, column: int) -> np.ndarray:
    """Increasing times, as numbers, or in seconds since the first row from dates or clock times."""
    cells = table.columns[column]
    first = str(cells.iloc[0]).strip()
    if cells.dtype.kind in "mM":  # times of day, dates
        times = _seconds(cells)
    elif _is_numeric(cells) or not _DATE.match(first) or _NUMBER.fullmatch(first):
        times = _as_floats(cells)
    else:
        times = _clock_seconds(_as_text(cells))
    times = _finite(table, column, times)
    back = np.flatnonzero(np.diff(times) <= 0).tolist()
    if back:
        before, after = (f"{times[row]:.9g} {table.place(row)}" for row in (back[0], back[0] + 1))
        raise ValueError(
            f"The time {table.names[column]!r} of {table.source} does not increase:"
            f" it is {before} and {after}."
        )
    return times


def _clock_seconds(text: "pd.Series") -> np.ndarray:
    """Seconds since the first row; day before month if only that gives increasing dates."""
    import pandas as pd

    if _DURATION.fullmatch(text.iloc[0]):
        return _seconds(pd.to_timedelta(text, errors="coerce"))
    best = np.full(text.size, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pandas warns where it guesses the order of day and month
        for form, day in (("ISO8601", False), (None, False), (None, True)):
            dates = pd.to_datetime(text, errors="coerce", utc=True, format=form, dayfirst=day)
            seconds = _seconds(dates)
            if (np.diff(seconds) > 0).all():
                return seconds
            best = max(best, seconds, key=lambda x: np.isfinite(x).sum())
    return best


def _seconds(times: "pd.Series") -> np.ndarray:
    """Seconds since the first row."""
    return (times - times.iloc[0]).dt.total_seconds().to_numpy(dtype=float)


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
    return cells.astype(str).str.strip().str.replace(",", ".")


def _finite(table: Table, column: int, values: np.ndarray) -> np.ndarray:
    """The values if all are finite; else a sentence about the first cell that is not."""
    wrong = np.flatnonzero(~np.isfinite(values)).tolist()
    if wrong:
        cells = table.columns[column].iloc[wrong[:1]]
        cell = cells.iloc[0]
        blank = cells.isna().all() or not str(cell).strip()
        raise ValueError(
            f"The column {table.names[column]!r} of {table.source} has"
            f" {'an empty or NaN cell' if blank else repr(str(cell))} {table.place(wrong[0])},"
            " where a finite number is needed."
        )
    return values
