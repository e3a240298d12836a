"""Writes the simulated record behind `stepax identify --example heater`.

A heater steps from 0 to 40 % at t = 20 s; the plant has gain 0.8 degC/%, lags of 60, 12 and 4 s and
a dead time of 5 s, and starts at 22 degC. Gaussian noise of 0.1 degC, recorded in steps of 0.05.
"""

from pathlib import Path

import jax
import numpy as np

from stepax import PTn


STEP_TIME, STEP = 20.0, 40.0
COMMENT = (
    "# simulated: gain 0.8 degC/%, lags 60, 12 and 4 s, dead time 5 s, from 22 degC,"
    " noise 0.1 degC, steps of 0.05 degC"
)


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    t = np.arange(0.0, 401.0, 1.25)  # a row at the step
    plant = PTn(lags=np.array([60.0, 12.0, 4.0]), gain=0.8 * STEP, offset=22.0, delay=5.0)
    y = np.asarray(plant.step_response(t - STEP_TIME))
    y = np.round((y + np.random.default_rng(20).normal(0, 0.1, t.size)) / 0.05) * 0.05
    rows = [f"{a:g},{STEP * (a >= STEP_TIME):g},{b:.2f}" for a, b in zip(t, y, strict=True)]
    header = "time (s),heater (%),temperature (degC)"
    target = Path(__file__).parents[1] / "src" / "stepax" / "examples" / "heater.csv"
    target.write_text("\n".join([COMMENT, header, *rows]) + "\n", newline="\n")


if __name__ == "__main__":
    main()
