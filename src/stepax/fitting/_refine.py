"""Least-squares refinement of any model to a record."""

import dataclasses
from collections.abc import Callable, Iterable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array

from .._arrays import Samples
from .._result import Identification, conclude
from .._status import Status, first_problem, refused
from ..models._contour import accuracy
from ..models._plants import AbstractPlant, EqualLag, Hudzovic, Sani, parameter_names
from ..models._spread import DEFAULT_ORDERS, check_orders
from ..records._record import StepRecord, usable_record
from ._certainty import HUBER, aicc, with_errors
from ._families import with_order
from ._optimum import Optimum, optimum
from ._problem import Fit, least_loss, weights_of
from ._solver import BoundedLevenbergMarquardt


SAME_AICC = 2.0
"""Difference in AICc below which the smaller order is kept (Burnham and Anderson 2002)."""

LOSSES = ("squares", "huber")


@eqx.filter_jit
def refine(
    record: StepRecord,
    model: AbstractPlant,
    fixed: Sequence[str] = (),
    *,
    order: str | int | None = None,
    orders: Iterable[int] = DEFAULT_ORDERS,
    weights: Samples | None = None,
    loss: str = "squares",
    solver: optx.AbstractLeastSquaresSolver | None = None,
    max_steps: int = 80,
    errors: bool = True,
) -> Identification:
    r"""Model that minimises the squared error, found from `model`.

    $$ \min \sum_i w_i \left(y_i - b - a\, g(t_i - t_0 - L)\right)^2, \qquad
       b = \text{offset}, \; a = \text{step size} \cdot \text{gain}, $$

    over all rows of the record: those before the step tell the offset. Own parameters, gain,
    offset and delay are free within their ranges (0 <= r, delay >= 0, gain of either sign), except

    - `fixed`: names of parameters kept exactly as in `model`;
    - known levels of the record: `initial` fixes the offset, with `final` the gain too; `final`
        alone keeps offset + step_size gain = final;
    - the order n, except a real n of `EqualLag`; a lag of 0 of `PTn` is none and stays none.

    **Arguments:**

    - `model`: the start, in the record's units.
    - `order`: "auto" tries each of `orders` for n, from the same sum of lags and ratio of rates,
        and keeps the smallest whose AICc is within 2 of the best, since with a free delay orders
        are nearly interchangeable; AICc then counts n as one more parameter.
    - `weights`: per row, 1 by default; the standard errors take them as inverse variances up to a
        common factor. 0 leaves a row out.
    - `loss`: "huber" bounds the pull of glitches: beyond 1.345 times the noise level (1.4826 times
        the median absolute residual, of a fit by squares and of one by this loss before) a
        residual counts linearly (Huber 1964).
    - `solver`: any optimistix least-squares solver; bounds are kept only by the default one.
    - `errors=False` leaves standard errors and covariance NaN, which is faster.

    **Returns:** `Identification`; see `with_errors` for the standard errors. Derivatives with
    respect to the record and to what is fixed come from the implicit function theorem; those of a
    lane that did not converge are NaN. `.details`: `steps`, `aicc` (Hurvich and Tsai 1989, with
    the number of free `parameters`), `at_bound` in the order of `.free`, with "huber" the
    `noise_level`; unless `errors=False` also those of `with_errors`.
    """
    _check(model, fixed, order, loss)

    def fit(model: AbstractPlant) -> Identification:
        return _refine(record, model, tuple(fixed), weights, loss, solver, max_steps)

    if order is None:
        result = fit(model)
    else:
        result = best_order(record, check_orders(orders), lambda n: fit(with_order(model, n)))
    if errors:
        result = with_errors(result, fixed, weights, loss)
    return dataclasses.replace(result, record=record, details=result.details | record.details)


def best_order(
    record: StepRecord, orders: Sequence[int], fit: Callable[[Array], Identification]
) -> Identification:
    """Fits of several orders, of which the smallest is kept that AICc does not reject."""
    results = jax.lax.map(fit, jnp.asarray(orders))
    score = jnp.where(refused(results.status), jnp.inf, results.details["aicc"])
    # argmax finds the first, that is smallest, order that is near enough
    best = jnp.argmax(score <= jnp.min(score) + SAME_AICC)
    result = jax.tree.map(lambda x: x[best], results)
    details = {name: result.details[name] + more for name, more in (("aicc", 2), ("parameters", 1))}
    details = result.details | details
    return dataclasses.replace(result, record=record, details=details)


def _refine(record, model, fixed, weights, loss, solver, max_steps) -> Identification:
    """One order, without standard errors."""
    record_problem, safe = usable_record(record)
    fit = Fit(safe, model, weights_of(record, weights), fixed)
    if solver is None:
        eps = float(jnp.finfo(safe.y.dtype).eps)
        atol = 0.5 * least_loss(safe.y.dtype, safe)
        solver = BoundedLevenbergMarquardt(rtol=eps**0.5, atol=atol)
    noise = {}
    if loss == "huber":
        fit, found, noise["noise_level"] = _robust(fit, solver, max_steps)
    else:
        found = optimum(fit, fit.start(), solver, max_steps)
    fitted, g = fit.plant(found.x)
    status = first_problem(
        record_problem,
        Status.where(found.converged, Status.successful, Status.not_converged),
        fit.settled_status(g),
        fit.bound_status(found.x),
    )
    free = fit.free_names()
    parameters = len(free) - jnp.sum(fit.absent)
    loss_value = jnp.sum(fit.residual(found.x, g) ** 2) * fit.range**2
    details = {
        "steps": found.steps,
        "at_bound": fit.at_bound(found.x),
        "parameters": parameters,
        "aicc": aicc(loss_value, jnp.sum(fit.weights > 0), parameters),
    }
    result = conclude(safe, fitted, status, response=g, free=free, details=details | noise)
    return dataclasses.replace(result, record=record)


def _robust(fit: Fit, solver, max_steps: int) -> tuple[Fit, Optimum, Array]:
    """Huber's loss with the noise level of the fit before; the first is one by squares."""
    dtype = fit.record.y.dtype
    everything = jnp.asarray(1e6, dtype)  # in units of the range: no residual lies beyond it
    first = dataclasses.replace(fit, threshold=everything).start()

    def stage(carry, _):
        """The better optimum from the last one and from the first start: squares may mislead."""
        x, noise = carry
        current = dataclasses.replace(fit, threshold=HUBER * noise)
        starts = jnp.stack([x, first])
        both = jax.lax.map(lambda x: optimum(current, x, solver, max_steps), starts)
        loss = jax.lax.map(lambda x: jnp.sum(current.residual(x) ** 2), both.x)
        better = jnp.argmin(jnp.where(both.converged, loss, jnp.inf))
        found = jax.tree.map(lambda x: x[better], both)
        counted = jnp.where(fit.weights > 0, jnp.abs(current.errors(found.x)), jnp.nan)
        size = jnp.nanmedian(counted)
        level = jnp.maximum(1.4826 * size, 10 * accuracy(dtype))
        return (found.x, level), (found, noise)

    _, (found, noise) = jax.lax.scan(stage, (first, everything), length=3)
    last = jax.tree.map(lambda x: x[-1], found)
    last = last._replace(steps=jnp.sum(found.steps))
    return dataclasses.replace(fit, threshold=HUBER * noise[-1]), last, noise[-1] * fit.range


def _check(model: AbstractPlant, fixed: Sequence[str], order: str | int | None, loss: str) -> None:
    known = parameter_names(model)
    name = type(model).__name__
    if isinstance(fixed, str):
        raise TypeError(f"fixed must be a sequence of names, such as fixed=({fixed!r},).")
    for parameter in fixed:
        if parameter not in known:
            raise ValueError(
                f"{name} has no parameter {parameter!r} to fix; it has {', '.join(known)}."
            )
    if loss not in LOSSES:
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}.")
    if order is None:
        return
    if order != "auto":
        raise ValueError(f'order must be "auto", or None to keep that of the model, got {order!r}.')
    if isinstance(model, Hudzovic | Sani) or (isinstance(model, EqualLag) and "n" not in known):
        return
    raise ValueError(f'order="auto" needs a chain with a whole order n, got {name}.')
