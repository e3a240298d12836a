"""The front door: one record in, a model out."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ._result import Identification
from ._status import refused
from .fitting._fitted import Fitted, aicc
from .fitting._refine import concluded
from .methods import METHODS
from .methods._fits import AUTO
from .records._record import StepRecord


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
        refuse_tracers(record, 'identify(method="auto")')
        return _identify_auto(record, options)
    return _run(record, _known(method), options)


def _known(method: str):
    if method not in METHODS:
        raise KeyError(f"Unknown method {method!r}; known are auto, {', '.join(METHODS)}.")
    return METHODS[method]


def _run(record: StepRecord, method, options) -> Identification:
    """Run a compiled method on the bare record, so that names of columns do not recompile it."""
    result = method(record.plain, **options)
    return dataclasses.replace(result, record=record, details=result.details | record.details)


def refuse_tracers(record: StepRecord, what: str) -> None:
    if any(isinstance(x, Tracer) for x in jax.tree.leaves(record)):
        raise TypeError(
            f"{what} chooses between model classes on the host and cannot be traced: name one"
            " method inside jit, vmap and grad."
        )


def _identify_auto(record: StepRecord, options: dict[str, Any]) -> Identification:
    options = dict(options)
    errors = options.pop("errors", True)
    bare = record.plain
    fits = [_searched(search, bare, options) for search in AUTO.values()]
    scores = [float(fitted.score) for fitted in fits]
    chosen = int(np.argmin(scores))
    result = _concluded(fits[chosen], bare, errors)
    details = {f"aicc_{name}": jnp.asarray(score) for name, score in zip(AUTO, scores, strict=True)}
    details["chosen"] = jnp.asarray(chosen)
    details = result.details | record.details | details
    return dataclasses.replace(result, record=record, details=details)


@eqx.filter_jit
def _searched(search: Callable[..., Fitted], record: StepRecord, options) -> Fitted:
    return search(record, **options)


@eqx.filter_jit
def _concluded(fitted: Fitted, record: StepRecord, errors: bool) -> Identification:
    return concluded(fitted, record, errors)


def chosen_method(result: Identification) -> str:
    """Name of the method that "auto" kept."""
    return list(AUTO)[int(result.details["chosen"])]


def aicc_of(result: Identification, order_found: bool):
    """AICc of a result over all rows of its record, infinite for a refusal.

    `order_found` as in `parameter_count`; a fit has counted its own.
    """
    if "aicc" in result.details:
        value = result.details["aicc"]
    else:
        record = result.record
        square = jnp.sum((record.y - result.predict(record.t)) ** 2)
        value = aicc(square, record.y.size, parameter_count(result, order_found))
    return jnp.where(refused(result.status) | jnp.isnan(value), jnp.inf, value)


def parameter_count(result: Identification, order_found: bool) -> int:
    """Number of parameters that were found from the record, the order among them if `order_found`.

    Of a fit those that its AICc counts. Of other methods: lags of 0 do not count, equal ones once,
    nor a dead time of 0, nor gain and offset where the record's levels are known.
    """
    if "parameters" in result.details:
        return int(result.details["parameters"])
    model, record = result.model, result.record
    levels = {"gain": record.final, "offset": record.initial}
    known = {name for name, level in levels.items() if level is not None}
    known |= set() if float(model.delay) else {"delay"}
    # A real order is a parameter of the model too; found, it still counts once.
    known |= {"n"} if order_found else set()
    found = set(model.parameter_names) - known
    values = [np.unique(np.asarray(getattr(model, name))) for name in found]
    return int(order_found) + sum(int(np.count_nonzero(x)) if x.size > 1 else 1 for x in values)
