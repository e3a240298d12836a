"""Records of any input: what they hold, and how their input moves a plant."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

import stepax
from stepax import SOPDT, InputRecord, PTn, Status, StepRecord, identify, stack_records
from stepax.records._record import compact, padded_record, predict, record_status


pytestmark = pytest.mark.usefixtures("quick_compilation")

T = np.linspace(3.0, 33.0, 61)
RANDOM = np.random.default_rng(0)
U = 2.0 + np.repeat(RANDOM.normal(size=13), 5)[:61]
PLANT = SOPDT(zeta=0.4, omega_n=0.9, gain=-2.0, offset=5.0, delay=1.3)


def by_hand(plant, t, rows=T, u=U):
    """Every move of a held input answered by itself."""
    moves = np.diff(u)
    since = np.asarray(t)[:, None] - rows[None, 1:]
    return float(plant.offset) + (np.asarray(plant.step_response(since)) - plant.offset) @ moves


def test_every_move_of_a_held_input_is_answered_at_rows_and_between():
    record = InputRecord(T, T, U)
    np.testing.assert_allclose(predict(PLANT, record), by_hand(PLANT, T), atol=1e-11)
    between = np.sort(RANDOM.uniform(0.0, 40.0, 50))  # before the first row and after the last too
    np.testing.assert_allclose(predict(PLANT, record, between), by_hand(PLANT, between), atol=1e-11)


def test_uneven_times():
    t = np.cumsum(RANDOM.uniform(0.2, 0.8, 61))
    record = InputRecord(t, t, U)
    assert record.even is False
    np.testing.assert_allclose(predict(PLANT, record), by_hand(PLANT, t, t), atol=1e-11)


def test_first_order_hold_against_scipy():
    plant = SOPDT(zeta=0.4, omega_n=0.9, gain=-2.0, offset=5.0)
    record = InputRecord(T, T, U, hold="first")
    _, y, _ = signal.lsim(plant.to_scipy(), U - U[0], T - T[0], interp=True)
    np.testing.assert_allclose(predict(plant, record), 5.0 + y, atol=1e-9)
    fine = np.linspace(T[0], T[-1], 4 * 60 + 1)
    u = np.interp(fine, T, U) - U[0]
    _, y, _ = signal.lsim(plant.to_scipy(), u, fine - fine[0], interp=True)
    np.testing.assert_allclose(predict(plant, record, fine), 5.0 + y, atol=1e-9)


@pytest.mark.parametrize("plant", [PLANT, PTn(lags=[3.0, 1.0], delay=0.7)])
def test_few_moves_are_added_up_to_the_same(plant):
    u = np.where(T > 10, 3.0, 1.0) - 4.0 * (T > 20)
    record = InputRecord(T, T, u)
    quick = record.for_search()
    assert record.moves == 2 and quick.superposes and not record.superposes
    way = {"lags": jnp.array([1.0, 0.0])} if isinstance(plant, PTn) else {"zeta": jnp.array(1.0)}
    both = [
        jax.jit(lambda plant, record=record: record.response_slopes(plant, [way]))(plant)
        for record in (record, quick)
    ]
    for full, added in zip(*map(jax.tree.leaves, both), strict=True):
        np.testing.assert_allclose(full, added, atol=1e-10)
    if isinstance(plant, PTn):
        weights = jnp.asarray(RANDOM.normal(size=T.size))
        np.testing.assert_allclose(
            record.curvature(plant, weights), quick.curvature(plant, weights), atol=1e-9
        )


def test_what_is_wrong_in_kind_is_said():
    with pytest.raises(ValueError, match="t, y and u of an InputRecord must have equal lengths"):
        InputRecord(T, T, U[:-1])
    with pytest.raises(ValueError, match="hold must be one of"):
        InputRecord(T, T, U, hold="second")
    with pytest.raises(TypeError, match="u of an InputRecord must hold real numbers"):
        InputRecord(T, T, U > 2)
    with pytest.raises(ValueError, match="rows of an InputRecord must lie in"):
        InputRecord(T, T, U, rows=99)
    with pytest.raises(ValueError, match="records of one kind"):
        stack_records([InputRecord(T, T, U), StepRecord(T, T)])
    with pytest.raises(ValueError, match="one hold"):
        stack_records([InputRecord(T, T, U), InputRecord(T, T, U, hold="first")])


def test_what_is_wrong_in_value_is_a_status():
    y = np.sin(T)
    status = lambda *rows, **more: record_status(compact(InputRecord(*rows, **more)))  # noqa: E731
    assert status(T, y, U) == Status.successful
    assert status(T, y, 0 * U + 2) == Status.no_step
    assert status(T, 0 * y, U) == Status.constant_output
    assert status(T[::-1], y, U) == Status.time_not_increasing
    assert status(T, y, np.where(T > 30, np.nan, U)) == Status.nonfinite_data
    assert status(T[:7], y[:7], U[:7]) == Status.too_few_samples
    gaps = np.where(np.arange(61) % 9 == 0, np.nan, y)
    assert status(T, gaps, U) == Status.nonfinite_data
    assert status(T, gaps, U, weights=np.isfinite(gaps) * 1.0) == Status.successful


def test_padding_moves_nothing():
    record = InputRecord(T, np.sin(T), U)
    padded = compact(padded_record(record, 90))
    assert padded.even and padded.moves == record.moves
    np.testing.assert_allclose(predict(PLANT, padded)[:61], predict(PLANT, record), atol=1e-11)
    np.testing.assert_allclose(padded.duration, record.duration)
    batch = stack_records([record, InputRecord(T[:40], np.sin(T[:40]), U[:40])])
    y = jax.vmap(lambda record: predict(PLANT, compact(record)))(batch)
    np.testing.assert_allclose(y[1, :40], predict(PLANT, record)[:40], atol=1e-11)


def test_padding_moves_nothing_at_other_times():
    """The zeros that fill a record up are no level of its input, which is far from 0 here."""
    record = InputRecord(T, T, U + 20.0)
    padded = padded_record(record, 90)
    between = np.linspace(0.0, 40.0, 30)
    assert float(padded.input_size) == float(record.input_size)
    expected = predict(PLANT, record, between)
    np.testing.assert_allclose(predict(PLANT, padded, between), expected, atol=1e-11)


def test_evenness_is_seen_where_times_are_known():
    assert InputRecord(np.arange(50), T[:50], U[:50]).even
    assert InputRecord(np.linspace(0, 1, 50, dtype=np.float32), T[:50], U[:50]).even
    assert InputRecord(T + 1e-3 * RANDOM.normal(size=61), T, U).even is False
    known = []
    jax.jit(lambda t: known.append(InputRecord(t, t, U).even))(jnp.asarray(T))
    assert known == [None]


def test_what_reads_a_step_says_that_it_needs_one():
    record = InputRecord(T, np.sin(T), U)
    for call in (
        lambda: identify(record, "latzel"),
        lambda: stepax.METHODS["rdkam"](record),
        lambda: stepax.compare(record, ["smith_1972"]),
    ):
        with pytest.raises(TypeError, match="needs a StepRecord"):
            call()


def log(tmp_path, u, y, t=T):
    file = tmp_path / "log.csv"
    rows = [f"{a:.9g},{b:.9g},{c:.9g}" for a, b, c in zip(t, u, y, strict=True)]
    file.write_text("t (s),u (%),y (degC)\n" + "\n".join(rows))
    return file


def test_a_whole_log_is_read_with_its_input(tmp_path):
    u = np.where(T > 8, 3.0, 1.0) - 4.0 * (T > 18)
    plant = SOPDT(zeta=0.9, omega_n=2.0)
    y = by_hand(plant, T, u=u)
    file = log(tmp_path, u, y)
    first = stepax.read_record(file)
    assert isinstance(first, StepRecord) and int(first.details["steps_found"]) == 2
    record = stepax.read_record(file, whole=True, hold="first", at_rest=False, drift=True)
    assert isinstance(record, InputRecord) and record.even and record.t.size == 61
    assert (record.hold, record.at_rest, record.drift) == ("first", False, True)
    np.testing.assert_allclose(record.u, u)
    assert record.labels.input == "u (%)"
    assert "61 rows, input from -1 to 3 %" in str(stepax.summary._content.record_line(record))
    with pytest.raises(ValueError, match="leave out step"):
        stepax.read_record(file, whole=True, step=1)
    with pytest.raises(ValueError, match="needs an input"):
        stepax.read_record(two_columns(tmp_path, y), whole=True)


def two_columns(tmp_path, y):
    file = tmp_path / "two.csv"
    file.write_text("t,y\n" + "\n".join(f"{a:.9g},{b:.9g}" for a, b in zip(T, y, strict=True)))
    return file


def test_a_log_whose_steps_are_too_short_is_read_whole(tmp_path):
    """After none of them does the output come to rest."""
    u = np.repeat([1.0, 3.0, 1.0, 2.0], 16)[:61]
    y = by_hand(SOPDT(zeta=2.0, omega_n=0.3), T, u=u)
    record = stepax.read_record(log(tmp_path, u, y))
    assert isinstance(record, InputRecord) and bool(record.details["whole_by_itself"])
    assert isinstance(stepax.read_record(log(tmp_path, u, y), step=2), StepRecord)
    assert isinstance(stepax.read_record(log(tmp_path, u, y), whole=False), StepRecord)


def test_the_picture_has_the_input_below_the_output():
    from stepax.plots._model import plot_model

    record = InputRecord(T, by_hand(PLANT, T), U)
    axes = plot_model(record, PLANT, title="input").axes
    assert [x.get_ylabel() for x in axes] == ["output", "input", "residual"]
    np.testing.assert_allclose(axes[1].lines[0].get_ydata(), U)
    assert axes[1].lines[0].get_drawstyle() == "steps-post"
    assert np.abs(axes[2].lines[0].get_ydata()).max() < 1e-9
