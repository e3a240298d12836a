"""The 35 cells of tables 4 to 8: as published, as Prechar computed them, and correct.

The same samples are read in two ways: by the first sample at or above a level (`prechar.as_read`),
and interpolated. J is the integral to infinity of the squared deviation from the system, gain 2.
"""

import functools
from typing import NamedTuple

import numpy as np

from experiments.jakoubek import prechar
from experiments.jakoubek.independent import CORRECT, Correct
from experiments.jakoubek.published import METHODS, OTHER_J, TABLES, Cell, half_unit
from experiments.jakoubek.systems import GAIN, SYSTEMS, System, chain, record_of, response
from stepax import PTn, Status, StepRecord, identify
from stepax._status import refused
from stepax.models._deviation import squared_deviation
from stepax.models._notation import transfer_function


class Reading(NamedTuple):
    """A model, None where the method refuses, what the method says, and J to infinity.

    `details`: what the method read.
    """

    model: PTn | None
    status: str
    J: float
    details: dict[str, float] = {}  # noqa: RUF012 (never written to)

    @property
    def lags(self) -> list[float]:
        """Every lag, the largest first, but those of rounding; empty where there is no model."""
        return [] if self.model is None else _lags_of(self.model)

    @property
    def delay(self) -> float:
        return 0.0 if self.model is None else float(self.model.delay)

    def response(self, t: np.ndarray) -> np.ndarray:
        """Step response; NaN without a model."""
        return np.full(t.shape, np.nan) if self.model is None else response(self.model, t)

    @property
    def text(self) -> str:
        """The transfer function, or what the method says instead."""
        return self.status if self.model is None else transfer_function(self.model)


class Row(NamedTuple):
    """One cell: the paper's, its printed parameters, Prechar's, and the correct one.

    `printed`: the printed parameters. `recomputed`: under the paper's sampling law, by the method's
    formulae (Strejc: with Prechar's faults). `correct`: interpolated, printed constants.
    """

    cell: Cell
    printed: Reading
    recomputed: Reading
    correct: Reading

    @property
    def J(self) -> dict[str, float]:
        """By stage, published first."""
        published = float(self.cell.J) if self.cell.J else np.nan
        readings = {"printed": self.printed, "recomputed": self.recomputed, "correct": self.correct}
        return {"published": published} | {name: x.J for name, x in readings.items()}

    @property
    def within_rounding(self) -> bool:
        """Whether every printed parameter is the recomputed one, rounded."""
        found = self.recomputed
        if len(found.lags) != len(self.cell.printed_lags):
            return False
        pairs = list(zip(self.cell.printed_lags, found.lags, strict=True))
        if self.cell.lags:
            pairs.append((self.cell.delay, found.delay))
        return all(_rounds_to(value, printed) for printed, value in pairs)


EXACT = 1e-12
"""J over GAIN^2 times the sum of lags up to which a model is the system itself."""


def is_exact(J: float, name: str) -> bool:
    """Whether J against a system is no more than the rounding of the times read."""
    return J <= EXACT * GAIN**2 * sum(SYSTEMS[name].lags)


def J_text(J: float, name: str) -> str:
    """J in three digits; - without a model."""
    if np.isnan(J):
        return "-"
    return "exact" if is_exact(J, name) else f"{J:.2e}"


def _rounds_to(value: float, printed: str) -> bool:
    if float(printed) == 0:
        return value == 0
    return abs(value - float(printed)) <= half_unit(printed)


@functools.cache
def rows(name: str) -> tuple[Row, ...]:
    """The table of one system, in the order of the paper."""
    system = SYSTEMS[name]
    record = system.record()
    t, y = np.asarray(record.t), np.asarray(record.y)
    as_read = record_of(system, t, prechar.as_read(t, y, GAIN))
    table = []
    for cell in TABLES[name]:
        if cell.method == "strejc":
            T, order = prechar.strejc(t, y, GAIN)
            recomputed = _reading(chain([T] * order), "", system)
        else:
            recomputed = _read(cell.method, as_read, system)
        table.append(
            Row(
                cell,
                _reading(cell.plant, "not suited", system),
                recomputed,
                _read(cell.method, record, system),
            )
        )
    return tuple(table)


def _read(method: str, record: StepRecord, system: System, **options) -> Reading:
    result = identify(record, method, all_rows=True, **options)
    model = None
    if not bool(refused(result.status)):
        model = chain(_lags_of(result.model), float(result.model.delay))
    details = {name: float(x) for name, x in result.details.items()}
    return _reading(model, Status[result.status], system, details)


def _lags_of(model) -> list[float]:
    """Lags of a model, the largest first, without those that are rounding."""
    lags = np.asarray(model.lags)
    return sorted((float(x) for x in lags if x > 1e-6 * lags.max()), reverse=True)


def _reading(
    model: PTn | None, status: str, system: System, details: dict[str, float] | None = None
) -> Reading:
    J = np.nan if model is None else squared_deviation(model, system.plant)
    return Reading(model, status, J, details or {})


@functools.cache
def exact(name: str, method: str) -> Reading:
    """Interpolated, with recomputed constants (Smith's method has none)."""
    options = {} if method == "smith" else {"constants": "exact"}
    return _read(method, SYSTEMS[name].record(), SYSTEMS[name], **options)


def errors(name: str, stage: str) -> dict[str, float]:
    """J by method in the order of the table: published, printed, recomputed, correct or exact."""
    if stage == "exact":
        return {cell.method: exact(name, cell.method).J for cell in TABLES[name]}
    return {row.cell.method: row.J[stage] for row in rows(name)}


@functools.cache
def smith_with_dead_time(name: str) -> Reading:
    """Smith on one system after the dead time of eq. 11 is taken off, which the paper announces."""
    return _read("smith", SYSTEMS[name].record(), SYSTEMS[name], dead_time=True)


def published_errors() -> np.ndarray:
    """J of the printed models over the printed J, where that is above 1e-3 and of that model.

    Below, J is as large as the rounding of the printed parameters.
    """
    kept = [row for key, row in all_rows().items() if key not in OTHER_J]
    return np.array([x.printed.J / x.J["published"] for x in kept if x.J["published"] > 1e-3])


def all_rows() -> dict[tuple[str, str], Row]:
    """By system and method."""
    return {(name, row.cell.method): row for name in SYSTEMS for row in rows(name)}


def agrees(found: Reading, expected: Correct) -> bool:
    """Whether lags and dead time agree with the independent ones to four digits."""
    lags = list(expected.lags) * (expected.order if len(expected.lags) == 1 else 1)
    return len(lags) == len(found.lags) and all(
        _same_digits(a, b)
        for a, b in zip([*found.lags, found.delay], [*lags, expected.delay], strict=True)
    )


def _same_digits(value: float, expected: float) -> bool:
    """Four digits, and nothing below the 1e-6 that a sum of lags of 1 s resolves."""
    if expected == 0:
        return abs(value) < 1e-6
    unit = 10.0 ** (np.floor(np.log10(expected)) - 3)
    return abs(value - expected) <= 0.5 * unit


def disagreements() -> list[tuple[str, str]]:
    """Cells whose correct values differ from the independent ones."""
    cells = all_rows()
    return [
        (name, method)
        for name in SYSTEMS
        for method in METHODS
        if not agrees(cells[name, method].correct, CORRECT[name][method])
    ]
