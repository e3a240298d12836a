"""The front door for many records: a row for each; few compilations serve all."""

import contextlib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from stepax import FOPDT, METHODS, StepRecord, identify, identify_each
from stepax._compilation import coarse_rung, rung
from stepax._identify import identify_filled
from stepax._identify_each import shared_lengths
from stepax.records._labels import Labels


FAST = "smith_1972"  # compiles quickly


def record(rows=60, **fields):
    t = np.linspace(-2.0, 30.0, rows)
    y = np.asarray(FOPDT(T=4.0, gain=2.0, offset=1.0, delay=1.0).step_response(t))
    noise = 0.005 * np.random.default_rng(rows).standard_normal(rows)
    return StepRecord(t, y + noise, **fields)


def write(path, rows=60):
    data = record(rows)
    lines = [f"{t:.6f},{float(t >= 0)},{y:.9f}" for t, y in zip(data.t, data.y, strict=True)]
    path.write_text("\n".join(["time (s),valve (%),level [m]", *lines]) + "\n")
    return path


CONSTANT = StepRecord(np.arange(20.0), np.ones(20), labels=Labels("flat"))


def test_records_of_a_list_or_a_generator():
    records = [record(rows, labels=Labels(f"run {rows}")) for rows in (60, 61, 75)]
    found = identify_each(records, FAST)
    assert len(found) == 3
    for result, given in zip(found, records, strict=True):
        assert result is not None and result.record is given
        same(result, METHODS[FAST](given))
    again = identify_each((x for x in records), FAST)
    assert [float(x.J) for x in again] == [float(x.J) for x in found]
    assert [outcome.source for outcome in found.outcomes] == ["run 60", "run 61", "run 75"]
    part = found[1:]
    assert type(part) is type(found) and len(part) == 2 and part[0] is found[1]
    assert found[-1].record is records[2]
    with pytest.raises(IndexError):
        found[3]


def test_what_cannot_be_used_is_a_row(tmp_path, capsys):
    (tmp_path / "binary.csv").write_bytes(bytes(range(256)))
    (tmp_path / "text.csv").write_text("nothing here\n")
    sources = [
        write(tmp_path / "a.csv"),
        tmp_path / "missing.csv",
        tmp_path,
        tmp_path / "binary.csv",
        tmp_path / "text.csv",
        CONSTANT,
        str(write(tmp_path / "b.csv", 70)),
    ]
    found = identify_each(sources, FAST)
    assert capsys.readouterr() == ("", "")
    assert [outcome.has_model for outcome in found.outcomes] == [True, *[False] * 5, True]
    assert [result is None for result in found] == [False, *[True] * 4, False, False]
    reasons = [outcome.reason for outcome in found.outcomes]
    assert all(reason.endswith(".") and " " in reason for reason in reasons[1:-1])
    assert "missing.csv" in reasons[1] and "does not change" in reasons[5]
    frame = found.to_frame()
    assert list(frame["source"]) == [Path(str(s)).name for s in sources[:5]] + ["flat", "b.csv"]
    assert list(frame["status"][1:6]) == ["unreadable"] * 4 + ["constant_output"]
    assert list(frame["notes"][1:6]) == reasons[1:6]
    assert list(frame["method"]) == [FAST, *[""] * 4, FAST, FAST]


def test_a_row_has_all_numbers():
    found = identify_each([record(), CONSTANT], FAST)
    frame = found.to_frame()
    texts = {"source", "method", "model", "status", "notes"}
    numbers = {"fit_percent", "rmse", "J"}
    for name in ("gain", "offset", "delay", "T"):
        numbers |= {name, f"{name}_std"}
        assert frame[name][0] == float(getattr(found[0].model, name))
    assert set(frame.columns) == texts | numbers
    assert list(frame.columns[:4]) == ["source", "method", "model", "status"]
    assert all(frame[name].dtype == np.float64 for name in numbers)
    assert frame.loc[1, sorted(numbers)].isna().all()
    assert list(frame["model"]) == ["FOPDT", "FOPDT"]


@pytest.mark.long
def test_auto_tells_which_method_was_kept():
    frame = identify_each([record(), record(66)]).to_frame()
    assert set(frame["method"]) == {"fopdt_fit"}
    assert (frame["T_std"] > 0).all() and (frame["fit_percent"] > 95).all()


def test_no_record_at_all():
    for nothing in ([], iter(())):
        found = identify_each(nothing)
        assert len(found) == 0 and len(found.to_frame()) == 0 and list(found) == []


def test_what_is_wrong_for_all_raises():
    with pytest.raises(KeyError, match="magic"):
        identify_each([record()], "magic")
    with pytest.raises(ValueError, match="no option 'colour'"):
        identify_each([record()], FAST, colour="red")
    with pytest.raises(ValueError, match="no option 'colour'"):
        identify_each([record()], colour="red")
    with pytest.raises(TypeError):
        identify_each(iter([1]), FAST)  # pyright: ignore[reportArgumentType]


def test_progress_goes_to_stderr(capsys):
    found = identify_each((record(rows) for rows in (60, 70)), FAST, progress=True)
    captured = capsys.readouterr()
    assert len(found) == 2 and captured.out == "" and "Identifying" in captured.err


def test_a_record_that_is_too_short_for_the_span():
    """It is told by its own rows, not by the length that it is filled up to."""
    for rows in (8, 20):
        with pytest.raises(ValueError, match=f"span=0.15 of {rows} samples is a window of"):
            identify(record(rows), "tangent_63", span=0.15)
    found = identify_each([record(8), record(60), record(20)], "tangent_63", span=0.15)
    assert [outcome.has_model for outcome in found.outcomes] == [False, True, False]
    assert "LOESS needs at least 4" in found.to_frame()["notes"][2]
    with pytest.raises(ValueError, match="span must lie in"):
        identify_each([record(8)], "tangent_63", span=1.5)


# One record


def same(ours, theirs, rtol=1e-9):
    assert bool(ours.status == theirs.status)
    for name in ("model", "rmse", "J", "fit_percent", "std", "details"):
        a, b = (jax.tree.leaves(getattr(x, name)) for x in (ours, theirs))
        for x, y in zip(a, b, strict=True):
            x, y = np.asarray(x, float), np.asarray(y, float)
            np.testing.assert_allclose(x, y, rtol=rtol, atol=rtol * 1e-3)


QUICK = (FAST, "fopdt_fit")
SHORT = pytest.mark.xfail(
    reason="sopdt_zero_fit of a plant without a zero: a flat optimum, equal to 1e-8 only",
    strict=False,
)
MARKS = {name: [] if name in QUICK else [pytest.mark.long] for name in METHODS}
MARKS["sopdt_zero_fit"].append(SHORT)
ALL = [pytest.param(name, marks=marks) for name, marks in MARKS.items()]


@pytest.mark.parametrize("name", ALL)
def test_identify_gives_the_numbers_of_the_method_and_the_record_itself(name):
    fact = jnp.asarray(True)
    given = record(62, labels=Labels("a", output="level [m]"), details={"assumed_step": fact})
    result = identify(given, name)
    assert result.record is given and result.details["assumed_step"] is fact
    assert len(np.asarray(result.predict(given.t))) == 62
    same(result, METHODS[name](given))


def test_weights_given_to_a_fit():
    given, weights = record(62), np.where(np.arange(62) % 5, 1.0, 0.0)
    result = identify(given, "fopdt_fit", weights=weights)
    assert result.record is given
    same(result, METHODS["fopdt_fit"](given, weights=weights))


# Lengths


@contextlib.contextmanager
def compilations():
    """Names of the events of the compiler while it holds."""
    seen = []

    def listen(event: str, duration_secs: float, **kwargs: str | int):
        if "backend_compile" in event:
            seen.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield seen
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


ONE_LEFT = pytest.mark.xfail(
    reason="auto compiles one function more at another length; which one is not found yet",
    strict=False,
)


@pytest.mark.parametrize(
    "method", [FAST, "fopdt_fit", pytest.param("auto", marks=[pytest.mark.long, ONE_LEFT])]
)
def test_another_length_on_a_rung_compiles_nothing(method):
    first, *others = [record(rows, labels=Labels(f"{rows}")) for rows in (114, 111, 146)]
    many = [record(rows, labels=Labels(f"{rows}")) for rows in (129, 300, 512)]
    identify(first, method)
    assert rung(111) == rung(146) == 148
    with compilations() as seen:
        for other in others:
            identify(other, method)
    assert seen == []
    identify_each([first, record(140)], method)
    with compilations() as seen:
        identify_each(many, method)
    assert seen == []
    with compilations() as seen:
        identify(many[-1], method)
    assert seen  # of another rung: the events are counted


def test_the_ladder_is_at_most_a_third_longer():
    lengths = np.arange(8, 10_001)
    rungs = np.array([rung(int(size)) for size in lengths])
    assert (rungs >= lengths).all() and (rungs <= lengths * 4 / 3).all()
    assert np.unique(rungs).size < 30
    assert [rung(size) for size in range(8)] == [8] * 8
    assert all(rung(int(size)) == size for size in np.unique(rungs))


def test_the_coarse_ladder_has_powers_of_four():
    coarse = {size: coarse_rung(size) for size in range(1, 10_001)}
    assert all(size <= length for size, length in coarse.items())
    assert sorted(set(coarse.values())) == [8, 32, 128, 512, 2048, 8192, 32768]
    assert all(length < 4 * size for size, length in coarse.items() if size > 8)


def test_the_lengths_that_records_are_filled_to_change_nothing():
    given = record(40)
    results = [identify_filled(given, FAST, {}, length) for length in (rung, coarse_rung, int)]
    for result in results[:2]:
        same(result, results[2])


def test_few_records_share_one_length_and_many_short_ones_do_not_pay_for_a_long_one():
    assert shared_lengths([60, 300, 1240], []) == {60: 2048, 300: 2048, 1240: 2048}
    many = [50 + k for k in range(60)] + [1240]
    assert set(shared_lengths(many, []).values()) == {128, 2048}
    assert shared_lengths([60], [128]) == {60: 128} and shared_lengths([60], [8]) == {60: 128}
    assert shared_lengths([60], [2048]) == {60: 2048} and shared_lengths([], []) == {}
