"""The command `stepax lookup`: a model from times read by hand."""

from typing import Annotated, Any

import typer

from ._options import Number, waiting


def lookup(
    tu: Annotated[Number, typer.Option("--Tu", help="Apparent dead time of the tangent.")] = None,
    tg: Annotated[Number, typer.Option("--Tg", help="Rise time of the tangent.")] = None,
    t10: Annotated[Number, typer.Option("--t10", help="Time to 10 % of the change.")] = None,
    t50: Annotated[Number, typer.Option("--t50", help="Time to 50 %.")] = None,
    t90: Annotated[Number, typer.Option("--t90", help="Time to 90 %.")] = None,
) -> Any:
    """Look a model up from times read by hand: --Tu and --Tg, or --t10, --t50 and --t90."""
    import jax

    from ._status import Status, refused
    from .curves._lookup import lookup as looked_up
    from .models._plants import Hudzovic, Sani
    from .report._content import lookup_content
    from .report._terminal import table

    times = {"Tu": tu, "Tg": tg, "t10": t10, "t50": t50, "t90": t90}
    times = {name: time for name, time in times.items() if time is not None}
    if set(times) not in ({"Tu", "Tg"}, {"t10", "t50", "t90"}):
        raise ValueError("lookup takes either --Tu and --Tg, or --t10, --t50 and --t90.")

    @jax.jit
    def look_up_all(times):
        rows = [looked_up(family, **times) for family in (Hudzovic, Sani)]
        return [*rows, looked_up(Sani, formula=True, **times)] if "t50" in times else rows

    with waiting("Looking up ..."):
        rows = list(zip(["exact", "exact", "formulae"], look_up_all(times), strict=False))
    if all(bool(refused(found.status)) for _, found in rows):
        reasons = dict.fromkeys(Status[found.status] for _, found in rows)
        given = ", ".join(f"{name} = {time:g}" for name, time in times.items())
        raise ValueError(f"No model has {given}. {' '.join(reasons)}")
    return table(lookup_content(rows))
