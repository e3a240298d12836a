"""Reports: transfer functions, units, warnings and JSON."""

import json
import math
from dataclasses import replace
from io import StringIO

import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from stepax import FOPDT, SOPDT, EqualLag, PTn, Sani, Status, StepRecord
from stepax._compare import Comparison, Row
from stepax._notes import notes_of
from stepax._result import conclude
from stepax.methods import ROWS
from stepax.records._labels import Labels
from stepax.report._content import comparison_content, content, to_json
from stepax.report._terminal import report


LABELS = Labels("oven.csv", "time (s)", "T [degC]", "heater (%)")


def identification(model, status=Status.successful, labels=LABELS, details=None, **options):
    t = jnp.linspace(0.0, 100.0, 40)
    y = 20 + 5 * (1 - jnp.exp(-t / 10)) + 0.01 * jnp.sin(37 * t)
    record = StepRecord(t, y, labels=labels, details=details)
    return conclude(record, model, status, **options)


def text_of(renderable):
    console = Console(width=200, no_color=True, record=True, file=StringIO())
    console.print(renderable)
    return console.export_text()


def test_report():
    std = {"T": 0.123, "gain": 0.01, "offset": 0.0, "delay": math.nan}
    std = {name: jnp.asarray(value) for name, value in std.items()}
    model = FOPDT(T=10.0, gain=5.0, offset=20.0)
    result = identification(model, free=("T", "gain", "delay"))
    result = replace(result, std=std)
    text = text_of(report(result, "fopdt_fit"))
    assert "Model FOPDT by fopdt_fit" in text and "G(s) = 5 / (1 + 10 s)" in text
    assert "9.76 to 10.24" in text and "degC/%" in text and "fixed" in text
    assert "RMSE" in text and "degC^2 s" in text and Status[Status.successful] in text


def test_warnings():
    details = {
        "assumed_step": True,
        "steps_found": 3,
        "quantised": True,
        "quantisation": 0.32,
        "residuals_correlated": True,
        "residual_autocorrelation": 0.93,
    }
    details = {name: jnp.asarray(value) for name, value in details.items()}
    model = FOPDT(T=10.0, gain=5.0, offset=20.0)
    result = identification(model, Status.not_settled, details=details)
    sentences = notes_of(result)
    assert sentences[0] == Status[Status.not_settled] and len(sentences) == 5
    whole = "--whole uses the whole log with its input."
    several = "3 steps in the input; this is step 1: choose with --step"
    assert f"{several}; {whole}" in sentences
    assert f"3 steps in the input; this is step 3; {whole}" in notes_of(result, -1)
    assert any("0.32 degC, which its noise does not hide" in text for text in sentences)
    assert any("0.93" in text for text in sentences)
    assert notes_of(identification(FOPDT(T=10.0, gain=5.0, offset=20.0))) == []
    assert "Note: " + sentences[0] in text_of(report(result, "x"))


@pytest.mark.parametrize(
    "model",
    [
        FOPDT(T=10.0),
        PTn(lags=np.array([10.0, 1.0])),
        Sani(T=10.0, r=0.5, n=jnp.asarray(2)),
        EqualLag(T=2.0, n=2.5),
        SOPDT(zeta=0.5, omega_n=1.0),
    ],
    ids=lambda model: type(model).__name__,
)
def test_json(model):
    result = identification(model)
    data = to_json(result, "name")
    assert list(data)[:7] == [
        "method", "model", "parameters", "standard_errors", "rmse", "fit_percent", "status"
    ]  # fmt: skip
    assert set(list(data)[7:]) == {
        "J", "aicc", "intervals", "lags", "numerator", "denominator", "step", "units", "notes",
        "version",
    }  # fmt: skip
    assert data["model"] == type(model).__name__ and data["status"] == "successful"
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    for name, value in data["parameters"].items():
        np.testing.assert_allclose(value, getattr(model, name))
    if isinstance(model, PTn):
        assert data["standard_errors"]["lags"] == [None, None]
    if isinstance(model, Sani):
        assert data["parameters"]["n"] == 2 and isinstance(data["parameters"]["n"], int)
        assert "n" not in data["standard_errors"]


def test_json_of_a_refusal():
    data = to_json(identification(FOPDT(T=10.0), Status.no_inflection), "name")
    assert data["parameters"]["T"] is None and data["rmse"] is None
    assert data["status"] == "no_inflection"


def test_what_is_uncertain_is_named():
    free = ("T", "gain", "delay")
    details = {
        "at_bound": jnp.array([False, False, True]),
        "identifiable": jnp.array([True, False, True]),
        "steps_found": jnp.array(0),
    }
    model = FOPDT(T=300.0, gain=5.0, offset=20.0)
    result = identification(model, Status.not_identifiable, free=free, details=details)
    text = " ".join(notes_of(result))
    assert "determined by this record: gain." in text and "The dead time is at the end" in text
    assert "The fit is only" in text and "No input column" in text
    assert result.show_model() == "5 / (1 + 300 s)"
    assert "No input column" not in " ".join(notes_of(identification(FOPDT(T=10.0))))


def is_text(tree):
    if isinstance(tree, list | tuple):
        return all(map(is_text, tree))
    return isinstance(tree, str | int)  # numbers of columns


def test_content_is_plain_text():
    std = {"T": 0.123, "gain": 0.01, "offset": 0.0, "delay": math.nan}
    result = identification(
        FOPDT(T=10.0, gain=5.0, offset=20.0),
        free=("T", "gain", "delay"),
    )
    aicc = {"aicc_sani_fit": jnp.asarray(-3.0), "aicc_fopdt_fit": jnp.asarray(-8.25)}
    std = {name: jnp.asarray(value) for name, value in std.items()}
    said = content(replace(result, std=std, details=aicc), "fopdt_fit")
    assert is_text(said)
    assert said.heading == ["Model FOPDT by fopdt_fit", "G(s) = 5 / (1 + 10 s)"]
    assert said.ranking == [("fopdt_fit", "-8.25"), ("sani_fit", "-3")]
    assert said.parameters.rows == [
        ("T", "10", "0.12", "9.76 to 10.24", "s"),
        ("gain", "5", "0.01", "4.98 to 5.02", "degC/%"),
        ("offset", "20", "fixed", "", "degC"),
        ("delay", "0", "", "", "s"),
    ]
    assert [name for name, _ in said.quality] == ["fit", "RMSE", "J"]
    assert said.verdict == Status[Status.successful] and said.notes == []


def test_lags_have_one_name_in_table_and_notes():
    free = ("lags[0]", "lags[1]", "gain")
    details = {"at_bound": jnp.array([False, True, False])}
    model = PTn(lags=[10.0, 2.0], gain=5.0, offset=20.0)
    said = content(identification(model, Status.at_bound, free=free, details=details), "ptn_fit")
    assert [row[0] for row in said.parameters.rows[:3]] == ["lag 1", "lag 2", "gain"]
    assert "At the end of its range: lag 2." in said.notes and said.verdict == ""


def test_content_of_a_comparison():
    good = identification(FOPDT(T=10.0, gain=5.0, offset=20.0))
    lost = identification(PTn(lags=[1.0]), Status.no_inflection)
    figures = (0.02, 0.01, 99.0, 4, -3.5)
    rows = (
        Row("viteckova_1", good, "FOPDT", *figures, "successful", "Fine.", ROWS["viteckova_1"]),
        Row("smith", lost, "PTn", *figures, "no_inflection", "None.", ROWS["smith"]),
    )
    said = comparison_content(Comparison(good.record, rows))
    assert is_text(said) and "J, degC^2 s" in said.ranking.columns
    texts = ("0.02", "0.01", "99", "4", "-3.5", "5 / (1 + 10 s)")
    assert said.ranking.rows == [("1", "viteckova_1", "FOPDT", *texts)]
    assert said.notes == ["smith: None."]
