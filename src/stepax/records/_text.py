"""Text tables as loggers write them: encoding, separators, decimal signs, headers; host code."""

import csv
import io
import re
import warnings
from statistics import mode
from typing import TYPE_CHECKING

from ._labels import is_unit, with_unit


if TYPE_CHECKING:
    import pandas as pd

# What cells and headers look like. `test_text_formats` has a file for each branch here and below.
_BLANKS = r"\s+"
# One word, or a name with a unit in brackets: "T (deg C)" is one column of a table set with blanks.
_WORD = re.compile(r'"[^"]*"|[^\s(\[]\S*(?:\s*[(\[][^)\]]*[)\]])?|\S+')
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+|\d*,\d+)([eE][-+]?\d+)?")
# Thousands in groups of three: by points where the comma is decimal, by commas only beside a point
# or in two groups (1,234 may be a decimal comma), by blanks and apostrophes.
_GROUPED = {
    ".": re.compile(r"[-+]?\d{1,3}(\.\d{3})+(,\d+)?"),
    ",": re.compile(r"[-+]?\d{1,3}((,\d{3})+\.\d*|(,\d{3}){2,})"),
    " ": re.compile(r"[-+]?\d{1,3}( \d{3})+([.,]\d+)?"),
    "'": re.compile(r"[-+]?\d{1,3}('\d{3})+([.,]\d+)?"),
}
# Of cells that are no number (12.5 fits, too); "3 days " is how pandas writes a duration.
DATE = re.compile(r"\d{1,4}[-./:]\d|\d+ days? ")
_STAMP = re.compile(r"\d+:\d\d|\d{1,4}([-./])\d{1,2}\1\d{1,4}")
# Bytes that no text has; 1A ended text files once, 1B begins colours of a terminal.
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x19\x7f]")
_SEPARATOR_LINE = re.compile(r'\s*"?sep=(.)"?\s*', re.IGNORECASE)
# Signs of a unit or a western name, and words of Cyrillic letters, by which an encoding is told.
_WESTERN = re.compile(r"[°µ²³ΩäöüßÄÖÜéèêëáàâíìîóòôúùûñçãõåøæÅØÆÉ€]")
_CYRILLIC = re.compile(r"[а-яА-ЯёЁ]{3,}")

MANY_LINES = 100
"""Lines by which separator and header are told."""


def text_columns(source: str, content: bytes) -> tuple[list[str], "list[pd.Series]", list[int]]:
    """Names, columns and line numbers of a table; blank lines and those with # or % are left out.

    A first line `sep=;` names the separator. The header is the last line of text before the
    numbers, or the last but one where that is a row of units.
    """
    lines = _decoded(source, content).split("\n")
    told = _SEPARATOR_LINE.fullmatch(lines[0])
    if told:
        lines[0] = ""
    kept = [i for i, line in enumerate(lines) if line.strip() and line.lstrip()[0] not in "#%"]
    sample = [lines[i] for i in kept[1:MANY_LINES] or kept]  # without what may be a header
    if not sample:
        raise ValueError(f"{source} has no rows of data.")
    separator, decimal, thousands = _dialect(sample, told[1] if told else None)
    width = mode(len(_split(line, separator)) for line in sample)
    top = [_split(lines[i], separator) for i in kept[:MANY_LINES]]
    begin, header = heading(top, width)
    comment = lines[kept[0] - 1].lstrip("#% \t") if kept[0] else ""
    if begin and len(header) != width:  # it may have another separator than the data
        header = _header(lines[kept[begin - 1]], separator, width)
    elif not begin and comment:
        names = _header(comment, separator, width)
        header = names if len(names) >= width and not any(map(is_value, names)) else []
    kept = kept[begin:]
    if not kept:
        raise ValueError(f"{source} has a header but no rows of data.")
    header += [""] * (width - len(header))
    stamps = [i for i, cell in enumerate(_split(lines[kept[0]], separator)) if _STAMP.match(cell)]
    frame = _parsed(
        source,
        lines,
        kept,
        sep=separator,
        decimal=decimal,
        thousands=thousands,
        names=range(len(header)),
        dtype=dict.fromkeys(stamps, str),  # with points for thousands 31.01.2024 would be a number
    )
    columns = {
        i: _plain(frame.iloc[:, i], decimal, thousands, i in stamps) for i in range(len(header))
    }
    columns = {i: cells for i, cells in columns.items() if not _is_filler(header, i, cells)}
    names = [header[i] or str(i + 1) for i in columns]
    return names, list(columns.values()), [i + 1 for i in kept]


def heading(rows: list[list[str]], width: int) -> tuple[int, list[str]]:
    """How many rows stand above the data, and the names in them, with units from a row of units.

    Data begin in the first row that starts with a value, has the right width or nothing but values.
    Above may stand any text of a logger; of it only the last rows are names and units.
    """

    def is_data(cells: list[str]) -> bool:
        filled = [cell for cell in cells if cell]
        fits = len(cells) == width or all(map(is_value, filled))
        return bool(filled) and is_value(filled[0]) and fits

    begin = next((i for i, cells in enumerate(rows) if is_data(cells)), min(1, len(rows)))
    while begin > 1 and any(map(is_value, rows[begin - 1])):  # a first cell that is no number
        begin -= 1
    if not begin:
        return 0, []
    names = rows[begin - 1]
    known = [is_unit(cell) for cell in names if cell]
    above = rows[begin - 2] if begin > 1 else []
    if len(above) == len(names) and known and 2 * sum(known) >= len(known):
        names = [with_unit(name, unit) for name, unit in zip(above, names, strict=True)]
    return begin, names


def _decoded(source: str, content: bytes) -> str:
    """Text of a file in UTF-8, UTF-16, or a code page of Windows or the Mac, plain line ends."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = content.decode("utf-16", errors="replace")
    elif content[1:200:2].strip(b"\0") == b"" and len(content) > 2 and content[0]:
        text = content.decode("utf-16-le", errors="replace")  # without its mark
    elif _CONTROL.search(content):
        raise ValueError(f"{source} is neither a text table nor a MAT file.")
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = _of_code_page(content)
    text = text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n")
    # Blanks that do not break a line part thousands.
    return re.sub("(?<=\\d)[\u00a0\u2009\u202f](?=\\d{3})", "", text)


def _of_code_page(content: bytes) -> str:
    """Text in the code page in which most of its signs make sense; the first of equals."""
    beyond = re.sub(rb"[\x00-\x7f]{9,}", b" ", content)[:10_000]

    def sense(page: str) -> int:
        text = beyond.decode(page, errors="replace")
        cyrillic = sum(map(len, _CYRILLIC.findall(text)))
        return cyrillic if page == "cp1251" else len(_WESTERN.findall(text))

    page = max(("cp1252", "mac_roman", "cp1251"), key=sense)
    return content.decode(page if sense(page) else "latin-1", errors="replace")


def _dialect(sample: list[str], told: str | None) -> tuple[str, str, str | None]:
    """Separator of most rows of data unless it is told, decimal sign, and sign of thousands."""
    common = [mark for mark in ";\t|," if sum(mark in line for line in sample) * 2 > len(sample)]
    blanks = [len(line.split()) > 1 and all(map(NUMBER.fullmatch, line.split())) for line in sample]
    separator = _BLANKS if not common or (common == [","] and mode(blanks)) else common[0]
    separator = told or separator
    cells = [cell for line in sample for cell in _split(line, separator)]
    grouped = {sign: any(map(form.fullmatch, cells)) for sign, form in _GROUPED.items()}
    comma = any("," in c and NUMBER.fullmatch(c) for c in cells)
    comma |= any("," in c for c in cells if _GROUPED["."].fullmatch(c))
    comma |= any(_GROUPED[sign].fullmatch(c) and "," in c for c in cells for sign in " '")
    comma &= not grouped[","]
    signs = [s for s, there in grouped.items() if there and (s != "." or comma)]
    return separator, "," if comma else ".", signs[0] if signs else None


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


def is_value(cell: str) -> bool:
    """Whether a cell is a number, a date or a clock time, and not a name."""
    known = cell.strip("+-").casefold() in ("nan", "inf")
    grouped = any(form.fullmatch(cell) for form in _GROUPED.values())
    return known or grouped or bool(NUMBER.fullmatch(cell) or DATE.match(cell))


def _is_filler(header: list[str], i: int, cells: "pd.Series") -> bool:
    """Whether a column is empty, or numbers the rows under no name (as pandas writes its index)."""
    counted = i == 0 and not header[0] and any(header) and cells.dtype.kind in "iuf"
    return bool(cells.isna().all() or (counted and (cells.diff().iloc[1:] == 1).all()))


def _plain(cells: "pd.Series", decimal: str, thousands: str | None, stamp: bool) -> "pd.Series":
    """Cells of a column with some text, their numbers in plain notation."""
    if stamp or cells.dtype.kind in "biuf" or not (thousands or decimal == ","):
        return cells
    form = re.compile(NUMBER.pattern + "|" + "|".join(x.pattern for x in _GROUPED.values()))

    def plain(cell):
        if not isinstance(cell, str) or not form.fullmatch(cell.strip()):
            return cell
        return cell.strip().replace(thousands or "", "").replace(decimal, ".")

    return cells.map(plain)


def _parsed(source: str, lines: list[str], kept: list[int], **dialect) -> "pd.DataFrame":
    """The kept lines, as numbers where a column has nothing else, else as text."""
    import pandas as pd

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # the first line is too long
            return pd.read_csv(
                io.BytesIO("\n".join([lines[i] for i in kept]).encode()),
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
