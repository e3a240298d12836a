"""LOESS's span tuned by gradient: `python -m experiments.layer.span`.

Random plants of order 2 to 4, noise of 1, 3 and 10 % of the change (simulated), read by
`hudzovic_tu_tg` after smoothing. The loss is the mean logarithm of the relative RMSE against the
response without noise; its derivative in the span passes LOESS, the tangent and the lookup's root.
The logit of the span descends by Adam. A grid of spans beside it shows what there is to find, and
other plants whether it holds for them.
"""

import argparse
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

from experiments.drawing import new_figure, quiet
from stepax import METHODS, StepRecord, random_plants


NOISE, ORDERS, SAMPLES = (0.01, 0.03, 0.1), (2, 3, 4), 200
START, STEPS, RATE = 0.5, 40, 0.15
METHOD = "hudzovic_tu_tg"


def simulated(noise: float, count: int, seed: int) -> tuple[np.ndarray, jax.Array, jax.Array]:
    """Shares of the settling time, and a row a plant: responses without noise and with it."""
    keys = jax.random.split(jax.random.key(seed), len(ORDERS))
    share, clean = jnp.linspace(0.0, 1.0, SAMPLES), []
    for order, key in zip(ORDERS, keys, strict=True):
        plants = random_plants(key, count, order)
        ends = 6 * jnp.sum(plants.lags, axis=1) / order**0.5
        times = ends[:, None] * share[None, :]
        clean.append(jax.vmap(lambda plant, t: plant.step_response(t))(plants, times))
    rows = jnp.concatenate(clean)
    white = np.random.default_rng(seed).standard_normal(rows.shape)
    return np.asarray(share), rows, rows + noise * white


@partial(jax.jit, static_argnums=4)
def loss(logit: jax.Array, share, clean, noisy, method: str = METHOD) -> jax.Array:
    """Mean logarithm of the RMSE over the plants that give a model at this span."""
    span = jax.nn.sigmoid(logit)

    def one(clean, noisy):
        model = METHODS[method](StepRecord(share, noisy), span=span).model
        usable = jnp.isfinite(model.T)
        model = jax.tree.map(lambda x: jnp.where(usable, x, 1), model)
        square = jnp.mean((model.step_response(share) - clean) ** 2)
        return jnp.where(usable, 0.5 * jnp.log(square), 0), usable

    errors, usable = jax.vmap(one)(clean, noisy)
    return jnp.sum(errors) / jnp.sum(usable)


def tuned(data) -> list[tuple[float, float]]:
    """Span and loss after each step of Adam."""
    solver, logit = optax.adam(RATE), jnp.log(START / (1 - START))
    state, path = solver.init(logit), []
    slope = jax.jit(jax.value_and_grad(lambda logit: loss(logit, *data)))
    for _ in range(STEPS):
        value, gradient = slope(logit)
        path.append((float(jax.nn.sigmoid(logit)), float(value)))
        move, state = solver.update(gradient, state)
        logit = logit + move  # pyright: ignore[reportOperatorIssue]
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--plants", type=int, default=100, help="of each order")
    parser.add_argument("--out", type=Path, default=Path("experiments/layer/out"))
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    grid = np.linspace(0.06, 0.8, 30)
    figure = new_figure((7.0, 4.2))
    axes = figure.subplots()
    print("noise   tuned span   RMSE: start  tuned  of the grid   other plants: start  tuned")
    for noise, color, mark in zip(NOISE, ("#0b3c5d", "#d95f02", "0.45"), "os^", strict=True):
        data, other = (simulated(noise, options.plants, seed) for seed in (0, 1))
        curve = [float(loss(jnp.log(x / (1 - x)), *data)) for x in grid]
        path = tuned(data)
        (first, begin), (span, end) = path[0], min(path, key=lambda pair: pair[1])
        fresh = [float(loss(jnp.log(x / (1 - x)), *other)) for x in (first, span)]
        rmse = [100 * np.exp(x) for x in (begin, end, min(curve), *fresh)]
        print(
            f"{noise:5.2f}   {span:10.3f}   {rmse[0]:11.2f}  {rmse[1]:5.2f}  {rmse[2]:11.2f}"
            f"   {rmse[3]:19.2f}  {rmse[4]:5.2f}   (% of the change)"
        )
        axes.plot(grid, 100 * np.exp(curve), color=color, label=f"noise {100 * noise:g} %")
        spans, values = np.transpose(path)
        look = {"linestyle": "none", "marker": mark, "markersize": 3.5, "color": color}
        axes.plot(spans, 100 * np.exp(values), **look)
    axes.set_xlabel("span of LOESS (share of the record)")
    axes.set_ylabel("geometric mean of RMSE (% of the change)")
    axes.set_yscale("log")
    axes.set_title(f"{METHOD}, simulated: a grid of spans, and the steps of Adam", fontsize=10)
    axes.legend(frameon=False)
    quiet([axes])
    figure.savefig(options.out / "span.png")
    print(f"Written: {options.out / 'span.png'}")


if __name__ == "__main__":
    main()
