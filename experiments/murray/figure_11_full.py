"""Figure 11 as it was meant: 1000 noise levels, 504 random plants, every method, fits included.

    python -m experiments.murray.figure_11_full --out DIR [--float32] [--quick]

72 plants of each order from 2 to 8 at every noise level, uniform noise to 35 % peak to peak.
Lookups smooth with LOESS over 20 % of the record. The fits free T and r, as the author's; their
order is that of the family's lookup by t10/t50/t90, from whose model they start. (`figure_11`, with
a tenth of the levels, has every order tried and chosen by AICc.) Six methods are the paper's, the
Sani lookup is the seventh.

The folder holds a store for each precision, which a run that was stopped goes on from, the picture
and a table. Where both precisions are there, they are compared.
"""

import argparse
import resource
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from experiments.cores import use_all_cores
from experiments.drawing import new_figure
from experiments.murray.drawing import LOOKS, finish, line
from stepax import Study, StudyResults, UniformNoise, run_study


TOP, SPAN, SAMPLES, ORDERS = 0.35, 0.2, 253, range(2, 9)
MARKS = (0.01, 0.05, 0.1, 0.2, 0.34)
"""Noise levels of the table, each with those within 1 %."""


def study(levels: int, plants: int) -> Study:
    read = {"span": SPAN}
    fit = {"fixed": ("delay",)}
    return Study(
        {
            "hudzovic_tu_tg": read,
            "hudzovic_t10_t50_t90": read,
            "sani_tu_tg": read,
            "sani_interpolation": read,
            "sani_t10_t50_t90": read,
            "hudzovic_fit": fit | {"order": "hudzovic_t10_t50_t90"},
            "sani_fit": fit | {"order": "sani_t10_t50_t90"},
        },
        orders=ORDERS,
        plants=plants,
        noise=[UniformNoise(level) for level in np.linspace(0, TOP, levels)],
        samples=SAMPLES,
    )


def by_level(found: StudyResults) -> pd.DataFrame:
    """Medians, refusals and wins by method and noise level.

    A win is the smallest error of a record; where all are refused there is none.
    """
    table: Any = found.summary(by=("method", "noise"), quantiles=(0.25, 0.5, 0.75), bootstrap=0)
    ranked = np.where(np.isfinite(found.rmse), found.rmse, np.inf)
    best = np.where(np.isfinite(ranked.min(axis=1)), ranked.argmin(axis=1), -1)
    level = found.study.places(found.records)[2]
    methods = list(found.study.options)
    wins = [
        np.bincount(level[best == k], minlength=found.study.shape[2]) / np.bincount(level)
        for k in range(len(methods))
    ]
    levels = np.array([x.level for x in found.study.models])
    wins = pd.concat(
        pd.DataFrame({"method": name, "noise": levels, "best": share})
        for name, share in zip(methods, wins, strict=True)
    )
    return table.merge(wins, on=["method", "noise"])


def near(table: Any, level: float) -> Any:
    """Means by method over the levels within 1 % of one."""
    part = table[(table.noise - level).abs() <= 0.01 + 1e-12]
    return part.groupby("method")[["q25", "q50", "q75", "refused", "best"]].mean()


def picture(table: Any, said: str) -> Figure:
    figure = new_figure((12, 8))
    error, best, lost = figure.subplot_mosaic("ab;ac", width_ratios=[1.5, 1]).values()
    for method in LOOKS:
        part = table[table.method == method]
        noise, median = 100 * part.noise, part.q50.where(np.isfinite(part.q50))
        line(error, method, noise, median, linewidth=1.2)
        line(best, method, noise, 100 * part.best.rolling(21, 1, center=True).mean(), linewidth=1.2)
        line(lost, method, noise, 100 * part.refused, linewidth=1.2)
    error.set(
        yscale="log", ylim=(3e-4, 0.1), ylabel="RMSE, median over the plants, a refusal worst"
    )
    best.set(ylabel="has the smallest error, % of records")
    lost.set(ylabel="refused, % of records")
    for axes in (error, lost):
        axes.set_xlabel("noise, peak to peak, % of the step")
    figure.suptitle(said)
    finish(figure, (error, best, lost))
    return figure


def compared(double: Any, single: Any) -> list[str]:
    """Whether single precision changes a conclusion: medians, and who is better than whom."""
    both = double.merge(single, on=["method", "noise"], suffixes=("", "_32"))
    noisy = both[both.noise >= 0.01]
    change = (noisy.q50_32 / noisy.q50 - 1).abs()
    lost = (both.refused_32 - both.refused).abs()
    wide = {x: both.pivot(index="noise", columns="method", values=x) for x in ("q50", "q50_32")}
    first = {x: wide[x].idxmin(axis=1) for x in wide}
    other = first["q50"] != first["q50_32"]
    a, b = (np.argsort(np.argsort(wide[x].to_numpy(), axis=1), axis=1) for x in wide)
    return [
        f"medians from 1 % noise on: float32 differs by {change.median():.1e} in the median,"
        f" {change.max():.1e} at most; refusals by {100 * lost.max():.2f} % at most",
        f"the best method is another at {other.sum()} of {len(other)} levels, the ranking of all"
        f" seven at {np.any(a != b, axis=1).sum()}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/murray/figure_11_full"))
    parser.add_argument("--float32", action="store_true")
    parser.add_argument("--levels", type=int, default=1000)
    parser.add_argument("--plants", type=int, default=72, help="of each order")
    parser.add_argument("--quick", action="store_true", help="50 levels, 5 plants of each order")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    use_all_cores()
    levels, plants = (50, 5) if options.quick else (options.levels, options.plants)
    asked, console, tables = study(levels, plants), Console(width=120), {}
    options.out.mkdir(parents=True, exist_ok=True)
    precision = "float32" if options.float32 else "float64"
    for name in ("float64", "float32"):
        folder = options.out / name
        if name != precision and not folder.is_dir():
            continue
        jax.config.update("jax_enable_x64", name == "float64")
        start, busy = time.perf_counter(), time.process_time()
        found = run_study(asked, key=options.seed, store=folder, progress=True)
        wall, busy = time.perf_counter() - start, time.process_time() - busy
        tables[name] = by_level(found)
        if name == precision:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            console.print(
                f"{name}: {len(found):,} identifications in {wall:.0f} s, compilation included"
                f" ({busy:.0f} s of processor time on {jax.device_count()} devices), peak memory"
                f" {peak:.1f} GB"
            )
    table = tables[precision]
    table.to_csv(options.out / f"{precision}.csv", index=False, float_format="%.6g")
    said = (
        f"Figure 11 (Murray 2016) in full: {levels} noise levels, {7 * plants} plants, {precision}"
    )
    picture(table, said).savefig(options.out / f"figure_11_full_{precision}.png", dpi=150)
    shown = Table("method", *(f"{100 * level:.0f} % noise" for level in MARKS))
    for method in LOOKS:
        rows = [near(table, level).loc[method] for level in MARKS]
        shown.add_row(
            LOOKS[method].label,
            *(f"{r.q50:.4f} ({100 * r.refused:.0f} %, best {100 * r.best:.0f} %)" for r in rows),
        )
    console.print("Median RMSE (refused, how often best):", shown)
    if len(tables) == 2:
        console.print(*compared(tables["float64"], tables["float32"]), sep="\n")


if __name__ == "__main__":
    main()
