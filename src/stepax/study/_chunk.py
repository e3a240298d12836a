"""One chunk of a study: a pure function of the study, the key and the numbers of its records."""

import functools
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arrays import Samples, nan_where
from .._batches import in_groups, over_devices
from .._compilation import side_by_side
from .._status import Status, first_problem, refused
from ..fitting._refine import refine
from ..methods import FITS, METHODS
from ..models._plants import PTn
from ..models._respond import respond_evenly
from ..records._preprocess import smooth
from ..records._record import StepRecord
from ._plants import plant_lags, settling_time
from ._study import Study


class Task(NamedTuple):
    """What a process needs to compute a chunk: it can be sent to another one.

    `key`: of JAX, as its data and its implementation. `first` and `last`: numbers of the records,
    the last one excluded. `size`: how many are computed together.
    """

    study: Study
    key: tuple[np.ndarray, str]
    first: int
    last: int
    size: int
    double: bool


class Columns(NamedTuple):
    """What a chunk gives, an array (records, methods) each: errors, and numbers of a `Status`."""

    rmse: np.ndarray
    status: np.ndarray


def compute(task: Task) -> Columns:
    """The results of a chunk."""
    with jax.enable_x64(task.double):
        program = _program(task.study, task.key[1])
        # the last chunk is filled up with its last record: one compilation serves all
        records = np.minimum(np.arange(task.first, task.first + task.size), task.last - 1)
        data = np.broadcast_to(task.key[0], (task.size, *task.key[0].shape))
        count = task.last - task.first
        found = program(data, *task.study.places(records))
        rmse, status = (np.stack([np.asarray(x) for x in rows], axis=1) for rows in found)
    return Columns(rmse[:count], status[:count].astype(np.int8))


_kept: dict[Any, Any] = {}
_one_at_a_time = threading.Lock()


def _program(study: Study, implementation: str):
    """The compiled functions of a study; the last one is kept."""
    double = jax.config.read("jax_enable_x64")
    # how many plants and draws there are is not part of the program
    said = repr(study.describe() | {"plants": 0, "draws": 0})
    name = said, study.distribution, implementation, double
    with _one_at_a_time:
        if name not in _kept:
            _kept.clear()
            _kept[name] = _compiled(study, implementation)
        return _kept[name]


def _compiled(study: Study, implementation: str):
    """Records of a batch, then one method after the other: compiled apart, they compile faster."""
    make = over_devices(jax.vmap(functools.partial(_record, study, implementation)))
    smoothers = {span: over_devices(_smoother(study, span)) for span in _spans(study)}
    run = {name: over_devices(_method(study, name)) for name in study.options}
    # those that start from another method's models come after all others
    waves = [[], []]
    for name, options in study.options.items():
        waves[options.get("order") in run].append(name)

    def program(data, *places):
        t, clean, raw = make(data, *places)
        outputs = {None: raw} | {span: smoother(raw) for span, smoother in smoothers.items()}
        found: dict[str, Any] = {}
        for names in waves:
            tasks = []
            for name in names:
                options = study.options[name]
                start = [found[options["order"]][0]] if options.get("order") in found else []
                output = outputs[options.get("span")]
                tasks.append(functools.partial(run[name], t, clean, output, *start))
            found |= dict(zip(names, side_by_side(tasks), strict=True))  # so they compile
        rows = [found[name] for name in study.options]
        return [row[1] for row in rows], [row[2] for row in rows]

    return program


def _record(study: Study, implementation: str, data: Array, order, plant, level, draw):
    """Times, output without noise, and with it, of one record.

    The plant depends on (key, order, its number), its noise on that, the level and the draw.
    """
    key = jax.random.wrap_key_data(data, impl=implementation)
    orders = tuple(study.orders)
    rows = []
    for n in orders:
        lags = plant_lags(jax.random.fold_in(key, n), plant, n, study.distribution)
        rows.append(jnp.pad(lags, (0, max(orders) - n)))
    lags = jnp.stack(rows)[order]
    model = PTn(lags=lags)
    t = settling_time(lags) * jnp.asarray(np.linspace(0, 1, study.samples), lags.dtype)
    clean = model.step_response(t)
    key = jax.random.fold_in(jax.random.fold_in(key, jnp.asarray(orders)[order]), plant)
    for place in (NOISE, level, draw):
        key = jax.random.fold_in(key, place)

    def respond(t: Samples, u: Samples) -> Samples:
        """That of the plant to an input held between samples, which are evenly spaced from 0."""
        return respond_evenly(model, t[1], u, "zero")

    return t, clean, study.table.disturb(level, key, t, clean, respond)


NOISE = 1
"""Number that parts the keys of a plant's noise from the key of its lags."""


def _spans(study: Study) -> set[float]:
    found = {options.get("span") for options in study.options.values()}
    return {span for span in found if span is not None}


def _smoother(study: Study, span: float):
    """LOESS of all records at once.

    It is linear in the output, and its weights do not change when times are stretched: records of
    one spacing have one matrix. A point of 250 costs 8 ns so, and a microsecond by itself.
    """
    grid = jnp.linspace(0, 1, study.samples)
    matrix = np.asarray(jax.vmap(lambda y: smooth(grid, y, span))(jnp.eye(study.samples)))

    def smoothed(y: Array) -> Array:
        return y @ jnp.asarray(matrix, y.dtype)  # row k is what a unit at sample k becomes

    return smoothed


def _method(study: Study, name: str):
    """A method on a batch: its models, their errors, and the statuses."""
    options = {k: v for k, v in study.options[name].items() if k != "span"}
    start = options.get("order")
    from_other = isinstance(start, str) and start != "auto"
    levels: dict[str, Any] = {"initial": 0.0, "final": 1.0} if study.known_levels else {}
    own = {k: v for k, v in options.items() if k != "order"}

    def one(t: Samples, clean: Samples, y: Samples, begin: Any = None):
        record = StepRecord(t, y, **levels)
        if from_other:
            result = _refined(record, begin, own)
        else:
            more = {"errors": False} if name in FITS else {}
            result = METHODS[name](record, **more | options)
        error = jnp.sqrt(jnp.mean((result.model.step_response(t) - clean) ** 2))
        return (result.model, result.status), error, result.status._value

    # the searches of a lookup end with the slowest of those that go on together
    return jax.vmap(one if name in FITS else in_groups(one))


def _refined(record: StepRecord, start: tuple[Any, Status], options: dict[str, Any]):
    """The fit from another method's model, of the same order; refused where that is."""
    model, status = start
    lost = refused(status)
    safe = jax.tree.map(
        lambda x, stand_in: jnp.where(lost, stand_in, x), model, _stand_in(model, record)
    )
    fit: Callable[..., Any] = refine
    found = fit(record, safe, **{"errors": False} | options)
    status = first_problem(Status.where(lost, status, Status.successful), found.status)
    return _Refused(nan_where(lost, found.model), status)


class _Refused(NamedTuple):
    """What a study reads of a result."""

    model: Any
    status: Status


def _stand_in(model: Any, record: StepRecord) -> Any:
    """Some model, whose fit ends soon, for a record without one."""
    duration = record.duration
    return type(model)(T=duration / 5, r=0.3 + 0 * duration, n=2 + 0 * model.n)
