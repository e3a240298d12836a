"""The front door: one record in, a model out."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ._arrays import Count, Samples, Scalar
from ._compilation import compiled, is_traced, quick_compilation, rung, side_by_side
from ._notes import POOR_FIT
from ._result import Identification
from ._status import refused
from .fitting._certainty import with_record
from .fitting._fitted import Fitted, aicc, fit
from .fitting._refine import concluded
from .methods import METHODS
from .methods._fits import AUTO, CHAINS, WITH_REASON, FitOptions
from .methods._method import option_names, prepared
from .records._abstract import AbstractRecord
from .records._glitches import MOST, are_glitches, outliers, spikes
from .records._input import InputRecord
from .records._preprocess import quantisation, window_of
from .records._record import StepRecord, padded_record, rows_that_count, with_weights
from .records._signs import Signs, signs
from .records._thin import thinned


AUTO_OPTIONS = (*FitOptions.__annotations__, "orders")
"""Options of `identify(method="auto")`: those of every fit, and the orders that chains try."""


def identify(
    record: StepRecord | InputRecord, method: str = "auto", **options: Any
) -> Identification:
    """Model of a recorded step response, or of a record of any input.

    **Arguments:**

    - `record`: a `StepRecord`, from arrays or from `read_record`; or an `InputRecord`, to which all
        methods can be applied that fit.
    - `method`: a name in `METHODS`, or "auto": all families of `AUTO` are fitted by least squares,
        chains in every order from 2 to 8, and the one with the smallest AICc is kept. A second
        order with a zero is tried too where the output first moves the wrong way or overshoots
        without oscillation, an integrator where it ends as a ramp; the former is kept if its AICc
        is better by more than 10, the latter also if it is as good as that of a model whose gain
        would be extrapolated to more than twice what was seen; to an `InputRecord` both are always
        tried. Where rows stand out as glitches do, or the fit is poor, Huber's loss is tried and
        kept if it explains the other rows clearly better (`glitches` in `.details`), unless `loss`
        is given. `.method` is the one kept; `.details` holds `aicc_<method>` of each that was
        tried, and the signs in the record.
    - `options`: passed to the method; see its docstring. "auto" takes those of `refine`, and
        `orders` for the chains. `all_rows=True`: a record of more than 4000 rows, which is averaged
        over equal spans of time otherwise (the result's `record`), is used as it is, as it is too
        with `weights`.

    **Returns:** `Identification`. What is wrong with the values of the record is in its `.status`.
    A named method is clean under `jit`, `vmap` and `grad`; "auto" chooses between classes on the
    host and raises a `TypeError` when traced.
    """
    if not isinstance(record, StepRecord | InputRecord):
        raise TypeError(
            f"identify needs a StepRecord or an InputRecord, got {type(record).__name__}: build one"
            " with StepRecord(t, y, ...), InputRecord(t, y, u) or read_record(path)."
        )
    return identify_filled(record, method, options, rung)


def identify_filled(
    record: AbstractRecord, method: str, options: dict[str, Any], length: Callable[[int], int]
) -> Identification:
    """`identify` for a ladder of lengths that records are filled up to."""
    if method != "auto" and method not in METHODS:
        raise KeyError(f"Unknown method {method!r}; known are auto, {', '.join(METHODS)}.")
    options = dict(options)
    all_rows = options.pop("all_rows", False)
    if method != "auto" and is_traced((record, options)):
        result = METHODS[method](record.plain, **options)
    else:
        refuse_tracers(record, 'identify(method="auto")')
        if not all_rows and options.get("weights") is None:
            record = thinned(record)
        known = AUTO_OPTIONS if method == "auto" else option_names(METHODS[method])
        options = prepared(method, known, record, options)
        check_length(record, options)
        filled = filled_record(record, options.pop("weights", None), length)
        run = _identify_auto if method == "auto" else METHODS[method]
        with quick_compilation():
            result = run(filled, **options)
    return with_record(result, record)


def check_length(record: AbstractRecord, options: dict[str, Any]) -> None:
    """A `ValueError` for a record that is too short to be smoothed; filled up it may not be."""
    if options.get("span") is not None and not is_traced(options["span"]):
        window_of(record.t.size, options["span"])


def filled_record(
    record: AbstractRecord, weights: Any = None, length: Callable[[int], int] = rung
) -> Any:
    """A bare record filled up to a rung of a ladder of lengths; host code.

    One compilation serves all records of a rung. `weights` are those given to a fit.
    """
    return padded_record(with_weights(record.plain, weights), length(record.t.size))


def refuse_tracers(record: AbstractRecord, what: str) -> None:
    if is_traced(record):
        raise TypeError(
            f"{what} chooses between model classes on the host and cannot be traced: name one"
            " method inside jit, vmap and grad."
        )


CLEARLY_BETTER = 10.0
"""Difference in AICc from which a model has essentially no support (Burnham, Anderson 2002).

A zero can mimic what a higher order does a little better: less than that is no reason."""

HALF_SEEN = 0.5
"""Share of its change that a record must show of a settling model, to be told from a ramp."""


def _identify_auto(
    record: AbstractRecord,
    errors: bool = True,
    orders: tuple[int, ...] | None = None,
    **options: Any,
) -> Identification:
    """Of a filled record; the searches compile side by side."""
    record = record.seeking(options.pop("at_rest", None), options.pop("drift", None))
    chains = {} if orders is None else {"orders": orders}
    asked = {name: options | chains if name in CHAINS else options for name in AUTO}
    fits, scores, seen = _search_all(record, asked)
    best = min(scores, key=scores.__getitem__)
    reasons = {
        "sopdt_zero_fit": bool(seen.wrong_way) or bool(seen.lone_overshoot),
        "ipdt_fit": bool(seen.unsettled),
    }
    for name, search in WITH_REASON.items():
        if reasons[name]:
            fits[name], score = _searched(search, record, options)
            scores[name] = float(score)
    chosen = _kept(record, fits[best], scores, best)
    result, residual = _concluded(fits[chosen], record, errors)
    result = dataclasses.replace(result, method=chosen)
    if "loss" not in options and not fits[chosen].beside:
        poor = not float(result.fit_percent) > POOR_FIT
        if poor or spikes(_counted(fits[chosen], residual))[0].any():
            kept = _without_glitches(record, fits[chosen], residual, asked, poor)
            if kept is not None:
                chosen, scores, robust, facts = kept
                result, _ = _concluded(robust, record, errors)
                result = dataclasses.replace(result, method=chosen, details=result.details | facts)
    details = {f"aicc_{name}": np.asarray(score) for name, score in scores.items()}
    details |= seen._asdict()
    details = {name: jnp.asarray(x) for name, x in details.items()}
    return dataclasses.replace(result, details=result.details | details)


def _search_all(
    record: AbstractRecord, asked: dict[str, dict[str, Any]]
) -> tuple[dict[str, Fitted], dict[str, float], Signs]:
    """The fit of each family, its score, and the signs in the record."""
    names = sorted(AUTO, key=lambda name: name != "sani_fit")  # what takes longest begins
    searched = {name: _searched_long if name == "sani_fit" else _searched for name in names}
    tasks = [partial(searched[name], AUTO[name], record, asked[name]) for name in names]
    *fits, seen = side_by_side([*tasks, partial(_signs, record)])
    found = dict(zip(names, fits, strict=True))
    scores = {name: float(found[name][1]) for name in AUTO}
    return {name: found[name][0] for name in AUTO}, scores, seen


def _counted(fit: Fitted, rows: Any) -> np.ndarray:
    """Of one value a row, those of the rows that a fit counts."""
    return np.asarray(rows)[np.asarray(fit.problem.weights) > 0]


def _without_glitches(
    record: AbstractRecord,
    squares: Fitted,
    residual: Samples,
    asked: dict[str, dict[str, Any]],
    poor: bool,
) -> tuple[str, dict[str, float], Fitted, dict[str, Array]] | None:
    """Families fitted with Huber's loss, where that explains the bulk of the rows better.

    They start from what the squares give without the spikes. The name of the best, AICc of each
    over the rows that do not stand out, the fit, and details; None where the fit by squares is
    kept. `residual`: of its rows, over the range; `poor`: whether it misses the response.
    """
    safe = squares.problem.record
    unit, y, away = (
        float(squares.problem.range),
        _counted(squares, safe.y),
        _counted(squares, residual),
    )
    stand, by = spikes(y / unit)
    # small ones on a slope stand out of a model alone; and what answers to an input may stand out
    if not stand.any() or not isinstance(record, StepRecord):
        stand, by = spikes(away)
    clean = np.array(safe.y)
    clean[np.flatnonzero(squares.problem.weights)[stand]] -= unit * by[stand]
    starts, *_ = _search_all(eqx.tree_at(lambda r: r.y, safe, jnp.asarray(clean)), asked)
    tasks = [partial(_robust, record, starts[name], asked[name]) for name in AUTO]
    tried = dict(zip(AUTO, side_by_side(tasks), strict=True))
    fits = {name: fit for name, (fit, _) in tried.items() if not bool(refused(fit.status))}
    if not fits:
        return None
    rows = {name: _counted(squares, tried[name][1]) for name in fits}
    noise = {name: float(fit.noise_level) / unit for name, fit in fits.items()}
    sharpest = min(noise, key=noise.__getitem__)
    out = outliers(rows[sharpest], noise[sharpest], float(quantisation(jnp.asarray(y))) / unit)

    def score(away: np.ndarray, parameters: Count) -> float:
        square = jnp.asarray(np.sum(away[~out] ** 2))
        return float(aicc(square, int(np.sum(~out)), int(parameters)))

    scores = {name: score(rows[name], fit.parameters) for name, fit in fits.items()}
    best = min(scores, key=scores.__getitem__)
    better = score(away, squares.parameters) - scores[best] > CLEARLY_BETTER
    if not better or not (are_glitches(out) or (poor and 0 < out.mean() <= MOST)):
        return None
    after = _counted(squares, safe.after_step) & ~out
    spread = np.linalg.norm(y[after] - y[after].mean())
    percent = 100 * (1 - unit * np.linalg.norm(rows[best][after]) / spread)
    details = {"glitches": jnp.asarray(out.sum()), "fit_of_the_rest": jnp.asarray(percent)}
    return best, scores, fits[best], details


def _kept(record: AbstractRecord, fit: Fitted, score: dict[str, float], best: str) -> str:
    """The method to keep, of which `best` is the best without a special reason, and `fit` its fit.

    What was tried for a reason must be clearly better. A ramp is the limit of settling models, none
    of which it can beat by much: it is kept where it is as good, and the best of them would have to
    extrapolate its gain, not being known, to more than twice the change that the record shows.
    """
    others = [name for name in WITH_REASON if name in score]
    winner = min(others, key=score.__getitem__, default=best)
    if score[winner] < score[best] - CLEARLY_BETTER:
        return winner
    extrapolates = record.final is None and "gain" not in fit.problem.fixed
    if extrapolates and "ipdt_fit" in others and score["ipdt_fit"] <= score[best]:
        if not float(_share_shown(fit)) > HALF_SEEN:
            return "ipdt_fit"
    return best


def _search(
    search: Callable[..., Fitted], record: AbstractRecord, options
) -> tuple[Fitted, Scalar]:
    """A fit and its score."""
    fitted = search(record, **options)
    return fitted, fitted.score


# The contour sum of Sani's chain runs ten times as long as the closed forms of the others.
_searched, _searched_long = compiled(_search), compiled(_search, effort=2)


@compiled
def _robust(record: AbstractRecord, start: Fitted, options) -> tuple[Fitted, Samples]:
    """The fit with Huber's loss from that of a family by squares, and its residuals."""
    model, _ = start.problem.plant(start.x)
    options = {name: value for name, value in options.items() if name != "orders"}
    fitted = fit(record, model, **options, loss="huber")
    fitted = dataclasses.replace(fitted, parameters=start.parameters)  # an order among them
    return fitted, fitted.problem.errors(fitted.x)


@compiled
def _concluded(
    fitted: Fitted, record: AbstractRecord, errors: bool
) -> tuple[Identification, Samples]:
    """The result, and the residuals over the range, which cost nothing here."""
    _, g = fitted.problem.response(fitted.x)
    return concluded(fitted, record, errors), fitted.problem.errors(fitted.x, g)


@compiled
def _signs(record: AbstractRecord) -> Signs:
    return signs(record)


@compiled
def _share_shown(fitted: Fitted) -> Scalar:
    """Share of its change that a settling model has gone in the last row of the record."""
    model, g = fitted.problem.plant(fitted.x)
    return fitted.problem.record.share_shown(model, g)


def aicc_of(result: Identification, order_found: bool) -> float:
    """AICc of a result over all rows of its record, infinite for a refusal; host code.

    `order_found` as in `parameter_count`; a fit has counted its own.
    """
    if "aicc" in result.details:
        value = float(result.details["aicc"])
    else:
        found = parameter_count(result, order_found)
        count = rows_that_count(result.record).t.size
        with quick_compilation():
            arguments = result.details["square"], np.asarray(count), np.asarray(found)
            value = float(_aicc(*arguments))
    return np.inf if bool(refused(result.status)) or np.isnan(value) else value


_aicc = compiled(aicc)


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
