"""Which columns of a table are time, output and input; host code."""

import operator
from typing import Any, NamedTuple, SupportsIndex

from ._labels import without_unit
from ._table import TIME_NAME, Table


class Roles(NamedTuple):
    """Columns by their places; `implied`: nobody named the input, it is the column that is left."""

    time: int
    output: int
    input: int | None
    implied: bool = False


def roles_of(table: Table, time: Any, output: Any, input: Any, by_hand: bool = False) -> Roles:
    """Columns of time, output and, if there is one, input; `by_hand`: the step is told."""
    names, source = table.names, table.source
    if len(names) < 2:
        raise ValueError(f"{source} needs columns for time and output; it has: {_listed(names)}.")
    asked = [None if key is None else _position(table, key) for key in (time, output, input)]
    if asked == [None, None, None]:
        t, u, y = (_first_of(names, known) for known in (("t", "time"), ("u",), ("y",)))
        if t is not None and y is not None and (u is not None or len(names) == 2):
            return Roles(t, y, None if by_hand else u)
        if len(names) <= 3:
            return Roles(0, 1, None) if len(names) == 2 else Roles(0, 2, None if by_hand else 1)
    rest = [i for i in range(len(names)) if i not in asked]
    i_time, i_output, i_input = asked
    if i_time is None and rest:
        i_time = next((i for i in rest if TIME_NAME.search(names[i])), rest[0])
        rest.remove(i_time)
    implied = i_input is None and i_output is not None and len(rest) == 1 and not by_hand
    if i_output is None and len(rest) == 1:
        i_output = rest[0]
    if i_time is None or i_output is None:
        raise ValueError(f"Name the columns of {source} to use; it has: {_listed(names)}.")
    if implied:
        i_input = rest[0]
    if len({i_time, i_output, i_input}) < 3:
        raise ValueError(f"One column of {source} is named twice: {[time, output, input]}.")
    return Roles(i_time, i_output, i_input, implied)


def _first_of(names: list[str], known: tuple[str, ...]) -> int | None:
    """Where the first known name is that a table has, with or without a unit."""
    bare = [without_unit(name) for name in names]
    return next((bare.index(name) for name in known if name in bare), None)


def _position(table: Table, key: Any) -> int:
    """Where a column is, given its name, that without its unit, or its number from 1."""
    names = table.names
    if isinstance(key, str):
        wanted = key.strip().casefold()
        matches = [i for i, name in enumerate(names) if name == key]
        matches = matches or [i for i, name in enumerate(names) if name.casefold() == wanted]
        if not matches and wanted.isdecimal():
            matches = [i for i in range(len(names)) if i + 1 == int(wanted)]
        bare = [without_unit(name).casefold() for name in names]
        matches = matches or [i for i, name in enumerate(bare) if name == wanted]
    elif isinstance(key, bool) or not isinstance(key, SupportsIndex):
        raise TypeError(f"A column is given by a name or a number, got {key!r}.")
    else:
        matches = [i for i in range(len(names)) if i + 1 == operator.index(key)]
    if len(matches) != 1:
        found = "several columns" if matches else "no column with data"
        raise KeyError(f"{table.source} has {found} {key!r}; it has: {_listed(names)}.")
    return matches[0]


def _listed(names: list[str]) -> str:
    """Names for a message."""
    return ", ".join(map(repr, names)) or "none"
