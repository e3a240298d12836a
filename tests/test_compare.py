"""Comparison of methods: ranking, the exact integral, transfer functions, pictures."""

from io import BytesIO

import jax.numpy as jnp
import numpy as np
import pytest

from stepax import FOPDT, SOPDT, EqualLag, PTn, Sani, Status, StepRecord, compare
from stepax._compare import Comparison, Row, level_marks, tangent_ends
from stepax._identify import parameter_count
from stepax._result import conclude
from stepax.methods._method import Method
from stepax.models._deviation import squared_deviation
from stepax.records._labels import Labels


TIMES = np.linspace(0.0, 80.0, 240)
PLANT = Sani(T=8.0, r=0.5, n=3, gain=2.0, offset=1.0)
NAMES = ["sani_t10_t50_t90", "sani_interpolation", "sani_tu_tg", "fopdt_fit"]


@pytest.fixture(scope="module")
def record():
    y = np.asarray(PLANT.step_response(TIMES))
    return StepRecord(TIMES, y, initial=1.0, final=3.0, labels=Labels("p.csv", "time (s)", "T (K)"))


@pytest.fixture(scope="module")
def comparison(record):
    return compare(record, NAMES)


def test_ranked_by_J(comparison):
    errors = [row.J for row in comparison.rows]
    assert errors == sorted(errors)
    assert comparison.best is comparison.rows[0].result
    frame = comparison.to_frame()
    assert list(frame["method"]) == [row.method for row in comparison.rows]
    assert {"model", "J", "rmse", "fit_percent", "parameters", "aicc", "status", "reason"} <= set(
        frame.columns
    )


def test_a_known_plant(record):
    rows = compare(record, NAMES, plant=PLANT).rows
    by_name = {row.method: row for row in rows}
    assert rows[0].method == "sani_t10_t50_t90" and rows[0].J < 1e-12
    formulae = by_name["sani_interpolation"]
    oracle = squared_deviation(formulae.result.model, PLANT)
    assert formulae.J == pytest.approx(oracle)
    np.testing.assert_allclose(
        formulae.rmse,
        np.sqrt(np.mean((formulae.result.predict(TIMES) - PLANT.step_response(TIMES)) ** 2)),
    )
    fitted = by_name["fopdt_fit"]  # known levels: it settles where the plant does
    assert np.isfinite(fitted.J) and fitted.J > formulae.J
    elsewhere = compare(record, ["sani_interpolation"], plant=Sani(T=8.0, r=0.5, n=3)).rows[0]
    assert np.isinf(elsewhere.J) and "another level" in elsewhere.reason


def test_aicc_of_fits_and_others_counts_the_same_rows():
    t = np.linspace(-40.0, 40.0, 401)
    noise = 0.01 * np.random.default_rng(0).standard_normal(t.size)
    y = np.asarray(FOPDT(T=8.0, delay=2.0).step_response(t)) + noise
    rows = compare(StepRecord(t, y, initial=0.0, final=1.0), ["viteckova_1", "fopdt_fit"]).rows
    square = [float(np.sum((y - np.asarray(row.result.predict(t))) ** 2)) for row in rows]
    per_row = np.diff([row.aicc for row in rows]) / t.size
    np.testing.assert_allclose(per_row, np.log(square[1] / square[0]), rtol=1e-6)
    assert [row.parameters for row in rows] == [2, 2]


@pytest.mark.parametrize(
    ("model", "order_found", "count"),
    [
        (FOPDT(T=2.0, delay=1.0), False, 4),
        (FOPDT(T=2.0), False, 3),
        (PTn(lags=[2.0, 2.0]), False, 3),
        (PTn(lags=[2.0, 1.0, 0.0]), True, 5),
        (Sani(T=2.0, r=0.5, n=jnp.asarray(3)), True, 5),
        (EqualLag(T=2.0, n=2), False, 3),
        (EqualLag(T=2.0, n=jnp.asarray(3)), True, 4),
        (EqualLag(T=2.0, n=jnp.asarray(2.5)), True, 4),
        (EqualLag(T=2.0, n=jnp.asarray(2.5)), False, 4),
    ],
)
def test_an_order_that_was_found_counts_once(model, order_found, count):
    t = np.linspace(0.0, 9.0, 30)
    y = 1 - np.exp(-t)
    for levels, known in (({}, 0), ({"final": 1.0}, 1), ({"initial": 0.0, "final": 1.0}, 2)):
        result = conclude(StepRecord(t, y, **levels), model, Status.successful)
        assert parameter_count(result, order_found) == count - known


def test_nothing_to_compare(record):
    with pytest.raises(ValueError, match="at least one method"):
        compare(record, [])


def test_transfer_functions_as_text_and_latex(comparison):
    text, latex = comparison.show_models(), comparison.show_models("latex")
    assert all(name in text and name in latex for name in NAMES)
    assert r"\frac{" in latex and "frac" not in text
    with pytest.raises(ValueError, match="latex"):
        comparison.show_models("html")


# Pictures


def identification(model, status=Status.successful, **details):
    t = np.linspace(0.0, 100.0, 60)
    y = 20 + 5 * (1 - np.exp(-np.maximum(t - 14, 0) / 10)) + 0.01 * np.sin(37 * t)
    record = StepRecord(t, y, step_time=10.0, labels=Labels("oven.csv", "time (s)", "T [degC]"))
    details = {name: jnp.asarray(value, float) for name, value in details.items()}
    return conclude(record, model, status, details=details)


def row(name, result, about):
    numbers = [float(x) for x in (result.J, result.rmse, result.fit_percent)]
    return Row(name, result, about.gives.__name__, *numbers, 4, 0.0, "successful", "", about)


@pytest.fixture(scope="module")
def drawn():
    levels = {"gain": 5.0, "offset": 20.0}
    results = [
        identification(FOPDT(T=T, delay=4.0, **levels), t33=8.0, t70=16.0)
        for T in (10.0, 11.0, 12.0, 9.0, 13.0, 8.0, 14.0)
    ]
    results.append(identification(SOPDT(zeta=1.0, omega_n=0.15, **levels), Tu=2.0, Tg=18.0))
    results.append(identification(FOPDT(T=1.0), Status.no_inflection))
    about = [Method(FOPDT, "first", levels=(0.33, 0.70))] * 7
    about += [Method(SOPDT, "second", has_tangent=True), Method(FOPDT, "first", has_tangent=True)]
    pairs = zip(results, about, strict=True)
    rows = [row(f"method_{i}", *pair) for i, pair in enumerate(pairs)]
    return Comparison(results[0].record, tuple(rows))


def saved(figure):
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=50)
    return buffer.getvalue()


def test_the_picture_has_models_residuals_and_ranking(drawn):
    figure = drawn.plot()
    assert saved(figure).startswith(b"\x89PNG")
    _response, residuals, bars = figure.axes
    entries = [text.get_text() for text in figure.subfigs[0].legends[0].get_texts()]
    assert entries[0] == "record" and entries[-1] == "step" and len(entries) == 8
    assert residuals.get_xlabel() == "time (s)" and bars.get_xscale() == "log"
    assert bars.get_xlabel() == "J (degC^2 s)"
    assert [label.get_text() for label in bars.get_yticklabels()] == [
        f"method_{i}" for i in range(8)
    ]


def test_marks_lie_on_the_levels_that_a_method_reads(drawn):
    np.testing.assert_allclose(level_marks(drawn.rows[0]), [(18.0, 21.65), (26.0, 23.5)])
    assert tangent_ends(drawn.rows[0]) == []
    assert tangent_ends(drawn.rows[7]) == [(12.0, 20.0), (30.0, 25.0)]


@pytest.mark.parametrize("kind", ["bar", "pie"])
def test_rankings(drawn, kind):
    assert saved(drawn.plot("first", kind))


def test_groups(drawn):
    assert [row.method for row in drawn.models("second")] == ["method_7"]
    assert len(drawn.models("first")) == 7 and len(drawn.models("all")) == 8
    with pytest.raises(ValueError, match="no model of nth order"):
        drawn.plot("nth")
    with pytest.raises(ValueError, match="second"):
        drawn.plot("third")
    with pytest.raises(ValueError, match="pie"):
        drawn.plot(kind="tart")
    with pytest.raises(TypeError, match="sequence"):
        compare(drawn.record, "fopdt_fit")
