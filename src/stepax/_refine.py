r"""Least-squares refinement of any model to a record.

Gain and offset enter linearly: for given shape and dead time their best values are a regression
(variable projection, Golub and Pereyra 1973), so that the iteration sees one to four parameters.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from ._certainty import aicc, with_errors
from ._contour import accuracy
from ._coordinates import MAX_SPREAD, Family, family_of
from ._models import FOPDT, AbstractPlant, Hudzovic, Sani
from ._record import StepRecord, usable_record
from ._result import Identification, Status, conclude, first_problem, parameter_names, predict
from ._solver import BoundedLevenbergMarquardt, columns, free_parameters, solve_positive
from ._types import Coordinates, Samples, Scalar


SETTLED = 0.95
"""Share of the change that a record must show for its gain not to count as extrapolated."""


@eqx.filter_jit
def refine(
    record: StepRecord,
    model: AbstractPlant,
    fixed: Sequence[str] = (),
    *,
    weights: Samples | None = None,
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
    - the order n, except a real n of `EqualLag`.

    **Arguments:** `model` is the start, in the record's units. `weights` per row, 1 by default.
    `solver` is any optimistix least-squares solver; bounds are kept only by the default one.
    `errors=False` leaves standard errors and covariance NaN, which is faster.

    **Returns:** `Identification`; see `with_errors` for the standard errors. Derivatives with
    respect to the record and to what is fixed come from the implicit function theorem; those of a
    lane that did not converge are NaN. `.details`: `steps`, `aicc` (Hurvich and Tsai 1989, with
    the number of free parameters), `at_bound` in the order of `.free`; unless `errors=False` also
    `residual_autocorrelation`, `quantisation`, and the truth of `residuals_correlated`,
    `quantised`.
    """
    _check_names(model, fixed)
    record_problem, safe = usable_record(record)
    fit = Fit.of(safe, model, tuple(fixed), weights)
    start = fit.start()
    if solver is None:
        eps = float(jnp.finfo(safe.y.dtype).eps)
        solver = BoundedLevenbergMarquardt(
            rtol=eps**0.6, atol=0.5 * accuracy(safe.y.dtype) ** 2 * safe.y.size
        )
    x, converged, steps = _optimum(fit, start, solver, max_steps)
    fitted = fit.plant(x)
    stuck = fit.on_bound(x)
    status = first_problem(
        record_problem,
        Status.where(converged, Status.successful, Status.not_converged),
        fit.settled_status(fitted),
        fit.bound_status(stuck, x),
    )
    free, at_bound = fit.free_names(stuck)
    square = jnp.sum((safe.y - predict(fitted, safe, safe.t)) ** 2)
    details = {
        "steps": steps,
        "at_bound": at_bound,
        "aicc": aicc(square, safe.y.size, len(free)),
    }
    result = conclude(safe, fitted, status, free=free, details=details)
    if errors:
        result = with_errors(result, tied=fit.final is not None)
    return dataclasses.replace(result, record=record, details=result.details | record.details)


def final_level_ties(record: StepRecord, fixed: Sequence[str]) -> bool:
    """Whether a known final level ties gain and offset, neither being known."""
    return (
        record.final is not None
        and record.initial is None
        and "gain" not in fixed
        and "offset" not in fixed
    )


def _check_names(model: AbstractPlant, fixed: Sequence[str]) -> None:
    known = parameter_names(model)
    if isinstance(fixed, str):
        raise TypeError(f"fixed must be a sequence of names, such as fixed=({fixed!r},).")
    for name in fixed:
        if name not in known:
            raise ValueError(
                f"{type(model).__name__} has no parameter {name!r} to fix; it has"
                f" {', '.join(known)}."
            )


class Fit(eqx.Module):
    """One least-squares problem: the data, what is known, and the coordinates of the rest."""

    record: StepRecord
    model: AbstractPlant
    weights: Samples
    fixed: tuple[str, ...] = eqx.field(static=True)

    @staticmethod
    def of(record, model, fixed, weights) -> "Fit":
        """The problem for a usable record."""
        ones = jnp.ones_like(record.y)
        return Fit(record, model, ones if weights is None else weights * ones, fixed)

    @property
    def family(self) -> Family:
        """Coordinates of the model's family."""
        return family_of(self.model)

    @property
    def duration(self) -> Scalar:
        """Length of the record after the step, the unit of time of the coordinates."""
        return self.record.t[-1] - self.record.step_time

    @property
    def offset(self) -> Scalar | None:
        """The offset where it is known."""
        if "offset" in self.fixed:
            return jnp.asarray(self.model.offset, self.record.y.dtype)
        if self.record.initial is None and self.record.final is not None and "gain" in self.fixed:
            return self.record.final - self.record.step_size * self.model.gain
        return self.record.initial

    @property
    def gain(self) -> Scalar | None:
        """The gain where it is known."""
        if "gain" in self.fixed:
            return jnp.asarray(self.model.gain, self.record.y.dtype)
        if self.record.final is not None and self.offset is not None:
            return (self.record.final - self.offset) / self.record.step_size
        return None

    @property
    def final(self) -> Scalar | None:
        """The final level where it ties gain and offset, neither being known."""
        return self.record.final if final_level_ties(self.record, self.fixed) else None

    def free_names(self, stuck: dict[str, Array]) -> tuple[tuple[str, ...], Array]:
        """Names of the free parameters, lags counted one by one, and which lie on a bound."""
        known = set(self.fixed)
        known |= {"offset"} if self.offset is not None or self.final is not None else set()
        known |= {"gain"} if self.gain is not None else set()
        names: list[str] = []
        flags = [jnp.zeros(0, bool)]
        for name in parameter_names(self.model):
            if name not in known:
                size = jnp.size(getattr(self.model, name))
                names += [name] if name != "lags" else [f"lags[{k}]" for k in range(size)]
                flags.append(jnp.broadcast_to(stuck.get(name, jnp.array(False)), (size,)))
        return tuple(names), jnp.concatenate(flags)

    def _kept(self) -> np.ndarray:
        """Which of the family's coordinates are free."""
        names = self.family.names
        if names == ("lags",):
            names = names * len(self.family.bounds)
        return np.array([name not in self.fixed for name in names])

    def _shift(self) -> Array:
        return jnp.asarray(self.family.time_powers, self.record.t.dtype) * jnp.log(self.duration)

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the free coordinates; the delay's, over the duration, comes last."""
        pairs = [b for b, kept in zip(self.family.bounds, self._kept(), strict=True) if kept]
        if "delay" not in self.fixed:
            pairs.append((0.0, 0.95))
        lower, upper = np.array(pairs).reshape(-1, 2).T
        return jnp.asarray(lower, self.record.t.dtype), jnp.asarray(upper, self.record.t.dtype)

    def start(self) -> Array:
        """Free coordinates of the model given."""
        x = (self.family.encode(self.model) - self._shift())[np.flatnonzero(self._kept())]
        if "delay" not in self.fixed:
            x = jnp.append(x, self.model.delay / self.duration)
        lower, upper = self.bounds()
        return jax.lax.stop_gradient(jnp.clip(x.astype(lower.dtype), lower, upper))

    def shape(self, x: Coordinates) -> AbstractPlant:
        """Plant with gain 1 and offset 0 at coordinates."""
        full = list(self.family.encode(self.model).astype(self.record.t.dtype))
        shift = self._shift()
        for position, i in enumerate(np.flatnonzero(self._kept())):
            full[i] = x[position] + shift[i]
        own = self.family.decode(full, self.model)
        own |= {k: getattr(self.model, k) for k in own if k in self.fixed}
        order = getattr(self.model, "n", None)
        if order is not None:
            own.setdefault("n", order)
        delay = self.model.delay if "delay" in self.fixed else x[-1] * self.duration
        return type(self.model)(**own, delay=delay)

    def _levels(self, g: Samples) -> tuple[Scalar, Scalar]:
        """Best offset and amplitude (step size times gain) for a response g: a regression."""
        y, w, step = self.record.y, self.weights, self.record.step_size
        offset, gain, final = self.offset, self.gain, self.final
        if offset is not None and gain is not None:
            return offset, step * gain
        if gain is not None:
            return jnp.sum(w * (y - step * gain * g)) / jnp.sum(w), step * gain
        if offset is not None:
            return offset, _slope(w, g, y - offset)
        if final is not None:
            amplitude = _slope(w, g - 1, y - final)
            return final - amplitude, amplitude
        mean_g, mean_y = jnp.sum(w * g) / jnp.sum(w), jnp.sum(w * y) / jnp.sum(w)
        amplitude = _slope(w, g - mean_g, y - mean_y)
        return mean_y - amplitude * mean_g, amplitude

    def residual(self, x: Coordinates) -> Samples:
        """Weighted residuals over the range of the output."""
        g = self.shape(x).step_response(self.record.t - self.record.step_time)
        offset, amplitude = self._levels(g)
        scale = jax.lax.stop_gradient(jnp.max(self.record.y) - jnp.min(self.record.y))
        return jnp.sqrt(self.weights) * (self.record.y - offset - amplitude * g) / scale

    def plant(self, x: Coordinates) -> AbstractPlant:
        """The whole model at coordinates; what is known is returned exactly as given."""
        shape = self.shape(x)
        g = shape.step_response(self.record.t - self.record.step_time)
        offset, amplitude = self._levels(g)
        gain = amplitude / self.record.step_size if self.gain is None else self.gain
        return eqx.tree_at(lambda m: (m.gain, m.offset), shape, (gain, offset))

    def on_bound(self, x: Array) -> dict[str, Array]:
        """Whether each free parameter lies on a bound of its coordinate."""
        lower, upper = self.bounds()
        at = (x <= lower) | (x >= upper)
        kept = self._kept()
        own = np.zeros(len(kept), int)
        own[kept] = np.arange(kept.sum())
        flags: dict[str, Array] = {}
        if self.family.names == ("lags",):
            flags["lags"] = at[: len(kept)] if kept.any() else jnp.zeros(len(kept), bool)
        else:
            for i, name in enumerate(self.family.names):
                if kept[i]:
                    flags[name] = at[own[i]]
        if "delay" not in self.fixed:
            flags["delay"] = at[-1]
        return flags

    def settled_status(self, fitted: AbstractPlant) -> Status:
        """A warning where a gain to be found is extrapolated."""
        if self.gain is not None or self.final is not None:
            return Status.successful
        reached = fitted.unit_response(self.duration - fitted.delay)
        return Status.where(reached < SETTLED, Status.not_settled, Status.successful)

    def bound_status(self, stuck: dict[str, Array], x: Array) -> Status:
        """A warning where an own parameter lies on a bound; no dead time is no warning."""
        own = [jnp.any(flag) for name, flag in stuck.items() if name != "delay"]
        if not own:
            return Status.successful
        anywhere = jnp.any(jnp.stack(own))
        status = Status.where(anywhere, Status.at_bound, Status.successful)
        if isinstance(self.model, Hudzovic | Sani) and "r" in stuck:
            spread = x[1] if "T" not in self.fixed else x[0]
            status = Status.where(spread <= 0, Status.at_equal_lags, status)
            if isinstance(self.model, Sani):
                first = spread >= MAX_SPREAD
                status = Status.where(first, Status.at_first_order, status)
        return status


def _slope(w: Samples, x: Samples, y: Samples) -> Scalar:
    """Slope of the weighted regression of y on x through 0."""
    square = jnp.sum(w * x * x)
    return jnp.sum(w * x * y) / jnp.where(square > 0, square, 1)


@eqx.filter_custom_jvp
def _optimum(fit: Fit, start: Array, solver, max_steps: int):
    """Optimal coordinates, whether the iteration converged, and its number of steps."""
    if start.size == 0:
        return start, jnp.array(True), jnp.array(0)
    lower, upper = fit.bounds()
    solution = optx.least_squares(
        lambda x, fit: fit.residual(x),
        solver,
        tuple(start),
        fit,
        options={"lower": lower, "upper": upper},
        max_steps=max_steps,
        throw=False,
    )
    x = jnp.clip(jnp.stack(solution.value), lower, upper)
    return x, solution.result == optx.RESULTS.successful, solution.stats["num_steps"]


@_optimum.def_jvp
def _optimum_jvp(primals, tangents):
    r"""Implicit function theorem for $\nabla_x \frac12 |r(x)|^2 = 0$ over the free coordinates.

    With the Hessian, or $J^\top J$ for a first-order plant with free dead time, whose response has
    a kink that the Hessian does not see. A coordinate on its bound does not move.
    """
    fit, start, *_ = primals
    x, converged, steps = _optimum(*primals)
    if start.size == 0:
        return (x, converged, steps), (jnp.zeros_like(x), None, None)

    def gradient(x, fit):
        residual, pullback = jax.vjp(fit.residual, x)
        return pullback(residual)[0]

    lower, upper = fit.bounds()
    free = free_parameters(x, gradient(x, fit), lower, upper)
    _, change = eqx.filter_jvp(lambda fit: gradient(x, fit), (fit,), (tangents[0],))
    if isinstance(fit.model, FOPDT) and "delay" not in fit.fixed:
        jacobian = columns(lambda *x: fit.residual(x), x)
        matrix = jacobian @ jacobian.T
    else:
        matrix = jax.jacfwd(gradient)(x, fit)
    both = free[:, None] & free[None, :]
    matrix = jnp.where(both, matrix, jnp.eye(x.size, dtype=x.dtype))
    scale = 1 / jnp.sqrt(jnp.abs(jnp.diagonal(matrix)))
    scaled = matrix * scale[:, None] * scale[None, :]
    move = -scale * solve_positive(scaled, jnp.where(free, change, 0) * scale)
    move = jnp.where(converged, move, jnp.nan)
    return (x, converged, steps), (move, None, None)
