"""The command line: output, files and what goes wrong."""

import dataclasses
import importlib.util
import json
import os
import subprocess
import sys
from types import ModuleType, SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import stepax
from stepax import FOPDT, PTn, Status
from stepax._cli import run, set_up_jax
from stepax._compare import Comparison, Row
from stepax._options import EXAMPLES
from stepax._result import conclude
from stepax._status import status_name
from stepax.curves._lookup import Lookup
from stepax.methods import METHODS, ROWS


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path_factory):
    """Compiled code of tests goes to a folder of its own."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture
def front(monkeypatch):
    """A front door that needs no time: a first-order model, or a refusal of what is asked."""
    calls = SimpleNamespace(status=Status.successful, methods=[])

    def identify(record, method="auto", **options):
        if method not in ("auto", *METHODS):
            raise KeyError(f"There is no method {method!r}; the known ones are: auto, fopdt_fit.")
        calls.methods.append(method)
        model = FOPDT(T=60.0, gain=0.8, offset=22.0, delay=15.0)
        details = {"aicc_fopdt": jnp.asarray(3.0)} if method == "auto" else {}
        result = conclude(record, model, calls.status, details=record.details | details)
        return dataclasses.replace(result, method="fopdt_fit")

    def compare(record, methods=None, plant=None, all_rows=False):
        return Comparison(record, (row("fopdt_fit", identify(record)), lost(record)))

    def row(method, result):
        numbers = [float(x) for x in (result.J, result.rmse, result.fit_percent)]
        status, reason = status_name(result.status), Status[result.status]
        return Row(method, result, "FOPDT", *numbers, 4, 1.5, status, reason, ROWS[method])

    def lost(record):
        return row("strejc", conclude(record, FOPDT(T=1.0), Status.levels_not_crossed))

    module = ModuleType("stepax._identify")
    module.__dict__.update(
        AUTO=("fopdt_fit",),
        identify=identify,
    )
    monkeypatch.setitem(sys.modules, "stepax._identify", module)
    many = "stepax._identify_each"
    monkeypatch.setattr(f"{many}.identify_filled", lambda *args: identify(args[0], args[1]))
    monkeypatch.setattr("stepax._compare.compare", compare)
    return calls


@pytest.fixture
def csv(tmp_path):
    t = np.arange(60.0)
    u, y = 2.0 * (t >= 10), 3 + np.maximum(0, 1 - np.exp(-(t - 10) / 8))
    path = tmp_path / "run 1.csv"
    rows = "\n".join(f"{a},{b},{c:.4f}" for a, b, c in zip(t, u, y, strict=True))
    path.write_text(f"time (s),valve (%),level [m]\n{rows}\n")
    return path


def failure(capsys, *arguments):
    """The one paragraph on stderr of a command that fails."""
    assert run([str(argument) for argument in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.endswith("\n")
    (paragraph,) = captured.err.splitlines()
    return paragraph


def success(capsys, *arguments):
    assert run([str(argument) for argument in arguments]) == 0
    captured = capsys.readouterr()
    assert captured.err == "" and "\x1b" not in captured.out
    return captured.out


def test_identify(capsys, front, csv, tmp_path):
    plot, data = tmp_path / "a.png", tmp_path / "a.json"
    out = success(capsys, "identify", csv, "--plot", plot, "--json", data)
    assert "Model FOPDT by fopdt_fit, chosen by AICc" in out and "m/%" in out
    assert "run 1.csv: 60 rows, step of 2 % at t = 10 s" in out and str(plot) in out
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert json.loads(data.read_text())["method"] == "fopdt_fit"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.png", "run 1.csv"]


def test_columns_and_method(capsys, front, csv):
    columns = ["--time", "time (s)", "--output", "3", "--input", "valve (%)", "--step", "1"]
    out = success(capsys, "identify", csv, *columns, "--method", "fopdt_fit")
    assert "Model FOPDT by fopdt_fit\n" in out and front.methods == ["fopdt_fit"]


def test_example(capsys, front):
    out = success(capsys, "identify", "--example", "heater")
    assert "simulated" in out and "step of 40 % at t = 20 s" in out and "degC/%" in out


def test_compare(capsys, front, csv, tmp_path):
    plot, data = tmp_path / "b.svg", tmp_path / "b.json"
    out = success(capsys, "compare", csv, "--plot", plot, "--json", data)
    assert "FOPDT" in out and f"strejc: {Status[Status.levels_not_crossed]}" in out
    assert "<svg" in plot.read_text()
    assert [row["method"] for row in json.loads(data.read_text())] == ["fopdt_fit"]
    assert "FOPDT" in success(capsys, "compare", csv, "--group", "first", "--kind", "bar")
    assert "no method of the group nth" in failure(capsys, "compare", csv, "--group", "nth")
    assert "second" in failure(capsys, "compare", csv, "--group", "third")
    assert "pie" in failure(capsys, "compare", csv, "--kind", "tart")


def test_refusals(capsys, front, csv, tmp_path):
    front.status = Status.no_inflection
    for command in ("identify", "compare"):
        message = failure(capsys, command, csv, "--plot", tmp_path / "c.png")
        assert "run 1.csv: " in message and Status[Status.no_inflection] in message
    assert list(tmp_path.iterdir()) == [csv]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["FILE", "--method", "magic"], ["magic", "fopdt_fit"]),
        (["FILE", "--output", "speed"], ["run 1.csv", "speed", "level [m]"]),
        (["FILE", "--step", "4"], ["no step 4"]),
        (["FILE", "--step", "one"], ["--step"]),
        (["FILE", "--example", "heater"], ["not both"]),
        ([], ["FILE", "--example"]),
        (["--example", "kettle"], ["kettle", *EXAMPLES]),
        (["missing.csv"], ["missing.csv"]),
        (["FILE", "--plot", "nowhere/a.png"], ["nowhere"]),
        (["FILE", "--plot", "a.docx"], ["a.docx", "png"]),
        (["FILE", "--plot", "a"], ["png"]),
        (["FILE", "--json", "FILE"], ["is the record"]),
        (["FILE", "--json", "."], ["no ordinary file"]),
        (["FILE", "--wrong"], ["--wrong"]),
        (["FILE", "--plot", "a.png", "--json", "a.png"], ["same file"]),
    ],
)
def test_wrong_input(capsys, front, csv, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    options = [csv.name if option == "FILE" else option for option in options]
    message = failure(capsys, "identify", *options)
    assert all(word in message for word in words)
    assert [path.name for path in tmp_path.iterdir()] == [csv.name]


def test_a_failure_while_writing_leaves_the_old_files(capsys, front, csv, tmp_path, monkeypatch):
    plot, data = tmp_path / "d.png", tmp_path / "d.json"
    plot.write_text("old")
    data.write_text("old")

    def full(*paths):
        raise OSError(28, "No space left on device", str(paths[1]))

    monkeypatch.setattr(os, "replace", full)
    message = failure(capsys, "identify", csv, "--plot", plot, "--json", data)
    assert "No space left" in message
    assert plot.read_text() == data.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 3


# Several files


NAMES = ("a", "b", "bad")


@pytest.fixture
def folder(csv):
    """Two records, and a file that is none."""
    place = csv.parent / "runs"
    place.mkdir()
    for name in ("a.csv", "b.csv"):
        (place / name).write_bytes(csv.read_bytes())
    (place / "bad.csv").write_text("time,level\n")
    (place / "readme.txt").write_text("no record\n")
    return place


def table_rows(out, names):
    """The row of each file, in the order of the output."""
    rows = [line for line in out.splitlines() if any(f"{name}.csv" in line for name in names)]
    return [row for row in rows if not row.startswith("Written")]


def test_a_folder(capsys, front, folder, tmp_path):
    pictures, frame = tmp_path / "pictures", tmp_path / "all.csv"
    out = success(capsys, "identify", folder, "--plot", pictures, "--csv", frame)
    rows = table_rows(out, NAMES)
    assert [row.split()[0] for row in rows] == [str(folder / f"{x}.csv") for x in NAMES]
    assert all("FOPDT" in row and "0.8" in row for row in rows[:2])
    assert "no rows of data" in rows[2] and "FOPDT" not in rows[2] and "readme" not in out
    assert front.methods == ["auto", "auto"]
    assert sorted(path.name for path in pictures.iterdir()) == ["a.png", "b.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures.iterdir())
    assert all(f"Written: {path}" in out for path in (*pictures.iterdir(), frame))
    written = pd.read_csv(frame)
    assert list(written["source"]) == [str(folder / f"{x}.csv") for x in NAMES]
    assert list(written["method"])[:2] == ["fopdt_fit"] * 2 and list(written["T"])[:2] == [60, 60]
    assert list(written["status"]) == ["successful"] * 2 + ["unreadable"]


def test_several_files_with_columns_and_method(capsys, front, csv, folder):
    columns = ["--time", "time (s)", "--output", "3", "--input", "valve (%)"]
    out = success(capsys, "identify", csv, folder / "b.csv", *columns, "--method", "strejc")
    assert len(table_rows(out, ["run 1", "b"])) == 2 and front.methods == ["strejc"] * 2


def test_a_folder_of_one_file(capsys, front, folder):
    for name in ("b.csv", "bad.csv"):
        (folder / name).unlink()
    assert len(table_rows(success(capsys, "identify", folder), ["a"])) == 1


def test_files_of_one_name_get_different_pictures(capsys, front, csv, tmp_path):
    """Also where another file has the name that a number would make."""
    paths = [tmp_path / folder / name for folder in "xyz" for name in ("run_2.csv", "run.csv")]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(csv.read_bytes())
    pictures = tmp_path / "pictures"
    out = success(capsys, "identify", *paths, "--plot", pictures)
    assert len(list(pictures.iterdir())) == len(paths) == 6
    assert {"run.png", "run_2.png"} < {path.name for path in pictures.iterdir()}
    assert out.count("Written: ") == 6


def test_no_file_can_be_used(capsys, front, csv, folder, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    more = ["--csv", tmp_path / "all.csv", "--plot", tmp_path / "pictures"]
    message = failure(capsys, "identify", folder / "bad.csv", "missing.csv", *more)
    assert "No file could be used" in message and "bad.csv has a header" in message
    front.status = Status.no_inflection
    message = failure(capsys, "identify", csv, folder / "a.csv", *more)
    assert str(csv) in message and Status[Status.no_inflection] in message
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["runs", "--json", "a.json"], ["--csv OUT.csv"]),
        (["runs", "run 1.csv", "--example", "heater"], ["--csv"]),
        (["run 1.csv", "--csv", "all.csv"], ["--csv is for several files"]),
        (["--example", "heater", "--csv", "all.csv"], ["--csv is for several files"]),
        (["runs", "--plot", "run 1.csv"], ["run 1.csv is no folder"]),
        (["runs", "--plot", "no/where"], ["no folder no"]),
        (["runs", "--csv", "runs/a.csv"], ["is the record"]),
        (["runs", "--csv", "nowhere/all.csv"], ["nowhere"]),
        (["empty", "runs/none"], ["No file could be used"]),
        (["empty"], ["no CSV files in empty"]),
        (["runs", "--method", "magic"], ["magic"]),
    ],
)
def test_wrong_combinations(capsys, front, folder, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    before = sorted(tmp_path.rglob("*"))
    message = failure(capsys, "identify", *options)
    assert all(word in message for word in words)
    assert sorted(tmp_path.rglob("*")) == before


def test_methods(capsys, monkeypatch):
    def strejc(record):
        """Strejc's method: equal lags from Tu/Tg.

        More.
        """

    module = ModuleType("stepax.methods")
    module.__dict__.update(METHODS={"strejc": strejc}, MODELS={"strejc": PTn})
    monkeypatch.setitem(sys.modules, "stepax.methods", module)
    out = success(capsys, "methods")
    assert "auto" in out and "Strejc's method: equal lags from Tu/Tg." in out and "PTn" in out


def test_lookup(capsys, monkeypatch):
    def look_up(family, formula=False, **times):
        short = times["t50"] < 3
        status = Status.where(short, Status.at_equal_lags, Status.beyond_last_order)
        return Lookup(family(T=times["t50"], r=0.0, n=jnp.asarray(3)), status)

    monkeypatch.setattr("stepax.curves._lookup.lookup", look_up)
    out = success(capsys, "lookup", "--t10", "1", "--t50", "2", "--t90", "4")
    rows = [line.split()[:5] for line in out.splitlines()[3:6]]
    assert rows[0] == ["exact", "Hudzovic", "3", "0", "2"]
    assert [row[:2] for row in rows[1:]] == [["exact", "Sani"], ["formulae", "Sani"]]
    assert Status[Status.at_equal_lags] in out
    message = failure(capsys, "lookup", "--t10", "1", "--t50", "5", "--t90", "6")
    assert "t50 = 5" in message and Status[Status.beyond_last_order] in message


def test_version(capsys):
    assert success(capsys, "--version") == f"{stepax.__version__}\n"


@pytest.mark.long
def test_lookup_in_a_shell():
    done = shell("lookup", "--Tu", "2", "--Tg", "10")
    rows = [line.split() for line in done.stdout.splitlines() if "exact" in line]
    assert rows[0][1:5] == ["Hudzovic", "3", "0.29814", "1.6594"] and "successful" in rows[1]


def test_lookup_needs_times_of_one_kind(capsys):
    for times in (["--Tu", "2"], ["--Tu", "2", "--Tg", "9", "--t50", "3"], []):
        assert "--t90" in failure(capsys, "lookup", *times)


def test_cache_folder(monkeypatch, tmp_path):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    old = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    try:
        set_up_jax()
        assert jax.config.jax_compilation_cache_dir == str(tmp_path / "stepax")  # type: ignore[attr-defined]
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
        set_up_jax()
    finally:
        jax.config.update("jax_compilation_cache_dir", old)


def shell(*arguments):
    command = [sys.executable, "-c", "from stepax._cli import main; main()", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


def test_in_a_shell():
    done = shell("identify", "nowhere.csv")
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr == "stepax: There is no file nowhere.csv.\n"


@pytest.mark.skipif(importlib.util.find_spec("stepax._identify") is None, reason="no front door")
@pytest.mark.long
def test_example_in_a_shell(tmp_path):
    data = tmp_path / "heater.json"
    done = shell("identify", "--example", "heater", "--json", str(data))
    assert done.returncode == 0 and "simulated" in done.stdout
    assert abs(json.loads(data.read_text())["parameters"]["gain"] - 0.8) < 0.01


# Options of reading and fitting


@pytest.fixture
def bare(tmp_path):
    """A log without an input column, of which the step came at 10 s."""
    t = np.arange(60.0)
    y = 3 + 2 * np.maximum(0, 1 - np.exp(-(t - 10) / 8)) + 0.01 * np.sin(37 * t)
    path = tmp_path / "bare.csv"
    path.write_text("t,y\n" + "".join(f"{a},{b:.4f}\n" for a, b in zip(t, y, strict=True)))
    return path


def test_options_reach_the_reading(capsys, front, bare):
    said = success(
        capsys, "identify", bare, "--step-time", "10", "--step-size", "4", "--initial", "3",
        "--final", "5", "--from", "2", "--to", "50",
    )  # fmt: skip
    assert "bare.csv: 49 rows, step of 4 at t = 10" in said and "No input column" not in said
    assert "tell another" in success(capsys, "identify", bare)
    assert "step of 4 at t = 10" in success(
        capsys, "compare", bare, "--step-time", "10", "--step-size", "4"
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--from", "55"], ["fewer than 8 samples from t = 55 to inf: only 5"]),
        (["--to", "noon"], ["end must be a number", "noon"]),
        (["--step-time", "99"], ["leaves out t = 99"]),
        (["--step-size", "0"], ["size that is not 0"]),
        (["--step-size", "big"], ["--step-size"]),
    ],
)
def test_wrong_options_of_reading(capsys, front, bare, options, words):
    message = failure(capsys, "identify", bare, *options)
    assert all(word in message for word in words)


def test_options_reach_the_fit(capsys, bare, tmp_path):
    data = tmp_path / "a.json"
    told = ["--step-time", "10", "--method", "fopdt_fit", "--json", data]
    success(capsys, "identify", bare, *told, "--loss", "huber", "--fixed", "delay", "--all-rows")
    found = json.loads(data.read_text())
    assert found["parameters"]["delay"] == 0 and found["standard_errors"]["delay"] == 0
    assert abs(found["parameters"]["T"] - 8) < 0.2 and found["step"] == {"time": 10, "size": 1}
    for options, words in [
        (["--loss", "cubes"], "loss must be one of squares, huber, got 'cubes'."),
        (["--span", "0.2"], "no option 'span'"),
        (["--fixed", "zeta"], "FOPDT has no parameter 'zeta' to fix; it has T, gain"),
    ]:
        assert words in failure(capsys, "identify", bare, *told, *options)
    said = success(capsys, "identify", bare, "--method", "tangent_63", "--span", "0.2", *told[:2])
    assert "by tangent_63" in said


def test_methods_of_a_comparison(capsys, bare):
    said = success(capsys, "compare", bare, "--methods", "smith_1972, broida", "--step-time", "10")
    assert "smith_1972" in said and "broida" in said and "alfaro" not in said
    assert "Unknown method 'magic'" in failure(capsys, "compare", bare, "--methods", "magic")
