"""A problem and its solution: what orders and families are chosen among."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from .._arrays import Count, Samples, Scalar, safe_sqrt, still
from .._status import Status, first_problem, refused
from ..models._abstract import COMMON, AbstractPlant
from ..models._contour import accuracy
from ..records._abstract import AbstractRecord
from ._optimum import Optimum, implicit, optimum
from ._prior import prior_of
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
    parameter too. `stages`: coordinates of the fits before the last, where the loss needs a noise
    level; `robust`: whether that is Huber's. Everything else follows from problem and coordinates.

    The search has no derivatives: `with_derivatives` gives them, once for what was chosen.
    """

    problem: Problem
    x: Array
    status: Status
    steps: Count
    aicc: Scalar
    parameters: Count
    stages: Array | None = None
    robust: bool = eqx.field(static=True, default=False)

    @property
    def noise_level(self) -> Scalar:
        """Of a robust fit, or one with a prior, in units of the output."""
        threshold, prior = self.problem.threshold, self.problem.prior
        assert threshold is not None
        return (threshold / HUBER if prior is None else prior.noise) * self.problem.range

    @property
    def beside(self) -> bool:
        """Whether more than a response and its levels was found."""
        return self.problem.record.seeks_beside

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
    prior: Mapping[str, Any] | None = None,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    max_steps: int = MAX_STEPS,
) -> Fitted:
    """The least loss from a start; arguments as in `refine`."""
    record_problem, safe, row_weights = problem_data(record, weights)
    problem = Problem.of(safe, start, row_weights, tuple(fixed))
    if solver is None:
        eps = float(jnp.finfo(safe.y.dtype).eps)
        atol = 0.5 * least_loss(safe.y.dtype, safe)
        # the cost is flat to a root of eps around its least value: beyond, digits are noise
        solver = BoundedLevenbergMarquardt(rtol=eps**0.5)
        solver = eqx.tree_at(lambda s: s.atol, solver, atol)  # traced where rows are
    beside = problem.record.beside(start)
    if beside and (prior or loss != "squares"):
        raise ValueError("A prior or a loss other than squares needs a plant at rest and no drift.")
    if prior or loss == "huber":
        numbers = [x.name for x in problem.free_scalars if x.place is None]
        rows = prior_of(prior, start, numbers, safe.y.dtype)
        problem = dataclasses.replace(problem, prior=rows)
        quiet, found, stages = _staged(still(problem), loss == "huber", solver, max_steps)
    else:
        quiet, stages = still(problem), None
        found = optimum(quiet, quiet.start(), solver, max_steps)
    converged = Status.where(found.converged, Status.successful, Status.not_converged)
    parameters = len(problem.free_scalars) - jnp.sum(problem.absent)
    if beside:
        parameters = parameters + jnp.sum(jnp.any(jnp.stack(beside) != 0, axis=1))
    problem = dataclasses.replace(problem, threshold=quiet.threshold)
    if quiet.prior is not None:
        problem = eqx.tree_at(lambda p: p.prior.noise, problem, quiet.prior.noise)
    return Fitted(
        problem=problem,
        x=found.x,
        status=first_problem(record_problem, converged),
        steps=found.steps,
        aicc=_aicc(quiet, found.x, parameters),
        parameters=parameters,
        stages=stages,
        robust=loss == "huber",
    )


def _aicc(problem: Problem, x: Array, parameters: Array | int) -> Scalar:
    """AICc, in which a prior counts as the likelihood of its parameters."""
    _, g = problem.response(x)
    square = dataclasses.replace(problem, prior=None).loss(x, g) * problem.range**2
    value = aicc(square, jnp.sum(problem.counted), parameters)
    if problem.prior is None:
        return value
    model, _ = problem.plant(x)
    return value + jnp.sum(problem.prior.distances(model) ** 2)


def with_derivatives(fitted: Fitted) -> Fitted:
    """The same, with the derivatives of all coordinates in the data and in what is known."""
    problem = fitted.problem
    converged = ~(fitted.status == Status.not_converged)
    if fitted.stages is not None:
        robust = fitted.robust
        problem = _with_noise(problem, jnp.zeros((), fitted.x.dtype), robust)
        for x in fitted.stages:  # each is the optimum for the noise level of the one before
            level = _noise_level(problem, implicit(problem, x, converged), robust)
            problem = _with_noise(problem, level, robust)
    x = implicit(problem, fitted.x, converged)
    moves = _aicc(problem, x, fitted.parameters)  # what an order costs does not
    return dataclasses.replace(
        fitted, problem=problem, x=x, aicc=fitted.aicc + moves - still(moves)
    )


EVERYTHING = 1e6
"""A threshold, in units of the range, beyond which no residual lies."""


def _with_noise(problem: Problem, noise: Scalar, robust: bool) -> Problem:
    """The problem at a noise level, over the range; at 0, not known yet, by squares of rows alone.

    Gain and offset are coordinates, for which there must be a threshold.
    """
    known = noise > 0 if robust else False
    threshold = jnp.where(known, HUBER * noise, EVERYTHING).astype(noise.dtype)
    prior = problem.prior
    prior = None if prior is None else dataclasses.replace(prior, noise=noise)
    return dataclasses.replace(problem, threshold=threshold, prior=prior)


def _noise_level(problem: Problem, x: Array, robust: bool) -> Scalar:
    """That of the residuals at x, over the range."""
    counted, errors = problem.counted, problem.errors(x)
    if robust:
        # 1.4826 times the median makes a standard deviation of Gaussian noise
        level = 1.4826 * jnp.nanmedian(jnp.where(counted, jnp.abs(errors), jnp.nan))
    else:
        level = safe_sqrt(jnp.sum(errors**2) / jnp.sum(counted))
    return jnp.maximum(level, 10 * accuracy(x.dtype))


def _staged(
    problem: Problem, robust: bool, solver, max_steps: int
) -> tuple[Problem, Optimum, Array]:
    """What needs a noise level: that of the fit before, the first being one by squares alone.

    Last the coordinates of the fits before the last.
    """
    unknown = jnp.zeros((), problem.record.y.dtype)
    first = _with_noise(problem, unknown, robust).start()

    def stage(carry, _):
        """The better optimum from the last one and from the first start: squares may mislead."""
        x, noise = carry
        current = _with_noise(problem, noise, robust)
        starts = jnp.stack([x, first])
        both = jax.lax.map(lambda x: optimum(current, x, solver, max_steps), starts)
        loss = jax.lax.map(current.loss, both.x)
        better = jnp.argmin(jnp.where(both.converged, loss, jnp.inf))
        found = jax.tree.map(lambda x: x[better], both)
        return (found.x, _noise_level(current, found.x, robust)), (found, noise)

    # squares, then twice with the noise level of the stage before: a third moves it by little
    _, (found, noise) = jax.lax.scan(stage, (first, unknown), length=3)
    last = jax.tree.map(lambda x: x[-1], found)
    last = last._replace(steps=jnp.sum(found.steps))
    return _with_noise(problem, noise[-1], robust), last, found.x[:-1]


def best_order(
    record: AbstractRecord,
    weights: Samples | None,
    orders: Sequence[int],
    start: AbstractPlant,
    next_start: Callable[[AbstractPlant, Array], AbstractPlant],
    fit_from: Callable[[AbstractRecord, AbstractPlant], Fitted],
) -> Fitted:
    """Of the fits of several orders the smallest that AICc does not reject.

    The first order is fitted from `start`, each other one from `next_start(plant, n)`, the plant
    being the optimum before. The order that was chosen counts as one more parameter.
    """
    data = lambda f: (f.problem.record, f.problem.weights)  # noqa: E731
    like = jnp.result_type(record.y)

    def one(before: AbstractPlant, place: tuple[Array, Array]):
        """What differs from order to order: copies of the record do not pass through the scan."""
        n, first = place
        following = next_start(before, n)
        begin = jax.tree.map(lambda a, b: jnp.where(first, a, b), before, following)
        fitted = fit_from(quiet, begin)
        return _found(fitted, begin), (eqx.tree_at(data, fitted, (None, None)), fitted.score)

    start = jax.tree.map(lambda x: x.astype(like) if eqx.is_inexact_array(x) else x, start)
    quiet = still(record)  # `with_derivatives` has those of the order that is kept
    first = np.arange(len(orders)) == 0
    _, (fits, score) = jax.lax.scan(one, still(start), (jnp.asarray(orders), first))
    # argmax finds the first, that is smallest, order that is near enough
    best = jnp.argmax(score <= jnp.min(score) + SAME_AICC)
    kept = jax.tree.map(lambda x: x[best], fits)
    same = problem_data(record, weights)[1:]
    kept = eqx.tree_at(data, kept, same, is_leaf=lambda x: x is None)
    known = {name: getattr(start, name) for name in kept.problem.fixed if name in COMMON}
    model = dataclasses.replace(kept.problem.model, **known)
    kept = eqx.tree_at(lambda f: f.problem.model, kept, model)
    return dataclasses.replace(kept, aicc=kept.aicc + 2, parameters=kept.parameters + 1)


def _found(fitted: Fitted, start: AbstractPlant) -> AbstractPlant:
    """The start of a fit with the own parameters and the dead time that it found, if it did."""
    usable = jnp.isfinite(fitted.score)
    found = still(fitted.problem.shape(fitted.x))
    names = [n for n in start.parameter_names if n not in ("gain", "offset")]
    free = {name: getattr(start, name) for name in names if name not in fitted.problem.fixed}
    after = {
        name: jnp.where(usable, getattr(found, name), x).astype(x.dtype) for name, x in free.items()
    }
    return dataclasses.replace(start, **after)
