"""Least squares with few parameters and bounds: a Levenberg-Marquardt solver for optimistix."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, PyTree

from .._arrays import Flag, Scalar, row_by_row


REFUSED = 0.1
"""Least damping after a step that did not lower the cost: from below it would take many more."""

DAMPED = 1e-3
"""Damping of the first step."""

SURE = 1e-4
"""Share of the cost to which it must be known for a search to end there."""

HOPE = 30.0
"""Times the decrease of the cost that a full step promises: what may be left of it at best."""


class _State(eqx.Module):
    """Everything has the size of the parameters; nothing of the size of the data is carried."""

    candidate: Float[Array, " p"]
    predicted: Scalar
    cost: Scalar
    gradient: Float[Array, " p"]
    matrix: Float[Array, "p p"]
    damping: Scalar
    growth: Scalar
    converged: Flag
    failed: Flag
    near: PyTree
    doubt: Scalar


class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    r"""Levenberg-Marquardt for p <= 10 parameters within bounds.

    Each iteration evaluates residuals and Jacobian once, at the candidate; only the normal matrix
    $J^\top J$ and gradient are kept. Damping is scaled by the diagonal (Marquardt 1963) and
    follows the gain ratio (Nielsen 1999). Parameters on a bound whose gradient points outwards
    leave the step; those that a step would carry across are put on the bound and the others solved
    again. It ends when the decrease of the cost that a full Gauss-Newton step promises is at most
    `rtol` of the cost, or the cost is at most `atol`, or only short steps lower it, and hardly: a
    minimum at a kink, such as a dead time on a sample. The result is the best point seen, and from
    there the step that promised so little, unless it is long.

    Where residuals are so curved that their Jacobian loses a direction, `options["curvature"]`,
    a function of (args, y), adds $\sum_i r_i \nabla^2 r_i$ to the normal matrix, whose negative
    eigenvalues then count as positive ones; `options["retract"]`, a function of (args, y, step),
    gives the end of a step on the curve that follows the valley, with the step as its tangent.
    `options["products"]`, a function of (args, y, near), gives the inner products of the
    derivatives of the residuals, and of these last, where a caller has a shorter way to them; what
    it wants to know at points near by, `near`, of which `options["near"]` is the first; and by how
    much twice the cost may be wrong, for want of that.
    `options["beat"]`: a cost that the result is to get below; the search fails where that is out of
    reach.

    Parameters are a tuple of numbers, or a row of them. With a tuple, the derivative in one does
    not compute what depends on the others alone. Bounds come in `options`: `dict(lower=...,
    upper=...)`, rows. The normal matrix squares the condition number: normalise data and
    parameters first.
    """

    rtol: float
    atol: float = 0.0
    norm: Callable[..., Any] = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _State:
        """State before the first evaluation: the candidate is the start."""
        del fn, args, f_struct, aux_struct, tags
        y = jnp.stack(list(y))
        number = jnp.zeros((), y.dtype)
        return _State(
            candidate=jnp.clip(y, options["lower"], options["upper"]),
            predicted=number,
            cost=number + jnp.inf,
            gradient=jnp.zeros_like(y),
            matrix=jnp.eye(y.size, dtype=y.dtype),
            damping=number + DAMPED,
            growth=number + 2,
            converged=jnp.array(False),
            failed=jnp.array(False),
            near=options.get("near"),
            doubt=number,
        )

    def step(self, fn, y, args, options, state, tags) -> tuple[PyTree, _State, PyTree]:
        """Evaluate the candidate, keep it if it is better, and prepare the next one."""
        del tags
        lower, upper = options["lower"], options["upper"]
        new, like, y = state.candidate, y, jnp.stack(list(y))
        products, near, doubt, aux = _evaluated(fn, new, like, args, options, state.near)
        cost = 0.5 * products[-1, -1]
        cost = jnp.where(jnp.isfinite(cost), cost, jnp.inf)
        better = _is_better(state, cost)
        curved = "curvature" in options
        damping, growth = _next_damping(state, cost, better, curved)

        y = jnp.where(better, new, y)
        cost = jnp.where(better, cost, state.cost)
        gradient = jnp.where(better, products[:-1, -1], state.gradient)
        normal = products[:-1, :-1]
        if curved:
            normal = _positive(normal, options["curvature"](args, new), lower < upper)
        matrix = jnp.where(better, normal, state.matrix)
        near, doubt = jax.tree.map(
            lambda a, b: jnp.where(better, a, b), (near, doubt), (state.near, state.doubt)
        )

        free = free_parameters(y, gradient, lower, upper)
        full, candidate = _steps(matrix, gradient, free, damping, y, lower, upper)
        move = candidate - y
        predicted = -(gradient @ move) - 0.5 * move @ matrix @ move
        if "retract" in options:
            candidate = jnp.clip(options["retract"](args, y, move), lower, upper)

        sure = doubt <= SURE * cost
        good = (sure & (-0.5 * gradient @ full <= self.rtol * cost)) | (cost <= self.atol)
        decrease = jnp.where(better, state.cost - cost, jnp.inf)
        stalled = self._stalled(y, move, damping, predicted, cost, decrease)
        finite = jnp.isfinite(cost)
        # what the step within bounds promises, as long as none that failed has made it shorter
        early = (damping <= DAMPED) & (predicted > 0)
        promised = jnp.where(early, predicted, -0.5 * gradient @ full)
        hopeless = cost - HOPE * promised > options.get("beat", jnp.inf)
        converged, failed = finite & (good | stalled) & ~hopeless, ~finite | hopeless
        new_state = _State(
            candidate,
            predicted,
            cost,
            gradient,
            matrix,
            damping,
            growth,
            converged,
            failed,
            near,
            doubt,
        )
        # A short step that promises next to nothing is taken without a last look. Short is a
        # cube root: a quadratic model errs by its cube, which is rtol then.
        short = jnp.max(jnp.abs(move)) ** 3 <= self.rtol
        y = jnp.where(finite & good & short, candidate, y)
        return _similar(y, like), new_state, aux

    def _stalled(self, y, move, damping, predicted, cost, decrease) -> Flag:
        """Whether steps have become too short to tell, or lower the cost by next to nothing.

        At a kink only short steps lower it, and the promise of a full step never falls to `rtol`:
        its 3/4 power, with a damping that has grown, is as far as the cost can be trusted there.
        In a valley that has no bottom, such as that of a lag far below the sampling interval and
        the dead time, each step lowers the cost by a little less than the one before: it has ended
        where the last one and the next one do not reach a tenth of `rtol`.
        """
        eps = jnp.finfo(y.dtype).eps
        tiny = (damping > 1 / eps) | (jnp.max(jnp.abs(move)) <= eps * jnp.max(jnp.abs(y)))
        kink = (damping > 1) & (predicted <= jnp.sqrt(self.rtol * jnp.sqrt(self.rtol)) * cost)
        little = self.rtol / 10 * cost
        return tiny | kink | ((predicted <= little) & (decrease <= little))

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Whether the last evaluation ended the iteration, and how."""
        del fn, y, args, options, tags
        result = optx.RESULTS.where(
            state.failed, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful
        )
        return state.converged | state.failed, result

    def postprocess(
        self, fn, y, aux, args, options, state, tags, result
    ) -> tuple[PyTree, PyTree, dict[str, Any]]:
        """The result as it is."""
        del fn, args, options, state, tags, result
        return y, aux, {}


def _evaluated(fn, new, like, args, options, near) -> tuple[Array, PyTree, Scalar, PyTree]:
    """Inner products of derivatives and residuals at a point, and what else comes with them."""
    if "products" in options:
        products, near, doubt = options["products"](args, new, near)
        return products, near, 0.5 * doubt, None
    residual, aux = fn(_similar(new, like), args)
    jacobian = derivatives(lambda *x: fn(_similar(jnp.stack(x), like, x), args)[0], new)
    return inner_products([*jacobian, residual]), near, jnp.zeros((), new.dtype), aux


def _is_better(state: _State, cost: Scalar) -> Flag:
    """Whether a step has lowered the cost.

    Below rounding of the cost the gradient alone tells: such a step is taken on its word. Data are
    of size one, so each residual is rounded by some eps, the contour's by 64 at most
    (test_gradient_through_the_fit), and the cost by that of their root sum, beside its own doubt.
    """
    rounding = jnp.finfo(cost.dtype).eps * (state.cost + jnp.sqrt(2 * state.cost)) + state.doubt
    within = (state.predicted <= rounding) & (cost <= state.cost + 64 * rounding)
    return (cost < state.cost) | (within & (state.predicted > 0))


def _next_damping(state: _State, cost: Scalar, better: Flag, curved: bool) -> tuple[Scalar, Scalar]:
    """Damping after a step, and by how much it grows after the next one that fails.

    Nielsen (1999): it shrinks with the gain ratio, at most to a tenth, and grows by 2, 4, 8, ...
    With curvature the model is trusted less far: 4, 16, ..., from any damping.
    """
    ratio = (state.cost - cost) / jnp.where(state.predicted > 0, state.predicted, 1)
    shrink = jnp.maximum(0.1, 1 - (2 * jnp.clip(ratio, 0, 1) - 1) ** 3)
    more = jnp.maximum(state.damping * state.growth, 0 if curved else REFUSED)
    damping = jnp.where(better, state.damping * shrink, more)
    damping = jnp.where(jnp.isinf(state.cost), state.damping, damping)
    return damping, jnp.where(better, 2, (4 if curved else 2) * state.growth)


def _similar(row: Array, like, parts=None):
    """Parameters in the form that the caller uses: a row, or a tuple of numbers."""
    return row if eqx.is_array(like) else type(like)(list(row) if parts is None else parts)


def derivatives(function, x: Float[Array, " p"]) -> Float[Array, "p residuals"]:
    """Derivatives of `function(x_1, ..., x_p)`, a row a parameter, one forward pass each.

    The barrier keeps XLA from sharing subexpressions between the passes: on a CPU that sharing
    splits each pass into many loops over memory and makes it several times slower.
    """
    directions = []
    for i in range(x.size):
        x = jax.lax.optimization_barrier(x)
        before, after = list(x[:i]), list(x[i + 1 :])
        one = lambda xi, before=before, after=after: function(*before, xi, *after)  # noqa: E731
        directions.append(jax.jvp(one, (x[i],), (jnp.ones_like(x[i]),))[1])
    return jnp.stack(directions)


def inner_products(rows: list[Float[Array, " residuals"]]) -> Float[Array, "rows rows"]:
    """Sums of the products of all pairs.

    On a CPU a matrix product adds four times faster than single sums.
    """
    matrix = row_by_row(rows)
    return matrix @ matrix.T


def free_parameters(y, gradient, lower, upper) -> Bool[Array, " p"]:
    """Parameters that can move, and are not on a bound with the cost falling beyond it."""
    stuck = ((y <= lower) & (gradient > 0)) | ((y >= upper) & (gradient < 0))
    return (lower < upper) & ~stuck


def _positive(normal: Array, curvature: Array, varies: Array) -> Array:
    """Their sum over what varies, scaled, with the absolute values of its eigenvalues."""
    diagonal = jnp.diagonal(normal) + jnp.abs(jnp.diagonal(curvature))
    scale = jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1))
    scale = scale[:, None] * scale[None, :]
    both = varies[:, None] & varies[None, :]
    values, vectors = jnp.linalg.eigh(jnp.where(both, normal + curvature, 0) / scale)
    return (vectors * jnp.abs(values)[None, :]) @ vectors.T * scale


def _steps(matrix, gradient, free, damping, y, lower, upper) -> tuple[Array, Array]:
    """The undamped step, and the end of the damped one within bounds.

    What would cross is set on its bound and the rest solved again. The first two are solved at
    once: of so few numbers the number of loops is what counts.
    """
    both = jnp.stack([jnp.zeros_like(damping), damping])
    full, step = jax.vmap(lambda damping: damped_step(matrix, gradient, free, damping))(both)
    crosses = free & ((y + step < lower) | (y + step > upper))
    clipped = jnp.where(crosses, jnp.clip(y + step, lower, upper) - y, 0)
    rest = damped_step(matrix, gradient + matrix @ clipped, free & ~crosses, damping)
    return full, jnp.clip(y + clipped + rest, lower, upper)


def damped_step(matrix, gradient, free, damping) -> Array:
    """Solution of (H + damping diag H) step = -gradient over the free parameters."""
    both = free[:, None] & free[None, :]
    diagonal = jnp.diagonal(matrix)
    tiny = jnp.finfo(matrix.dtype).tiny
    scale = 1 / jnp.sqrt(jnp.maximum(jnp.where(free, diagonal, 1), tiny))
    scaled = jnp.where(both, matrix * scale[:, None] * scale[None, :], 0)
    eps = jnp.finfo(matrix.dtype).eps
    # 8 eps: what rounding leaves of a pivot where two columns are the same to all digits
    scaled = scaled + jnp.diag(jnp.where(free, damping + 8 * eps, 1 + 0 * damping))
    right = jnp.where(free, -gradient * scale, 0)
    return jnp.where(free, solve_positive(scaled, right) * scale, 0)


def solve_positive(matrix: Float[Array, "p p"], right: Float[Array, " p"]) -> Float[Array, " p"]:
    """Cholesky solution written out: for few unknowns it vectorises over a batch.

    By divisions, which XLA stores: products with inverse pivots it computes again for each unknown,
    rounded in another way, and of nearly dependent columns the unknowns no longer go together.
    """
    p = right.shape[0]
    factor: list[list[Array]] = []
    half: list[Array] = []
    floor = jnp.finfo(matrix.dtype).eps * jnp.finfo(matrix.dtype).eps
    for i in range(p):
        row: list[Array] = []
        for j in range(i):
            value = matrix[i, j] - sum(row[k] * factor[j][k] for k in range(j))
            row.append(value / factor[j][j])
        pivot = matrix[i, i] - sum(x * x for x in row)
        row.append(jnp.sqrt(jnp.maximum(pivot, floor)))
        half.append((right[i] - sum(row[k] * half[k] for k in range(i))) / row[i])
        factor.append(row)
    solution: list[Array] = [half[-1]] * p
    for i in reversed(range(p)):
        known = sum(factor[k][i] * solution[k] for k in range(i + 1, p))
        solution[i] = (half[i] - known) / factor[i][i]
    return jnp.stack(solution)
