r"""How certain a least-squares fit is: covariance, autocorrelation, information criterion."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ._models import AbstractPlant
from ._preprocess import quantisation
from ._record import StepRecord
from ._result import parameter_names, predict
from ._solver import columns
from ._types import Scalar


def certainty(
    record: StepRecord,
    model: AbstractPlant,
    known: tuple[str, ...],
    stuck: dict[str, Array],
    final: Scalar | None,
) -> tuple[dict[str, Array], Array, tuple[str, ...], dict[str, Array]]:
    r"""Standard errors by name, covariance, its names, and details.

    With $J$ the Jacobian of the prediction in the free parameters and $A = J^\top J$,

    $$ \mathrm{cov} = \sigma^2 A^{-1} (J^\top R J) A^{-1}, \qquad
       \sigma^2 = \frac{\sum r_i^2}{N - \mathrm{tr}(A^{-1} J^\top R J)}, $$

    $R_{ij} = \varphi^{|i-j|}$ (Seber and Wild 1989, section 6.2): for white residuals
    ($\varphi = 0$) the usual formula. $\varphi$ is the lag-1 autocorrelation of the residuals with
    the first-order bias correction $(1 + (p + 3)\hat\varphi)/N$ (after Kendall 1954), and 0
    unless it exceeds $2/\sqrt N$. A parameter on a bound has NaN, the others hold with it fixed.
    """
    names = [name for name in parameter_names(model) if name not in known]
    if final is not None:  # tied to the gain
        names.remove("offset")
    values = [jnp.atleast_1d(jnp.asarray(getattr(model, name), record.y.dtype)) for name in names]
    sizes = [value.size for value in values]
    free = tuple(
        name if size == 1 and name != "lags" else f"{name}[{k}]"
        for name, size in zip(names, sizes, strict=True)
        for k in range(size)
    )
    bounds = [jnp.atleast_1d(stuck.get(name, jnp.zeros((), bool))) for name in names]
    residual = record.y - predict(model, record, record.t)
    count, parameters = residual.size, len(free)
    square = jnp.sum(residual**2)
    phi = _autocorrelation(residual, parameters)
    quantum = quantisation(record.y)
    details = {
        "aicc": count * jnp.log(jnp.maximum(square, jnp.finfo(square.dtype).tiny) / count)
        + 2 * parameters * count / max(count - parameters - 1, 1),
        "residual_autocorrelation": phi,
        "residuals_correlated": jnp.abs(phi) > 0,
        "quantisation": quantum,
        "quantised": quantum > 0,
    }
    if not free:
        zero = jnp.zeros((), residual.dtype)
        return (
            _by_name(model, (), [], zero[None], final, record),
            zero * jnp.ones((0, 0)),
            free,
            details,
        )

    def prediction(*numbers: Array) -> Array:
        new, position = [], 0
        for name, size in zip(names, sizes, strict=True):
            part = numbers[position : position + size]
            new.append(jnp.stack(part) if jnp.ndim(getattr(model, name)) else part[0])
            position += size
        plant = eqx.tree_at(lambda m: [getattr(m, name) for name in names], model, new)
        if final is not None:
            plant = eqx.tree_at(lambda m: m.offset, plant, final - record.step_size * plant.gain)
        return predict(plant, record, record.t)

    at_bound = jnp.concatenate(bounds)
    jacobian = columns(prediction, jnp.concatenate(values))
    jacobian = jnp.where(at_bound[:, None], 0, jacobian)
    size = jnp.sqrt(jnp.sum(jacobian**2, axis=1))
    size = jnp.where(size > 0, size, 1)
    q, r = jnp.linalg.qr((jacobian / size[:, None]).T)
    diagonal = jnp.diagonal(r)
    lost = jnp.abs(diagonal) < 64 * jnp.finfo(r.dtype).eps
    r = r + jnp.diag(jnp.where(lost, 1 - diagonal, 0))
    inverse = jax.scipy.linalg.solve_triangular(r, jnp.eye(r.shape[0], dtype=r.dtype))
    q = jnp.where(lost[None, :], 0, q)
    coloured = q.T @ _correlate(q, phi)
    effective = jnp.trace(coloured)
    variance = square / jnp.maximum(count - effective, 1)
    covariance = variance * inverse @ coloured @ inverse.T / size[:, None] / size[None, :]
    unknown = at_bound | lost
    covariance = jnp.where(unknown[:, None] | unknown[None, :], jnp.nan, covariance)
    details["effective_parameters"] = effective
    std = _by_name(model, names, sizes, jnp.sqrt(jnp.diagonal(covariance)), final, record)
    return std, covariance, free, details


def _by_name(model, names, sizes, errors, final, record) -> dict[str, Array]:
    std = {
        name: jnp.zeros_like(jnp.asarray(getattr(model, name), errors.dtype))
        for name in parameter_names(model)
    }
    position = 0
    for name, size in zip(names, sizes, strict=True):
        std[name] = errors[position : position + size].reshape(std[name].shape)
        position += size
    if final is not None:
        std["offset"] = jnp.abs(record.step_size) * std["gain"]
    return std


def _autocorrelation(residual: Array, parameters: int) -> Scalar:
    """Lag-1 coefficient, corrected for bias; 0 where it is not significant."""
    count = residual.size
    square = jnp.sum(residual**2)
    raw = jnp.sum(residual[1:] * residual[:-1]) / jnp.where(square > 0, square, 1)
    corrected = raw + (1 + (parameters + 3) * raw) / count
    significant = jnp.abs(raw) > 2 / count**0.5
    return jnp.where(significant, jnp.clip(corrected, -0.99, 0.99), 0)


def _correlate(q: Array, phi: Scalar) -> Array:
    """R q for R_ij = phi^|i-j|, by one pass forwards and one backwards."""

    def decay(carry, row):
        carry = phi * carry + row
        return carry, carry

    zero = jnp.zeros(q.shape[1], q.dtype)
    forward = jax.lax.scan(decay, zero, q)[1]
    backward = jax.lax.scan(decay, zero, q, reverse=True)[1]
    return forward + backward - q
