"""Tables 4 to 8: each cell as published, as Prechar read it, and correct, with its J."""

import pandas as pd
from rich.table import Table

from experiments.jakoubek.cells import J_text, Row, exact, rows
from experiments.jakoubek.outcome import Outcome
from experiments.jakoubek.published import METHODS
from experiments.jakoubek.systems import SYSTEMS


def run(name: str) -> Outcome:
    """The table of one system."""
    system = SYSTEMS[name]
    table = Table(
        "method", "published", "J", "as Prechar read it", "J", "correct", "J", "verdict",
        title=f"Table {system.table}: {system.title}",
    )  # fmt: skip
    for row in rows(name):
        J = {stage: J_text(x, name) for stage, x in row.J.items()}
        table.add_row(
            METHODS[row.cell.method], row.printed.text, J["published"], row.recomputed.text,
            J["recomputed"], row.correct.text, J["correct"], _verdict(row),
        )  # fmt: skip
    frame = pd.DataFrame([_record(name, row) for row in rows(name)])
    return Outcome(frame, table=table)


def _verdict(row: Row) -> str:
    return row.cell.verdict + (f": {row.cell.why}" if row.cell.why else "")


def _record(name: str, row: Row) -> dict:
    """One line of the CSV; several lags are separated by bars."""
    cell, J = row.cell, row.J
    record = {
        "system": name, "method": cell.method,
        "lags_published": "|".join(cell.printed_lags), "delay_published": cell.delay,
        "J_published": cell.J, "J_of_published_parameters": J["printed"],
    }  # fmt: skip
    readings = {"recomputed": row.recomputed, "correct": row.correct}
    for stage, reading in (readings | {"exact": exact(name, cell.method)}).items():
        record |= {
            f"lags_{stage}": "|".join(f"{x:.6g}" for x in reading.lags),
            f"delay_{stage}": f"{reading.delay:.6g}" if reading.lags else "",
            f"J_{stage}": reading.J,
            f"status_{stage}": reading.status,
        }
    return record | {
        "within_rounding": row.within_rounding,
        "verdict": cell.verdict,
        "why": cell.why,
    }
