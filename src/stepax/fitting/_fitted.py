"""A problem and its solution: what orders and families are chosen among."""

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from .._arrays import Count, Samples, Scalar
from .._status import Status, first_problem, refused
from ..models._abstract import AbstractPlant
from ..models._contour import accuracy
from ..records._abstract import AbstractRecord
from ._optimum import Optimum, optimum
from ._problem import Problem, least_loss, problem_data
from ._solver import BoundedLevenbergMarquardt


SAME_AICC = 2.0
"""Difference in AICc below which the smaller order is kept (Burnham and Anderson 2002)."""

HUBER = 1.345
"""Threshold of Huber's loss over the noise level: 95 % efficient for Gaussian noise."""

LOSSES = ("squares", "huber")

MAX_STEPS = 80
"""Of one search: the slowest noisy lanes with a dead time take about 60."""


class Fitted(eqx.Module):
    """A problem, the coordinates of its least loss, and how the search for them ended.

    `aicc` and `parameters` are those by which fits are compared: an order that was chosen is a
    parameter too. Everything else follows from problem and coordinates.
    """

    problem: Problem
    x: Array
    status: Status
    steps: Count
    aicc: Scalar
    parameters: Count

    @property
    def noise_level(self) -> Scalar:
        """Of a robust fit, in units of the output."""
        assert self.problem.threshold is not None
        return self.problem.threshold * self.problem.range / HUBER

    @property
    def beside(self) -> bool:
        """Whether more than a response and its levels was found."""
        return bool(self.problem.record.beside(self.problem.model))

    @property
    def score(self) -> Scalar:
        """AICc, infinite for a refusal."""
        return jnp.where(refused(self.status) | jnp.isnan(self.aicc), jnp.inf, self.aicc)


def aicc(square: Scalar, count: Array | int, parameters: Array | int) -> Scalar:
    """Information criterion N ln(RSS/N) + 2 k N/(N - k - 1) (Hurvich and Tsai 1989)."""
    tiny = jnp.finfo(square.dtype).tiny
    penalty = 2 * parameters * count / jnp.maximum(count - parameters - 1, 1)
    return count * jnp.log(jnp.maximum(square / count, tiny)) + penalty


def fit(
    record: AbstractRecord,
    start: AbstractPlant,
    fixed: Sequence[str] = (),
    *,
    weights: Samples | None = None,
    loss: str = "squares",
    solver: optx.AbstractLeastSquaresSolver | None = None,
    max_steps: int = MAX_STEPS,
) -> Fitted:
    """The least loss from a start; arguments as in `refine`."""
    record_problem, safe, row_weights = problem_data(record, weights)
    problem = Problem(safe, start, row_weights, tuple(fixed))
    if solver is None:
        eps = float(jnp.finfo(safe.y.dtype).eps)
        atol = 0.5 * least_loss(safe.y.dtype, safe)
        # the cost is flat to a root of eps around its least value: beyond, digits are noise
        solver = BoundedLevenbergMarquardt(rtol=eps**0.5)
        solver = eqx.tree_at(lambda s: s.atol, solver, atol)  # traced where rows are
    beside = problem.record.beside(start)
    if beside and loss != "squares":
        raise ValueError(f'loss={loss!r} needs a plant at rest and no drift: use loss="squares".')
    if loss == "huber":
        problem, found = _robust(problem, solver, max_steps)
    else:
        found = optimum(problem, problem.start(), solver, max_steps)
    converged = Status.where(found.converged, Status.successful, Status.not_converged)
    parameters = len(problem.free_scalars) - jnp.sum(problem.absent)
    if beside:
        parameters = parameters + jnp.sum(jnp.any(jnp.stack(beside) != 0, axis=1))
    square = problem.loss(found.x, problem.plant(found.x)[1]) * problem.range**2
    return Fitted(
        problem=problem,
        x=found.x,
        status=first_problem(record_problem, converged),
        steps=found.steps,
        aicc=aicc(square, jnp.sum(problem.counted), parameters),
        parameters=parameters,
    )


def _robust(problem: Problem, solver, max_steps: int) -> tuple[Problem, Optimum]:
    """Huber's loss with the noise level of the fit before; the first is one by squares."""
    dtype = problem.record.y.dtype
    everything = jnp.asarray(1e6, dtype)  # in units of the range: no residual lies beyond it
    first = dataclasses.replace(problem, threshold=everything).start()

    def stage(carry, _):
        """The better optimum from the last one and from the first start: squares may mislead."""
        x, noise = carry
        current = dataclasses.replace(problem, threshold=HUBER * noise)
        starts = jnp.stack([x, first])
        both = jax.lax.map(lambda x: optimum(current, x, solver, max_steps), starts)
        loss = jax.lax.map(current.loss, both.x)
        better = jnp.argmin(jnp.where(both.converged, loss, jnp.inf))
        found = jax.tree.map(lambda x: x[better], both)
        counted = jnp.where(problem.counted, jnp.abs(current.errors(found.x)), jnp.nan)
        # 1.4826 times the median makes a standard deviation of Gaussian noise
        level = jnp.maximum(1.4826 * jnp.nanmedian(counted), 10 * accuracy(dtype))
        return (found.x, level), (found, noise)

    # squares, then twice with the noise level of the stage before: a third moves it by little
    _, (found, noise) = jax.lax.scan(stage, (first, everything), length=3)
    last = jax.tree.map(lambda x: x[-1], found)
    last = last._replace(steps=jnp.sum(found.steps))
    return dataclasses.replace(problem, threshold=HUBER * noise[-1]), last


def best_order(
    record: AbstractRecord,
    weights: Samples | None,
    orders: Sequence[int],
    start: AbstractPlant,
    next_start: Callable[[AbstractPlant, Array], AbstractPlant],
    fit_from: Callable[[AbstractPlant], Fitted],
) -> Fitted:
    """Of the fits of several orders the smallest that AICc does not reject.

    The first order is fitted from `start`, each other one from `next_start(plant, n)`, the plant
    being the optimum before. `fit_from` fits this record. The order that was chosen counts as one
    more parameter.
    """
    data = lambda f: (f.problem.record, f.problem.weights)  # noqa: E731
    like = jnp.result_type(record.y)

    def one(before: AbstractPlant, place: tuple[Array, Array]):
        """What differs from order to order: copies of the record do not pass through the scan."""
        n, first = place
        following = next_start(before, n)
        begin = jax.tree.map(lambda a, b: jnp.where(first, a, b), before, following)
        fitted = fit_from(begin)
        usable = jnp.isfinite(fitted.score)
        after = jax.tree.map(
            lambda a, b: jnp.where(usable, a, b).astype(b.dtype), _found(fitted, begin), begin
        )
        return after, (eqx.tree_at(data, fitted, (None, None)), fitted.score)

    start = jax.tree.map(lambda x: x.astype(like) if eqx.is_inexact_array(x) else x, start)
    first = np.arange(len(orders)) == 0
    _, (fits, score) = jax.lax.scan(one, start, (jnp.asarray(orders), first))
    # argmax finds the first, that is smallest, order that is near enough
    best = jnp.argmax(score <= jnp.min(score) + SAME_AICC)
    kept = jax.tree.map(lambda x: x[best], fits)
    same = problem_data(record, weights)[1:]
    kept = eqx.tree_at(data, kept, same, is_leaf=lambda x: x is None)
    return dataclasses.replace(kept, aicc=kept.aicc + 2, parameters=kept.parameters + 1)


def _found(fitted: Fitted, start: AbstractPlant) -> AbstractPlant:
    """The start of a fit with the own parameters and the dead time that it found."""
    found = jax.lax.stop_gradient(fitted.problem.shape(fitted.x))
    names = [n for n in start.parameter_names if n not in ("gain", "offset")]
    free = [name for name in names if name not in fitted.problem.fixed]
    return dataclasses.replace(start, **{name: getattr(found, name) for name in free})
