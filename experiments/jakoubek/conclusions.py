"""What the paper concludes (its section 5), and whether it stands with correct values."""

from collections.abc import Iterable
from typing import NamedTuple

import pandas as pd
from rich.table import Table

from experiments.jakoubek.cells import J_text, all_rows, smith_with_dead_time
from experiments.jakoubek.outcome import Outcome
from experiments.jakoubek.ranking import SHORT, agreement, as_text, ranking
from experiments.jakoubek.systems import SYSTEMS


V1, V2, LATZEL, HARRIOTT, SMITH, STREJC, SK = (
    "viteckova_1", "viteckova_2", "latzel", "harriott", "smith", "strejc", "sundaresan_krishnaswamy"
)  # fmt: skip
FIVE = tuple(SYSTEMS)
HIGH = ("S4", "S5")
FAIR = {"S1": 1e-3, "S2": 1e-3, "S3": 1e-3, "S4": 0.1, "S5": 0.1}
"""J up to which a method counts as applicable; the paper's word for up to 8.6e-4 and 5.1e-2."""


class Claim(NamedTuple):
    """A conclusion of the paper, the parts that it consists of, and the numbers behind."""

    text: str
    parts: tuple[bool, ...]
    numbers: str

    @property
    def verdict(self) -> str:
        if all(self.parts):
            return "stands"
        return "in part" if any(self.parts) else "false"


def claims() -> list[Claim]:
    """In the order of the paper. J with printed constants; "best" with exact ones, ties allowed."""
    return [
        Claim(
            "S1, one lag: Vítečková's 1st order is the best",
            (_is_best("S1", V1),), _first("S1") + _printed("S1", V1, SMITH),
        ),
        Claim(
            "S1: Strejc, Sundaresan & Krishnaswamy are less accurate, still applicable",
            _applicable("S1", STREJC, SK), _J("S1", V1, STREJC, SK),
        ),
        Claim(
            "S1: the other methods are not recommended",
            _not(_applicable("S1", LATZEL, V2, HARRIOTT, SMITH)),
            _J("S1", LATZEL, V2, HARRIOTT, SMITH),
        ),
        Claim(
            "S2, two equal lags: Latzel and Vítečková's 2nd order are the best",
            (_is_best("S2", LATZEL), _is_best("S2", V2)),
            _first("S2") + _printed("S2", LATZEL, V2, SMITH),
        ),
        Claim(
            "S3, one lag dominates: Harriott and Smith are the best",
            (_is_best("S3", HARRIOTT), _is_best("S3", SMITH)),
            _first("S3") + _printed("S3", HARRIOTT, SMITH, STREJC),
        ),
        Claim(
            "S3: Vítečková's 1st order, Sundaresan & Krishnaswamy are well applicable",
            _applicable("S3", V1, SK), _J("S3", V1, SK),
        ),
        Claim(
            "S3: Strejc gives bad results, is not recommended",
            _not(_applicable("S3", STREJC)), _before("S3", STREJC),
        ),
        Claim(
            "S4, S5, high order: Latzel is the best",
            tuple(_is_best(x, LATZEL) for x in HIGH),
            "; ".join(_first(x) + _printed(x, LATZEL, STREJC) for x in HIGH),
        ),
        Claim(
            "S4, S5: Strejc gives bad results",
            _not(part for x in HIGH for part in _applicable(x, STREJC)),
            "; ".join(_before(x, STREJC) for x in HIGH),
        ),
        Claim(
            "S4, S5: the others approximate the system well",
            tuple(part for x in HIGH for part in _applicable(x, V1, V2, HARRIOTT, SK)),
            "; ".join(_J(x, V2, HARRIOTT, V1, SK) for x in HIGH),
        ),
        Claim(
            "S4, S5: Smith does not suit",
            tuple(all_rows()[x, SMITH].correct.model is None for x in HIGH),
            "without a dead time; with that of eq. 11 taken off "
            + "; ".join(f"{x} {J_text(smith_with_dead_time(x).J, x)}" for x in HIGH),
        ),
        Claim(
            "All tables: Vítečková's 1st order is before Sundaresan & Krishnaswamy",
            tuple(_value(x, V1) < _value(x, SK) for x in FIVE),
            "; ".join(_J(x, V1, SK) for x in FIVE),
        ),
        Claim(
            "All tables: the order of the methods",
            tuple(agreement(x) == 1 for x in FIVE),
            "Kendall's tau " + ", ".join(f"{x} {agreement(x):.2f}" for x in FIVE),
        ),
        Claim(
            "All tables: the order of Vítečková's two, Latzel, Sundaresan & Krishnaswamy",
            tuple(agreement(x, methods=(V1, V2, LATZEL, SK)) == 1 for x in FIVE),
            "Kendall's tau "
            + ", ".join(f"{x} {agreement(x, methods=(V1, V2, LATZEL, SK)):.2f}" for x in FIVE),
        ),
    ]  # fmt: skip


def _value(name: str, method: str) -> float:
    return all_rows()[name, method].correct.J


def _applicable(name: str, *methods: str) -> tuple[bool, ...]:
    return tuple(_value(name, method) < FAIR[name] for method in methods)


def _not(parts: Iterable[bool]) -> tuple[bool, ...]:
    return tuple(not part for part in parts)


def _is_best(name: str, method: str) -> bool:
    """Whether a method has the first place with exact constants, alone or with others."""
    return method in ranking(name, "exact")[0]


def _first(name: str) -> str:
    return f"{name} first place {as_text(ranking(name, 'exact')[:1])}"


def _printed(name: str, *methods: str) -> str:
    return f" (printed constants: {_list(name, methods)})"


def _J(name: str, *methods: str) -> str:
    return f"{name} {_list(name, methods)}"


def _before(name: str, method: str) -> str:
    published = all_rows()[name, method].J["published"]
    return f"{_J(name, method)}, published {published:.2e}"


def _list(name: str, methods: Iterable[str]) -> str:
    return ", ".join(f"{SHORT[x]} {J_text(_value(name, x), name)}" for x in methods)


def run() -> Outcome:
    """The paper's conclusions with a verdict and numbers."""
    found = claims()
    frame = pd.DataFrame(
        [(x.text, x.verdict, x.numbers) for x in found], columns=["conclusion", "verdict", "J"]
    )
    table = Table("conclusion of the paper", "verdict", "J, gain 2", title="What stands")
    for row in found:
        table.add_row(row.text, row.verdict, row.numbers)
    counts = frame["verdict"].value_counts()
    summary = ", ".join(f"{counts.get(x, 0)} {x}" for x in ("stands", "in part", "false"))
    return Outcome(frame, table=table, numbers={"conclusions": summary})
