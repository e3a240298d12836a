"""Pages to hand over: what stands in them, that nothing in a file is taken for markup or code."""

import asyncio
import json
import re
from dataclasses import replace
from importlib.resources import files
from xml.etree import ElementTree

import jax.numpy as jnp
import numpy as np
import pytest
from tests.browser import drive, needs_chromium

import stepax
from stepax import FOPDT, SOPDT, EqualLag, InputRecord, PTn, SOPDTZero, Status, StepRecord
from stepax._cli import run
from stepax._compare import Comparison, Row
from stepax._identify_each import Outcome
from stepax._notes import advice_of, notes_of
from stepax._result import conclude
from stepax._status import status_name
from stepax.methods import ROWS
from stepax.models._notation import transfer_function
from stepax.records._labels import Labels
from stepax.report._html import html
from stepax.report._pages import comparison_page, files_page, result_page


EVIL = '<script>document.title="owned"</script>'
LABELS = Labels(
    f"{EVIL}.csv", f"time {EVIL} (s)", f"$$\\alpha$$ </svg>{EVIL}& 'T' [degC]", f'"{EVIL} (%)'
)
bokeh = pytest.importorskip("bokeh")


def identification(model=None, status=Status.successful, labels=LABELS, **details):
    t = jnp.linspace(0.0, 100.0, 60)
    y = 20 + 5 * (1 - jnp.exp(-jnp.maximum(t - 14, 0) / 10)) + 0.01 * jnp.sin(37 * t)
    record = StepRecord(t, y, step_time=10.0, step_size=5.0, labels=labels)
    model = FOPDT(T=10.0, gain=1.0, offset=20.0, delay=4.0) if model is None else model
    found = {name: jnp.asarray(x) for name, x in details.items()}
    return conclude(record, model, status, details=found)


def comparison(labels=LABELS):
    rows = []
    models = {
        "fopdt_fit": FOPDT(T=10.0, gain=1.0, offset=20.0, delay=4.0),
        "viteckova_1": FOPDT(T=9.0, gain=1.0, offset=20.0, delay=4.5),
        "viteckova_2": EqualLag(T=6.0, n=2, gain=1.0, offset=20.0),
    }
    marks = {"t33": 8.0, "t70": 16.0}
    for name, model in models.items():
        result = replace(identification(model, labels=labels, **marks), method=name)
        rows.append(row(name, result))
    rows.append(row("strejc", identification(FOPDT(T=1.0), Status.no_inflection, labels)))
    return Comparison(rows[0].result.record, tuple(rows))


def row(name, result):
    numbers = [float(x) for x in (result.J, result.rmse, result.fit_percent)]
    status, reason = status_name(result.status), Status[result.status]
    model = type(result.model).__name__
    return Row(name, result, model, *numbers, 4, 1.5, status, reason, ROWS[name])


def outcomes():
    good = identification()
    bad = Outcome(f"{EVIL}.csv", "", None, f"{EVIL} has fewer than 8 samples.")
    return [Outcome("a.csv", "fopdt_fit", good, ""), bad]


PAGES = {
    "result": lambda: result_page(identification()),
    "refusal": lambda: result_page(identification(FOPDT(T=1.0), Status.no_inflection)),
    "comparison": lambda: comparison_page(comparison()),
    "files": lambda: files_page(outcomes()),
}
each = pytest.mark.parametrize("name", PAGES)


@pytest.fixture(scope="module")
def pages():
    return {name: html(make(), live=False) for name, make in PAGES.items()}


@each
def test_a_page_needs_nothing_beside_it(pages, name):
    page = pages[name]
    assert page.startswith("<!DOCTYPE html>") and "default-src 'none'" in page
    addresses = set(re.findall(r"https?://[^\"' <]*", page))
    assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    assert "<script" not in page and "<link" not in page and "@import" not in page


@each
def test_names_of_a_file_are_text(pages, name):
    page = pages[name]
    assert "owned" in page and EVIL not in page
    for picture in re.findall(r"<svg.*?</svg>", page, re.S):
        ElementTree.fromstring(picture.replace("<svg ", '<svg xmlns:xlink="x" ', 1))


@each
def test_ids_are_unique_and_known(pages, name):
    page = pages[name]
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(set(ids)) == len(ids)
    assert set(re.findall(r'(?:href="|url\()#([^")]*)', page)) <= set(ids)


def test_what_a_page_says(pages):
    page = pages["result"]
    for words in ["Model FOPDT", "Parameters", "To paste", "MATLAB", "signal.TransferFunction"]:
        assert words in page
    assert f"stepax {stepax.__version__}" in page and "rows used" in page
    assert page.count("<svg") == 4  # two pictures, each wide and narrow
    assert "no usable tangent" in pages["refusal"] and "To paste" not in pages["refusal"]
    page = pages["comparison"]
    assert "viteckova_2" in page and "3 methods give a model" in page and "no usable" in page
    assert "2 files, 1 of them with a model" in pages["files"] and "a.csv" in pages["files"]


def test_notes_tell_what_to_do():
    result = identification(status=Status.not_settled, residuals_correlated=True)
    advice = advice_of(result)
    assert [sentence for sentence, _ in advice] == notes_of(result) and len(advice) == 2
    page = html(result_page(result), live=False)
    assert "Record until the output rests" in page


@pytest.mark.parametrize("live", [True, False])
def test_as_many_rows_as_there_are(live):
    """A picture of few rows has points, one of many a line: a page stays under 3 MB."""
    t = jnp.linspace(0.0, 100.0, 20_000)
    y = 20 + 5 * (1 - jnp.exp(-t / 10)) + 0.3 * jnp.sin(37 * t)
    model = FOPDT(T=10.0, gain=5.0, offset=20.0)
    result = conclude(StepRecord(t, y), model, Status.successful)
    assert len(html(result_page(result), live)) < 3e6


def test_report_of_a_result_and_of_a_comparison(tmp_path):
    identification().report(tmp_path / "a.html")
    comparison().report(str(tmp_path / "b.html"), "first")
    assert b"Model FOPDT" in (tmp_path / "a.html").read_bytes()
    text = (tmp_path / "b.html").read_text()
    assert "2 methods give a model" in text and "viteckova_2" not in text
    with pytest.raises(ValueError, match=r"let its name end in \.html"):
        identification().report(tmp_path / "a.pdf")
    with pytest.raises(FileNotFoundError, match="no folder"):
        identification().report(tmp_path / "nowhere" / "a.html")


# Typesetting


MODELS = [
    FOPDT(T=8.0, gain=-2.0, delay=1.5),
    SOPDT(zeta=0.4, omega_n=0.5, gain=3e-7),
    SOPDTZero(zeta=0.7, omega_n=0.4, lead=-3.0, gain=2.0),
    EqualLag(T=4.0, n=2.5, gain=2.0),
    PTn(lags=[8.0, 2.0, 2.0], gain=2.0, delay=0.25),
]


def meaning(node):
    """A MathML element as an expression of Python."""
    children = [meaning(child) for child in node if child.get("class") != "name"]
    match node.tag:
        case "mn":
            return node.text.replace("−", "-")
        case "mi":
            return {"s": "s", "e": "E"}[node.text]
        case "mo":
            return {"−": "-", "·": "*"}.get(node.text, node.text)
        case "mspace":
            return ""
        case "mfrac":
            return f"({children[0]})/({children[1]})"
        case "msup":
            return f"({children[0]})**({children[1]})"
    text = ""
    for part in filter(None, children):
        product = text and text[-1] not in "(+-*" and part[0] not in ")+-*"
        text += ("*" if product else "") + part
    return text


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_the_formula_means_the_model(model):
    tree = ElementTree.fromstring(transfer_function(model, "mathml"))
    s = 1j * np.geomspace(0.01, 3.0, 20)
    found = eval(meaning(tree), {"s": s, "E": np.e, "__builtins__": {}})
    expected = np.asarray(model.frequency_response(jnp.asarray(s.imag)))
    np.testing.assert_allclose(found, expected, rtol=2e-3)  # four digits are written


# The command


@pytest.fixture
def own_cache(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))


def test_the_command_writes_it(capsys, own_cache, tmp_path):
    out = tmp_path / "out.html"
    example = ["--example", "heater", "--report", str(out)]
    assert run(["identify", *example, "--method", "viteckova_1"]) == 0
    page = out.read_text()
    assert f"Written: {out}" in capsys.readouterr().out
    assert "stepax identify --example heater --report" in page and "is simulated" in page
    assert run(["compare", *example, "--methods", "viteckova_1,viteckova_2"]) == 0
    assert "methods compared" in out.read_text()
    for name in ("a.csv", "b.csv"):
        heater = files("stepax") / "examples" / "heater.csv"
        (tmp_path / name).write_bytes(heater.read_bytes())
    command = ["identify", str(tmp_path), "--method", "viteckova_1", "--report", str(out)]
    assert run(command) == 0
    assert "2 files, 2 of them with a model" in out.read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--report", "{}/a.pdf"], "let its name end in .html"),
        (["--report", "{}/a.html", "--plot", "{}/a.html"], "--plot and --report name the same"),
        (["--report", "{}/none/a.html"], "no folder"),
    ],
)
def test_a_wrong_name_is_told_before_the_work(capsys, tmp_path, options, words):
    options = [option.format(tmp_path) for option in options]
    assert run(["identify", "--example", "heater", *options]) == 2
    assert words in capsys.readouterr().err and list(tmp_path.iterdir()) == []


# In a browser


@needs_chromium
def test_in_a_browser(tmp_path):
    """No request, no complaint, nothing wider than the window, pictures drawn, and on paper."""

    async def story(page):
        for name, make in PAGES.items():
            file = tmp_path / f"{name}.html"
            file.write_text(html(make(), live=True))
            assert file.stat().st_size < 3e6
            for width in (1400, 390):
                page.requests.clear()
                await page.show(file.as_uri(), width)
                if name in ("result", "comparison"):
                    await page.until("document.querySelector('.live').offsetHeight > 100")
                await asyncio.sleep(0.2)
                assert await page.run("document.documentElement.scrollWidth") == width
                assert page.requests == [file.as_uri()] and page.complaints == []
                assert await page.run("document.title") != "owned"
            await page.print(tmp_path / f"{name}.pdf")
            assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")

    drive(story)


def test_live_pictures_hold_the_numbers():
    from stepax.plots._live import live_responses

    found = comparison()
    item = json.dumps(bokeh.embed.json_item(live_responses(found.record, found.entries())))
    assert item.count('"PlainText"') >= 3 and "viteckova_1" in item


def test_a_sampled_input_is_reported():
    """It has no step: the page names the range of the input instead."""
    t = np.arange(60.0)
    u = np.where((t > 5) & (t < 30), 4.0, 1.0)
    record = InputRecord(t, np.cumsum(u) / 60, u)
    result = conclude(record, FOPDT(T=9.0, gain=0.4), Status.successful)
    for live in (False, True):
        page = html(result_page(result), live)
        assert "input from 1 to 4" in page and "1 to 4" in page
