"""Models as objects of python-control and SciPy."""

import numpy as np


def _zeros_poles_gain(model, pade_order: int | None) -> tuple[np.ndarray, np.ndarray, float]:
    """Zeros, poles and leading coefficient k of k prod(s - z)/prod(s - p), without the dead time.

    The gain is that of the model's factors 1 + sT, and s alone for a pole at 0.
    """
    delay = float(model.delay)
    if delay and pade_order is None:
        raise ValueError(
            f"the model has a dead time of {delay:g}, which no rational transfer function has:"
            " give pade_order, for example pade_order=3."
        )
    zeros, poles = np.asarray(model.zeros), np.asarray(model.poles)
    k = float(model.gain) * np.prod(-poles[poles != 0]) / np.prod(-zeros)
    return zeros, poles, float(np.real(k))


def polynomials(model) -> tuple[list[float], list[float]] | None:
    """Numerator and denominator without the dead time, the highest power of s first.

    The constant of the denominator's factors is 1, that of the numerator the gain. None for a model
    with NaN or with a real order.
    """
    products = []
    for factors in (model.numerator(), model.denominator()):
        product = np.ones(1)
        for factor in factors:
            if factor.power != round(factor.power):
                return None
            for _ in range(round(factor.power)):
                product = np.polymul(product, factor.coefficients[::-1])
        products.append(product)
    numerator, denominator = float(model.gain) * products[0], products[1]
    if not (np.all(np.isfinite(numerator)) and np.all(np.isfinite(denominator))):
        return None
    return numerator.tolist(), denominator.tolist()


def scipy_transfer_function(model, pade_order: int | None):
    """`scipy.signal.ZerosPolesGain` of a model."""
    from scipy import signal

    zeros, poles, k = _zeros_poles_gain(model, pade_order)
    if delay := float(model.delay):
        numerator, denominator = _pade(delay, pade_order)
        zeros = np.concatenate([zeros, np.roots(numerator)])
        poles = np.concatenate([poles, np.roots(denominator)])
        k = k * numerator[0] / denominator[0]
    return signal.ZerosPolesGain(zeros, poles, k)


def control_transfer_function(model, pade_order: int | None):
    """python-control `TransferFunction` of a model."""
    try:
        import control
    except ImportError:
        raise ImportError(
            'to_control needs python-control: pip install "stepax[control]".'
        ) from None

    plant = control.zpk(*_zeros_poles_gain(model, pade_order))
    if delay := float(model.delay):
        plant = plant * control.tf(*_pade(delay, pade_order))
    return plant


def _pade(delay: float, order: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Diagonal Pade approximation of exp(-s delay): numerator and denominator, descending."""
    if not isinstance(order, int) or order < 1:
        raise ValueError(f"pade_order must be a whole number of at least 1, got {order!r}.")
    coefficients = [1.0]
    for k in range(order):
        coefficients.append(coefficients[-1] * (order - k) / ((2 * order - k) * (k + 1)) * delay)
    signs = [(-1.0) ** k for k in range(order + 1)]
    ascending = np.array(coefficients)
    return (ascending * signs)[::-1], ascending[::-1]
