"""What all scripts share: their options, their files and the line they print."""

import argparse
import importlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from experiments.cores import use_all_cores


Frame = Any
"""A pandas DataFrame, whose stubs do not follow selections and groups."""


class Settings(NamedTuple):
    """Options of a run. `quick` has fewer plants and noise levels."""

    out: Path
    quick: bool
    seed: int

    def size(self, full: int, quick: int) -> int:
        return quick if self.quick else full

    def generator(self, study: str) -> np.random.Generator:
        """Random numbers of one study, the same whichever scripts run before it."""
        return np.random.default_rng([self.seed, *study.encode()])


class Outcome(NamedTuple):
    """What a script's `run(settings)` returns: its CSV, its PNG and its key numbers."""

    frame: Frame
    figure: Figure | None
    numbers: Mapping[str, str | float]


class Finished(NamedTuple):
    """A script that ran: the names of its files, its runtime, its key numbers."""

    files: str
    seconds: float
    numbers: Mapping[str, str | float]


def run_script(name: str, settings: Settings) -> Finished:
    """Run `experiments.murray.<name>` and write `<name>.csv` and `<name>.png`."""
    start = time.perf_counter()
    outcome = importlib.import_module(f"experiments.murray.{name}").run(settings)
    settings.out.mkdir(parents=True, exist_ok=True)
    files = f"{name}.csv"
    outcome.frame.to_csv(settings.out / files, index=False, float_format="%.8g")
    if outcome.figure is not None:
        files += ", .png"
        outcome.figure.savefig(settings.out / f"{name}.png", dpi=150)
    return Finished(files, time.perf_counter() - start, outcome.numbers)


def parser(description: str | None) -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(description=description)
    options.add_argument("--out", type=Path, default=Path("out/murray"), help="folder of the files")
    options.add_argument("--quick", action="store_true", help="fewer plants and noise levels")
    options.add_argument("--seed", type=int, default=0)
    return options


def settings_of(options: argparse.Namespace) -> Settings:
    use_all_cores()
    return Settings(options.out, options.quick, options.seed)


def main(file: str) -> None:
    """Run the script in `file` alone."""
    name = Path(file).stem
    module = importlib.import_module(f"experiments.murray.{name}")
    settings = settings_of(parser(module.__doc__).parse_args())
    show([run_script(name, settings)], settings)


def show(finished: list[Finished], settings: Settings) -> None:
    """Table of scripts with runtime, files and key numbers."""
    table = Table("files", "seconds", "number", "value")
    for script in finished:
        first = [script.files, f"{script.seconds:.1f}"]
        for place, (key, value) in enumerate(script.numbers.items()):
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
            table.add_row(*(first if place == 0 else ["", ""]), key, text)
        table.add_section()
    console = Console()
    console.width = max(console.width, 160)
    console.print(table)
    total = sum(script.seconds for script in finished)
    size = "quick" if settings.quick else "full"
    console.print(f"seed {settings.seed}, {size} size, {total:.0f} s, files in {settings.out}")
