"""Files as loggers write them: each kind with the model that comes out and what is said of it.

`tests/README.md` has the same kinds, a row each.
"""

import io
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stepax import Status, identify, read_record


pytestmark = pytest.mark.usefixtures("quick_compilation")

T = np.arange(60.0)
NOISE = 0.02 * np.random.default_rng(0).standard_normal(400)


def response(t, step_time=10.0, size=40.0):
    """Output of the plant, 0.8 e^-2s/(1 + 8s) on 22 degrees, with a little noise."""
    since = np.maximum(np.asarray(t) - step_time - 2.0, 0.0)
    return 22.0 + 0.8 * size * (1 - np.exp(-since / 8.0)) + np.resize(NOISE, np.size(t))


U, Y = np.where(T < 10, 0.0, 40.0), response(T).round(3)
BEGAN = pd.Timestamp("2024-02-11 23:59:30")
STAMPS = BEGAN + pd.to_timedelta(T, "s")
NAMES = "Time (s),Heater (%),Temp (degC)"


def text(t=T, u=U, y=Y, names=NAMES, separator=","):
    """A table as text; no header without names."""
    lines = [] if names is None else [names.replace(",", separator)]
    columns = [x for x in (t, u, y) if x is not None]
    lines += [separator.join(map(str, row)) for row in zip(*columns, strict=True)]
    return "\n".join(lines) + "\n"


def changed(y, rows, cell):
    """A column with other cells in some rows."""
    cells = [str(x) for x in y]
    for row in rows:
        cells[row] = cell
    return cells


def excel(frame, **options):
    """Content of an .xlsx file."""
    pytest.importorskip("openpyxl")
    content = io.BytesIO()
    frame.to_excel(content, index=False, **options)
    return content.getvalue()


def grouped(x, sign, decimal):
    """A number with its thousands in groups."""
    return f"{x:,.2f}".translate({ord(","): sign, ord("."): decimal})


WARM = np.concatenate([-30 * np.exp(-np.arange(200.0) / 25), np.zeros(60)])
COLD = np.arange(260.0)
TAIL = np.concatenate([12 * np.exp(-np.arange(60.0) / 15), np.zeros(60)])
STAIR = np.arange(100.0)
CLOCK = [str((BEGAN + pd.Timedelta(x, "s")).time()) for x in T]
LONG = (np.arange(10_000) * 0.02).round(2)
WHOLE = T.astype(int)
BIG = 1e6 + 100 * (Y - 22)
FRAME = pd.DataFrame({"when": STAMPS, "heater [%]": U, "temp [degC]": Y})
UNITS = [["Time", "Heater", "Temp"], ["s", "%", "degC"], *zip(T, U, Y, strict=True)]

# Name: content or object, options, what the notes say, what else differs from the plant.
GROUPS = {"factor": 100.0, "offset": 1e6}
KINDS = {
    "plain": (text(), {}, "", {}),
    "step one interval before the first row": (
        text(T[1:], None, response(T[1:], 0.0, 1.0 * 40), "t,Temp (degC)"),
        {"step_size": 40},
        "The record begins 1 after the step",
        {"begins_late": 1.0, "at": 0.0},
    ),
    "log that starts three seconds after the step": (
        text(T[3:], None, response(T[3:], 0.0), "t,Temp (degC)"),
        {"step_time": 0, "step_size": 40, "initial": 22},
        "",
        {"begins_late": 3.0, "at": 0.0},
    ),
    "cold start before the step": (
        text(COLD, np.where(COLD < 200, 0, 40), response(COLD, 200.0) + WARM),
        {},
        r"\d+ rows before the step are left out: the output was not yet at rest",
        {"rows_before_rest": (75, 170), "at": 200.0},
    ),
    "tail of an earlier move before the step": (
        text(
            np.arange(120.0),
            np.where(np.arange(120) < 60, 0, 40),
            response(np.arange(120), 60.0) + TAIL,
        ),
        {},
        r"\d+ rows before the step are left out",
        {"rows_before_rest": (25, 59), "at": 60.0, "loose": True},
    ),
    "step while the output still moves": (
        text(
            STAIR,
            np.select([STAIR < 10, STAIR < 22], [0.0, 40.0], 60.0),
            response(STAIR) + response(STAIR, 22.0, 20.0) - 22,
        ),
        {"step": 2},
        r"The output still moves when the step comes, by \d\.\d+ degC/s: .*step=",
        {"model": None},
    ),
    "repeated time stamps": (
        text(T // 2 * 2),
        {},
        "60 rows share their time stamp with a neighbour: such rows are averaged.",
        {"loose": True},
    ),
    "ISO time stamps": (
        text(STAMPS.strftime("%Y-%m-%dT%H:%M:%S"), names="Zeit,Heater (%),Temp (degC)"),
        {},
        "The time stamps became seconds since the first row, 2024-02-11 23:59:30.",
        {},
    ),
    "time stamps of Excel's CSV": (
        text(STAMPS.strftime("%m/%d/%Y %I:%M:%S %p"), names="Date,Heater (%),Temp (degC)"),
        {},
        "since the first row, 2024-02-11 23:59:30.",
        {},
    ),
    "day first": (
        text(STAMPS.strftime("%d/%m/%Y %H:%M:%S"), names="Date,Heater (%),Temp (degC)"),
        {"dayfirst": True},
        "since the first row, 2024-02-11 23:59:30.",
        {},
    ),
    "Excel's day numbers": (
        text(
            [f"{45333 + (86370 + x) / 86400:.9f}" for x in T], names="Date,Heater (%),Temp (degC)"
        ),
        {},
        "since the first row, 2024-02-11 23:59:30",
        {},
    ),
    "clock that passes midnight": (
        text(CLOCK),
        {},
        "The time stamps became seconds since the first row.",
        {},
    ),
    "xlsx with dates": (lambda: excel(FRAME), {}, "since the first row, 2024-02-11 23:59:30.", {}),
    "xlsx with a row of units": (
        lambda: excel(pd.DataFrame(UNITS), header=False, startrow=2),
        {"output": "Temp"},
        "",
        {},
    ),
    "TSV": (text(separator="\t"), {}, "", {}),
    "row of units": (text(names="Time,Heater,Temp\ns,%,degC"), {"output": "Temp"}, "", {}),
    "row of units in brackets, after a preamble": (
        "Logger 7\nSerial: 0815, rig 3\n\n" + text(names="Time,Heater,Temp\n[s],[%],[degC]"),
        {},
        "",
        {},
    ),
    "byte-order mark": (("\ufeff" + text()).encode(), {}, "", {}),
    "UTF-16 without a mark": (text().encode("utf-16-le"), {}, "", {}),
    "Windows code page": (
        text(names="Time (s),Heater (%),Öl (°C)").encode("cp1252"),
        {},
        "",
        {"output": "Öl (°C)"},
    ),
    "Mac code page, CR": (
        text(names="Time (s),Heater (%),Öl (°C)").replace("\n", "\r").encode("mac_roman"),
        {},
        "",
        {"output": "Öl (°C)"},
    ),
    "Cyrillic code page": (
        text(names="Время (s),Heater (%),Температура (degC)").encode("cp1251"),
        {"output": "Температура"},
        "",
        {"output": "Температура (degC)"},
    ),
    "sep=;": ("sep=;\n" + text(separator=";"), {}, "", {}),
    "thousands by points, decimal comma": (
        text(WHOLE, 40 * (WHOLE >= 10), [grouped(x, ".", ",") for x in BIG], separator=";"),
        {},
        "",
        GROUPS,
    ),
    "thousands by commas, quoted": (text(T, U, [f'"{x:,.2f}"' for x in BIG]), {}, "", GROUPS),
    "thousands by blanks": (
        text(T, U, [grouped(x, " ", ",") for x in BIG], separator=";"),
        {},
        "",
        GROUPS,
    ),
    "thousands by apostrophes": (
        text(T, U, [grouped(x, "'", ".") for x in BIG], separator=";"),
        {},
        "",
        GROUPS,
    ),
    "text cells": (
        text(T, changed(U, [3], "---"), changed(Y, [5, 30, 31], "---")),
        {},
        "4 rows without a value are left out.",
        {},
    ),
    "gaps": (
        text(T, U, changed(changed(Y, [20], ""), [40, 41, 42], "NaN")),
        {},
        "4 rows without a value are left out.",
        {},
    ),
    "last line cut off": (text() + "60.0,40", {}, "1 row without a value is left out.", {}),
    "output named, the rest is the input": (text(), {"output": "Temp (degC)"}, "", {}),
    "output named, the rest has no step": (
        text(T - 10, 20 + T / 9 + np.sin(9 * T**2), Y / 40, "Time (s),Room,Temp (degC)"),
        {"output": "Temp"},
        "The column that is left has no step in it and is not taken for the input.",
        {"factor": 1 / 40, "offset": 22 / 40, "at": 0.0},
    ),
    "no input column": (
        text(T, None, Y, "Time (s),Temp (degC)"),
        {"step_time": 10, "step_size": 40},
        "",
        {},
    ),
    "columns by number": (
        text(Y, T, U, "Temp (degC),Time (s),Heater (%)"),
        {"time": 2, "output": 1, "input": 3},
        "",
        {},
    ),
    "part of a log, by time": (
        text(
            np.arange(200.0),
            np.where(np.arange(200) < 110, 0, 40) + 5.0 * (np.arange(200) < 50),
            response(np.arange(200.0), 110.0),
        ),
        {"begin": "100", "end": 170},
        "",
        {"at": 110.0},
    ),
    "part of a log, by time stamps": (
        text(STAMPS.strftime("%Y-%m-%d %H:%M:%S")),
        {"begin": "23:59:32", "end": "2024-02-12 00:00:25"},
        "since the first row, 2024-02-11 23:59:30.",
        {},
    ),
    "DataFrame with a time index": (
        FRAME.set_index("when"),
        {},
        "since the first row, 2024-02-11 23:59:30.",
        {},
    ),
    "Series with a time index": (
        FRAME.set_index("when")["temp [degC]"],
        {"step_time": "2024-02-11 23:59:40", "step_size": 40},
        "since the first row, 2024-02-11 23:59:30.",
        {},
    ),
    "long log": (
        text(LONG, np.where(LONG < 10, 0, 40), response(LONG)),
        {},
        r"10000 rows are averaged over equal spans of 0\.0561\d* s, and RMSE and fit",
        {},
    ),
}


def read(folder, content, options):
    """The record of a file with that content, or of a DataFrame or Series."""
    content = content() if callable(content) else content
    if isinstance(content, str | bytes):
        raw = content.encode() if isinstance(content, str) else content
        path = folder / ("log.xlsx" if raw.startswith(b"PK") else "log.csv")
        path.write_bytes(raw)
        content = path
    return read_record(content, **options)


@pytest.mark.parametrize("kind", KINDS)
def test_kinds_of_files(tmp_path, kind):
    content, options, said, told = KINDS[kind]
    record = read(tmp_path, content, options)
    result = identify(record, "fopdt_fit")
    notes = " ".join(result.notes)
    assert re.search(said, notes) if said else not notes, notes
    details = {name: float(value) for name, value in record.details.items()}
    assert details["rows_used"] == result.record.t.size or "rows_thinned" in result.record.details
    for name in ("begins_late", "rows_before_rest"):
        low, high = np.broadcast_to(told.get(name, details.get(name, 0.0)), 2)
        assert low <= details.get(name, 0.0) <= high
    assert record.labels.output == told.get("output", record.labels.output)
    if told.get("model", True):
        model, loose, factor = result.model, 6 if "loose" in told else 1, told.get("factor", 1.0)
        change = float(model.gain * record.step_size)
        assert bool(result.status == Status.successful), notes
        assert abs(float(model.T) - 8.0) < 0.1 * loose
        assert abs(float(model.delay) - 2.0) < 0.1 * loose
        np.testing.assert_allclose(change, 32 * factor, rtol=0.005 * loose)
        np.testing.assert_allclose(
            model.offset, told.get("offset", 22.0), atol=0.1 * loose * factor
        )
        np.testing.assert_allclose(record.step_time, told.get("at", 10.0))


def test_every_kind_stands_in_the_table():
    """`tests/README.md` has a row for each kind of file here, and for nothing else."""
    table = (Path(__file__).parents[1] / "README.md").read_text().split("## Files")[1]
    rows = [line.split("|")[1].strip() for line in table.splitlines() if line.startswith("| ")]
    assert rows[1:] == [*KINDS, *REFUSED]


REFUSED = {
    "step after the last row": (
        text(T, None, Y, "t,y"),
        {"step_time": 99},
        "goes from t = 0 to 59, which leaves out t = 99.",
    ),
    "no step for a record that begins late": (
        text(T + 1000, None, Y, "t,y"),
        {},
        "goes from t = 1000 to 1059, which leaves out t = 0,",
    ),
    "more than a tenth missing": (
        text(T, U, changed(Y, range(20, 30), "")),
        {},
        "has an empty or NaN cell in line 22, where a finite number is needed. 10 of 60 rows lack",
    ),
    "clock that was set back": (
        text(CLOCK[:40] + CLOCK[30:50]),
        {},
        "does not increase: it is 39 in line 41 and 30 in line 42.",
    ),
    "xls of before 2007": (
        b"\xd0\xcf\x11\xe0" + bytes(600),
        {},
        "log.csv is an Excel file of before 2007: save it as",
    ),
    "damaged xlsx": (b"PK\x03\x04" + bytes(600), {}, "log.xlsx is damaged, or no Excel file."),
    "xlsx with nothing in it": (
        lambda: excel(pd.DataFrame()),
        {},
        "log.xlsx has no sheet with columns for time and output.",
    ),
    "time stamp for a file without": (
        text(),
        {"begin": "10:00"},
        "begin must be a number, got '10:00'.",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_sentences_of_refusals(tmp_path, kind):
    content, options, sentence = REFUSED[kind]
    with pytest.raises(ValueError) as caught:
        read(tmp_path, content, options)
    assert sentence in str(caught.value)


def test_excel_without_its_package(tmp_path, monkeypatch):
    content = excel(FRAME)
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(
        ImportError, match=r'log\.xlsx is an Excel file: pip install "stepax\[excel\]"'
    ):
        read(tmp_path, content, {})


def test_second_sheet_of_an_excel_file(tmp_path):
    pytest.importorskip("openpyxl")
    path = tmp_path / "log.xlsx"
    with pd.ExcelWriter(path) as book:
        pd.DataFrame({"about": ["rig 3"]}).to_excel(book, sheet_name="About", index=False)
        for name in ("Run 1", "Run 2"):
            FRAME.to_excel(book, sheet_name=name, index=False)
    assert read_record(path).labels.source == "log.xlsx, sheet Run 1"
