"""What a table or figure leaves behind: its CSV, its picture, its printed table, its numbers."""

from pathlib import Path
from typing import NamedTuple

import pandas as pd
from matplotlib.figure import Figure
from rich.table import Table


class Outcome(NamedTuple):
    """One table or figure of the paper."""

    frame: pd.DataFrame
    figure: Figure | None = None
    table: Table | None = None
    numbers: dict[str, str] = {}  # noqa: RUF012 (never written to)

    def write(self, out: Path, name: str) -> list[Path]:
        """Write NAME.csv and, if there is a figure, NAME.png."""
        out.mkdir(parents=True, exist_ok=True)
        files = [out / f"{name}.csv"]
        self.frame.to_csv(files[0], index=False, float_format="%.8g")
        if self.figure is not None:
            files.append(out / f"{name}.png")
            self.figure.savefig(files[1], dpi=150)
        return files
