"""The front door: one record in, the best model or a ranking of all out."""

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ._certainty import aicc, with_errors
from ._models import AbstractPlant
from ._record import StepRecord
from ._result import Identification, Status, conclude, predict, refused, status_name
from .methods import METHODS


if TYPE_CHECKING:
    import pandas as pd

AUTO = ("fopdt_fit", "sopdt_fit", "hudzovic_fit", "sani_fit")
"""Methods that `method="auto"` compares, simplest first."""


def identify(record: StepRecord, method: str = "auto", **options: Any) -> Identification:
    """Model of a recorded step response.

    **Arguments:**

    - `record`: a `StepRecord`, from arrays or from `read_record`.
    - `method`: a name in `METHODS`, or "auto": all families of `AUTO` are fitted by least squares,
        chains in every order from 2 to 8, and the one with the smallest AICc is kept; `.details`
        holds `aicc_<method>` of each and `chosen`, the position in `AUTO`.
    - `options`: passed to the method; see its docstring.

    **Returns:** `Identification`. What is wrong with the values of the record is in its `.status`.
    A named method is clean under `jit`, `vmap` and `grad`; "auto" chooses between classes on the
    host and raises a `TypeError` when traced.
    """
    if not isinstance(record, StepRecord):
        raise TypeError(
            f"identify needs a StepRecord, got {type(record).__name__}: build one with"
            " StepRecord(t, y, ...) or read_record(path)."
        )
    if method == "auto":
        _refuse_tracers(record, 'identify(method="auto")')
        return _identify_auto(record, options)
    return _run(record, _known(method), options)


def _known(method: str):
    if method not in METHODS:
        raise KeyError(f"Unknown method {method!r}; known are auto, {', '.join(METHODS)}.")
    return METHODS[method]


def _run(record: StepRecord, method, options) -> Identification:
    """Run a compiled method on the bare record, so that names of columns do not recompile it."""
    try:
        result = method(record.plain, **options)
    except TypeError as error:
        if "unexpected keyword argument" in str(error):
            option = str(error).split("'")[1]
            raise ValueError(f"Method {method.__name__!r} has no option {option!r}.") from None
        raise
    return dataclasses.replace(result, record=record, details=result.details | record.details)


def _refuse_tracers(record: StepRecord, what: str) -> None:
    if any(isinstance(x, Tracer) for x in jax.tree.leaves(record)):
        raise TypeError(
            f"{what} chooses between model classes on the host and cannot be traced: name one"
            " method inside jit, vmap and grad."
        )


def _identify_auto(record: StepRecord, options: dict[str, Any]) -> Identification:
    results = [identify(record, name, **(options | {"errors": False})) for name in AUTO]
    scores = [float(_aicc(result)) for result in results]
    chosen = int(np.argmin(scores))
    result = dataclasses.replace(results[chosen], record=record.plain)
    if options.get("errors", True):
        known = {name: options[name] for name in ("fixed", "weights", "loss") if name in options}
        result = eqx.filter_jit(with_errors)(result, **known)
    details = {f"aicc_{name}": jnp.asarray(score) for name, score in zip(AUTO, scores, strict=True)}
    details["chosen"] = jnp.asarray(chosen)
    return dataclasses.replace(result, record=record, details=result.details | details)


def chosen_method(result: Identification) -> str:
    """Name of the method that "auto" kept."""
    return AUTO[int(result.details["chosen"])]


def _aicc(result: Identification):
    """AICc of a result, infinite for a refusal; of methods that do not fit, from their RMSE."""
    if "aicc" in result.details:
        value = result.details["aicc"]
    else:
        count = result.record.y.size
        value = aicc(count * result.rmse**2, count, parameter_count(result.model))
    return jnp.where(refused(result.status) | jnp.isnan(value), jnp.inf, value)


def parameter_count(model: AbstractPlant) -> int:
    """Number of real parameters of a model, lags counted one by one, zero lags left out."""
    skip = {"n"} if not hasattr(getattr(model, "n", 0), "dtype") else set()
    leaves = [
        np.asarray(getattr(model, name))
        for name in model.__dataclass_fields__
        if name not in skip and eqx.is_inexact_array(getattr(model, name))
    ]
    return sum(int(np.count_nonzero(x)) if x.ndim else 1 for x in leaves)


class Row(NamedTuple):
    """One method in a `Comparison`."""

    method: str
    result: Identification
    J: float
    rmse: float
    fit_percent: float
    parameters: int
    aicc: float
    status: str
    reason: str


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Methods on one record, ranked by J, refusals last."""

    record: StepRecord
    rows: tuple[Row, ...]

    @property
    def best(self) -> Identification:
        """Result of the first row."""
        return self.rows[0].result

    def to_frame(self) -> "pd.DataFrame":
        """One row per method, as a DataFrame without the results themselves."""
        import pandas as pd

        frame = pd.DataFrame(self.rows)
        return frame.drop(columns="result")

    def show_models(self) -> str:
        """All transfer functions, one line per method."""
        from ._report import transfer_function_text

        width = max(len(row.method) for row in self.rows)
        return "\n".join(
            f"{row.method:{width}}  "
            + (transfer_function_text(row.result.model) if np.isfinite(row.J) else row.reason)
            for row in self.rows
        )

    def plot(self, **options):
        """Record and best models as a matplotlib figure; see `stepax.plot_comparison`."""
        from ._plot import plot_comparison

        return plot_comparison(self, **options)


def compare(
    record: StepRecord, methods: list[str] | None = None, plant: AbstractPlant | None = None
) -> Comparison:
    """Several methods on one record, ranked by J (integral of the squared error).

    **Arguments:** `methods`: names, by default all of `METHODS`. `plant`: the true plant, if known
    (a simulation); J and RMSE are then measured against its response, on the record's times.

    **Returns:** `Comparison`. On the host only: traced, it raises a `TypeError`.
    """
    _refuse_tracers(record, "compare")
    names = list(METHODS) if methods is None else methods
    rows = [_row(name, identify(record, name), plant) for name in names]
    rows.sort(key=lambda row: (not np.isfinite(row.J), row.J))
    return Comparison(record, tuple(rows))


def _row(name: str, result: Identification, plant: AbstractPlant | None) -> Row:
    measured = result
    if plant is not None:
        record = result.record
        clean = eqx.tree_at(lambda r: r.y, record, predict(plant, record, record.t))
        measured = conclude(clean, result.model, result.status)
    return Row(
        name,
        result,
        float(measured.J),
        float(measured.rmse),
        float(measured.fit_percent),
        parameter_count(result.model),
        float(_aicc(result)),
        status_name(result.status),
        Status[result.status],
    )
