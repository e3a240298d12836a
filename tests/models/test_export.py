"""Models as objects of python-control and scipy."""

import dataclasses

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from stepax import FOPDT, IPDT, SOPDT, EqualLag, Hudzovic, PTn, Sani, SOPDTZero


MODELS = {
    "Hudzovic": Hudzovic(T=1.0, r=0.3, n=3, gain=-2.0, offset=5.0),
    "Hudzovic, array n": Hudzovic(T=1.0, r=0.3, n=jnp.asarray(3)),
    "Sani": Sani(T=2.0, r=0.3, n=3, gain=1.5),
    "Sani, r = 0": Sani(T=2.0, r=0.0, n=3),
    "EqualLag": EqualLag(T=1.0, n=4, offset=-1.0),
    "EqualLag, whole float": EqualLag(T=1.0, n=4.0),
    "EqualLag, whole array": EqualLag(T=1.0, n=jnp.asarray(4.0, jnp.float32)),
    "PTn": PTn(lags=np.array([2.0, 0.0, 0.7])),
    "PTn, float32": PTn(lags=np.array([2.0, 0.0, 0.7], np.float32), gain=np.float32(2)),
    "FOPDT": FOPDT(T=1.7, gain=3.0),
    "SOPDT": SOPDT(zeta=0.3, omega_n=1.2),
    "SOPDT, critical": SOPDT(zeta=1.0, omega_n=1.2, gain=-1.0),
    "SOPDT, slow": SOPDT(zeta=3.0, omega_n=1.2),
    "SOPDTZero": SOPDTZero(zeta=0.3, omega_n=1.2, lead=-0.8, gain=-2.0, offset=5.0),
    "SOPDTZero, overshoot": SOPDTZero(zeta=3.0, omega_n=1.2, lead=8.0),
    "SOPDTZero, no lead": SOPDTZero(zeta=0.7, omega_n=1.2, lead=0.0),
    "IPDT": IPDT(T=1.7, gain=-0.5, offset=5.0),
    "IPDT, no lag": IPDT(T=0.0, gain=2.0),
}
T = np.linspace(0, 15, 12)

models = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


def check_step(model, y):
    """Against the model's own step response, without the offset."""
    single = any(np.asarray(x).dtype == np.float32 for x in jax.tree.leaves(model))
    expected = np.asarray(model.step_response(T)) - np.asarray(model.offset)
    assert np.allclose(y, expected, rtol=0, atol=1e-6 if single else 1e-9)


@models
def test_scipy_step_response(model):
    plant = model.to_scipy()
    assert isinstance(plant, signal.ZerosPolesGain)
    _, y = signal.step(plant, T=T)
    check_step(model, y)


@models
def test_control_step_response(model):
    plant = model.to_control()
    assert isinstance(plant, control.TransferFunction)
    y = control.step_response(plant, T).outputs
    check_step(model, y)
    if model.settles:
        assert np.allclose(plant.dcgain(), model.static_gain, rtol=1e-12)
    else:
        assert not np.isfinite(plant.dcgain())


@models
def test_frequency_responses_agree(model):
    omega = np.geomspace(0.01, 10, 12)
    ours = model.frequency_response(omega)
    assert np.allclose(model.to_control()(1j * omega), ours, rtol=1e-9)
    assert np.allclose(model.to_scipy().freqresp(omega)[1], ours, rtol=1e-9)


@pytest.mark.parametrize("export", ["to_control", "to_scipy"])
@pytest.mark.parametrize("order", [1, 2, 3, 6])
def test_pade_approximation_of_a_delay(export, order):
    """Exact up to omega^(2 order): the frequency response at low frequencies shows the order."""
    model = Hudzovic(T=1.0, r=0.3, n=3, gain=-2.0, delay=1.5)
    omega = 0.4
    plant = getattr(model, export)(pade_order=order)
    value = plant(1j * omega) if export == "to_control" else plant.freqresp([omega])[1][0]
    x = 0.6  # omega times delay
    remainder = np.prod([x**2 / ((2 * k - 1) * 2 * (2 * order + 1)) for k in range(1, order + 1)])
    assert abs(value / model.frequency_response(omega) - 1) <= x * remainder + 1e-12


@models
@pytest.mark.parametrize("delay", [0.0, 1.5])
def test_zeros_and_poles_of_exports(model, delay):
    """Exactly those of the model where there is no dead time, among others where there is."""
    model = dataclasses.replace(model, delay=delay)
    order = 2 if delay else None
    plant = model.to_scipy(pade_order=order)
    assert set(model.zeros.tolist()) <= set(plant.zeros.tolist())
    assert set(model.poles.tolist()) <= set(plant.poles.tolist())
    added = 2 if delay else 0
    assert len(plant.zeros) == len(model.zeros) + added
    assert len(plant.poles) == len(model.poles) + added

    other = model.to_control(pade_order=order)
    single = any(np.asarray(x).dtype == np.float32 for x in jax.tree.leaves(model))
    for mine, theirs in [(plant.zeros, other.zeros()), (plant.poles, other.poles())]:
        assert len(theirs) == len(mine)
        for place in mine:  # roots of a polynomial: multiple ones keep few digits
            assert np.min(np.abs(theirs - place)) < (1e-2 if single or len(mine) > 2 else 1e-9)
    if not model.settles:
        assert np.sum(other.poles() == 0) == np.sum(plant.poles == 0) == 1


# The ripple of a Pade approximation is the larger the less smooth the response begins.
DELAYED = {
    "EqualLag": (EqualLag(T=1.0, n=3, gain=2.0, delay=1.5), 1e-3),
    "SOPDTZero": (SOPDTZero(zeta=0.7, omega_n=1.2, lead=-0.8, delay=1.5), 2e-3),
    "IPDT": (IPDT(T=1.0, gain=2.0, delay=1.5), 1e-2),
}


@pytest.mark.parametrize(("model", "ripple"), DELAYED.values(), ids=DELAYED)
@pytest.mark.parametrize("export", ["to_control", "to_scipy"])
def test_step_response_with_a_delay(export, model, ripple):
    plant = getattr(model, export)(pade_order=5)
    if export == "to_control":
        y = control.step_response(plant, T).outputs
    else:
        y = signal.step(plant, T=T)[1]
    assert np.allclose(y, model.step_response(T), rtol=0, atol=ripple)


@pytest.mark.parametrize("export", ["to_control", "to_scipy"])
def test_delay_needs_an_order(export):
    model = FOPDT(T=1.0, delay=2.0)
    with pytest.raises(ValueError, match="pade_order"):
        getattr(model, export)()
    for order in (0, -1):
        with pytest.raises(ValueError, match="pade_order"):
            getattr(model, export)(pade_order=order)
    getattr(FOPDT(T=1.0), export)(pade_order=3)  # no delay: nothing to approximate


@pytest.mark.parametrize("use", ["lags", "poles", "to_control", "to_scipy"])
@pytest.mark.parametrize("n", [2.5, 0.3])
def test_fractional_order_is_no_chain(use, n):
    with pytest.raises(ValueError, match="order"):
        attribute = getattr(EqualLag(T=1.0, n=n), use)
        attribute()


def test_whole_float_order_is_a_chain():
    """As identification returns it."""
    whole, integer = EqualLag(T=2.0, n=3.0), EqualLag(T=2.0, n=3)
    assert np.array_equal(whole.lags, integer.lags)
    assert np.array_equal(whole.poles, integer.poles)
    assert np.allclose(whole.to_control().den[0][0], integer.to_control().den[0][0])


def test_model_from_a_jitted_function_exports():
    """An order that has been through jit is an array."""
    model = jax.jit(lambda T: Sani(T=T, r=0.5, n=3))(2.0)
    assert np.allclose(model.poles, [-0.5, -1, -2])
    assert np.allclose(np.sort(model.to_scipy().poles), [-2, -1, -0.5])
