r"""The optimum of a problem, and its derivatives by the implicit function theorem."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from .._arrays import Count, Flag, Scalar, still
from .._compilation import FORM
from ._individual_lags import curvature, in_order, means_of_equal, retract
from ._lanes import Search, run_search
from ._levels import Near
from ._problem import Problem
from ._solver import BoundedLevenbergMarquardt, damped_step, free_parameters, solve_positive


REACH = 50
"""Intervals between samples to each side of a first estimate in which a dead time is sought at
most: of a record that hardly tells the dead time more are not worth their time."""

ALLOWED = 9.0
"""Sum of squares, in units of the noise's variance, that a dead time may lose to another before
those beyond it are out of the question: three standard errors. With 30 % noise and 60 rows 99 % of
records come out at the least cost of all, as many as if all intervals were searched; with the
nearest five alone 94 % do, and 89 % with 200 rows."""

STRAIGHT = 0.2
"""How far other coordinates, most of them logarithms, go along a valley before that may bend."""

TIE = 1e-9
"""Relative difference of costs that is rounding, or 4 eps where that is more."""

LOOSE = 1e-3
"""Relative decrease of the cost at which that first estimate ends."""


class Optimum(NamedTuple):
    """Coordinates, whether the iteration converged, and its number of steps."""

    x: Array
    converged: Flag
    steps: Count


def optimum(problem: Problem, start: Array, solver, max_steps: int) -> Optimum:
    """Coordinates of the least loss, from `start`; their derivatives are those of `implicit`.

    The cost of a first-order plant has a kink and often a minimum wherever the dead time meets a
    sample; between samples it is smooth. So each of the intervals around a first estimate is
    searched on its own. Where a loss may have two minima, as that of nearly first-order plants, it
    is searched from a second start too. The best is kept.
    """
    problem, start, solver = still((problem, start, solver))
    if start.size == 0:
        return Optimum(start, jnp.array(True), jnp.array(0))
    problem = dataclasses.replace(problem, record=problem.record.for_search())
    ours = isinstance(solver, BoundedLevenbergMarquardt)
    search = _between_samples if ours and problem.kinked else _anywhere
    if ours and problem.second_start(start) is not None:
        found, _ = _from_two_starts(search, problem, start, solver, max_steps)
    else:
        found, _ = search(problem, start, solver, max_steps, jnp.array(True))
    return found._replace(x=in_order(problem, found.x))


def _anywhere(problem: Problem, start: Array, solver, max_steps, wanted) -> tuple[Optimum, Array]:
    """The optimum from a start, and its cost."""
    near = problem.first_near
    found = _solve(problem, start, *problem.bounds(), solver, max_steps, wanted, near)
    return found.optimum, found.cost


def _from_two_starts(
    search, problem: Problem, start: Array, solver, max_steps: int
) -> tuple[Optimum, Array]:
    """The better of the optima from `start` and from the second start that the first suggests."""

    def better(best, second):
        best, least = best
        other = problem.second_start(best.x)
        assert other is not None
        begin = jnp.where(second, other.x, best.x)
        wanted = ~second | other.worthwhile
        found, cost = search(problem, begin, solver, max_steps, wanted)
        steps = best.steps + found.steps
        found, cost = jax.tree.map(
            lambda new, old: jnp.where(wanted & (cost <= least), new, old),
            (found, cost),
            (best, least),
        )
        return (found._replace(steps=steps), cost), None

    return jax.lax.scan(better, _nothing(start), jnp.array([False, True]))[0]


def _nothing(start: Array) -> tuple[Optimum, Array]:
    """No optimum yet, at an infinite cost.

    All with the lanes of the start: JAX traces a loop once more for what gets lanes within it.
    """
    zero = jnp.where(start[0] > 0, 0, jnp.zeros_like(start[0]))
    return Optimum(start, zero > 0, zero.astype(int)), zero + jnp.inf


class _Found(NamedTuple):
    """The end of a search, with the cost, J^T J and levels there."""

    optimum: Optimum
    cost: Array
    matrix: Array
    near: Near


class _Sweep(NamedTuple):
    """Searches between samples so far: where they are centred, the best, the cell it lies in.

    `goes_on`: whether to the left, and to the right. `number` of searches: the first estimate, its
    own cell, then one to the left, one to the right, and so on. That estimate is no optimum within
    a cell: as the best so far it has an infinite cost.
    """

    centre: Array
    best: _Found
    cell: Count
    steps: Count
    goes_on: Array
    number: Count


def _between_samples(
    problem: Problem, start: Array, solver, max_steps: int, wanted: Flag
) -> tuple[Optimum, Array]:
    """The best of the optima in the intervals between samples around a first estimate.

    From there on outwards, to each side until the cost says that no better one lies beyond.
    """
    lower, upper = problem.bounds()
    place = problem.delay_place
    loose = jnp.maximum(LOOSE, solver.rtol)
    tie = max(TIE, 4 * float(jnp.finfo(start.dtype).eps))
    excluded = 1 + ALLOWED / jnp.sum(problem.counted)
    earliest = jnp.maximum(problem.record.elapsed[0] / problem.record.duration, 0)

    def search(so_far: _Sweep) -> _Sweep:
        number = so_far.number
        first, cell = number == 0, jnp.where(number % 2 == 0, -(number // 2), number // 2)
        side = jnp.stack([cell <= 0, cell >= 0]) & ~first
        looks = wanted & (first | jnp.any(so_far.goes_on & side))
        left, right = _cell(problem, so_far.centre[place], upper[place], cell, first)
        low, high = lower.at[place].set(left), upper.at[place].set(right)
        within = eqx.tree_at(lambda s: s.rtol, solver, jnp.where(first, loose, solver.rtol))
        valley = _along_the_valley(so_far, place, low, high)
        begin = jnp.clip(jnp.where(jnp.isinf(so_far.best.cost), so_far.centre, valley), low, high)
        # of equal costs the smaller dead time, although rounding may decide for another
        beat = so_far.best.cost * (1 + jnp.where(cell < so_far.cell, tie, -tie))
        near = so_far.best.near
        found = _solve(problem, begin, low, high, within, max_steps, looks, near, beat)
        better = first | (looks & (found.cost < beat))
        best, best_cell = jax.tree.map(
            lambda new, old: jnp.where(better, new, old),
            (found, cell),
            (so_far.best, so_far.cell),
        )
        # before the first row there is one interval, if only of no dead time
        more = jnp.stack([right > earliest, right < upper[place]])
        beyond = more & (found.cost <= excluded * best.cost)
        return _Sweep(
            centre=jnp.where(first, found.optimum.x, so_far.centre),
            best=best._replace(cost=jnp.where(first, jnp.inf, best.cost)),
            cell=best_cell,
            steps=jnp.where(first, found.optimum.steps, so_far.steps),
            goes_on=jnp.where(side & looks, beyond, so_far.goes_on),
            number=number + 1,
        )

    (nothing, infinite), zero = _nothing(start), jnp.array(0)
    no_matrix = jnp.eye(start.size, dtype=start.dtype) + 0 * start[:, None]
    nowhere = _Found(nothing, infinite, no_matrix, problem.first_near)
    both = jnp.stack([wanted, wanted]) & jnp.isinf(infinite)
    end = jax.lax.while_loop(
        lambda x: jnp.any(x.goes_on) & (x.number < 2 * (REACH + 1)),
        search,
        _Sweep(start, nowhere, nothing.steps, nothing.steps, both, zero),
    )
    best = end.best.optimum
    return best._replace(steps=end.steps + best.steps), end.best.cost


def _along_the_valley(so_far: _Sweep, place: int, low: Array, high: Array) -> Array:
    """The best so far with its dead time moved into bounds, and what goes along with that."""
    x, matrix = so_far.best.optimum.x, so_far.best.matrix
    move = jnp.clip(x[place], low[place], high[place]) - x[place]
    free = (low < high).at[place].set(False)
    along = damped_step(matrix, matrix[:, place] * move, free, jnp.zeros_like(move))
    short = jnp.max(jnp.abs(along)) <= STRAIGHT
    return jnp.where(short, (x + along).at[place].add(move), so_far.centre)


def _solve(
    problem,
    start,
    lower,
    upper,
    solver,
    max_steps,
    wanted,
    near: Near,
    beat: Scalar | float = np.inf,
) -> _Found:
    """The optimum within bounds; the start where it is not `wanted`.

    One that cannot get below the cost to `beat` need not be found. `near`: levels to begin with.
    """
    options = {}
    if problem.individual and start.size > 1:
        options |= {"curvature": curvature, "retract": retract}
    if isinstance(solver, BoundedLevenbergMarquardt):
        search = Search(problem, start, lower, upper, solver, wanted, near, beat)
        end = run_search(search, options | {"products": Problem.products}, max_steps)
        return _Found(Optimum(end.x, end.converged, end.steps), end.cost, end.matrix, end.near)
    solution = optx.least_squares(
        lambda x, problem: problem.residual(x),
        solver,
        tuple(start),
        problem,
        options=options | {"lower": lower, "upper": upper},
        max_steps=max_steps,
        throw=False,
    )
    x = jnp.clip(jnp.stack(solution.value), lower, upper)
    converged = solution.result == optx.RESULTS.successful
    nothing = jnp.zeros((), x.dtype), jnp.eye(x.size, dtype=x.dtype)  # which nobody asks for
    return _Found(Optimum(x, converged, solution.stats["num_steps"]), *nothing, near)


def _cell(
    problem: Problem, delay: Array, longest: Array, cell: Count, whole: Flag
) -> tuple[Array, Array]:
    """Ends of the interval that lies `cell` intervals from that of a dead time; or the whole range.

    They lie a rounding error inside, where the slope of the response at the sample is one-sided.
    """
    elapsed = problem.record.elapsed / problem.record.duration
    place = jnp.searchsorted(elapsed, delay, side="right") - 1 + cell
    index = jnp.clip(jnp.stack([place, place + 1]), 0, problem.record.last)
    left, right = jnp.clip(elapsed[index], 0, longest)
    # Of a record that begins after the step: up to its first row a first-order plant trades dead
    # time for gain and offset, if both are free; then no dead time stands for them all.
    left = jnp.where(place < 0, 0, left)
    if problem.known_levels.free == 2:
        right = jnp.where(place < 0, 0, right)
    margin = jnp.finfo(elapsed.dtype).eps ** 0.5 * (right - left)
    left = jnp.where((left > 0) & ~whole, left + margin, 0)
    right = jnp.where((right < longest) & ~whole, right - margin, longest)
    return left, jnp.maximum(left, right)


@eqx.filter_custom_jvp
def implicit(problem: Problem, x: Array, converged: Flag) -> Array:
    r"""Coordinates x of the least loss, with their derivatives in the problem.

    These come from the implicit function theorem for $\nabla_x \frac12 |r(x)|^2 = 0$ over the free
    coordinates; NaN where the search has not converged. A coordinate on its bound does not move,
    nor does a dead time at a kink, which the slope that is left there tells; equal lags move
    together. The matrix is the Hessian; where a dead time leaves it indefinite, $J^\top J$.
    """
    del problem, converged
    return x


@implicit.def_jvp
def _implicit_jvp(primals, tangents):
    """Few of them are computed, and once a fit: the contour's sums are a loop, quick to compile."""
    problem, x, converged = primals
    if x.size == 0:
        return x, jnp.zeros_like(x)
    with FORM("loop"):
        move = _move(problem, x, tangents[0])
    return x, jnp.where(converged, move, jnp.nan)


def _move(problem: Problem, x: Array, change_of_problem) -> Array:
    """How the optimum moves."""

    def gradient(x, problem):
        products, *_ = problem.products(x)
        return products[:-1, -1], products

    lower, upper = problem.bounds()
    hessian, products = jax.jacfwd(gradient, has_aux=True)(x, problem)
    slope, cost = products[:-1, -1], products[-1, -1]
    free = free_parameters(x, slope, lower, upper)
    if problem.kinked:
        place = problem.delay_place
        tiny = jnp.finfo(x.dtype).tiny
        promised = slope[place] ** 2 / jnp.maximum(jnp.abs(hessian[place, place]), tiny)
        free = free.at[place].set(free[place] & (promised <= 1e-7 * cost))
    _, change = eqx.filter_jvp(
        lambda problem: gradient(x, problem)[0], (problem,), (change_of_problem,)
    )
    mean = means_of_equal(problem, x)
    change = mean @ change
    scaled, scale = _scaled(hessian, free, mean)
    if problem.free_delay:
        definite = jnp.linalg.eigvalsh(scaled)[0] > jnp.finfo(x.dtype).eps ** 0.75
        normal, normal_scale = _scaled(products[:-1, :-1], free, mean)
        scaled, scale = jax.tree.map(
            lambda a, b: jnp.where(definite, a, b), (scaled, scale), (normal, normal_scale)
        )
    return -mean @ (scale * solve_positive(scaled, jnp.where(free, change, 0) * scale))


def _scaled(matrix: Array, free: Array, mean: Array) -> tuple[Array, Array]:
    """A normal matrix over the free coordinates with diagonal 1, and the scale that makes it so.

    Only moves that `mean` leaves as they are count; all others are made stiff.
    """
    matrix = mean @ matrix @ mean
    stiff = jnp.max(jnp.abs(jnp.diagonal(matrix)))
    matrix = matrix + stiff * (jnp.eye(free.size, dtype=matrix.dtype) - mean)
    both = free[:, None] & free[None, :]
    matrix = jnp.where(both, matrix, jnp.eye(free.size, dtype=matrix.dtype))
    scale = 1 / jnp.sqrt(jnp.maximum(jnp.abs(jnp.diagonal(matrix)), jnp.finfo(matrix.dtype).tiny))
    return matrix * scale[:, None] * scale[None, :], scale
