"""The front door: one record in, a model out."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ._compilation import side_by_side
from ._result import Identification
from ._status import refused
from .fitting._fitted import Fitted, aicc
from .fitting._refine import concluded
from .methods import METHODS
from .methods._fits import AUTO, WITH_REASON, FitOptions
from .methods._method import prepared
from .records._record import StepRecord, compact
from .records._signs import signs


def identify(record: StepRecord, method: str = "auto", **options: Any) -> Identification:
    """Model of a recorded step response.

    **Arguments:**

    - `record`: a `StepRecord`, from arrays or from `read_record`.
    - `method`: a name in `METHODS`, or "auto": all families of `AUTO` are fitted by least squares,
        chains in every order from 2 to 8, and the one with the smallest AICc is kept. A second
        order with a zero is tried too where the output first moves the wrong way or overshoots
        without oscillation, an integrator where it ends as a ramp; the former is kept if its AICc
        is better by more than 10, the latter also if it is as good as that of a model whose gain
        would be extrapolated to more than twice what was seen. `.details` holds `aicc_<method>` of
        each that was tried, the signs in the record, and `chosen` (`chosen_method`).
    - `options`: passed to the method; see its docstring. "auto" takes those of `refine`.

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


CLEARLY_BETTER = 10.0
"""Difference in AICc from which a model has essentially no support (Burnham, Anderson 2002).

A zero can mimic what a higher order does a little better: less than that is no reason."""

HALF_SEEN = 0.5
"""Share of its change that a record must show of a settling model, to be told from a ramp."""


def _identify_auto(record: StepRecord, options: dict[str, Any]) -> Identification:
    bare = record.plain
    options = prepared("auto", tuple(FitOptions.__annotations__), bare, options)
    errors = options.pop("errors", True)
    found = side_by_side(partial(_searched, search, bare, options) for search in AUTO.values())
    fits: dict[str, Fitted] = dict(zip(AUTO, found, strict=True))
    best = min(fits, key=lambda name: float(fits[name].score))
    seen = signs(bare)
    reasons = {
        "sopdt_zero_fit": bool(seen.wrong_way | seen.lone_overshoot),
        "ipdt_fit": bool(seen.unsettled),
    }
    for name, search in WITH_REASON.items():
        if reasons[name]:
            fits[name] = _searched(search, bare, options)
    chosen = _kept(bare, fits, best)
    result = _concluded(fits[chosen], bare, errors)
    details = {f"aicc_{name}": jnp.asarray(float(fit.score)) for name, fit in fits.items()}
    details |= {name: jnp.asarray(flag) for name, flag in seen._asdict().items()}
    details["chosen"] = jnp.asarray(_CANDIDATES.index(chosen))
    details = result.details | record.details | details
    return dataclasses.replace(result, record=record, details=details)


_CANDIDATES = (*AUTO, *WITH_REASON)


def _kept(record: StepRecord, fits: dict[str, Fitted], best: str) -> str:
    """The method to keep, of which `best` is the best without a special reason.

    What was tried for a reason must be clearly better. A ramp is the limit of settling models, none
    of which it can beat by much: it is kept where it is as good, and the best of them would have to
    extrapolate its gain to more than twice the change that the record shows.
    """
    score = {name: float(fit.score) for name, fit in fits.items()}
    others = [name for name in WITH_REASON if name in fits]
    winner = min(others, key=score.__getitem__, default=best)
    if score[winner] < score[best] - CLEARLY_BETTER:
        return winner
    if "ipdt_fit" in others and score["ipdt_fit"] <= score[best]:
        result = _concluded(fits[best], record, False)
        used = compact(record)
        end = result.predict(used.t)[used.last]
        shown = (end - result.model.offset) / record.step_size
        if not bool(jnp.abs(shown) > HALF_SEEN * jnp.abs(result.model.gain)):
            return "ipdt_fit"
    return best


@eqx.filter_jit
def _searched(search: Callable[..., Fitted], record: StepRecord, options) -> Fitted:
    return search(record, **options)


@eqx.filter_jit
def _concluded(fitted: Fitted, record: StepRecord, errors: bool) -> Identification:
    return concluded(fitted, record, errors)


def chosen_method(result: Identification) -> str:
    """Name of the method that "auto" kept."""
    return _CANDIDATES[int(result.details["chosen"])]


def aicc_of(result: Identification, order_found: bool):
    """AICc of a result over all rows of its record, infinite for a refusal.

    `order_found` as in `parameter_count`; a fit has counted its own.
    """
    if "aicc" in result.details:
        value = result.details["aicc"]
    else:
        record = compact(result.record)
        residual = jnp.where(record.present, record.y - result.predict(record.t), 0)
        value = aicc(jnp.sum(residual**2), record.count, parameter_count(result, order_found))
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
