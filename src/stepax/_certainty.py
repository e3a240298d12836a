r"""How certain a least-squares fit is: covariance, autocorrelation, information criterion."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ._preprocess import quantisation
from ._result import Identification, nan_where, parameter_names, predict, refused
from ._solver import columns
from ._types import Scalar


def aicc(square: Scalar, count: int, parameters: int) -> Scalar:
    """Information criterion N ln(RSS/N) + 2 k N/(N - k - 1) (Hurvich and Tsai 1989)."""
    tiny = jnp.finfo(square.dtype).tiny
    penalty = 2 * parameters * count / max(count - parameters - 1, 1)
    return count * jnp.log(jnp.maximum(square, tiny) / count) + penalty


def with_errors(result: Identification, tied: bool = False) -> Identification:
    r"""A fit with its standard errors and covariance.

    With $J$ the Jacobian of the prediction in the free parameters and $A = J^\top J$,

    $$ \mathrm{cov} = \sigma^2 A^{-1} (J^\top R J) A^{-1}, \qquad
       \sigma^2 = \frac{\sum r_i^2}{N - \mathrm{tr}(A^{-1} J^\top R J)}, $$

    $R_{ij} = \varphi^{|i-j|}$ (Seber and Wild 1989, section 6.2): for white residuals
    ($\varphi = 0$) the usual formula. $\varphi$ is the lag-1 autocorrelation of the residuals with
    the first-order bias correction $(1 + (p + 3)\hat\varphi)/N$ (after Kendall 1954), and 0
    unless it exceeds $2/\sqrt N$. A parameter on a bound has NaN, the others hold with it fixed.

    `result` names its free parameters and has `details["at_bound"]`; `tied` says that the offset
    follows from the gain and a known final level.
    """
    record, model, free = result.record, result.model, result.free
    names = list(dict.fromkeys(name.split("[")[0] for name in free))
    values = [jnp.atleast_1d(jnp.asarray(getattr(model, name), record.y.dtype)) for name in names]
    sizes = [value.size for value in values]
    at_bound = result.details["at_bound"]
    residual = record.y - result.predict(record.t)
    count, square = residual.size, jnp.sum(residual**2)
    phi = _autocorrelation(residual, len(free))
    quantum = quantisation(record.y)
    details = result.details | {
        "residual_autocorrelation": phi,
        "residuals_correlated": jnp.abs(phi) > 0,
        "quantisation": quantum,
        "quantised": quantum > 0,
    }
    if not free:
        std = _by_name(result, (), [], residual[:0], tied)
        return dataclasses.replace(result, std=std, details=details)

    def prediction(*numbers: Array) -> Array:
        new, position = [], 0
        for name, size in zip(names, sizes, strict=True):
            part = numbers[position : position + size]
            new.append(jnp.stack(part) if jnp.ndim(getattr(model, name)) else part[0])
            position += size
        plant = eqx.tree_at(lambda m: [getattr(m, name) for name in names], model, new)
        if tied:
            offset = record.final - record.step_size * plant.gain
            plant = eqx.tree_at(lambda m: m.offset, plant, offset)
        return predict(plant, record, record.t)

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
    covariance = nan_where(refused(result.status), covariance)
    errors = jnp.sqrt(jnp.diagonal(covariance))
    return dataclasses.replace(
        result,
        std=_by_name(result, names, sizes, errors, tied),
        covariance=covariance,
        details=details | {"effective_parameters": effective},
    )


def _by_name(result, names, sizes, errors, tied) -> dict[str, Array]:
    std = {
        name: jnp.zeros(jnp.shape(getattr(result.model, name)), errors.dtype)
        for name in parameter_names(result.model)
    }
    position = 0
    for name, size in zip(names, sizes, strict=True):
        std[name] = errors[position : position + size].reshape(std[name].shape)
        position += size
    if tied:
        std["offset"] = jnp.abs(result.record.step_size) * std["gain"]
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
