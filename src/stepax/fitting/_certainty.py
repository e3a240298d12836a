r"""How certain a least-squares fit is: covariance, autocorrelation, verdict."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._arrays import Count, Samples, Scalar, nan_where, row_by_row, safe_sqrt
from .._batches import in_groups
from .._orthonormal import orthonormal
from .._result import Identification
from .._status import Status, first_problem, refused
from ..models._abstract import COMMON, ScalarParameter
from ..records._abstract import AbstractRecord
from ..records._preprocess import quantisation
from ..records._record import moved_beside, predict
from ._beside import Beside
from ._fitted import Fitted
from ._problem import Problem
from ._solver import derivatives


SAMPLES_AT_ONCE = 16384
"""Of all lanes whose errors are computed together: their Jacobians stay in the cache of a core."""


def student_95(freedom: Scalar) -> Scalar:
    """Half width of a 95 % interval over the standard error: Student's t, two-sided.

    Its expansion around the normal distribution (Abramowitz and Stegun 26.7.5), to 0.2 % for 3
    degrees of freedom and more: the verdict is traced with every fit, and there is no closed
    quantile in JAX; to invert `betainc` by iteration would take longer to compile than all else
    here. On the host intervals have the exact one.
    """
    z = 1.959964
    terms = (
        z,
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    inverse = 1 / jnp.maximum(freedom, 1)
    return sum(term * inverse**k for k, term in enumerate(terms))  # pyright: ignore[reportReturnType]


def with_errors(fitted: Fitted, result: Identification) -> Identification:
    r"""The result of a fit with its standard errors and covariance.

    With $J$ the Jacobian of the prediction in the free parameters and $A = J^\top J$ (rows times
    $\sqrt{w_i}$, across what else was eliminated),

    $$ \mathrm{cov} = \sigma^2 A^{-1} (J^\top R J) A^{-1}, \qquad
       \sigma^2 = \frac{\sum r_i^2}{N - \mathrm{tr}(A^{-1} J^\top R J)}, $$

    $R_{ij} = \varphi^{|i-j|}$ (Seber and Wild 1989, section 6.2): for white residuals
    ($\varphi = 0$) the usual formula. $\varphi$ is the lag-1 autocorrelation of the residuals with
    the first-order bias correction $(1 + (p + 3)\hat\varphi)/N$ (after Kendall 1954), and 0
    unless it exceeds $+2/\sqrt N$. With Huber's loss $r_i$ is $\psi(r_i)$ over the share of
    residuals within the threshold (Huber 1981, section 7.6). A parameter on a bound has NaN, the
    others hold with it fixed.

    **Verdict.** `details["identifiable"]`, in the order of `.free`, is false for an own parameter
    on a bound, for one without an effect of its own, for one that is positive by nature, or the
    gain, whose 95 % interval reaches 0, and for r if it covers half of its range or more. Unless
    it is the bound alone, the status is `not_identifiable`.
    """
    lanes = max(1, SAMPLES_AT_ONCE // fitted.problem.record.t.size)
    found = in_groups(_certainty, lanes)(fitted, result.model, result.status, result.details)
    return dataclasses.replace(
        result,
        status=first_problem(found.verdict, result.status),
        std=found.std,
        covariance=found.covariance,
        details=result.details | found.details,
    )


class _Certainty(NamedTuple):
    """What `with_errors` adds to a result."""

    verdict: Status
    std: dict[str, Array]
    covariance: Float[Array, "p p"]
    details: dict[str, Array]


def _certainty(fitted: Fitted, model, status: Status, details: dict[str, Array]) -> _Certainty:
    problem = fitted.problem.with_found(details)
    free, at_bound = problem.free_scalars, details["at_bound"]
    root, residual = _residual(problem, model)
    phi = _autocorrelation(residual, problem.record.count, len(free))
    quantum = quantisation(problem.record.y, problem.record.count)
    details = {
        "residual_autocorrelation": phi,
        "residuals_correlated": phi > 0,
        "quantisation": quantum,
        "quantised": quantum > 0,
        "identifiable": jnp.ones(0, bool),
    }
    if not free:
        nothing = jnp.zeros((0, 0), residual.dtype)
        std = _by_name(problem, model, (), residual[:0])
        return _Certainty(Status.successful, std, nothing, details)
    values = jnp.stack([_value(model, s).astype(residual.dtype) for s in free])
    found = _beside_a_kink(
        problem, values, partial(_covariance, problem, model, root, residual, phi, at_bound)
    )
    covariance = nan_where(refused(status), found.matrix)
    errors = safe_sqrt(jnp.diagonal(covariance))
    # Of correlated residuals N (1 - phi^2)/(1 + phi^2) rows tell their size (Bartlett 1946).
    freedom = found.freedom * (1 - phi**2) / (1 + phi**2)
    halves = student_95(freedom) * errors
    vague = found.lost | _vague(problem, free, values, halves, refused(status))
    vague = vague | _traded(problem, free, model.delay)
    vague = ~(found.at_bound | found.absent) & vague
    bounded = found.at_bound & np.array([s.name not in COMMON for s in free])
    details["identifiable"] = ~vague & ~bounded
    details |= {"effective_parameters": found.effective, "degrees_of_freedom": freedom}
    verdict = Status.where(jnp.any(vague), Status.not_identifiable, Status.successful)
    return _Certainty(verdict, _by_name(problem, model, free, errors), covariance, details)


def with_record(result: Identification, record: AbstractRecord) -> Identification:
    r"""A result with the record it was made from, whose names and details come along.

    **Axes.** A record from a picture says how certain its axes are (`scale_output`, `scale_time`,
    `stroke`, `stroke_time`; see `trace_image`), which no residual shows: the errors are the same in
    all rows. A parameter changes by itself times the relative change of its unit, a dead time also
    by the shift of time, an offset by that of the output: with deviation $s$ of each of these four
    causes and the parameters' sensitivity $v$ to it, $s^2 v v^\top$ is added to the covariance.
    """
    details = result.details | record.details
    result = dataclasses.replace(result, record=record.with_found(details), details=details)
    if "scale_time" not in record.details or not result.free:
        return result
    model = result.model
    free = [scalar for scalar in model.scalars if scalar.label in result.free]
    causes = jnp.stack([_through_the_axes(model, scalar, details) for scalar in free])
    covariance = result.covariance + causes @ causes.T
    std = dict(result.std)
    for scalar, error in zip(free, safe_sqrt(jnp.diagonal(covariance)), strict=True):
        row = std[scalar.name]
        std[scalar.name] = error if scalar.place is None else row.at[scalar.place].set(error)
    return dataclasses.replace(result, covariance=covariance, std=std)


def _through_the_axes(model, scalar: ScalarParameter, details: dict[str, Array]) -> Array:
    """Deviations of a parameter by the scales and places of both axes."""
    value = _value(model, scalar)
    time, output = value * details["scale_time"], value * details["scale_output"]
    zero = jnp.zeros_like(time)
    scales = {
        "time": (time, zero),
        "per time": (-time, zero),
        "output": (zero, zero),
        "output/input": (zero, output),
        "output/(input time)": (-time, output),
        "1": (zero, zero),
    }[model.dimension(scalar.name)]
    places = {"delay": ("stroke_time", 2), "offset": ("stroke", 3)}
    row = jnp.stack([*scales, zero, zero])
    if scalar.name in places:
        detail, cause = places[scalar.name]
        row = row.at[cause].set(details[detail])
    return row


def _residual(problem: Problem, model) -> tuple[Samples, Samples]:
    """Roots of the weights, and the weighted residuals; with Huber's loss cut off and raised."""
    root = safe_sqrt(problem.weights)
    residual = root * (problem.record.y - predict(model, problem.record))
    if problem.threshold is not None:
        threshold = problem.threshold * problem.range
        within = jnp.sum((jnp.abs(residual) <= threshold) & (root > 0)) / jnp.sum(root > 0)
        residual = jnp.clip(residual, -threshold, threshold) / within
    return root, residual


def _value(model, scalar: ScalarParameter) -> Array:
    """The number behind a scalar parameter."""
    value = jnp.asarray(getattr(model, scalar.name))
    return value if scalar.place is None else value[scalar.place]


def _with_numbers(model, scalars: Sequence[ScalarParameter], numbers):
    """The model with other numbers for some of its parameters."""
    new = {name: getattr(model, name) for name in dict.fromkeys(s.name for s in scalars)}
    for scalar, x in zip(scalars, numbers, strict=True):
        row = new[scalar.name]
        new[scalar.name] = x if scalar.place is None else row.at[scalar.place].set(x)
    return eqx.tree_at(lambda m: [getattr(m, name) for name in new], model, list(new.values()))


def _moves(problem: Problem, model, free: tuple[ScalarParameter, ...]) -> Float[Array, "p samples"]:
    """How the prediction moves with each free parameter, a row each."""
    own = [scalar for scalar in free if scalar.name not in COMMON]
    changes = []
    for name, place in own:
        value = getattr(model, name)
        one = jnp.ones_like(value) if place is None else jnp.zeros_like(value).at[place].set(1)
        changes.append({name: one})
    record = problem.record
    g, by_delay, _, moved = record.response_slopes(model, changes)
    size, tied = record.input_size, problem.known_levels.final is not None
    moves = {
        "delay": size * model.gain * by_delay,
        "gain": size * (g - 1 if tied else g),
        "offset": jnp.ones_like(g),
    }
    moves |= {s.label: size * model.gain * move for s, move in zip(own, moved, strict=True)}
    if record.found_beside is not None and own:
        values = jnp.stack([_value(model, scalar) for scalar in own])
        beside = derivatives(lambda *x: moved_beside(_with_numbers(model, own, x), record), values)
        moves |= {s.label: moves[s.label] + row for s, row in zip(own, beside, strict=True)}
    return row_by_row([moves[scalar.label] for scalar in free])


class _Covariance(NamedTuple):
    """A covariance matrix; parameters on a bound, that are no lags, without an effect of their own.

    `effective` is the number of parameters that the residuals have lost freedom by, `freedom` what
    they have left.
    """

    matrix: Float[Array, "p p"]
    at_bound: Bool[Array, " p"]
    absent: Bool[Array, " p"]
    lost: Bool[Array, " p"]
    effective: Scalar
    freedom: Scalar


def _beside_a_kink(
    problem: Problem, values: Array, covariance: Callable[[Array], _Covariance]
) -> _Covariance:
    """The covariance, beside a sample of the larger of its values on both sides of it.

    Where the dead time passes a sample, that row stops to tell the response, and the dead time is
    less certain. Of few rows that makes a difference: an optimum just before the sample would claim
    what holds on its side alone (20 rows of a first-order plant: 85 % coverage instead of 95).
    """
    if not problem.kinked:
        return covariance(values)
    elapsed = problem.record.elapsed
    place = [scalar.name for scalar in problem.free_scalars].index("delay")

    def on_a_side(values: Array, _) -> tuple[Array, _Covariance]:
        found, delay = covariance(values), values[place]
        reach = student_95(found.freedom) * safe_sqrt(found.matrix[place, place])
        ahead = jnp.min(jnp.where(elapsed > delay, elapsed, jnp.inf))
        after = ahead + jnp.finfo(delay.dtype).eps ** 0.5 * problem.record.duration
        return values.at[place].set(jnp.where(ahead < delay + reach, after, delay)), found

    _, sides = jax.lax.scan(on_a_side, values, length=2)
    first, second = sides.matrix[:, place, place]
    # A tenth of the standard error: of many rows one is less, and the usual formula stays exact.
    wider = second > 1.1**2 * first
    return jax.tree.map(lambda x: jnp.where(wider, x[1], x[0]), sides)


def _covariance(problem, model, root, residual, phi, at_bound, values) -> _Covariance:
    free = problem.free_scalars
    in_a_row = np.array([s.place is not None for s in free])
    absent = in_a_row & (values == 0) & ~at_bound
    frozen = absent | _frozen(in_a_row, values, at_bound)
    jacobian = root[None] * _moves(problem, _with_numbers(model, free, values), free)
    beside = _beside(problem, model, root)
    jacobian = jacobian - (jacobian @ beside.T) @ beside
    if problem.prior is not None:
        jacobian = jnp.concatenate([jacobian, _prior_rows(problem)], axis=1)
    jacobian = jnp.where(frozen[:, None], 0, jacobian)
    # A row that others explain to 64 eps of its length is rounding, no direction of its own.
    least = 64 * float(jnp.finfo(jacobian.dtype).eps)
    q, c, own = orthonormal(list(jacobian), 1.0, least)
    lost = ~own
    rows, known = q.T[: root.size], q.T[root.size :]
    coloured = _correlated(rows, phi)
    effective = jnp.trace(coloured) + jnp.trace(_correlated(beside.T, phi))
    coloured = coloured + known.T @ known
    freedom = jnp.maximum(jnp.sum(root > 0) - effective, 1)
    variance = jnp.sum(residual**2) / freedom
    matrix = variance * c.T @ coloured @ c
    unknown = at_bound | lost
    matrix = jnp.where(unknown[:, None] | unknown[None, :], jnp.nan, matrix)
    matrix = jnp.where(absent[:, None] | absent[None, :], 0, matrix)
    return _Covariance(matrix, at_bound, absent, lost, effective, freedom)


def _prior_rows(problem: Problem) -> Float[Array, "p priors"]:
    """How a prior's rows of the residuals change with the free parameters, in output units."""
    prior = problem.prior
    assert prior is not None
    free = [scalar.name for scalar in problem.free_scalars]
    is_of = np.array([[name == own for own in prior.names] for name in free])
    return jnp.where(is_of, prior.noise * problem.range / prior.std, 0)


def _beside(problem: Problem, model, root: Samples) -> Float[Array, "k samples"]:
    """Orthonormal rows of what else was found: parameters are as certain as what lies across."""
    columns = problem.record.beside(model)
    if not columns:
        return jnp.zeros((0, root.size), root.dtype)
    return root[None] * Beside.of(columns, problem.weights).q


def _frozen(in_a_row: np.ndarray, values: Array, at_bound: Array) -> Array:
    """Parameters to hold while the others vary: those on a bound, of equal lags all but one."""
    follows = jnp.append(False, in_a_row[1:] & in_a_row[:-1] & (values[1:] == values[:-1]))
    leads = jnp.append(follows[1:], False) & ~follows
    return at_bound & ~leads


def _vague(problem: Problem, free, values: Array, halves: Array, refusal) -> Array:
    """Parameters whose 95 % interval says next to nothing; an offset or dead time may be 0.

    `halves`: half widths of the intervals.
    """
    limits = [
        jnp.inf if s.name in ("delay", "offset") else problem.family.vague_beyond(s.name, value)
        for s, value in zip(free, values, strict=True)
    ]
    limits = jnp.stack([jnp.asarray(limit, values.dtype) for limit in limits])
    return ~(halves < limits) & ~refusal


def _traded(problem: Problem, free, delay: Scalar) -> Array | np.ndarray:
    """Gain and offset where rows begin after the step, and after the dead time.

    Of a first-order plant any dead time up to the first row then gives the same response with
    another gain and offset.
    """
    levels = np.array([s.name in ("gain", "offset") for s in free])
    if not problem.kinked or problem.known_levels.free < 2:
        return np.zeros(levels.size, bool)
    first = problem.record.elapsed[0]
    return levels & (first > 0) & (delay <= first)


def _by_name(problem: Problem, model, free, errors: Array) -> dict[str, Array]:
    """Standard errors by parameter: 0 where it was not found from the record."""
    std = {n: jnp.zeros(jnp.shape(getattr(model, n)), errors.dtype) for n in model.parameter_names}
    for scalar, error in zip(free, errors, strict=True):
        row = std[scalar.name]
        std[scalar.name] = error if scalar.place is None else row.at[scalar.place].set(error)
    if problem.known_levels.final is not None:
        std["offset"] = jnp.abs(problem.record.input_size) * std["gain"]
    return std


def _autocorrelation(residual: Array, count: Count | int, parameters: int) -> Scalar:
    """Lag-1 coefficient of the first `count`, corrected for bias; 0 where not significant.

    Nor where it is negative: the fit itself leaves such residuals, most of all of few rows, and
    errors that allow for it are far too small (of 10 rows, 20 to 40 % coverage instead of 95).
    """
    square = jnp.sum(residual**2)
    raw = jnp.sum(residual[1:] * residual[:-1]) / jnp.where(square > 0, square, 1)
    corrected = raw + (1 + (parameters + 3) * raw) / count
    return jnp.where(raw > 2 / count**0.5, jnp.clip(corrected, 0, 0.99), 0)


def _correlated(q: Array, phi: Scalar) -> Array:
    """q^T R q for R_ij = phi^|i-j|: the lower half of R by one pass, the upper one is the same."""

    def decay(carry, row):
        before, half = carry
        before = phi * before
        return (before + row, half + jnp.outer(row, before + row / 2)), None

    size = q.shape[1]
    nothing = jnp.zeros(size, q.dtype), jnp.zeros((size, size), q.dtype)
    (_, half), _ = jax.lax.scan(decay, nothing, q)
    return half + half.T
