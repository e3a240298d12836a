"""Every plant against the high-precision oracle: the response and all its derivatives."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mpf
from tests import oracle

import stepax


DTYPES = (np.float64, np.float32)
RESPONSE_TOLERANCE = {np.float64: 1e-12, np.float32: 1e-5}
DERIVATIVE_TOLERANCE = {np.float64: 1e-8, np.float32: 1e-3}
HUDZOVIC_END = {np.float64: 1e-9, np.float32: 1e-4}  # the smallest 1 - (n-1) r
UNIT = {np.float64: 2.0**60, np.float32: 2.0**30}  # another unit of time

# Times since the delay, in units of the sum of the lags.
FEW = (-0.5, 0.0, 1e-6, 1e-2, 0.2, 0.6, 0.9, 1.1, 1.5, 2.5, 7.0, 50.0)
MANY = (*FEW[:2], *np.geomspace(1e-14, 0.1, 10), *np.linspace(0.15, 2.5, 14), 4, 8, 16, 50)

BATCH = 12  # one shape for all, so that every operation is compiled once
POWERS = {"T": 1, "lead": 1, "delay": 1, "omega_n": -1}
"""Powers of the unit of time in a parameter."""
PLAIN = {"gain": 1.0, "offset": 0.0, "delay": 0.0}
SHIFTED = {"gain": -3.0, "offset": 40.0, "delay": 2.7}


def build(family, n, parameters):
    """Model of a family from scalars; lags come one by one, `n` is a static order or None."""
    lags = [parameters[k] for k in sorted(parameters) if k.startswith("lag")]
    own = {k: v for k, v in parameters.items() if not k.startswith("lag")}
    own |= {"lags": jnp.stack(lags)} if lags else {"n": n} if n else {}
    return getattr(stepax, family)(**own)


@functools.cache
def response_and_derivatives(family, n):
    """Vectorised over plants, then times."""

    def response(parameters, t):
        return build(family, n, parameters).step_response(t)

    return jax.jit(jax.vmap(jax.vmap(jax.value_and_grad(response, (0, 1)), (None, 0))))


def evaluate(family, n, plants, times, dtype, compiled):
    """Parameters and times as rounded, response and derivatives by name: one row per plant.

    For one use of the contour kernel, running operation by operation is quicker than compiling.
    """
    if compiled is None:
        compiled = family not in ("Sani", "PTn")
    padded = [*plants, *plants[:1] * (BATCH - len(plants))]
    parameters = {k: np.array([p[k] for p in padded], dtype) for k in plants[0]}
    t = np.array([*times, *times[:1] * (BATCH - len(plants))], dtype)
    with jax.disable_jit(not compiled):
        y, (slopes, slope_t) = response_and_derivatives(family, n)(parameters, t)
    assert y.dtype == slope_t.dtype == dtype
    slopes = {k: np.asarray(v) for k, v in (slopes | {"t": slope_t}).items()}
    assert all(np.isfinite(v).all() for v in (y, *slopes.values()))
    return parameters, t, np.asarray(y), slopes


def response_error(family, exact, t, y, dtype):
    """Largest error of one plant's response, in units of what is allowed.

    A ramp has no size of 1: there errors are relative to the largest |gain g| over the times.
    """
    gain, offset = float(abs(exact["gain"])), float(abs(exact["offset"]))
    truth = [oracle.step_response(family, oracle.exact(x), exact) for x in t]
    ramp = family == "IPDT"
    size = max(float(abs(x - exact["offset"])) for x in truth) if ramp else gain
    allowed = RESPONSE_TOLERANCE[dtype] * size
    if (gain, offset) != (1, 0):
        allowed += 2 * float(np.finfo(dtype).eps) * (size + offset)
    return max(abs(float(mpf(float(a)) - b)) for a, b in zip(y, truth, strict=True)) / allowed


def derivative_errors(family, exact, t, slopes):
    """Largest error of each derivative of one plant, in units of its largest value over t."""
    rows = [oracle.derivatives(family, oracle.exact(x), exact) for x in t]
    errors = {}
    for name, slope in slopes.items():
        truth = np.array([float(row[name]) for row in rows])
        errors[name] = np.max(np.abs(slope - truth)) / (np.max(np.abs(truth)) or 1.0)
    return errors


def worst_errors(family, n, plants, scales, dtype, fractions=FEW, compiled=None):
    """Largest errors over plants, by name; `scales` are the plants' sums of lags."""
    times = [p["delay"] + s * np.sort(fractions) for p, s in zip(plants, scales, strict=True)]
    parameters, t, y, slopes = evaluate(family, n, plants, times, dtype, compiled)
    before = t <= parameters["delay"][:, None]
    assert np.all((y == parameters["offset"][:, None])[before])
    assert all(np.all(v[before] == (k == "offset")) for k, v in slopes.items())

    errors = []
    for i in range(len(plants)):
        exact = {k: oracle.exact(v[i]) for k, v in parameters.items()} | ({"n": n} if n else {})
        error = derivative_errors(family, exact, t[i], {k: v[i] for k, v in slopes.items()})
        errors.append(error | {"response": response_error(family, exact, t[i], y[i], dtype)})
    return {k: max(error[k] for error in errors) for k in errors[0]}


def check(family, n, plants, scales, dtype, **options):
    errors = worst_errors(family, n, plants, scales, dtype, **options)
    assert errors.pop("response") <= 1
    assert max(errors.values()) <= DERIVATIVE_TOLERANCE[dtype], errors


def variants(plant, dtype, powers=POWERS):
    """The same plant with gain, offset and delay, and in two other units of time."""
    scaled = [
        {k: v * unit ** powers.get(k, 0) for k, v in (plant | SHIFTED).items()}
        for unit in (UNIT[dtype], 1 / UNIT[dtype])
    ]
    return [plant | PLAIN, plant | SHIFTED, *scaled]


def hudzovic(n, dtype, inner=(0.4, 0.9)):
    relative = (0.0, *inner, 1 - HUDZOVIC_END[dtype])
    plants = [{"T": 1.7, "r": x / max(n - 1, 1)} | PLAIN for x in relative]
    plants += variants(plants[1], dtype)[1:]
    return plants, [sum(p["T"] / (1 - k * p["r"]) for k in range(n)) for p in plants]


def sani(n, dtype, inner=(1e-6, 0.03, 0.5, 0.97)):
    plants = [{"T": 1.7, "r": r} | PLAIN for r in (0.0, *inner, 1.0)]
    plants += variants(plants[3], dtype)[1:]
    return plants, [sum(p["T"] * p["r"] ** k for k in range(n)) for p in plants]


def equal_lags(n, dtype):
    plants = variants({"T": 1.7}, dtype)
    return plants, [p["T"] * n for p in plants]


def equal_lags_real(dtype, orders=(0.3, 0.999, 1.0, 1.001, 2.5, 8.0, 15.2, 32.0)):
    plants = [{"T": 1.7, "n": n} | PLAIN for n in orders]
    plants += variants({"T": 1.7, "n": 2.5}, dtype)[1:]
    return plants, [p["T"] * max(p["n"], 1) for p in plants]


DAMPINGS = (0.01, 0.1, 0.7, 1 - 1e-7, 1.0, 1 + 1e-7, 1.01, 3.0, 50.0)


def second_order(dtype, dampings=DAMPINGS):
    plants = [{"zeta": z, "omega_n": 0.6} | PLAIN for z in dampings]
    plants += variants({"zeta": 0.4, "omega_n": 0.6}, dtype)[1:]
    return plants, [2 * max(p["zeta"], 0.2 / p["zeta"]) / p["omega_n"] for p in plants]


def second_order_zero(dtype, dampings, lead):
    """`lead` in units of the sum of the lags or, where it oscillates, of about 1/omega_n."""
    plants, scales = second_order(dtype, dampings)
    own = [np.hypot(1, 2 * p["zeta"]) / p["omega_n"] for p in plants]
    return [p | {"lead": lead * T} for p, T in zip(plants, own, strict=True)], scales


def lagged_ramps(dtype, lags=(0.0, 1e-9, 1e-4, 0.02, 0.3, 1.0, 7.0, 50.0, 2500.0)):
    """Lags in units of the times, which do not depend on them; the last is 50 times the longest."""
    plants = [{"T": 1.7 * T} | PLAIN for T in lags]
    others = variants({"T": 1.7}, dtype, POWERS | {"gain": -1})[1:]
    return plants + others, [1.7] * len(lags) + [p["T"] for p in others]


def chains(*lags):
    """Plants with individual lags; a short list is filled up with zeros, which are tested too."""
    length = max(len(x) for x in lags)
    rows = [[*x, *[0] * (length - len(x))] for x in lags]
    plants = [{f"lag{k}": float(T) for k, T in enumerate(row)} | PLAIN for row in rows]
    return length, [*plants, plants[0] | SHIFTED], [sum(x) for x in (*lags, lags[0])]


CHAINS = {
    "ratios to 1e12": chains([1, 1e-12, 1e-6, 1e-9], [1e-12, 1e-12, 1, 1], [5, 0, 1e-3, 1]),
    "few": chains(
        [0, 2, 0, 1], [1.7], [1, 1 + 1e-7, 1 + 2e-7, 1 - 1e-7], [1, 1 + 1e-15, 1 - 1e-15]
    ),
    "eight": chains([3] * 8, [51.0**-k for k in range(8)]),
}

by_dtype = pytest.mark.parametrize("dtype", DTYPES)


@by_dtype
@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_hudzovic(n, dtype):
    check("Hudzovic", n, *hudzovic(n, dtype), dtype)


@by_dtype
@pytest.mark.parametrize("n", [1, 2, 5])
def test_sani(n, dtype):
    check("Sani", n, *sani(n, dtype), dtype)


@by_dtype
@pytest.mark.parametrize("n", [1, 4, 20])
def test_equal_lags_of_whole_order(n, dtype):
    check("EqualLag", n, *equal_lags(n, dtype), dtype)


@by_dtype
def test_equal_lags_of_real_order(dtype):
    check("EqualLag", None, *equal_lags_real(dtype), dtype)


@by_dtype
@pytest.mark.parametrize("name", CHAINS)
def test_individual_lags(name, dtype):
    check("PTn", *CHAINS[name], dtype)


@by_dtype
def test_first_order(dtype):
    check("FOPDT", None, *equal_lags(1, dtype), dtype)


@by_dtype
def test_second_order(dtype):
    check("SOPDT", None, *second_order(dtype), dtype)


@by_dtype
@pytest.mark.parametrize("lead", [-0.6, 0.0, 1.4])
def test_second_order_with_a_zero(lead, dtype):
    check("SOPDTZero", None, *second_order_zero(dtype, DAMPINGS, lead), dtype)


@by_dtype
def test_lagged_ramp(dtype):
    check("IPDT", None, *lagged_ramps(dtype), dtype)


exhaustive = functools.partial(check, fractions=MANY)


@pytest.mark.long
@by_dtype
@pytest.mark.parametrize("n", range(1, 9))
def test_chains_exhaustively(n, dtype):
    exhaustive("Hudzovic", n, *hudzovic(n, dtype, (1e-9, 1e-3, 0.3, 0.7, 0.97, 0.999)), dtype)
    exhaustive("Sani", n, *sani(n, dtype, (1e-12, 1e-4, 0.1, 0.3, 0.8, 0.999)), dtype)
    exhaustive("EqualLag", n, *equal_lags(n, dtype), dtype)


@pytest.mark.long
@by_dtype
def test_other_families_exhaustively(dtype):
    orders = (0.3, 0.7, 1 + 1e-9, 2.0, 2 + 1e-9, 3.3, 6.5, 11.0, 21.7)
    exhaustive("EqualLag", None, *equal_lags_real(dtype, orders), dtype)
    for dampings in [(0.01, 0.03, 0.2, 0.5, 0.9, 0.99), (1 - 1e-9, 1 + 1e-9, 1.1, 1.3, 8.0, 20.0)]:
        exhaustive("SOPDT", None, *second_order(dtype, dampings), dtype)
        for lead in (-3.0, -0.1, 1e-6, 0.5):
            exhaustive("SOPDTZero", None, *second_order_zero(dtype, dampings, lead), dtype)
    for lags in [(1e-12, 1e-7, 1e-3, 0.01, 0.05, 0.1), (0.2, 0.5, 0.7, 2.0, 20.0, 400.0)]:
        exhaustive("IPDT", None, *lagged_ramps(dtype, lags), dtype)
    for case in CHAINS.values():
        exhaustive("PTn", *case, dtype)


@pytest.mark.long
@by_dtype
def test_compiled_contour_kernel(dtype):
    """Fused by the compiler it rounds differently."""
    check("Sani", 4, *sani(4, dtype), dtype, compiled=True)
    check("PTn", *CHAINS["eight"], dtype, compiled=True)


@pytest.mark.parametrize("n", [3, 8])
def test_oracle_agrees_with_itself(n):
    """Partial fractions of spread lags against the gamma distribution function."""
    listed = {f"lag{k}": mpf(2) for k in range(n)} | {"n": n}
    for t in (mpf("0.1"), mpf(7), mpf(90)):
        chain, equal = (
            oracle.step_response(family, t, p)
            for family, p in [("PTn", listed), ("EqualLag", {"T": mpf(2), "n": n})]
        )
        assert abs(chain - equal) < mpf(10) ** -40
