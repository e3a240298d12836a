"""What one result says: intervals, notes, text, a notebook's table, JSON, code to paste."""

import dataclasses
import json
import re
from html.parser import HTMLParser

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import stepax
from stepax import FOPDT, METHODS, PTn, Sani, StepRecord, identify
from stepax._cli import run
from stepax._notes import notes_of, stamp_of
from stepax.records._labels import Labels
from stepax.summary._layout import as_text


pytestmark = pytest.mark.usefixtures("quick_compilation")
T = np.arange(0.0, 60.0)
LABELS = Labels("oven.csv", "time (s)", "T [degC]", "heater (%)")


def record(rows=60, seed=0, **fields):
    clean = 20 + 8 * (1 - np.exp(-np.maximum(T - 5, 0) / 7))
    noise = 0.05 * np.random.default_rng(seed).standard_normal(T.size)
    fields = {"step_time": 3.0, "step_size": 4.0, "labels": LABELS} | fields
    return StepRecord(T[:rows], (clean + noise)[:rows], **fields)


@pytest.fixture(scope="module")
def result():
    return identify(record(), "fopdt_fit")


# Intervals


@pytest.mark.parametrize("level", [0.5, 0.95, 0.99])
def test_interval_is_students(result, level):
    freedom = T.size - 4
    assert float(result.details["degrees_of_freedom"]) == pytest.approx(freedom)
    for name in ("T", "delay", "gain", "offset"):
        low, high = result.interval(name, level)
        value, std = float(getattr(result.model, name)), float(result.std[name])
        expected = stats.t.interval(level, freedom, value, std)
        np.testing.assert_allclose((low, high), expected, rtol=1e-9)
    assert result.interval("delay") == result.interval("delay", 0.95)


def test_intervals_of_lags_and_of_what_is_fixed():
    found = METHODS["ptn_fit"](record(), order=2, fixed=("delay",))
    low, high = found.interval("lags")
    assert low.shape == high.shape == (2,)
    for name in ("lags[1]", "lag 2"):
        assert found.interval(name) == (low[1], high[1])
    assert found.interval("delay") == (0.0, 0.0)
    with pytest.raises(KeyError, match=r"PTn has no parameter 'T'; it has lags, gain"):
        found.interval("T")
    with pytest.raises(ValueError, match=r"between 0 and 1, got 95\.0"):
        found.interval("gain", 95.0)
    points = METHODS["smith_1972"](record())
    assert np.isnan(points.interval("T")).all()


def test_intervals_of_a_batch(result):
    y = jnp.stack([record(seed=seed).y for seed in range(3)])
    fit = jax.jit(jax.vmap(lambda y: METHODS["fopdt_fit"](StepRecord(T, y, 3.0, 4.0))))
    low, high = fit(y).interval("T")
    assert low.shape == (3,)
    np.testing.assert_allclose((low[0], high[0]), result.interval("T"), rtol=1e-6)


# In Python


def test_print_shows_the_summary(result):
    text = str(result)
    assert text == result.summary() == as_text(result)
    assert text.startswith("oven.csv: 60 rows, step of 4 % at t = 3 s\nModel FOPDT by fopdt_fit\n")
    assert "degC/%" in text and "95 % interval" in text and text.count("\n") > 8
    assert f"{result}" == text and "f64" not in text


def test_summary_is_what_the_command_prints(tmp_path, capsys):
    path = tmp_path / "oven.csv"
    given = record()
    rows = zip(given.t, np.where(T < 3, 0, 4), given.y, strict=True)
    path.write_text(
        "time (s),heater (%),T [degC]\n" + "".join(f"{a},{b},{c}\n" for a, b, c in rows)
    )
    assert run(["identify", str(path), "--method", "fopdt_fit"]) == 0
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    text = identify(stepax.read_record(path), "fopdt_fit").summary().splitlines()
    assert " ".join(printed).split() == " ".join(text).split()


def test_repr_is_one_line(result):
    assert re.fullmatch(
        r"Identification\(FOPDT\(T=7\.\d+, gain=[\d.]+, offset=[\d.]+, delay=[\d.]+\),"
        r" fopdt_fit, fit 9\d\.\d+ %, successful\)",
        repr(result),
    )


def test_tracers_and_batches_show_the_pytree(result):
    seen = []

    def traced(y):
        found = METHODS["fopdt_fit"](StepRecord(T, y, 3.0, 4.0))
        seen.extend([str(found), repr(found), found._repr_html_(), repr(found.model)])
        return found.rmse

    jax.eval_shape(traced, record().y)
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), eqx.filter(result, eqx.is_array))
    batch = eqx.combine(batch, result)
    seen += [str(batch), repr(batch), batch._repr_html_(), repr(batch.model)]
    for text, line, html, model in (seen[:4], seen[4:]):
        assert html is None and text == line and "f64[" in text
        assert "FOPDT(" in model
    shapes = eqx.filter_eval_shape(lambda: result)
    assert "ShapeDtypeStruct" in repr(shapes) and "ShapeDtypeStruct" in repr(shapes.model)
    assert repr(jax.tree.map(lambda _: 0, result.model)) == "FOPDT(T=0, gain=0, offset=0, delay=0)"
    assert "None" in repr(jax.tree.map(lambda _: None, result.model))  # in_axes


def test_a_refusal_speaks_too():
    flat = identify(StepRecord(T, 0 * T), "fopdt_fit")
    assert "The output does not change after the step." in str(flat)
    assert flat._repr_html_() and json.loads(flat.to_json())["parameters"]["T"] is None
    assert flat.show_model("matlab") == "% none" and flat.show_model("python-control") == "# none"


def test_concrete_models_print_their_numbers():
    assert repr(FOPDT(T=8.0, delay=1 / 3)) == "FOPDT(T=8, gain=1, offset=0, delay=0.333333)"
    assert repr(Sani(T=8.0, r=0.5, n=3)) == "Sani(T=8, r=0.5, n=3, gain=1, offset=0, delay=0)"
    assert repr(PTn(lags=[8.0, 2.5])) == "PTn(lags=[8. , 2.5], gain=1, offset=0, delay=0)"


# Notes


def noted(details, **fields):
    """Notes of a result with these details beside its own."""
    found = identify(record(), "fopdt_fit")
    details = {name: jnp.asarray(x) for name, x in details.items()}
    return notes_of(dataclasses.replace(found, details=found.details | details, **fields))


def test_quantisation_is_said_where_noise_does_not_hide_it(result):
    assert result.notes == []
    rmse = float(result.rmse)
    assert noted({"quantised": True, "quantisation": rmse}) == []
    said = noted({"quantised": True, "quantisation": 2 * rmse})
    assert len(said) == 1 and "degC, which its noise does not hide: the intervals leave" in said[0]


def test_notes_name_keywords_in_python():
    found = identify(record(), "fopdt_fit")
    details = {"steps_found": jnp.asarray(3), "rows_thinned": jnp.asarray(9000)}
    details |= {"span_of_average": jnp.asarray(0.5), "thinned_coarsely": jnp.asarray(True)}
    found = dataclasses.replace(found, details=found.details | details)
    said = " ".join(found.notes)
    assert "choose with step=; whole=True uses the whole log" in said
    assert "all_rows=True uses each row" in said and "with begin= and end= for" in said
    for text in (said, str(found), found._repr_html_()):
        assert "--" not in text.replace("-->", "")
    assert "--all-rows" in " ".join(notes_of(found))  # of the command


def test_quantised_records():
    """Rounding in steps of the noise is white noise; in steps of five times that it is not."""
    y = np.asarray(record().y)
    for step, count in ((0.05, 0), (0.25, 1)):
        found = identify(StepRecord(T, np.round(y / step) * step, 3.0, 4.0), "fopdt_fit")
        assert sum("quantised" in note for note in found.notes) == count


def test_dates():
    assert stamp_of(0.0) == "1970-01-01 00:00:00"
    assert stamp_of(1.7e9 + 0.25) == "2023-11-14 22:13:20.250"


# Notebook and JSON


class Cells(HTMLParser):
    """Text of a table's cells, and the tags that were opened and closed."""

    def __init__(self, text):
        super().__init__()
        self.cells, self.depth = [], 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.depth += 1
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag):
        self.depth -= 1

    def handle_data(self, data):
        if self.cells:
            self.cells[-1] += data


def test_html_has_the_table(result):
    html = Cells(result._repr_html_())
    assert html.depth == 0 and html.cells[:2] == ["parameter", "value"]
    for row in ("T", "gain", "offset", "delay"):
        assert row in html.cells
    hostile = dataclasses.replace(
        result, record=record(labels=Labels("<b>x</b>", "time (s)", "T [<i>]", "u"))
    )
    assert "<b>x" not in hostile._repr_html_() and "<i>" not in hostile._repr_html_()


def test_json(result):
    data = json.loads(result.to_json())
    assert data["method"] == "fopdt_fit" and data["version"] == stepax.__version__
    np.testing.assert_allclose(data["intervals"]["T"], result.interval("T"))
    assert data["aicc"] == float(result.details["aicc"]) and data["J"] == float(result.J)
    assert data["step"] == {"time": 3.0, "size": 4.0}
    assert data["units"] == {"time": "s", "output": "degC", "input": "%"} and data["notes"] == []
    s = 0.3j
    ratio = np.polyval(data["numerator"], s) / np.polyval(data["denominator"], s)
    dead = np.exp(-s * data["parameters"]["delay"])
    np.testing.assert_allclose(ratio * dead, result.model.frequency_response(0.3), rtol=1e-12)
    assert data["lags"] == [float(result.model.T)]


def test_the_method_is_known(result):
    assert result.method == METHODS["fopdt_fit"](record()).method == "fopdt_fit"
    rows = stepax.compare(record(), ["smith_1972", "broida", "fopdt_fit"]).rows
    assert all(row.result.method == row.method for row in rows)
    assert stepax.refine(record(), FOPDT(T=5.0)).method == ""
