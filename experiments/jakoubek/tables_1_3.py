"""Tables 1 to 3: the constants of Latzel's and Strejc's methods, printed and from theory."""

from collections.abc import Iterable

import jax.numpy as jnp
import numpy as np
import pandas as pd
from rich.table import Table

from experiments.jakoubek import prechar
from experiments.jakoubek.charts import heights, strejc_ratios
from experiments.jakoubek.outcome import Outcome
from experiments.jakoubek.published import LATZEL
from stepax.methods._charts import STREJC
from stepax.methods._tables import latzel_table, strejc_table


WRONG, ROUNDING = 1e-3, 0.5e-3
"""Difference from which a printed third decimal is wrong, and from which it is rounded wrongly."""


def table_1() -> Outcome:
    """Latzel's constants; misprints marked."""
    exact = latzel_table(exact=True)
    columns = ("mu", "alpha10", "alpha50", "alpha90")
    printed = np.array([[float(x) for x in row[1:]] for row in LATZEL])
    theory = np.column_stack([exact.mu, exact.weights])
    table = Table("n", *columns, title="Table 1, Latzel: printed (from theory where it differs)")
    for n, *cells in zip(exact.n, *_marked(printed, theory), strict=True):
        table.add_row(f"{n:g}", *cells)
    frame = pd.DataFrame({"n": exact.n})
    for place, name in enumerate(columns):
        frame[f"{name}_printed"], frame[f"{name}_theory"] = printed[:, place], theory[:, place]
    frame["misprinted"] = _names(printed, theory, columns)
    return Outcome(frame, table=table, numbers=_count("table 1", printed, theory))


def table_2() -> Outcome:
    """Strejc's table 2, missing in the paper: the ratio of two lags over y(t2)."""
    y = np.round(np.arange(0.160, 0.3005, 0.005), 3)
    ratios = np.asarray(strejc_ratios(jnp.asarray(y)))
    ends = np.asarray(heights(jnp.asarray([1.0, 1e-9]), STREJC.height_at))
    table = Table("y(t2)", "tau2/tau1", title="Table 2, Strejc: missing in the paper, from theory")
    for value, ratio in zip(y, ratios, strict=True):
        table.add_row(f"{value:.3f}", f"{ratio:.4f}" + (" (end)" if value < ends[0] else ""))
    frame = pd.DataFrame({"y_t2": y, "tau2_over_tau1": ratios})
    return Outcome(
        frame, table=table,
        numbers={"table 2": f"y(t2) from {ends[0]:.6f} (equal lags) to {ends[1]:.6f} (one lag)"},
    )  # fmt: skip


def table_3() -> Outcome:
    """Strejc's orders; misprints marked."""
    exact = strejc_table(exact=True)
    columns = ("tau", "y_i")
    printed = np.column_stack([prechar.STREJC_RATIOS, prechar.STREJC_INFLECTIONS])
    theory = np.column_stack([exact.ratio, exact.height])
    table = Table("n", *columns, title="Table 3, Strejc: printed (from theory where it differs)")
    for n, *cells in zip(exact.n, *_marked(printed, theory), strict=True):
        table.add_row(f"{n:g}", *cells)
    frame = pd.DataFrame({"n": exact.n.astype(int)})
    for place, name in enumerate(columns):
        frame[f"{name}_printed"], frame[f"{name}_theory"] = printed[:, place], theory[:, place]
    frame["misprinted"] = _names(printed, theory, columns)
    return Outcome(frame, table=table, numbers=_count("table 3", printed, theory))


def _marked(printed, theory) -> Iterable[list[str]]:
    """Columns of text, a wrong entry in red with its value from theory."""
    for shown, true in zip(printed.T, theory.T, strict=True):
        yield [
            f"[red]{a:.3f} ({b:.4f})[/red]" if abs(a - b) > ROUNDING else f"{a:.3f}"
            for a, b in zip(shown, true, strict=True)
        ]


def _names(printed, theory, columns) -> list[str]:
    """Names of the wrong entries of each row."""
    wrong = np.abs(printed - theory) > ROUNDING
    return ["; ".join(np.array(columns)[row]) for row in wrong]


def _count(name: str, printed, theory) -> dict[str, str]:
    distance = np.abs(printed - theory)
    wrong, rounded = np.sum(distance > WRONG), np.sum((distance > ROUNDING) & (distance <= WRONG))
    return {
        name: f"{wrong} of {printed.size} entries wrong, {rounded} rounded wrongly in the third"
        " decimal"
    }
