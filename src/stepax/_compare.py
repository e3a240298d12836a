"""Several methods on one record, ranked; host code."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ._identify import aicc_of, identify, parameter_count, refuse_tracers
from ._models import FOPDT, SOPDT, AbstractPlant, EqualLag, PTn
from ._record import StepRecord
from ._result import Identification, Status, conclude, predict, refused, status_name
from .methods import METHODS


if TYPE_CHECKING:
    import pandas as pd

GROUPS = ("all", "first", "second", "nth")
"""Groups of models that a comparison can be narrowed to."""
KINDS = ("response", "bar", "pie")
"""Pictures of a comparison."""


class Row(NamedTuple):
    """One method in a `Comparison`: its result, how good it is, and why not where it refused."""

    method: str
    result: Identification
    model: str
    J: float
    rmse: float
    fit_percent: float
    parameters: int
    aicc: float
    status: str
    reason: str

    @property
    def has_model(self) -> bool:
        """Whether the method gave a model."""
        return not bool(refused(self.result.status))

    def is_of(self, group: str) -> bool:
        """Whether the method's models, also where it refused, are of a group."""
        return group in ("all", _group(self.result.model))


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Methods on one record, ranked by J, refusals last."""

    record: StepRecord
    rows: tuple[Row, ...]

    @property
    def best(self) -> Identification:
        """Result of the first row."""
        return self.rows[0].result

    def models(self, group: str = "all") -> tuple[Row, ...]:
        """Rows that have a model, of one group.

        "first": first order plus dead time; "second": two poles; "nth": an order that the method
        chose.
        """
        check_group(group)
        return tuple(row for row in self.rows if row.has_model and row.is_of(group))

    def to_frame(self) -> "pd.DataFrame":
        """One row per method, as a DataFrame without the results themselves."""
        import pandas as pd

        return pd.DataFrame(self.rows, columns=Row._fields).drop(columns="result")

    def show_models(self, style: str = "text") -> str:
        """All transfer functions, one line per method, as "text" or "latex"."""
        from ._notation import transfer_function

        width = max(len(row.method) for row in self.rows)
        return "\n".join(
            f"{row.method:{width}}  "
            + (transfer_function(row.result.model, style) if row.has_model else row.reason)
            for row in self.rows
        )

    def plot(self, group: str = "all", kind: str = "response", **options):
        """Models of a group as a matplotlib figure; see `plot_comparison` and `plot_ranking`.

        `kind`: "response": record, models, the marks that each method reads, residuals and J;
        "bar": J of every method on a logarithmic axis; "pie": the share of each in the sum of J.
        """
        from ._plot_comparison import plot_comparison, plot_ranking

        check_kind(kind)
        if kind == "response":
            return plot_comparison(self, group=group, **options)
        return plot_ranking(self, group=group, kind=kind, **options)


def compare(
    record: StepRecord,
    methods: Sequence[str] | None = None,
    plant: AbstractPlant | None = None,
) -> Comparison:
    r"""Several methods on one record, ranked by J (integral of the squared error).

    **Arguments:** `methods`: names, by default all of `METHODS`. `plant`: the true plant, if known
    (a simulation); then J is the integral of the squared deviation from its response from the step
    to infinity, and RMSE and fit count the deviation from it at the times of the record.

    **Returns:** `Comparison`; equal J are ranked by RMSE. Where a model and the plant settle at
    different levels J to infinity is infinite, and the reason says so. On the host only: traced,
    it raises a `TypeError`.
    """
    refuse_tracers(record, "compare")
    if isinstance(methods, str):
        raise TypeError(f"methods must be a sequence of names, such as methods=[{methods!r}].")
    names = list(METHODS) if methods is None else list(methods)
    if not names:
        raise ValueError(f"compare needs at least one method; known are {', '.join(METHODS)}.")
    rows = [_row(name, identify(record, name), plant) for name in names]
    rows.sort(key=lambda row: (np.isnan(row.J), row.J, row.rmse))
    return Comparison(record, tuple(rows))


def _row(name: str, result: Identification, plant: AbstractPlant | None) -> Row:
    measured, J, reason = result, float(result.J), Status[result.status]
    if plant is not None and not bool(refused(result.status)):
        record = result.record
        clean = eqx.tree_at(lambda r: r.y, record, predict(plant, record, record.t))
        measured = conclude(clean, result.model, result.status)
        J = squared_deviation(result.model, plant, float(record.step_size))
        if np.isinf(J):
            reason += " It settles at another level than the plant."
    return Row(
        method=name,
        result=result,
        model=type(result.model).__name__,
        J=J,
        rmse=float(measured.rmse),
        fit_percent=float(measured.fit_percent),
        parameters=parameter_count(result),
        aicc=float(aicc_of(result)),
        status=status_name(result.status),
        reason=reason,
    )


def check_group(group: str) -> None:
    """A `ValueError` for an unknown group of models."""
    if group not in GROUPS:
        raise ValueError(f"group must be one of {', '.join(GROUPS)}, got {group!r}.")


def check_kind(kind: str) -> None:
    """A `ValueError` for an unknown kind of picture."""
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}.")


def _group(model: AbstractPlant) -> str:
    """Group of a model, by its class."""
    if isinstance(model, FOPDT):
        return "first"
    double = isinstance(model, EqualLag) and isinstance(model.n, int) and model.n == 2
    two = isinstance(model, PTn) and model.lags.size == 2
    return "second" if isinstance(model, SOPDT) or double or two else "nth"


# The integral to infinity


NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)


def squared_deviation(model: AbstractPlant, plant: AbstractPlant, step_size: float = 1.0) -> float:
    r"""$\int_0^\infty (y_m - y_p)^2\,dt$ of two step responses; infinite if they settle apart.

    Gauss-Legendre quadrature on panels that grow from the fastest lag to the slowest, from each
    dead time on; in float64 the relative error is below 1e-9 (absolute 1e-24 K^2 T).
    """
    last = [float(x.offset) + step_size * float(x.gain) for x in (model, plant)]
    size = abs(step_size) * max(abs(float(x.gain)) for x in (model, plant))
    rounding = max(1e-9, 16 * float(jnp.finfo(jnp.result_type(model.gain, plant.gain)).eps))
    if abs(last[0] - last[1]) > rounding * max(size, abs(last[1])):
        return np.inf
    scales = [_time_scales(x) for x in (model, plant)]
    begin, middle = sorted(float(x.delay) for x in (model, plant))
    end = max(scale.horizon for scale in scales)
    edges = [[0.0], begin + _panels(middle - begin, scales), middle + _panels(end, scales)]
    edges = np.concatenate(edges)
    left, width = edges[:-1], np.diff(edges)
    rows = -(-width.size // 128) * 128  # few shapes: each is compiled once
    left, width = np.pad(left, (0, rows - width.size)), np.pad(width, (0, rows - width.size))
    times = left[:, None] + width[:, None] * (NODES + 1) / 2
    deviation = np.asarray(_deviation(model, plant, times), float)
    return float(step_size**2 * np.sum(width * (deviation**2 @ WEIGHTS)) / 2)


@eqx.filter_jit
def _deviation(model: AbstractPlant, plant: AbstractPlant, times):
    """Difference of the transients, whose limits are equal."""

    def transient(x):
        return x.gain * (x.unit_response(times - x.delay) - 1)

    return transient(model) - transient(plant)


class _Scales(NamedTuple):
    """Of a transient: its fastest part, the widest panel for it, and when it is below rounding."""

    fastest: float
    widest: float
    horizon: float


def _panels(length: float, scales: Sequence[_Scales]) -> np.ndarray:
    """Edges from 0 to `length`: from half the fastest scale on a quarter wider each.

    None is wider than the transients that have not died away allow.
    """
    edges, width = [0.0], 0.5 * min(scale.fastest for scale in scales)
    while edges[-1] + width < length:
        edges.append(edges[-1] + width)
        alive = [scale.widest for scale in scales if scale.horizon > edges[-1]]
        width = min([1.25 * width, *alive])
    return np.array([*edges, length])


def _time_scales(model: AbstractPlant) -> _Scales:
    if isinstance(model, SOPDT) and float(model.zeta) < 1:
        fast = 1 / float(model.omega_n)
        return _Scales(fast, fast, 40 * fast / float(model.zeta))
    if isinstance(model, EqualLag):
        T, n = float(model.T), float(model.n)
        return _Scales(T, T, (40 + 10 * n) * T)
    lags = np.asarray(model.lags, float)  # type: ignore[attr-defined]
    lags = lags[lags > 0]
    if not lags.size:
        return _Scales(np.inf, np.inf, 0.0)
    return _Scales(lags.min(), lags.max(), 40 * lags.max() + 10 * lags.sum())
