"""Plants as objects: parameters, dtypes, orders, transformations, other responses, errors."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests import oracle

import stepax
from stepax import FOPDT, IPDT, MAX_ORDER, SOPDT, EqualLag, Hudzovic, PTn, Sani, SOPDTZero


LEVELS = {"gain": -3.0, "offset": 40.0, "delay": 2.7}
OWN = {
    "Hudzovic": {"T": 1.7, "r": 0.3, "n": 3},
    "Sani": {"T": 1.7, "r": 0.3, "n": 3},
    "EqualLag": {"T": 1.7, "n": 3},
    "EqualLag, real n": {"T": 1.7, "n": 2.5},
    "PTn": {"lags": np.array([2.0, 0.0, 0.7])},
    "FOPDT": {"T": 1.7},
    "SOPDT": {"zeta": 0.4, "omega_n": 0.6},
    "SOPDTZero": {"zeta": 0.4, "omega_n": 0.6, "lead": -0.8},
    "IPDT": {"T": 1.7},
}
CLASSES = {name: getattr(stepax, name.split(",")[0]) for name in OWN}
T = jnp.array([-1, 0, 2.7, 2.75, 3, 4, 5.5, 8, 12, 20, 40, 90])
"""Every axis of a batch has as many: each operation is then compiled for few shapes."""

families = pytest.mark.parametrize("name", OWN)
settling = pytest.mark.parametrize("name", [name for name in OWN if name != "IPDT"])
chains = pytest.mark.parametrize("cls", [Hudzovic, Sani])
ordered = pytest.mark.parametrize("cls", [Hudzovic, Sani, EqualLag])


def make(name, **changes):
    return CLASSES[name](**(OWN[name] | LEVELS | changes))


def of_order(cls, n, T=1.7, r=0.1):
    return EqualLag(T=T, n=n) if cls is EqualLag else cls(T=T, r=r, n=n)


def exact(model, name):
    """Parameters for the oracle."""
    own = {k: getattr(model, k) for k in (*OWN[name], *LEVELS)}
    lags = own.pop("lags", ())
    own |= {f"lag{k}": x for k, x in enumerate(lags)} | ({"n": len(lags)} if len(lags) else {})
    return {k: v if isinstance(v, int) else oracle.exact(v) for k, v in own.items()}


# ---- parameters


@families
def test_parameters_read_back(name):
    model = make(name)
    for key, value in (OWN[name] | LEVELS).items():
        assert np.array_equal(getattr(model, key), value)


@families
def test_defaults_are_those_of_a_unit_step(name):
    model = CLASSES[name](**OWN[name])
    assert (model.gain, model.offset, model.delay) == (1, 0, 0)


def test_integers_and_lists_are_numbers():
    after = np.maximum(T, 0)
    assert np.allclose(FOPDT(T=2).step_response(T), 1 - np.exp(-after / 2))
    assert np.allclose(Sani(T=1, r=0, n=np.int64(3)).step_response(T), 1 - np.exp(-after))
    expected = PTn(lags=np.array([1.0, 2.0]), gain=3.0).step_response(T)
    assert np.allclose(PTn(lags=[1, 2], gain=3).step_response(T), expected)  # pyright: ignore[reportArgumentType]


def test_times_of_any_shape():
    model = make("Hudzovic")
    grid = model.step_response(T.reshape(3, 4))
    assert np.allclose(grid.reshape(-1), model.step_response(T), rtol=0, atol=1e-12)


def shape_and_dtype(function, *arguments):
    """Of the result, by tracing alone."""
    result = jax.eval_shape(function, *arguments)
    return result.shape, result.dtype


@families
@pytest.mark.parametrize(
    ("dtype", "shape"),
    [(np.float32, (5,)), (np.float32, (2, 3)), (np.float64, ()), (np.float64, (0,))],
)
def test_shape_and_dtype_follow_the_data(name, dtype, shape):
    """Python numbers as parameters take the precision of the times, under x64 too."""
    own = {k: v.astype(dtype) if k == "lags" else v for k, v in OWN[name].items()}
    model = CLASSES[name](**own, **LEVELS)
    t = np.zeros(shape, dtype)
    assert shape_and_dtype(model.step_response, t) == (shape, dtype)
    assert shape_and_dtype(model.impulse_response, t) == (shape, dtype)
    complex_dtype = np.result_type(dtype, np.complex64)
    assert shape_and_dtype(model.frequency_response, t) == (shape, complex_dtype)
    if len(shape) == 1:
        assert shape_and_dtype(model.respond, t, t) == (shape, dtype)


@ordered
def test_dtype_with_an_array_order(cls):
    model, t = of_order(cls, jnp.asarray(3)), np.zeros(5, np.float32)
    assert shape_and_dtype(model.step_response, t) == ((5,), np.float32)
    assert shape_and_dtype(model.frequency_response, t) == ((5,), np.complex64)


@families
def test_float32_parameters(name):
    own = {k: v if k == "n" else np.asarray(v, np.float32) for k, v in OWN[name].items()}
    own |= {k: np.float32(v) for k, v in LEVELS.items()}
    t = np.zeros(5, np.float32)
    assert shape_and_dtype(CLASSES[name](**own).step_response, t) == ((5,), np.float32)


# ---- orders


@ordered
def test_mixed_orders_in_one_batch(cls):
    def response_and_lags(n):
        return of_order(cls, n).step_response(T), of_order(cls, n).lags

    responses, lags = jax.jit(jax.vmap(response_and_lags))(jnp.arange(2, MAX_ORDER + 1))
    for n, y, row in zip(range(2, MAX_ORDER + 1), responses, lags, strict=True):
        if n not in (2, 5, 8):  # quicker
            continue
        expected, lags = eqx.filter_jit(response_and_lags)(n)
        assert np.allclose(y, expected, rtol=0, atol=1e-12)
        assert np.allclose(row[:n], lags, rtol=1e-15) and np.all(row[n:] == 0)


@pytest.mark.parametrize("cls", [Hudzovic, EqualLag, pytest.param(Sani, marks=pytest.mark.long)])
def test_derivatives_with_an_array_order(cls):
    @eqx.filter_jit
    @jax.grad
    def gradient(own, n):
        return jnp.sum(of_order(cls, n, *own).step_response(T))

    static, traced = gradient((1.7, 0.1), 4), gradient((1.7, 0.1), jnp.asarray(4))
    assert np.allclose(static, traced, rtol=1e-11, atol=1e-11)


@ordered
def test_number_of_lags(cls):
    assert of_order(cls, 3).lags.shape == (3,)
    assert of_order(cls, 12, r=0.01).lags.shape == (12,)
    lags = of_order(cls, jnp.asarray(3)).lags
    assert lags.shape == (MAX_ORDER,)
    assert np.all(lags[:3] > 0) and np.all(lags[3:] == 0)
    traced = jax.jit(lambda model: model.lags)(of_order(cls, 3))
    assert np.allclose(traced, lags, rtol=1e-15)


@ordered
@pytest.mark.parametrize("n", [0, 9, 12])
def test_traced_order_out_of_range_is_nan(cls, n):
    """Not the response of another order."""
    y = of_order(cls, jnp.asarray(n), r=0.01).step_response(T)
    assert np.all(np.isnan(y[2:]))


def test_lags_by_their_formulae():
    assert np.allclose(Hudzovic(T=2, r=0.25, n=3).lags, [2, 2 / 0.75, 4], rtol=1e-15)
    assert np.allclose(Sani(T=2, r=0.25, n=3).lags, [2, 0.5, 0.125], rtol=1e-15)
    assert np.array_equal(EqualLag(T=2, n=3).lags, [2, 2, 2])
    assert np.array_equal(EqualLag(T=2, n=3.0).lags, [2, 2, 2])
    assert np.array_equal(PTn(lags=np.array([3, 0, 1])).lags, [3, 0, 1])
    assert np.array_equal(FOPDT(T=2).lags, [2])
    assert np.array_equal(IPDT(T=2).lags, [2])
    for plant in (SOPDT(zeta=1.25, omega_n=0.5), SOPDTZero(zeta=1.25, omega_n=0.5, lead=-3)):
        assert np.allclose(plant.lags, [4, 1], rtol=1e-15)  # rates 0.25 and 1


@chains
def test_ends_of_the_range_of_r(cls):
    one_lag, equal = FOPDT(T=1.7).step_response(T), EqualLag(T=1.7, n=4).step_response(T)
    ends = {Hudzovic: [(0.0, equal)], Sani: [(0.0, one_lag), (1.0, equal)]}
    for r, expected in ends[cls]:
        assert np.allclose(cls(T=1.7, r=r, n=4).step_response(T), expected, rtol=0, atol=1e-12)


OUTSIDE = {
    "Hudzovic": [{"T": 0.0}, {"T": -1.0}, {"r": 0.5}, {"r": -0.1}],
    "Sani": [{"T": 0.0}, {"T": -1.0}, {"r": -0.1}, {"r": 1.001}],
    "EqualLag": [{"T": 0.0}, {"T": -1.0}, {"n": jnp.asarray(9)}],
    "EqualLag, real n": [{"T": -1.0}, {"n": 41.0}],
    "PTn": [{"lags": np.array([1.0, -1.0])}, {"lags": np.array([np.nan, 1.0])}],
    "FOPDT": [{"T": 0.0}, {"T": -1.0}],
    "SOPDT": [{"zeta": 0.0}, {"zeta": -0.1}, {"omega_n": -1.0}, {"omega_n": 0.0}],
    "SOPDTZero": [{"zeta": -0.1}, {"omega_n": -1.0}, {"lead": np.nan}],
    "IPDT": [{"T": -1e-3}],
}


@families
def test_outside_their_range_models_are_nan(name):
    """Before the step too, and however the plant is asked."""
    for changes in (*OUTSIDE[name], {"delay": -0.1}, {"delay": np.nan}):
        model = make(name, **changes)
        for y in (
            model.step_response(T),
            model.impulse_response(T),
            model.frequency_response(T + 2),
            model.respond(T, T),
        ):
            assert np.all(np.isnan(y)), changes
    assert not model.admissible and make(name).admissible


def test_a_shape_without_effect_has_no_range():
    first_order = FOPDT(T=1).step_response(T)
    assert np.allclose(Hudzovic(T=1, r=7.0, n=1).step_response(T), first_order, rtol=1e-14)


@families
def test_several_plants_in_one_are_sent_to_vmap(name):
    model = make(name)
    several = jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * 2), model)
    for ask in (model.__class__.step_response, model.__class__.impulse_response):
        with pytest.raises(ValueError, match=r"one plant.*jax\.vmap"):
            ask(several, T)
    with pytest.raises(ValueError, match=r"delay has the shape \(2,\).*jax\.vmap"):
        make(name, delay=np.ones(2)).respond(T, T)


# ---- transformations


@families
def test_model_as_argument_of_jit(name):
    model = make(name)
    y = jax.jit(lambda model, t: model.step_response(t))(model, T)
    assert np.allclose(y, model.step_response(T), rtol=0, atol=1e-12)


@families
def test_filter_jit_and_filter_grad(name):
    """A whole model in, a model of derivatives out; an order that is a Python int has none."""

    @eqx.filter_grad
    def gradient(model):
        assert not isinstance(OWN[name].get("n"), int) or type(model.n) is int
        return jnp.sum(model.step_response(T))

    model = make(name)
    slopes = eqx.filter_eval_shape(gradient, model)
    assert isinstance(slopes, CLASSES[name])
    for key, value in (OWN[name] | LEVELS).items():
        slope = getattr(slopes, key)
        assert slope is None if isinstance(value, int) else slope.shape == np.shape(value)
    if name in ("Hudzovic", "FOPDT"):  # quick to compile
        compiled, direct = eqx.filter_jit(gradient)(model), gradient(model)
        assert eqx.tree_equal(compiled, direct, rtol=1e-10, atol=1e-10)
        assert np.allclose(direct.offset, len(T))


@families
def test_vmap_of_a_stacked_model(name):
    models = [make(name, gain=1.0 + k, delay=k / 2) for k in range(len(T))]
    stacked = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(x) for x in leaves]), *models)
    batch = jax.vmap(lambda model: model.step_response(T))(stacked)
    for k in (0, 7):
        assert np.allclose(batch[k], models[k].step_response(T), rtol=0, atol=1e-12)


@families
def test_model_as_a_result_of_vmap(name):
    gains = jnp.arange(len(T)) + 1.0
    models = jax.vmap(lambda gain: make(name, gain=gain))(gains)
    batch = jax.vmap(lambda model: model.step_response(T))(models)
    assert np.allclose(batch[1], make(name, gain=2.0).step_response(T), rtol=0, atol=1e-12)


def test_second_derivative_in_a_real_order():
    """Against second differences, which leave six digits."""
    orders, h = jnp.array([0.4, 1.0, 1.5, 2.0, 2.1, 5.5, 8.0, 32.0]), 1e-3

    def response(n, t):
        return EqualLag(T=1.7, n=n).step_response(t)

    def on_grid(function):
        return jax.jit(jax.vmap(jax.vmap(function, (None, 0)), (0, None)))

    curvature = on_grid(jax.grad(jax.grad(response)))(orders, T)
    assert np.all(np.isfinite(curvature))
    below, here, above = (on_grid(response)(orders + s, T) for s in (-h, 0, h))
    assert np.allclose(curvature, (above - 2 * here + below) / h**2, rtol=0, atol=2e-6)


@pytest.mark.long
@pytest.mark.parametrize("name", ["Hudzovic", "EqualLag", "FOPDT", "SOPDT", "SOPDTZero", "IPDT"])
def test_second_derivatives_are_finite(name):
    """With respect to all parameters and time; those of the contour kernel in test_contour.py."""
    own = {k: v for k, v in (OWN[name] | LEVELS).items() if not isinstance(v, int)}
    static = {k: v for k, v in OWN[name].items() if isinstance(v, int)}

    def response(own, t):
        return CLASSES[name](**own, **static).step_response(t)

    hessian = jax.jit(jax.vmap(jax.hessian(response, (0, 1)), (None, 0)))(own, T)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(hessian))


# ---- other responses


def check_impulse_response(name, dtype):
    t = np.asarray(T, dtype)
    own = {k: v if k == "n" else np.asarray(v, dtype) for k, v in (OWN[name] | LEVELS).items()}
    model = CLASSES[name](**own)
    family, parameters = name.split(",")[0], exact(model, name)
    truth = [float(oracle.derivatives(family, oracle.exact(x), parameters)["t"]) for x in t]
    y = model.impulse_response(t)
    tolerance = {np.float32: 1e-5, np.float64: 1e-12}[dtype]
    assert np.allclose(y, truth, rtol=0, atol=tolerance * np.max(np.abs(truth)))
    assert np.all(y[:3] == 0)


@pytest.mark.parametrize("name", ["Hudzovic", "PTn", "SOPDT", "SOPDTZero", "IPDT"])
def test_impulse_response_is_the_derivative_in_time(name):
    """The same forward derivative for all; in test_accuracy.py it is taken in reverse."""
    check_impulse_response(name, np.float64)


@pytest.mark.long
@families
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_all_impulse_responses(name, dtype):
    check_impulse_response(name, dtype)


def transfer_function(name, s):
    p = OWN[name]
    if name.startswith("SOPDT"):
        zeta, w = p["zeta"], p["omega_n"]
        return (1 + s * p.get("lead", 0)) * w**2 / (s**2 + 2 * zeta * w * s + w**2)
    if name == "IPDT":
        return 1 / s / (1 + s * p["T"])
    if name.startswith("EqualLag"):
        return (1 + s * p["T"]) ** -float(p["n"])
    lags = {
        "Hudzovic": lambda: [p["T"] / (1 - k * p["r"]) for k in range(p["n"])],
        "Sani": lambda: [p["T"] * p["r"] ** k for k in range(p["n"])],
        "PTn": lambda: p["lags"],
        "FOPDT": lambda: [p["T"]],
    }[name]()
    return np.prod([1 / (1 + s * T) for T in lags], axis=0)


@families
def test_frequency_response(name):
    omega = np.array([0, *np.geomspace(1e-4, 1e4, 11)])
    omega[0] += 1e-9 * (name == "IPDT")  # at 0 it is infinite
    s = 1j * omega
    expected = LEVELS["gain"] * np.exp(-s * LEVELS["delay"]) * transfer_function(name, s)
    response = make(name).frequency_response(omega)
    assert np.allclose(response, expected, rtol=1e-11, atol=0)
    assert np.allclose(make(name).frequency_response(-omega), np.conj(expected), rtol=1e-11)


@ordered
def test_frequency_response_with_an_array_order(cls):
    omega = jnp.geomspace(1e-3, 1e3, 12)
    traced = of_order(cls, jnp.asarray(3)).frequency_response(omega)
    assert np.allclose(traced, of_order(cls, 3).frequency_response(omega), rtol=1e-13)


@settling
def test_static_gain(name):
    model = make(name)
    assert model.static_gain == LEVELS["gain"]
    assert np.all(model.frequency_response(0 * T) == LEVELS["gain"])
    settled = model.step_response(1e3 + T)
    assert np.allclose(settled - model.offset, LEVELS["gain"], rtol=1e-11)


@families
def test_poles(name):
    """The transfer function is the product over them."""
    if name == "EqualLag, real n":
        return
    poles, s = make(name).poles, 1j * np.geomspace(0.01, 10, 7)
    product = np.prod([p / (p - s) if p else 1 / s for p in poles], axis=0)
    product *= np.prod([1 - s / z for z in make(name).zeros], axis=0)
    assert np.allclose(product, transfer_function(name, s), rtol=1e-12)
    assert len(poles) == {"FOPDT": 1, "EqualLag": 3, "Hudzovic": 3, "Sani": 3}.get(name, 2)
    assert len(make(name).zeros) == (name == "SOPDTZero")


@pytest.mark.parametrize("zeta", [0.01, 0.7, 1.0, 1.3, 1e6])
def test_poles_of_second_order(zeta):
    """Their product is omega_n^2, their sum -2 zeta omega_n; the slow one keeps its digits."""
    poles = SOPDT(zeta=zeta, omega_n=0.6).poles
    assert np.allclose(np.prod(poles), 0.36, rtol=1e-13)
    assert np.allclose(np.sum(poles), -1.2 * zeta, rtol=1e-13)
    assert np.iscomplexobj(poles) == (zeta < 1)


# ---- errors


@pytest.mark.parametrize("value", ["2", 1j, [1, "x"], True])
def test_parameters_that_are_no_real_numbers(value):
    for build in (
        lambda: FOPDT(T=value),
        lambda: PTn(lags=value),
        lambda: SOPDT(zeta=0.5, omega_n=value),
        lambda: SOPDTZero(zeta=0.5, omega_n=1.0, lead=value),
        lambda: IPDT(T=value),
        lambda: Hudzovic(T=1, r=value, n=2),
        lambda: Sani(T=1, r=0.5, n=2, gain=value),
        lambda: EqualLag(T=1, n=2, delay=value),
    ):
        with pytest.raises((TypeError, ValueError)):
            build()


@chains
@pytest.mark.parametrize("n", [0, -1, 2.5, 2.0, "3", 1j, True, np.array(2.0), [2.5]])
def test_orders_that_are_no_whole_numbers(cls, n):
    with pytest.raises((TypeError, ValueError), match="order"):
        cls(T=1, r=0.1, n=n)


@pytest.mark.parametrize("n", [0, -1, -0.5, 0.0, "3", 1j])
def test_orders_that_are_not_positive(n):
    with pytest.raises((TypeError, ValueError)):
        EqualLag(T=1, n=n)


def test_missing_parameter():
    with pytest.raises(TypeError):
        FOPDT()  # pyright: ignore[reportCallIssue]
    with pytest.raises(TypeError):
        Hudzovic(T=1, r=0.1)  # pyright: ignore[reportCallIssue]


def test_oscillating_model_has_no_lags():
    for plant in (SOPDT(zeta=0.5, omega_n=1.0), SOPDTZero(zeta=0.5, omega_n=1.0, lead=1.0)):
        with pytest.raises(ValueError, match="zeta"):
            _ = plant.lags


@settling
def test_the_sum_of_lags_is_the_area_above_the_response(name):
    """With the dead time, the integral of 1 - g to infinity."""
    model = make(name, gain=1.0, offset=0.0)
    t = np.linspace(0, 120, 200_001)
    area = np.trapezoid(1 - np.asarray(model.unit_response(jnp.asarray(t))), t)
    assert float(model.sum_of_lags) == pytest.approx(area, rel=1e-4)
    assert make(name).sum_of_lags == model.sum_of_lags
    assert eqx.filter_grad(lambda model: model.sum_of_lags)(model).gain == 0


def test_an_integrator_has_no_sum_of_lags():
    assert np.isnan(make("IPDT").sum_of_lags)
