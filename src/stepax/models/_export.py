"""Models as objects of python-control and SciPy."""

import numpy as np


def _poles_and_gain(model, pade_order: int | None) -> tuple[np.ndarray, float, float]:
    """Poles, static gain and delay of a model with concrete parameters."""
    delay = float(model.delay)
    if delay and pade_order is None:
        raise ValueError(
            f"the model has a dead time of {delay:g}, which no rational transfer function has:"
            " give pade_order, for example pade_order=3."
        )
    return np.asarray(model.poles), float(model.gain), delay


def _scaled_gain(poles: np.ndarray, gain: float) -> float:
    """Leading coefficient k of k / prod(s - p) for static gain `gain`."""
    return float(gain * np.real(np.prod(-poles)))


def scipy_transfer_function(model, pade_order: int | None):
    """`scipy.signal.ZerosPolesGain` of a model."""
    from scipy import signal

    poles, gain, delay = _poles_and_gain(model, pade_order)
    zeros = np.empty(0)
    k = _scaled_gain(poles, gain)
    if delay:
        numerator, denominator = _pade(delay, pade_order)
        zeros = np.roots(numerator)
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

    poles, gain, delay = _poles_and_gain(model, pade_order)
    plant = control.zpk([], poles, _scaled_gain(poles, gain))
    if delay:
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
