"""Pictures on the command line."""

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from tests.records.rendered import PLOTS, lag

from stepax._cli import run


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    plot = next(plot for plot in PLOTS if plot.name == "lag")
    return plot.written(tmp_path_factory.mktemp("plots"))[0]


TICKS = ["--x-ticks", "0", "10", "--y-ticks", "22", "36"]


def success(capsys, *arguments):
    assert run([str(argument) for argument in arguments]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out


def failure(capsys, *arguments):
    assert run([str(argument) for argument in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    (paragraph,) = captured.err.splitlines()
    return paragraph


def test_what_was_found(capsys, picture, tmp_path):
    overlay = tmp_path / "check.png"
    out = success(capsys, "trace", picture, "--overlay", overlay)
    assert "6 tick marks on x and 8 on y" in out and "#1f77b4" in out and str(overlay) in out
    with Image.open(overlay) as image:
        assert image.width > 1000


def test_csv(capsys, picture, tmp_path):
    csv = tmp_path / "out.csv"
    out = success(capsys, "trace", picture, *TICKS, "--csv", csv)
    assert "step of 1 at t = 0" in out and "standard deviation" in out
    table = pd.read_csv(csv)
    assert list(table) == ["time", "output"]
    truth = 22 + 15 * lag(table["time"].to_numpy())
    assert np.sqrt(np.mean((table["output"] - truth) ** 2)) < 0.02


def test_options_of_a_picture(capsys, picture):
    points = ["--point", "100,400=0,22", "--point", "500,100=8,36"]
    out = success(capsys, "trace", picture, *points, "--step-time", "auto", "--step-size", "2")
    assert "step of 2 at t = " in out


def test_identify_and_compare(capsys, picture, tmp_path):
    out = success(capsys, "identify", picture, *TICKS, "--method", "fopdt_fit")
    assert "Model FOPDT by fopdt_fit" in out and "lag.png: " in out
    out = success(
        capsys, "identify", picture, picture, *TICKS, "--method", "fopdt_fit", "--csv",
        tmp_path / "models.csv",
    )  # fmt: skip
    assert len(pd.read_csv(tmp_path / "models.csv")) == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["identify", "PICTURE"], "For x and y give"),
        (["compare", "PICTURE", "--x-range", "0", "10"], "For y give"),
        (["trace", "PICTURE", "--x-range", "10", "0"], "from a smaller to a larger"),
        (["trace", "PICTURE", *TICKS, "--color", "red"], "no curve in red"),
        (["trace", "PICTURE", *TICKS, "--point", "1;2"], "PX,PY=X,Y"),
        (["trace", "PICTURE", *TICKS, "--step-time", "soon"], "a number or auto"),
        (["trace", "PICTURE", *TICKS, "--csv", "PICTURE"], "is the record"),
        (["trace", "PICTURE", "--overlay", "out.jpg"], "let its name end in .png"),
        (["trace", "missing.png"], "There is no file missing.png"),
        (["identify", "PICTURE", *TICKS, "--time", "t"], "without columns: leave out --time"),
        (["identify", "--example", "heater", *TICKS], "is no picture: --x-ticks is for pictures"),
    ],
)
def test_one_sentence(capsys, picture, arguments, words):
    sentence = failure(capsys, *(picture if x == "PICTURE" else x for x in arguments))
    assert words in sentence
