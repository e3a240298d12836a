"""Where a report comes from: file, columns, rows, version and command."""

import platform
from collections.abc import Sequence
from datetime import datetime
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from .._notes import with_unit
from ..models._notation import number
from ..records._abstract import AbstractRecord
from ..records._labels import Units
from ..records._record import rows_that_count
from ._page import Facts, Part


class Origin(NamedTuple):
    """The command that made a page, what is to be said of the record, the step asked for.

    `step`: its number, None for the first. All may be empty: then Python made it.
    """

    command: str = ""
    remark: str = ""
    step: int | None = None


def provenance(records: Sequence[AbstractRecord], origin: Origin) -> Part:
    """The last part of a page; columns and rows of one record, of several the files tell."""
    facts = _record_facts(records[0]) if len(records) == 1 else []
    facts += [("command", origin.command)] if origin.command else []
    made = datetime.now().astimezone().isoformat(" ", "minutes")
    facts.append(("made", f"{made}, stepax {version('stepax')}, JAX {version('jax')}"))
    facts.append(("on", f"Python {platform.python_version()}, {platform.system()}"))
    return Part("Where this comes from", [Facts(facts)])


def _record_facts(record: AbstractRecord) -> list[tuple[str, str]]:
    labels, units = record.labels, Units.of(record.labels)
    kept = rows_that_count(record)
    t = np.asarray(kept.t)
    read = int(record.details.get("rows_thinned", record.details.get("rows_used", t.size)))
    rows = f"{read}, from {with_unit(t[0], units.time)} to {with_unit(t[-1], units.time)}"
    if read != t.size:
        rows += f", as {t.size} means"
    levels = {"initial": record.initial, "final": record.final}
    given = [f"{name} {with_unit(x, units.output)}" for name, x in levels.items() if x is not None]
    facts = [
        ("file", labels.source or "arrays"),
        ("columns", f"time: {labels.time}; output: {labels.output}; input: {labels.input}"),
        ("rows used", rows),
        _input_fact(record, units),
    ]
    return facts + ([("known levels", ", ".join(given))] if given else [])


def _input_fact(record: AbstractRecord, units: Units) -> tuple[str, str]:
    """The step, or the range of a sampled input."""
    known = record.input_facts()
    if step := known["step"]:
        size, time = with_unit(step["size"], units.input), with_unit(step["time"], units.time)
        return "step", f"{size} at {time}"
    about = known["input"]
    return "input", f"{number(about['least'])} to {with_unit(about['most'], units.input)}"
