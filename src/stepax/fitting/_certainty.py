r"""How certain a least-squares fit is: covariance, autocorrelation, information criterion."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arrays import Samples, Scalar, nan_where, safe_sqrt
from .._result import Identification
from .._status import Status, first_problem, refused
from ..models._plants import Hudzovic, Sani, parameter_names
from ..records._preprocess import quantisation
from ..records._record import predict, usable_record
from ._problem import final_level_ties, weights_of
from ._solver import columns


HUBER = 1.345
"""Threshold of Huber's loss over the noise level: 95 % efficient for Gaussian noise."""


def aicc(square: Scalar, count: Array | int, parameters: Array | int) -> Scalar:
    """Information criterion N ln(RSS/N) + 2 k N/(N - k - 1) (Hurvich and Tsai 1989)."""
    tiny = jnp.finfo(square.dtype).tiny
    penalty = 2 * parameters * count / jnp.maximum(count - parameters - 1, 1)
    return count * jnp.log(jnp.maximum(square, tiny) / count) + penalty


def with_errors(
    result: Identification,
    fixed: Sequence[str] = (),
    weights: Samples | None = None,
    loss: str = "squares",
) -> Identification:
    r"""A fit with its standard errors and covariance.

    With $J$ the Jacobian of the prediction in the free parameters and $A = J^\top J$ (rows times
    $\sqrt{w_i}$),

    $$ \mathrm{cov} = \sigma^2 A^{-1} (J^\top R J) A^{-1}, \qquad
       \sigma^2 = \frac{\sum r_i^2}{N - \mathrm{tr}(A^{-1} J^\top R J)}, $$

    $R_{ij} = \varphi^{|i-j|}$ (Seber and Wild 1989, section 6.2): for white residuals
    ($\varphi = 0$) the usual formula. $\varphi$ is the lag-1 autocorrelation of the residuals with
    the first-order bias correction $(1 + (p + 3)\hat\varphi)/N$ (after Kendall 1954), and 0
    unless it exceeds $2/\sqrt N$. With Huber's loss $r_i$ is $\psi(r_i)$ over the share of
    residuals within the threshold (Huber 1981, section 7.6). A parameter on a bound has NaN, the
    others hold with it fixed.

    **Verdict.** `details["identifiable"]`, in the order of `.free`, is false for an own parameter
    on a bound, for one without an effect of its own, for one that is positive by nature, or the
    gain, whose 95 % interval reaches 0, and for r if it covers half of its range or more. Unless
    it is the bound alone, the status is `not_identifiable`.

    `result` names its free parameters and has `details["at_bound"]`; the options are those it was
    refined with.
    """
    model, free = result.model, result.free
    _, record = usable_record(result.record)
    tied = final_level_ties(record, fixed)
    names = list(dict.fromkeys(name.split("[")[0] for name in free))
    values = [jnp.atleast_1d(jnp.asarray(getattr(model, name), record.y.dtype)) for name in names]
    sizes = [value.size for value in values]
    at_bound = result.details["at_bound"]
    root = safe_sqrt(weights_of(result.record, weights))
    residual = root * (record.y - predict(model, record, record.t))
    if loss == "huber":
        threshold = HUBER * result.details["noise_level"]
        within = jnp.sum((jnp.abs(residual) <= threshold) & (root > 0)) / jnp.sum(root > 0)
        residual = jnp.clip(residual, -threshold, threshold) / within
    phi = _autocorrelation(residual, len(free))
    quantum = quantisation(record.y)
    details = result.details | {
        "residual_autocorrelation": phi,
        "residuals_correlated": jnp.abs(phi) > 0,
        "quantisation": quantum,
        "quantised": quantum > 0,
        "identifiable": jnp.ones(0, bool),
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
        return root * predict(plant, record, record.t)

    row = jnp.concatenate(values)
    lag = np.array([name.startswith("lags") for name in free])
    absent = lag & (row == 0) & ~at_bound
    frozen = absent | _frozen(lag, row, at_bound)
    last = jnp.argsort(frozen)  # a column of zeros before others would take a row from them
    jacobian = jnp.where(frozen[:, None], 0, columns(prediction, row))[last]
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
    variance = jnp.sum(residual**2) / jnp.maximum(jnp.sum(root > 0) - effective, 1)
    covariance = variance * inverse @ coloured @ inverse.T / size[:, None] / size[None, :]
    place = jnp.argsort(last)
    covariance, lost = covariance[place][:, place], lost[place]
    unknown = at_bound | lost
    covariance = jnp.where(unknown[:, None] | unknown[None, :], jnp.nan, covariance)
    covariance = jnp.where(absent[:, None] | absent[None, :], 0, covariance)
    covariance = nan_where(refused(result.status), covariance)
    errors = safe_sqrt(jnp.diagonal(covariance))
    vague = ~(at_bound | absent) & (lost | _vague(result, free, row, errors))
    verdict = Status.where(jnp.any(vague), Status.not_identifiable, Status.successful)
    bounded = at_bound & jnp.array([name not in ("delay", "gain", "offset") for name in free])
    details["identifiable"] = ~vague & ~bounded
    return dataclasses.replace(
        result,
        status=first_problem(verdict, result.status),
        std=_by_name(result, names, sizes, errors, tied),
        covariance=covariance,
        details=details | {"effective_parameters": effective},
    )


def _frozen(lag: np.ndarray, row: Array, at_bound: Array) -> Array:
    """Parameters to hold while the others vary: those on a bound, of equal lags all but one."""
    follows = jnp.append(False, lag[1:] & lag[:-1] & (row[1:] == row[:-1]))
    leads = jnp.append(follows[1:], False) & ~follows
    return at_bound & ~leads


def _vague(result, free: tuple[str, ...], row: Array, errors: Array) -> Array:
    """Parameters whose 95 % interval says next to nothing."""
    span: dict[str, Any] = {"delay": jnp.inf, "offset": jnp.inf}
    if isinstance(result.model, Hudzovic | Sani):
        steps = 1 if isinstance(result.model, Sani) else jnp.maximum(result.model.n - 1, 1)
        span["r"] = 0.5 / steps
    limits = [
        jnp.asarray(span.get(name, jnp.abs(value)), row.dtype)
        for name, value in zip(free, row, strict=True)
    ]
    return ~(1.96 * errors < jnp.stack(limits)) & ~refused(result.status)


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
