"""Reading of files and data frames, the search for the step, and the sentences on failure."""

import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pandas as pd
import pytest
import scipy.io

from stepax.records._read import find_steps, read_record


DATA = Path(__file__).parents[3] / "shared/data"
real = pytest.mark.skipif(not DATA.is_dir(), reason="the real records are not here")

ROWS = 40
AFTER = np.arange(ROWS) - 10
T = 0.25 * np.arange(ROWS)
U = np.where(AFTER < 0, 1.5, 3.0)
Y = 20 + np.where(AFTER < 0, 0, 1 - 0.9 ** (AFTER + 1.0)).round(6)
TUY = pd.DataFrame({"Time": T, "Input": U, "Output": Y})


def rows(separator=",", decimal=".", end="\n", columns=(T, U, Y)):
    """The record as text without a header."""
    cells = [[f"{x:.10g}".replace(".", decimal) for x in row] for row in zip(*columns, strict=True)]
    return "".join(separator.join(row) + end for row in cells)


def header(separator=","):
    return separator.join(["Time", "Input", "Output"]) + "\n"


def written(folder, content, name="record.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def check(record):
    np.testing.assert_array_equal(record.t, T)
    np.testing.assert_array_equal(record.y, Y)
    assert (record.step_time, record.step_size) == (2.5, 1.5)
    assert record.initial is None and record.final is None
    assert not record.details["assumed_step"] and record.details["steps_found"] == 1


FORMATS = {
    "comma": header() + rows(),
    "no header": rows(),
    "comma and blank": header(" , ") + rows(", "),
    "semicolon": header(";") + rows(";"),
    "decimal comma": header(";") + rows(";", ","),
    "decimal comma, tab": header("\t") + rows("\t", ","),
    "decimal comma, blank": rows(" ", ","),
    "decimal comma, quoted": header() + '"' + rows('","', ",", '"\n"')[:-1],
    "decimal comma far down": rows(";", ","),
    "tab": header("\t") + rows("\t"),
    "pipe": "".join(f"| {row} |\n" for row in (header(" | ") + rows(" | ")).splitlines()),
    "blanks": header("  ") + rows("   ", end="\n  "),
    "header of another separator": header() + rows(" "),
    "separator at the end": header() + rows(end=",\n"),
    "comments": "# rig 3\n% heater, on\n\n" + header() + "# begin\n" + rows() + "# end\n",
    "comment as header": "# " + header() + rows(),
    "comment as header, blanks": "% " + header(" ") + rows(" "),
    "comment that is no header": "# recorded on Monday\n" + rows(),
    "longer header": "Time,Input,Output,P,I\n" + rows(),
    "shorter header": "Time,Input\n" + rows(),
    "CR LF": (header() + rows()).replace("\n", "\r\n"),
    "CR CR LF": (header() + rows()).replace("\n", "\r\r\n"),
    "CR": (header() + rows()).replace("\n", "\r"),
    "no last line end": (header() + rows())[:-1],
    "UTF-8 with mark": (header() + rows()).encode("utf-8-sig"),
    "UTF-16": (header() + rows()).encode("utf-16"),
    "Latin-1": ("Time,Input,Output °C\n" + rows()).encode("latin-1"),
    "index": TUY.to_csv(),
}


@pytest.mark.parametrize("name", FORMATS)
def test_text_formats(tmp_path, name):
    check(read_record(written(tmp_path, FORMATS[name])))


def test_decimal_comma_after_whole_numbers(tmp_path):
    t = np.arange(300.0)
    y = np.where(t < 200, 0, t / 8)
    record = read_record(written(tmp_path, rows(";", ",", columns=(t, y))))
    np.testing.assert_array_equal(record.y, y)


def test_names_with_blanks_commas_and_brackets(tmp_path):
    text = '"Time (s)", "Heater, front [%]" , Temp (deg C) \n' + rows()
    record = read_record(written(tmp_path, text), input="Heater, front [%]", output="temp (DEG C)")
    check(record)
    assert record.labels == ("record.csv", "Time (s)", "Temp (deg C)", "Heater, front [%]")
    text = "Time (s) Heater (%) Temp\n" + rows(" ")
    assert read_record(written(tmp_path, text)).labels.input == "Heater (%)"


def test_without_input_every_row_is_kept(tmp_path):
    t = T - 1
    record = read_record(str(written(tmp_path, rows(columns=(t, Y)), "step.txt")))
    np.testing.assert_array_equal(record.t, t)
    np.testing.assert_array_equal(record.y, Y)
    assert (record.step_time, record.step_size) == (0, 1)
    assert record.labels == ("step.txt", "1", "2", "input")
    assert not record.details["assumed_step"] and record.details["steps_found"] == 0


@pytest.mark.parametrize(
    "columns",
    [
        {"time": "Time", "output": "Output", "input": "Input"},
        {"time": 2, "output": 3, "input": 1},
        {"time": np.int64(2), "output": "3", "input": "1"},
        {"output": "output", "input": " INPUT "},
        {"input": "Input"},
        {"time": "Time", "input": 1},
        {"output": "Output"},
        {"time": "Time", "output": "Output"},
    ],
)
def test_columns_by_name_position_and_number(tmp_path, columns):
    text = "Input,Time,Output\n" + rows(columns=(U, T, Y))
    check(read_record(written(tmp_path, text), **columns))


def test_name_before_number(tmp_path):
    text = "t,3,2\n" + rows()
    assert read_record(written(tmp_path, text), output="2", input="3").labels.input == "3"
    text = "t,u,U,y\n" + rows(columns=(T, T, U, Y))
    assert read_record(written(tmp_path, text), output="y", input="U").labels.input == "U"


@pytest.mark.parametrize("names", [["y", "t", "u"], ["u", "y", "time"], ["t", "y", "u", "T2"]])
def test_known_names_go_before_the_order(names):
    values = {"t": T, "time": T, "u": U, "y": Y, "T2": Y + 1}
    check(read_record(pd.DataFrame({name: values[name] for name in names})))


@pytest.mark.parametrize(
    "name", ["t [s]", "time_s", "Time", "Elapsed time", "Tiempo (s)", "Zeit/s"]
)
def test_time_column_by_its_name(name):
    frame = pd.DataFrame({"T1": U, "temperature": Y, name: T})
    assert read_record(frame, output="temperature", input="T1").labels.time == name


def test_data_frame():
    record = read_record(TUY)
    check(record)
    assert record.labels == ("", "Time", "Output", "Input")
    check(read_record(TUY.set_index("Time")))
    check(read_record(TUY.rename_axis("number")))
    check(read_record(TUY.iloc[::-1].reset_index(drop=True).iloc[::-1]))
    check(read_record(TUY.astype({"Input": "Float64", "Output": object})))


@pytest.mark.parametrize(
    "clock",
    [
        pd.Timestamp("2024-02-29 23:59:58") + pd.to_timedelta(T, "s"),
        pd.to_timedelta(T + 3, "s"),
        [str(pd.Timestamp("2024-02-29 23:59:58") + pd.Timedelta(x, "s")) for x in T],
        [f"2024-03-31T10:00:{x:05.2f}+02:00" for x in T],
        [f"31.01.2024 23:59:{59 - 9.75 + x:05.2f}" for x in T],
        [f"1/13/2024 1:00:{x:05.2f} PM" for x in T],
        [f"10:59:{x:05.2f}" for x in T],
    ],
)
def test_dates_and_clock_times(tmp_path, clock):
    frame = TUY.assign(Time=clock)
    check(read_record(frame))
    check(read_record(written(tmp_path, frame.to_csv(index=False, sep=";"))))


def test_days_before_months(tmp_path):
    days = [f"{day:02}.{month:02}.2024" for month in (1, 2) for day in range(1, 29)]
    y = np.arange(56.0)
    text = "".join(f"{day};{x}\n" for day, x in zip(days, y, strict=True))
    record = read_record(written(tmp_path, text))
    assert record.t[27] == 27 * 86400 and record.t[28] == 31 * 86400


@pytest.mark.parametrize("time", ["t", "time"])
@pytest.mark.parametrize("shape", [(-1,), (-1, 1), (1, -1)])
def test_mat(tmp_path, time, shape):
    vectors = {time: T, "u": U, "y": Y, "yref": U}
    path = tmp_path / "record.mat"
    scipy.io.savemat(
        path, {k: v.reshape(shape) for k, v in vectors.items()} | {"Ts": 0.25, "n": "a"}
    )
    record = read_record(path)
    check(record)
    assert record.labels == ("record.mat", time, "y", "u")
    assert read_record(path, output="yref").step_size == 1


def test_mat_in_increments(tmp_path):
    path = tmp_path / "record.mat"
    scipy.io.savemat(path, {"t": T, "u": U - 1.5, "y": Y - 20})
    record = read_record(path)
    assert (record.step_time, record.step_size) == (2.5, 1.5)
    scipy.io.savemat(path, {"t": T[10:], "u": U[10:] - 1.5, "y": Y[10:] - 20})
    record = read_record(path)
    assert (record.step_time, record.step_size) == (2.5, 1.5)
    assert record.details["assumed_step"] and record.details["steps_found"] == 1
    assert record.initial is None


def test_mat_of_version_7_3(tmp_path, monkeypatch):
    start = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path = written(tmp_path, start.ljust(512, b"\0"), "record.mat")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ImportError, match=r"record\.mat is a MAT file of version 7\.3: .*h5py"):
        read_record(path)
    content = {"t": T[None], "u": U[None], "y": Y[None], "group": {}}
    reader = SimpleNamespace(File=lambda path: nullcontext(content))
    monkeypatch.setitem(sys.modules, "h5py", reader)
    check(read_record(path))


def several_steps():
    levels = [0.0, 5.0, 3.0, 3.0, 7.0]
    u = np.repeat(levels, 100)
    t = np.arange(u.size) / 10
    return t, u, np.sin(t) + u


@pytest.mark.parametrize(
    "step, time, size, kept",
    [
        (None, 10, 5, (0, 200)),
        (1, 10, 5, (0, 200)),
        (2, 20, -2, (195, 400)),
        (3, 40, 4, (390, 500)),
        (-1, 40, 4, (390, 500)),
        (-3, 10, 5, (0, 200)),
    ],
)
def test_one_of_several_steps(step, time, size, kept):
    t, u, y = several_steps()
    record = read_record(pd.DataFrame({"t": t, "u": u, "y": y}), step=step)
    np.testing.assert_array_equal(record.t, t[slice(*kept)])
    assert (record.step_time, record.step_size) == (time, size)
    assert record.details["steps_found"] == 3


@pytest.mark.parametrize("noise", [0, 0.05, 0.2])
def test_steps_in_noise(noise):
    _, u, _ = several_steps()
    noisy = u + noise * np.random.default_rng(1).standard_normal(u.size)
    found = find_steps(noisy)
    assert [row for row, _ in found] == [100, 200, 400]
    np.testing.assert_allclose([size for _, size in found], [5, -2, 4], atol=0.4 * noise)


def test_steps_of_a_wide_staircase():
    u = np.repeat(np.arange(-10.0, 11.0), 20)
    assert find_steps(u) == [(20 * k, 1) for k in range(1, 21)]


@pytest.mark.parametrize(
    "ramp",
    [[0.25, 0.5, 0.75], [0.5, 0.5, 0.5, 1.0], [0.5], [0.03, 0.9], list(np.linspace(0, 1, 50)[1:])],
)
def test_ramp_is_one_step(ramp):
    u = np.array([0.0] * 50 + ramp + [1.0] * 100)
    assert find_steps(2 + 3 * u) == [(50, pytest.approx(3))]
    assert find_steps(2 - 3 * u) == [(50, pytest.approx(-3))]


def test_small_changes_beside_a_large_step():
    """3 % of the largest step is no step, 8 % is; four rows between two changes part them."""
    for size, count in ((0.3, 1), (0.8, 2)):
        assert len(find_steps(np.repeat([0.0, 10.0, 10.0 + size], 50))) == count
    assert len(find_steps(np.repeat([0.0, 1.0, 2.0], [50, 4, 50]))) == 2
    assert len(find_steps(np.repeat([0.0, 1.0, 2.0], [50, 3, 50]))) == 1
    assert find_steps(np.repeat([5.0, np.nextafter(5.0, 6.0)], 30)) == []


def test_step_at_the_first_interval_and_quantised_input():
    assert find_steps(np.array([0.0] + [1.0] * 8)) == [(1, 1)]
    flicker = 0.01 * (np.arange(200) % 7 == 0)
    assert [row for row, _ in find_steps(flicker + (np.arange(200) >= 50))] == [50]


@pytest.mark.parametrize("noise", [0, 1e-15, 1e-3])
def test_constant_input_is_a_step_from_zero(noise):
    u = -4 + noise * np.random.default_rng(2).standard_normal(ROWS)
    record = read_record(pd.DataFrame({"t": T, "u": u, "y": Y}))
    assert record.t.size == ROWS and record.step_time == 0 and record.details["assumed_step"]
    np.testing.assert_allclose(record.step_size, -4, atol=noise, rtol=1e-14)


def changed(row, column, cell):
    """The record with one cell replaced, as text: row 0 is in line 2."""
    return TUY.astype(object).map(str).pipe(_set, row, column, cell).to_csv(index=False)


def _set(frame, row, column, cell):
    frame.loc[row, column] = cell
    return frame


ERRORS = {
    "text cells": (
        changed(slice(15, 19), "Output", "abc"),
        "'Output' of record.csv has 'abc' in line 17, where a finite number is needed."
        " 5 of 40 rows lack one, more than a tenth.",
    ),
    "empty": (
        changed(slice(3, 7), "Output", ""),
        "'Output' of record.csv has an empty or NaN cell in line 5,",
    ),
    "NaN": (changed(3, "Input", "NaN"), "'Input' of record.csv has 'NaN' in line 5,"),
    "infinite": (changed(3, "Input", "-inf"), "'Input' of record.csv has '-inf' in line 5,"),
    "text time": (changed(8, "Time", "x1"), "'Time' of record.csv has 'x1' in line 10,"),
    "no time": (changed(slice(None), "Time", "x1"), "'Time' of record.csv has 'x1' in line 2,"),
    "after comments": (
        "#\n\n" + changed(slice(3, 8), "Output", "a"),
        "'Output' of record.csv has 'a' in line 7,",
    ),
    "times": (
        changed(8, "Time", "1.25"),
        "'Time' of record.csv does not increase: it is 1.75 in line 9 and 1.25 in line 10.",
    ),
    "long line": (
        header() + rows() + "9,9,9,9\n",
        "Line 42 of record.csv does not fit a table of 3 columns: '9,9,9,9'.",
    ),
    "long first line": (
        "9,9,9,9\n" + rows(),
        "Line 1 of record.csv does not fit a table of 3 columns: '9,9,9,9'.",
    ),
    "quotation mark": (
        header() + rows() + '9,9,"9\n',
        "Line 42 of record.csv does not fit a table of 3 columns: '9,9,\"9'.",
    ),
    "short lines": (
        header() + rows() + "99,9\n" * 5,
        "has an empty or NaN cell in line 42,",
    ),
    "few rows": (header() + rows(columns=(T[:7], U[:7], Y[:7])), "fewer than 8 samples: only 7."),
    "no rows": (header(), "record.csv has a header but no rows of data."),
    "only comments": ("# a\n#b\n", "record.csv has no rows of data."),
    "nothing": ("", "record.csv is empty."),
    "one column": (rows(columns=(T,)), "needs columns for time and output; it has: '1'."),
    "constant": (
        rows(columns=(T, U, 0 * Y)),
        "'3' of record.csv is constant, 0, from step 1 of 1 at t = 2.5 to t = 9.75.",
    ),
    "no step": (rows(columns=(T, 0 * U, Y)), "The input '2' of record.csv has no step"),
    "drift": (
        rows(columns=(T, T + np.sin(9 * T**2), Y)),
        "The input '2' of record.csv has no step",
    ),
    "late step": (
        rows(columns=(T, T > 8.1, Y)),
        "'3' of record.csv has fewer than 8 samples from step 1 of 1 at t = 8.25 to t = 9.75:",
    ),
    "no zero time": (
        rows(columns=(T + 10, Y)),
        "goes from t = 10 to 19.75, which leaves out t = 0",
    ),
    "before zero": (
        rows(columns=(T - 11, Y)),
        "goes from t = -11 to -1.25, which leaves out t = 0",
    ),
    "one time": (
        rows(columns=(0 * T, U, Y)),
        "The time '1' of record.csv does not increase: it is 0 in line 1 and 0 in line 2.",
    ),
    "four columns": (
        "a,b,c,d\n" + rows(columns=(T, U, Y, Y)),
        "Name the columns of record.csv to use; it has: 'a', 'b', 'c', 'd'.",
    ),
    "binary": (bytes(range(256)), "record.csv is neither a text table nor a MAT file."),
    "picture": (b"\x89PNG\r\n\x1a\n\0\0", "record.csv is neither a text table nor a MAT file."),
}


@pytest.mark.parametrize("name", ERRORS)
def test_sentence_for_wrong_content(tmp_path, name):
    content, sentence = ERRORS[name]
    with pytest.raises(ValueError) as caught:
        read_record(written(tmp_path, content))
    assert type(caught.value) is ValueError
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    "options, kind, sentence",
    [
        (
            {"output": "T9"},
            KeyError,
            "record.csv has no column with data 'T9'; it has: ",
        ),
        ({"output": 4}, KeyError, "no column with data 4;"),
        ({"output": 0}, KeyError, "no column with data 0;"),
        ({"output": -1}, KeyError, "no column with data -1;"),
        ({"output": "0"}, KeyError, "no column with data '0';"),
        ({"output": "output"}, KeyError, "several columns 'output';"),
        ({"output": 1.5}, TypeError, ""),
        ({"output": True}, TypeError, ""),
        ({"output": "Output", "input": "Output"}, ValueError, "is named twice"),
        ({"time": "Time"}, ValueError, "Name the columns of record.csv to use; it has:"),
        ({"output": "Output", "step": 1, "step_time": 0}, ValueError, "step=1 needs an input"),
        ({"input": "Input", "step_time": 0}, ValueError, "tells the step: leave out the input"),
        ({"step_time": 99}, ValueError, "to 9.75, which leaves out t = 99."),
        ({"step_size": 0}, ValueError, "needs a size that is not 0, got 0."),
        ({"step_time": "noon"}, ValueError, "step_time must be a number, got 'noon'."),
        ({"begin": 9}, ValueError, "fewer than 8 samples from t = 9 to inf: only 4."),
        ({"step": 0}, ValueError, "has no step 0: there is 1, at t = 2.5."),
        ({"step": -2}, ValueError, "has no step -2: there is 1, at t = 2.5."),
        ({"step": True}, TypeError, "step must be a whole number"),
        ({"step": 1.0}, TypeError, ""),
    ],
)
def test_sentence_for_wrong_options(tmp_path, options, kind, sentence):
    names = header() if options.get("output") != "output" else "Time,Output,OUTPUT\n"
    with pytest.raises(kind) as caught:
        read_record(written(tmp_path, names + rows()), **options)
    assert sentence in caught.value.args[0]


def test_sentence_for_wrong_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"There is no file .*nothing\.csv\.$"):
        read_record(tmp_path / "nothing.csv")
    with pytest.raises(OSError, match="cannot be read: Is a directory"):
        read_record(tmp_path)
    with pytest.raises(ValueError, match=r"junk\.mat is damaged, or not a MAT file"):
        read_record(written(tmp_path, bytes(range(256)), "junk.mat"))
    scipy.io.savemat(tmp_path / "other.mat", {"a": T, "b": U, "c": Y, "d": Y})
    with pytest.raises(ValueError, match=r"other\.mat to use; it has: 'a', 'b', 'c', 'd'"):
        read_record(tmp_path / "other.mat")
    with pytest.raises(KeyError, match=r"no column with data 'y'; it has: 'a', 'b'"):
        read_record(tmp_path / "other.mat", output="y")
    scipy.io.savemat(tmp_path / "uneven.mat", {"t": T, "u": U[1:], "y": Y})
    with pytest.raises(ValueError, match=r"uneven\.mat have unequal numbers of rows"):
        read_record(tmp_path / "uneven.mat")
    scipy.io.savemat(tmp_path / "scalars.mat", {"t": 1.0, "y": np.eye(3)})
    with pytest.raises(ValueError, match="it has: none"):
        read_record(tmp_path / "scalars.mat")


def test_sentence_for_wrong_data_frames():
    with pytest.raises(
        ValueError, match=r"'Output' of DataFrame has an empty or NaN cell in row 6,"
    ):
        read_record(TUY.assign(Output=np.where((-5 <= AFTER) & (AFTER < 0), np.nan, Y)))
    with pytest.raises(ValueError, match=r"'Output' of DataFrame has .* in row 1, where a finite"):
        read_record(TUY.assign(Output=Y + 1j))
    with pytest.raises(ValueError, match="DataFrame has fewer than 8 samples: only 0"):
        read_record(TUY.iloc[:0])


def test_sentence_for_single_precision():
    frame = TUY.assign(Time=1.7e9 + T)
    with jax.enable_x64(False), pytest.raises(ValueError, match="too close together for single"):
        read_record(frame)


@real
@pytest.mark.parametrize(
    "name, columns, step, time, size, count, kept",
    [
        ("tclab_step50_run1.csv", ("T1", "Q1"), None, 0, 50, 1, 901),
        ("tclab_step50_run2.csv", ("T1", "Q1"), None, 0, 50, 1, 901),
        ("heater_multistep_kelvin.csv", ("3", "2"), 1, 11.04, 150, 3, 201),
        ("heater_multistep_kelvin.csv", ("3", "2"), 2, 201.78, -140, 3, 209),
        ("heater_multistep_kelvin.csv", ("3", "2"), 3, 402.51, 140, 3, 180),
        ("heated_box_truncated.csv", ("box temp", "control output"), 1, 62.181, 100, 2, 360),
        ("heated_box_truncated.csv", ("box temp", "control output"), -1, 800.224, -50, 2, 195),
        ("dc_motor_glitch.csv", ("Velocidad (rad/s)", "Voltaje (V)"), None, 2.02, 9, 2, 299),
        ("ball_hoop_closed_loop.mat", ("y", "yref"), None, 5, 1, 40, 100),
        ("ball_hoop_closed_loop.mat", ("y", "yref"), 12, 65, -1, 40, 52),
    ],
)
def test_real_records(name, columns, step, time, size, count, kept):
    output, input = columns
    record = read_record(DATA / name, output=output, input=input, step=step)
    np.testing.assert_allclose([record.step_time, record.step_size], [time, size], rtol=1e-6)
    assert record.details["steps_found"] == count and record.t.size == kept
    assert record.details["assumed_step"] == name.startswith("tclab")
    assert record.labels.source == name
