"""Models as PyTrees of unconstrained numbers, which any gradient step leaves admissible."""

import dataclasses
from typing import Any

import equinox as eqx

from ..models._abstract import AbstractPlant
from ..models._free import free_positive, positive


def to_unconstrained(model: AbstractPlant) -> Any:
    r"""Unconstrained numbers of a model, in a PyTree of its own shape, for an optimiser.

    Any real numbers in it are a model again (`from_unconstrained`), within the range of its family;
    so a step of any length stays admissible, and all slopes are finite:

    | parameters | free numbers |
    |---|---|
    | `T` of `FOPDT`, `IPDT`; `lags`; `delay` | logarithms |
    | `T`, `r` of `Hudzovic`, `Sani` | logarithm of the sum of the lags; contrast of the rates |
    | `T`, `n` of `EqualLag` | logarithm of nT; n as a share of its range, if it is real |
    | `zeta`, `omega_n`, `lead` | logarithms of damping and of period; lead over period |
    | `gain`, `offset` | themselves |

    The period is $\sqrt{1 + 4\zeta^2}/\omega_n$, the sum of the lags where a plant creeps. These
    are the coordinates of the fits without their bounds. Equal lags of a `PTn` part in training
    although their slopes are equal: the logarithm of the k-th is divided by 1 + k/10, so that one
    step moves them differently.

    **What lies on an end of its range stays there**, at an infinite free number with slope 0: a lag
    or a dead time of 0, equal lags (r = 0 of `Hudzovic`, r = 1 of `Sani`). Start inside to train
    it. The model must be admissible; whole orders are no numbers to train and stay.
    """
    own = model.own_to_free()
    return _with(model, own | {"delay": free_positive(model.delay)})


def from_unconstrained(free: Any) -> Any:
    """The model of unconstrained numbers; the inverse of `to_unconstrained`.

    NaN stays NaN. Slopes are with respect to the free numbers: `eqx.filter_grad` of a loss of
    `from_unconstrained(free)` gives a PyTree that Optax takes with `free` as parameters.
    """
    own = free.own_from_free()
    return _with(free, own | {"delay": positive(free.delay)})


def _with(model: Any, values: dict[str, Any]) -> Any:
    """Other numbers in the same places; what a model may not hold is not looked at."""
    names = [field.name for field in dataclasses.fields(model) if field.name in values]
    return eqx.tree_at(
        lambda m: [getattr(m, name) for name in names], model, [values[name] for name in names]
    )
