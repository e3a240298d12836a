"""The bounded least-squares solver on small problems, against SciPy and optimistix."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import least_squares
from tests.fits import COMPILED, START, TRUE, simulated

import stepax
from stepax import PTn, refine, refused
from stepax.fitting._solver import solve_positive


T = np.linspace(0.0, 4.0, 60)
NOISE = 0.02 * np.random.default_rng(0).standard_normal(T.size)
DECAY = 0.3 + 2 * np.exp(-1.5 * T) + NOISE


def decay(x, y):
    """A decay of height 2, rate 1.5 and end 0.3, with noise."""
    t, y = (jnp.asarray(a, x.dtype) for a in (T, y))
    return x[0] * jnp.exp(-x[1] * t) + x[2] - y


def valley(x, _):
    """Rosenbrock's: the minimum is at (1, 1)."""
    return jnp.stack([10 * (x[1] - x[0] ** 2), 1 - x[0]])


PROBLEMS = {"decay": (decay, [0.5, 0.2, 0.0]), "valley": (valley, [-1.2, 1.0])}
BOUNDS = {
    "decay": {
        "far": ([-9, 0, -9], [9, 9, 9]),
        "lower": ([-9, 0, 0.4], [9, 9, 9]),
        "two": ([-9, 0, -9], [1.5, 1.2, 9]),
        "held": ([-9, 0.2, -9], [9, 0.2, 9]),
    },
    "valley": {"far": ([-9, -9], [9, 9]), "upper": ([-9, -9], [0.5, 9]), "two": ([-9, 2], [1, 9])},
}
CASES = [(problem, name) for problem, bounds in BOUNDS.items() for name in bounds]


@functools.cache
def compiled(problem, dtype=np.float64):
    """(x, status, steps) of a start, bounds and data."""
    function = PROBLEMS[problem][0]
    solver = stepax.BoundedLevenbergMarquardt(rtol=float(jnp.finfo(dtype).eps) ** 0.75)

    @jax.jit
    def solved(start, lower, upper, y):
        found = optx.least_squares(
            function,
            solver,
            start,
            args=y,
            options={"lower": lower, "upper": upper},
            max_steps=200,
            throw=False,
        )
        return found.value, found.result._value, found.stats["num_steps"]

    return solved


def solve(problem, bounds, start=None, dtype=np.float64):
    start = PROBLEMS[problem][1] if start is None else start
    rows = [np.array(v, dtype) for v in (start, *bounds, DECAY)]
    x, result, steps = compiled(problem, dtype)(*rows)
    return np.asarray(x), int(result) == optx.RESULTS.successful._value, int(steps)


@pytest.mark.parametrize(("problem", "name"), CASES)
def test_within_bounds_as_scipy(problem, name):
    lower, upper = BOUNDS[problem][name]
    x, converged, _ = solve(problem, (lower, upper))
    function, start = PROBLEMS[problem]
    apart = np.array(upper) > np.array(lower)  # SciPy holds nothing: bounds a hair apart
    ends = np.array(lower, float), np.where(apart, upper, np.array(upper) + 1e-9)
    oracle = least_squares(
        lambda x: np.asarray(function(x, DECAY)),
        np.clip(start, ends[0] + 1e-10, ends[1] - 1e-10),
        bounds=ends,
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        x_scale="jac",
    )
    assert converged and np.all((x >= lower) & (x <= upper))
    np.testing.assert_allclose(x, oracle.x, atol=2e-7)
    assert 0.5 * np.sum(np.asarray(function(x, DECAY)) ** 2) <= oracle.cost * (1 + 1e-8)


@pytest.mark.parametrize(("problem", "name"), [("decay", "lower"), ("decay", "two")])
def test_an_optimum_on_a_bound_is_exact_and_takes_few_steps(problem, name):
    lower, upper = BOUNDS[problem][name]
    x, converged, steps = solve(problem, (lower, upper))
    on_bound = (x == lower) | (x == upper)
    assert converged and on_bound.any() and steps <= 12
    elsewhere = solve(problem, (lower, upper), np.where(on_bound, x, PROBLEMS[problem][1]))
    np.testing.assert_allclose(elsewhere[0], x, atol=1e-7)


@pytest.mark.parametrize(("share", "reached"), [(0.5, False), (1.001, True)])
def test_a_search_ends_where_a_cost_is_out_of_reach(share, reached):
    """`beat`: half of the least cost is given up at once, a little more than that is reached."""
    start = [2.0, 1.4, 0.3]
    x, _, _ = solve("decay", BOUNDS["decay"]["far"], start)
    least = 0.5 * np.sum(np.asarray(decay(x, DECAY)) ** 2)
    lower, upper = np.array(BOUNDS["decay"]["far"], float)
    found = optx.least_squares(
        decay,
        stepax.BoundedLevenbergMarquardt(rtol=1e-10),
        jnp.array(start),
        args=DECAY,
        options={"lower": lower, "upper": upper, "beat": share * least},
        throw=False,
    )
    assert (found.result == optx.RESULTS.successful) == reached
    assert reached or int(found.stats["num_steps"]) <= 4


def test_a_start_beyond_the_bounds_is_put_on_them():
    lower, upper = BOUNDS["decay"]["far"]
    x, converged, _ = solve("decay", (lower, upper), [20.0, -5.0, 0.0])
    assert converged
    np.testing.assert_allclose(x, solve("decay", (lower, upper))[0], atol=1e-7)


def test_solves_in_float32():
    bounds = BOUNDS["decay"]["far"]
    x, converged, _ = solve("decay", bounds, dtype=np.float32)
    assert x.dtype == np.float32 and converged
    np.testing.assert_allclose(x, solve("decay", bounds)[0], rtol=2e-3)


def test_lanes_are_independent_and_what_is_not_finite_at_the_start_diverges():
    lower, upper = (np.array(x, float) for x in BOUNDS["decay"]["far"])
    starts = np.array([[0.5, 0.2, 0.0], [0.5, 0.2, 0.0], [5.0, 3.0, -2.0]])
    data = np.stack([DECAY, np.where(T > 2, np.inf, DECAY), DECAY])
    x, result, steps = jax.vmap(compiled("decay"), (0, None, None, 0))(starts, lower, upper, data)
    good, bad = optx.RESULTS.successful, optx.RESULTS.nonlinear_divergence
    assert [int(r) for r in result] == [int(r._value) for r in (good, bad, good)]
    assert int(steps[1]) == 1 and np.all(x[1] == starts[1])
    alone, _, _ = solve("decay", (lower, upper))
    np.testing.assert_allclose(x[0], alone, rtol=1e-10)
    np.testing.assert_allclose(x[2], alone, atol=1e-7)


def test_two_decays_hard_to_tell_apart():
    """Rates of 1 and 1.1, a condition number of 7e4: as low as by QR factorisations."""
    y = np.exp(-T) + np.exp(-1.1 * T) + NOISE / 1e3

    def residual(x, y):
        return x[0] * jnp.exp(-x[1] * T) + x[2] * jnp.exp(-x[3] * T) - y

    bounds = {"lower": jnp.array([0.0, 0, 0, 0]), "upper": jnp.full(4, 9.0)}
    start = jnp.array([1.5, 0.8, 0.5, 1.5])

    @jax.jit
    def both(y):
        ours = stepax.BoundedLevenbergMarquardt(rtol=1e-12)
        qr = optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
        return [
            optx.least_squares(
                residual, solver, start, y, options, max_steps=500, throw=False
            ).value
            for solver, options in ((ours, bounds), (qr, {}))
        ]

    ours, other = (float(jnp.sum(residual(x, y) ** 2)) for x in both(y))
    assert ours <= other * (1 + 1e-6)


@pytest.mark.parametrize("p", [1, 2, 3, 6])
def test_solutions_of_positive_systems(p):
    """Against NumPy, a batch at once; a singular matrix gives something finite."""
    random = np.random.default_rng(p)
    roots = random.standard_normal((20, p, p + 3))
    matrices, right = roots @ roots.transpose(0, 2, 1), random.standard_normal((20, p))
    solved = jax.jit(jax.vmap(solve_positive))
    oracle = np.linalg.solve(matrices, right[..., None])[..., 0]
    np.testing.assert_allclose(solved(matrices, right), oracle, rtol=1e-9)
    assert np.isfinite(solved(np.ones_like(matrices), right)).all()


def test_a_batch_of_no_records():
    t = jnp.linspace(0, 40, 50)
    fit = jax.jit(jax.vmap(lambda y: stepax.identify(stepax.StepRecord(t, y), "fopdt_fit").rmse))
    assert fit(jnp.zeros((0, 50))).shape == (0,)


def test_other_solvers_serve():
    record = simulated(TRUE["FOPDT"], noise=0.05)
    ours = COMPILED(record, START["FOPDT"])
    other = refine(
        record, START["FOPDT"], solver=optx.LevenbergMarquardt(rtol=1e-9, atol=1e-9), max_steps=256
    )
    np.testing.assert_allclose(other.rmse, ours.rmse, rtol=1e-6)


def test_normal_equations_serve_where_parameters_are_hard_to_tell():
    """Nearly equal lags and hardly a dead time: no worse than QR factorisations of the Jacobian."""
    plant = PTn(lags=[5.0, 4.9], gain=2.0, offset=5.0, delay=0.05)
    start = PTn(lags=[8.0, 3.0], delay=0.5)
    record = simulated(plant, noise=0.02)
    ours = COMPILED(record, start)
    qr = optx.LevenbergMarquardt(rtol=1e-9, atol=1e-9)
    other = refine(record, start, solver=qr, max_steps=256, errors=False)
    cost = [float(jnp.sum((record.y - x.predict(record.t)) ** 2)) for x in (ours, other)]
    assert not bool(refused(ours.status)) and not bool(refused(other.status))
    assert cost[0] <= cost[1] * (1 + 1e-6)


def test_a_long_last_step_is_not_taken_unseen():
    """It promises 1e-10 of the cost, and would lead to a cost 1e8 times as high."""
    found = optx.least_squares(
        lambda x, _: jnp.stack([jnp.ones_like(x[0]), 1e-5 + 1e-7 * x[0] + x[0] ** 2]),
        stepax.BoundedLevenbergMarquardt(rtol=1e-8),
        (jnp.array(0.0, float),),
        options={"lower": jnp.array([-200.0]), "upper": jnp.array([200.0])},
        throw=False,
    )
    assert abs(float(found.value[0])) < 1e-2
