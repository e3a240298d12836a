"""All tables and figures: `python -m experiments.maxim [--out FOLDER] [--only NAME ...]`.

A. Maxim, R. De Keyser, "Estimation of FOPDT and SOPDT models from noisy step response data"
(RDKAM). Names: noise_free, noisy_examples, rigs, random_plants, variability, scatter, points.
"""

import argparse
import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from experiments.cores import use_all_cores
from experiments.maxim import (
    examples,
    points_under_noise,
    random_plants,
    rigs,
    scatter,
    variability,
)


PARTS = {
    "noise_free": examples.noise_free,
    "noisy_examples": examples.noisy_examples,
    "rigs": rigs.run,
    "random_plants": random_plants.run,
    "variability": variability.run,
    "scatter": scatter.run,
    "points": points_under_noise.run,
}


def main() -> None:
    use_all_cores()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/maxim"), help="folder")
    parser.add_argument("--only", nargs="+", choices=PARTS, metavar="NAME", default=list(PARTS))
    options = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 200)
    numbers, start = Table("part", "number", "value", title="Key numbers"), time.perf_counter()
    for name in options.only:
        begin = time.perf_counter()
        outcome = PARTS[name]()
        outcome.write(options.out, name)
        if outcome.table is not None:
            console.print(outcome.table)
        numbers.add_row(name, "seconds", f"{time.perf_counter() - begin:.0f}")
        for row in outcome.numbers.items():
            numbers.add_row(name, *row)
    console.print(numbers)
    console.print(f"{time.perf_counter() - start:.0f} s, files in {options.out}")


if __name__ == "__main__":
    main()
