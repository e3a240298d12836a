"""Pictures: what is on them, and that they need no display."""

from io import BytesIO

import jax.numpy as jnp
import pytest

from stepax import FOPDT, Status, StepRecord
from stepax._result import _wrapped, conclude
from stepax.records._labels import Labels


def identification(T=10.0, delay=4.0, status=Status.successful, labels=None, count=60):
    labels = labels or Labels("oven.csv", "time (s)", "T [degC]", "heater (%)")
    t = jnp.linspace(0.0, 100.0, count)
    y = 20 + 5 * (1 - jnp.exp(-jnp.maximum(t - 14, 0) / 10)) + 0.01 * jnp.sin(37 * t)
    record = StepRecord(t, y, step_time=10.0, labels=labels)
    return conclude(record, FOPDT(T=T, gain=5.0, offset=20.0, delay=delay), status)


def saved(figure):
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=50)
    return buffer.getvalue()


def names(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize("count", [60, 1000])
def test_identification(count):
    figure = identification(count=count).plot()
    response, residuals = figure.axes
    assert response.get_ylabel() == "T [degC]" and residuals.get_xlabel() == "time (s)"
    assert residuals.get_ylabel() == "residual\n(degC)"
    assert names(figure) == ["record", "model", "dead time 4 s", "step"]
    title = response.get_title("left")
    assert "5 exp(-4 s) / (1 + 10 s)" in title and "fit" in title and "%" in title
    assert saved(figure).startswith(b"\x89PNG")


def test_no_dead_time_and_a_title():
    figure = identification(delay=0.0).plot(title="Oven, $run$ 1", size=(6.0, 4.0))
    assert names(figure) == ["record", "model", "step"]
    assert figure.axes[0].get_title("left") == r"Oven, \$run\$ 1"
    assert saved(figure)


def test_a_refusal_shows_the_record_and_the_reason():
    figure = identification(status=Status.no_inflection).plot()
    assert names(figure) == ["record", "step"]
    assert figure.axes[0].get_title("left") == Status[Status.no_inflection]
    assert saved(figure)


def test_columns_without_names():
    figure = identification(labels=Labels("", "1", "2")).plot()
    assert [figure.axes[0].get_ylabel(), figure.axes[1].get_xlabel()] == ["output", "time"]


def test_a_long_transfer_function_is_broken_between_factors():
    text = "G(s) = 1 / (" + "(1 + 12.34 s)" * 8 + ")"
    lines = _wrapped(text).split("\n")
    assert len(lines) == 2 and max(map(len, lines)) <= 85
    assert "".join(line.strip() for line in lines) == text
