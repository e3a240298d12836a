"""All tables and figures: `python -m experiments.jakoubek [--out FOLDER] [--only NAME ...]`.

P. Jakoubek, "Experimental Identification of Stable Nonoscillatory Systems from Step-Responses by
Selected Methods" (the program Prechar). Names: table_1 ... table_8, figure_1 ... figure_13,
ranking, conclusions.
"""

import argparse
import functools
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from experiments.jakoubek import (
    charts,
    comparisons,
    conclusions,
    marks,
    ranking,
    tables_1_3,
    tables_4_8,
)
from experiments.jakoubek.cells import all_rows, disagreements, published_errors
from experiments.jakoubek.outcome import Outcome
from experiments.jakoubek.published import REPRODUCED
from experiments.jakoubek.systems import SYSTEMS


def parts() -> dict[str, Callable[[], Outcome]]:
    """Every table and figure, in the order of the paper."""
    tables = {f"table_{n}": getattr(tables_1_3, f"table_{n}") for n in (1, 2, 3)}
    tables |= {
        f"table_{system.table}": functools.partial(tables_4_8.run, name)
        for name, system in SYSTEMS.items()
    }
    figures = {n: functools.partial(marks.run, n) for n in marks.FIGURES}
    figures |= {4: charts.figure_4, 6: charts.figure_6}
    figures |= {
        system.figure: functools.partial(comparisons.run, name) for name, system in SYSTEMS.items()
    }
    tables |= {f"figure_{n}": figures[n] for n in sorted(figures)}
    return tables | {"ranking": ranking.run, "conclusions": conclusions.run}


def key_numbers() -> dict[str, str]:
    """What the 35 cells come to."""
    cells = all_rows()
    reproducible = [row for row in cells.values() if row.cell.verdict == REPRODUCED]
    within = sum(row.within_rounding for row in reproducible)
    apart = disagreements()
    off = np.abs(published_errors() - 1)
    names = f" (not {', '.join(f'{name} {method}' for name, method in apart)})" if apart else ""
    return {
        "printed J above 1e-3, against the printed models": (
            f"{np.sum(off < 0.02)} of {off.size} within 2 %, median {np.median(off):.1%}"
        ),
        "reproducible cells within printed rounding": f"{within} of {len(reproducible)}",
        "correct values as independently computed, 4 digits": (
            f"{len(cells) - len(apart)} of {len(cells)}{names}"
        ),
    }


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_disable_most_optimizations", True)  # most of the time is compilation
    known = parts()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/jakoubek"), help="folder")
    parser.add_argument("--only", nargs="+", choices=known, metavar="NAME", default=list(known))
    options = parser.parse_args()
    start, numbers = time.perf_counter(), {}
    console = Console(width=None if sys.stdout.isatty() else 160)
    columns = TextColumn("{task.description:12}"), BarColumn(), MofNCompleteColumn()
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        task = progress.add_task("", total=len(options.only))
        for name in options.only:
            progress.update(task, description=name)
            outcome = known[name]()
            outcome.write(options.out, name)
            if outcome.table is not None:
                console.print(outcome.table)
            numbers |= outcome.numbers
            progress.advance(task)
        progress.update(task, description="done")
    summary = Table("number", "value", title="Key numbers")
    for row in (numbers | key_numbers()).items():
        summary.add_row(*row)
    console.print(summary)
    console.print(f"{time.perf_counter() - start:.0f} s, files in {options.out}")


if __name__ == "__main__":
    main()
