"""The order of the methods before and after, and how far the two agree (Kendall's tau)."""

import math
from collections.abc import Sequence

import pandas as pd
from rich.table import Table

from experiments.jakoubek.cells import errors, is_exact
from experiments.jakoubek.outcome import Outcome
from experiments.jakoubek.published import METHODS
from experiments.jakoubek.systems import SYSTEMS


SHORT = {
    "viteckova_1": "V1",
    "viteckova_2": "V2",
    "latzel": "Latzel",
    "harriott": "Harriott",
    "smith": "Smith",
    "strejc": "Strejc",
    "sundaresan_krishnaswamy": "SK",
}
STAGES = ("published", "recomputed", "correct", "exact")
"""Rankings: as printed, as Prechar computed, interpolated with printed and with exact constants."""
AGREEING = ("viteckova_1", "viteckova_2", "latzel", "sundaresan_krishnaswamy")
"""Methods whose order among themselves is right in all five tables."""


def ranking(name: str, stage: str) -> list[list[str]]:
    """Methods of one table by J, best first; those that are exact share the first place."""
    judged = sorted((J, x) for x, J in errors(name, stage).items() if not math.isnan(J))
    exact = [method for J, method in judged if is_exact(J, name)]
    return ([exact] if exact else []) + [[x] for J, x in judged if not is_exact(J, name)]


def agreement(name: str, stage: str = "correct", methods: Sequence[str] = tuple(METHODS)) -> float:
    """Kendall's tau of the published and another ranking, over the methods that have both.

    Methods that are exact are tied (tau-b).
    """
    first, second = errors(name, "published"), errors(name, stage)
    both = [x for x in methods if not math.isnan(first[x] + second[x])]
    others = pd.Series([0.0 if is_exact(second[x], name) else second[x] for x in both])
    return float(others.corr(pd.Series([first[x] for x in both]), method="kendall"))


def as_text(places: list[list[str]]) -> str:
    """V1 SK {Smith Latzel}: braces where several are exact."""
    groups = [" ".join(SHORT[x] for x in sorted(group)) for group in places]
    return " ".join(
        f"{{{text}}}" if len(group) > 1 else text
        for text, group in zip(groups, places, strict=True)
    )


def run() -> Outcome:
    """Rankings of the five tables, and Kendall's tau of the published with the correct one."""
    records, table = [], Table("", "ranking", "best first", "tau", title="Rankings by J")
    for name in SYSTEMS:
        for stage in STAGES:
            places = ranking(name, stage)
            tau = 1.0 if stage == "published" else agreement(name, stage)
            label = name if stage == "published" else ""
            table.add_row(label, stage, as_text(places), f"{tau:.2f}")
            for place, group in enumerate(places, 1):
                records += [
                    {"system": name, "ranking": stage, "place": place, "method": method,
                     "kendall_tau_with_published": tau}
                    for method in sorted(group)
                ]  # fmt: skip
        table.add_section()
    numbers = {
        "Kendall's tau, published and correct": ", ".join(
            f"{name} {agreement(name):.2f}" for name in SYSTEMS
        ),
        "the same for V1, V2, Latzel, SK alone": ", ".join(
            f"{name} {agreement(name, methods=AGREEING):.2f}" for name in SYSTEMS
        ),
    }
    return Outcome(pd.DataFrame(records), table=table, numbers=numbers)
