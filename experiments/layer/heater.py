"""A network with a plant as its last layer: `python -m experiments.layer.heater`.

A simulated heater: the valve's characteristic is not known (an equal-percentage one), behind it a
first-order lag with dead time. From one log of random steps with 2 % noise a small network learns
the characteristic and, at once, the plant learns its time constant and dead time: an `LTILayer`
whose free numbers (`to_unconstrained`) Optax may move by any step. The gain belongs to the network.
"""

import argparse
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from experiments.drawing import new_figure, quiet
from stepax import FOPDT, LTILayer, from_unconstrained, to_unconstrained


TRUE = FOPDT(T=18.0, gain=60.0, offset=20.0, delay=4.3)
START = FOPDT(T=6.0, gain=1.0, offset=0.0, delay=1.0)
DT, SAMPLES, NOISE, HELD = 1.0, 1500, 0.02, 25
UNIT = 50.0
"""Degrees that the network's output counts in, so that its weights are of size one."""


def characteristic(u):
    """Flow over that of the open valve, equal percentage: 30^(u - 1), 0 where it is shut."""
    return (30.0 ** (u - 1) - 1 / 30) / (1 - 1 / 30)


def simulated(seed: int = 0) -> tuple[jax.Array, jax.Array]:
    """Positions of the valve, and temperatures with noise."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(0, 1, -(-SAMPLES // HELD)), HELD)[:SAMPLES]
    u[0] = 0
    y = LTILayer(TRUE)(characteristic(u), DT)
    return jnp.asarray(u), y + NOISE * float(TRUE.gain) * random.standard_normal(SAMPLES)


class Heater(eqx.Module):
    """A network from the valve's position to power, then a plant from power to temperature."""

    network: eqx.nn.MLP
    free: Any

    @property
    def plant(self) -> FOPDT:
        """The plant with the network's gain: its own stays 1."""
        plant = from_unconstrained(self.free)
        return eqx.tree_at(lambda p: p.gain, plant, jnp.ones_like(plant.gain))

    def static(self, u: jax.Array) -> jax.Array:
        """What the valve lets through, in degrees at rest, 0 where it is shut."""
        through = jax.vmap(self.network)
        return UNIT * (through(u[:, None]) - through(jnp.zeros((1, 1))))[:, 0]

    def __call__(self, u: jax.Array) -> jax.Array:
        return UNIT * self.plant.offset + LTILayer(_without_offset(self.plant))(self.static(u), DT)


def _without_offset(plant: FOPDT) -> FOPDT:
    return eqx.tree_at(lambda p: p.offset, plant, jnp.zeros_like(plant.offset))


def trained(u: jax.Array, y: jax.Array, steps: int, seed: int = 0) -> tuple[Heater, list[float]]:
    """The heater after so many steps of Adam, and the loss on the way."""
    network = eqx.nn.MLP(1, 1, 16, 2, jnp.tanh, key=jax.random.key(seed))
    start = eqx.tree_at(lambda p: p.offset, START, jnp.mean(y) / UNIT)
    heater = Heater(network, to_unconstrained(start))
    solver = optax.adam(optax.cosine_decay_schedule(2e-2, steps))
    state = solver.init(eqx.filter(heater, eqx.is_inexact_array))

    @eqx.filter_jit
    def step(heater, state):
        def loss(heater):
            return jnp.mean(((heater(u) - y) / UNIT) ** 2)

        value, slopes = eqx.filter_value_and_grad(loss)(heater)
        moves, state = solver.update(slopes, state)
        return eqx.apply_updates(heater, moves), state, value

    values = []
    for _ in range(steps):
        heater, state, value = step(heater, state)
        values.append(UNIT * float(value) ** 0.5)
    return heater, values


def draw(path: Path, u, y, heater: Heater) -> None:
    """A part of the log, and the characteristic that was learnt."""
    figure = new_figure((9.0, 3.8))
    log, valve = figure.subplots(1, 2, width_ratios=[1.6, 1])
    t, part = DT * np.arange(u.size), slice(0, 500)
    log.plot(t[part], y[part], ".", color="0.6", markersize=2.5, label="simulated record")
    log.plot(t[part], heater(u)[part], color="#0b3c5d", label="network and plant")
    log.set_xlabel("time (s)")
    log.set_ylabel("temperature (degC)")
    log.legend(frameon=False, loc="upper left", ncols=2)
    log.set_ylim(top=float(jnp.max(y[part])) + 8)
    x = np.linspace(0, 1, 200)
    valve.plot(x, TRUE.gain * characteristic(x), color="#d95f02", linewidth=3, label="true")
    learnt = heater.static(jnp.asarray(x))
    valve.plot(x, learnt, color="#0b3c5d", linestyle="--", label="learnt")
    valve.set_xlabel("position of the valve")
    valve.set_ylabel("temperature rise at rest (degC)")
    valve.legend(frameon=False)
    quiet([log, valve])
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--out", type=Path, default=Path("experiments/layer/out"))
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    u, y = simulated()
    heater, values = trained(u, y, options.steps)
    x = jnp.linspace(0, 1, 200)
    off = float(jnp.max(jnp.abs(heater.static(x) - TRUE.gain * characteristic(x))))
    print(f"RMSE {values[0]:.2f} at the start, {values[-1]:.3f} in the end; the noise is"
          f" {NOISE * float(TRUE.gain):.3f} degC")  # fmt: skip
    plant = heater.plant
    print(f"T = {float(plant.T):.2f} s for {float(TRUE.T):g}, dead time {float(plant.delay):.2f} s"
          f" for {float(TRUE.delay):g}")  # fmt: skip
    print(f"Characteristic off by at most {off:.2f} degC of {float(TRUE.gain):g}")
    draw(options.out / "heater.png", u, y, heater)
    print(f"Written: {options.out / 'heater.png'}")


if __name__ == "__main__":
    main()
