"""How everything is drawn: one colour, dash and marker for each method in all figures."""

from typing import Any, NamedTuple


class Look(NamedTuple):
    color: str
    dashes: Any
    marker: str


LOOKS = {
    "viteckova_1": Look("#1f5fa8", (0, (6, 2)), "o"),
    "viteckova_2": Look("#0b2a4a", (0, (1.2, 1.2)), "s"),
    "latzel": Look("#3f7a10", (0, (10, 2)), "^"),
    "harriott": Look("#d2560a", (0, (7, 2, 1.2, 2)), "D"),
    "smith": Look("#7a2f8a", (0, (3, 1.5)), "v"),
    "strejc": Look("#c0203a", (0, (9, 2, 2, 2, 2, 2)), "P"),
    "sundaresan_krishnaswamy": Look("#b08900", (0, (4, 1, 1, 1)), "X"),
}
"""Dashes and markers tell the lines apart in grey."""
LEGEND = {"framealpha": 1, "edgecolor": "none", "fancybox": False}
"""A legend on white, so that no guide line runs through it."""
SYSTEM, HELP, MARK = "0.62", "0.4", "#d2560a"
"""Colours of the system's response, of guide lines and of what a method reads."""
