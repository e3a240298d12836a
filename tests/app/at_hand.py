"""A comparison that needs no time: first-order models, whatever the method."""

import jax.numpy as jnp
import numpy as np

from stepax import FOPDT, Status
from stepax._compare import Comparison, Row
from stepax._result import conclude
from stepax._status import status_name
from stepax.methods import MODELS, ROWS
from stepax.methods._reading import time_name


def compare(calls, record, methods, marks=None, progress=None):
    """As `stepax.compare`; what was asked is added to `calls`."""
    calls.append((record, tuple(methods), dict(marks or {})))
    if progress is not None:
        progress(1, 1)
    rows = [_row(record, name, 40.0 + k, marks or {}) for k, name in enumerate(methods)]
    rows.sort(key=lambda row: (np.isnan(row.J), row.J))
    return Comparison(record, tuple(rows))


def _row(record, name, T, marks):
    about, start = ROWS[name], float(record.y[0])
    change = 0.8 * float(record.step_size) if record.final is None else float(record.final) - start
    model = FOPDT(T=T, gain=change / float(record.step_size), offset=start, delay=6.0)
    status = Status.levels_not_crossed if name == "latzel" else Status.successful
    details = {time_name(q): jnp.asarray(6 - T * np.log(1 - q)) for q in about.levels}
    details |= {"Tu": jnp.asarray(6.0), "Tg": jnp.asarray(T)} if about.has_tangent else {}
    details |= {key: jnp.asarray(x) for key, x in marks.items() if key in details}
    result = conclude(record, model, status, details=details)
    numbers = [float(x) for x in (result.J, result.rmse, result.fit_percent)]
    what = MODELS[name].__name__
    return Row(name, result, what, *numbers, 4, 1.5, status_name(status), "no", about)
