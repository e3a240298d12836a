"""Least-squares refinement of any model to a record."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array

from .._arrays import Samples
from .._batches import in_groups
from .._result import Identification, conclude
from .._status import first_problem, refused
from ..models._abstract import AbstractPlant
from ..models._spread import DEFAULT_ORDERS, check_orders
from ..records._abstract import AbstractRecord
from ._certainty import with_errors, with_record
from ._families import family_of
from ._fitted import LOSSES, MAX_STEPS, Fitted, best_order, fit, with_derivatives


@eqx.filter_jit
def refine(
    record: AbstractRecord,
    model: AbstractPlant,
    fixed: Sequence[str] = (),
    *,
    order: str | None = None,
    orders: Iterable[int] = DEFAULT_ORDERS,
    weights: Samples | None = None,
    loss: str = "squares",
    prior: Mapping[str, Any] | None = None,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    max_steps: int = MAX_STEPS,
    errors: bool = True,
    at_rest: bool | None = None,
    drift: bool | None = None,
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

    **Arguments:** `model`: the start, in the record's units. `order`: "auto" tries each of `orders`
    for n, from the same sum of lags and of their squares as the model or the order before, and
    keeps the smallest whose AICc, n being a parameter, is within 2 of the best. `weights`: per row;
    the standard errors take them as inverse variances up to a common factor, 0 leaves a row out.
    `loss`: "huber" bounds the pull of glitches: beyond 1.345 times the noise level (1.4826 times
    the median absolute residual, of a fit by squares and of one by this loss before) a residual
    counts linearly (Huber 1964). `prior`, `{"gain": (value, std)}`: what is known beforehand; the
    criterion gains $\sigma^2 ((p - v)/s)^2$, with the noise level $\sigma$ of the fit without it;
    standard errors and AICc know it. `solver`: any optimistix least-squares solver; only the
    default one keeps bounds. `errors=False`: no standard errors, faster. `at_rest=False`,
    `drift=True`: of an `InputRecord` the plant's state at the first row, and a linear drift, are
    found too (`own_motion`, `trend` in `.details`); None: as it has them.

    **Returns:** `Identification`; its standard errors: `with_errors`. Derivatives in the record and
    in what is fixed, by the implicit function theorem, are NaN in a lane that did not converge.
    """
    check_options(model, fixed, order, loss)
    record = record.seeking(at_rest, drift)

    def search(record: AbstractRecord, model: AbstractPlant, weights, prior, solver) -> Fitted:
        more = {"weights": weights, "prior": prior, "solver": solver}
        each = partial(fit, fixed=fixed, loss=loss, max_steps=max_steps, **more)
        if order is None:
            return each(record, model)
        numbers = check_orders(orders)
        first = with_order(model, jnp.asarray(numbers[0]))
        return best_order(record, weights, numbers, first, with_order, each)

    return concluded_in_groups(search, record, errors, model, weights, prior, solver)


def with_order(plant: AbstractPlant, n: Array) -> AbstractPlant:
    """A chain of another order that responds alike."""
    other = family_of(plant).with_order(n)
    assert other is not None  # `check_options` has asked
    return other


def concluded_in_groups(
    search: Callable[..., Fitted], record: AbstractRecord, errors: bool, *more: Any
) -> Identification:
    """The result of `search(record, *more)`, a batch of them group by group."""

    def without_record(record: AbstractRecord, *more: Any) -> Identification:
        """Not to copy the record."""
        return eqx.tree_at(of, concluded(search(record, *more), record, errors), None)

    of = lambda result: result.record  # noqa: E731
    result = in_groups(without_record)(record, *more)
    record = record.with_found(result.details)
    return eqx.tree_at(of, result, record, is_leaf=lambda x: x is None)


def concluded(fitted: Fitted, record: AbstractRecord, errors: bool = True) -> Identification:
    """The result of a fit; `record` is the one it was made from, names and details included."""
    fitted = with_derivatives(fitted)
    problem, x = fitted.problem, fitted.x
    model, g = problem.plant(x)
    status = first_problem(fitted.status, problem.settled_status(model, g), problem.bound_status(x))
    details = {
        "steps": fitted.steps,
        "at_bound": problem.at_bound(x),
        "parameters": fitted.parameters,
        # That of a refused record would be of what stands in for it.
        "aicc": jnp.where(refused(status), jnp.nan, fitted.aicc),
    }
    details |= problem.found_beside(x, model, g)
    if problem.threshold is not None:
        details["noise_level"] = fitted.noise_level
    free = tuple(scalar.label for scalar in problem.free_scalars)
    found = problem.record.with_found(details)
    result = conclude(found, model, status, response=g, free=free, details=details)
    if errors:
        result = with_errors(fitted, result)
    return with_record(result, record)


def check_options(model: AbstractPlant, fixed: Sequence[str], order: str | None, loss: str) -> None:
    """A sentence for what cannot be fixed, minimised or chosen."""
    known, name = model.parameter_names, type(model).__name__
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
    if family_of(model).with_order(jnp.asarray(2)) is None:
        raise ValueError(f'order="auto" needs a chain with a whole order n, got {name}.')
