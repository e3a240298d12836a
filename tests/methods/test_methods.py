"""What is known of every method, and its options."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.points import system_row

from stepax import METHODS, StepRecord, identify
from stepax.methods import MODELS, ROWS
from stepax.methods._method import option_names


pytestmark = pytest.mark.usefixtures("quick_compilation")
every = pytest.mark.parametrize("name", METHODS)


@pytest.fixture(scope="module")
def record():
    t, y, step_time, step_size, initial, final, _ = system_row("S4", samples=60)
    return StepRecord(t, y, step_time, step_size, initial, final)


def stand_in(path, leaf):
    """A number for one leaf of a model that was only traced; an order that is fixed stays."""
    if isinstance(leaf, int):
        return leaf
    return jnp.full(leaf.shape, 3 if path[-1].name == "n" else 0.25, leaf.dtype)


@every
def test_the_row_says_what_the_method_gives(name, record):
    row, result = ROWS[name], eqx.filter_eval_shape(METHODS[name], record)
    assert type(result.model) is row.gives is MODELS[name]
    poles = jax.tree_util.tree_map_with_path(stand_in, result.model).poles
    assert row.group == {1: "first", 2: "second"}.get(len(poles), "nth")
    assert row.order_found == (row.group == "nth")


@every
def test_marks_are_among_the_details(name, record):
    """And the other way round: no time of a level and no tangent without its mark."""
    row, details = ROWS[name], eqx.filter_eval_shape(METHODS[name], record).details
    numbers = dict.fromkeys(details, 0.5)
    assert len(row.marks(numbers)) == len(row.levels) + len(row.points)
    assert len(row.tangent(numbers)) == (2 if row.has_tangent else 0)
    assert len(row.levels) == sum(bool(re.match(r"t\d", key)) for key in details)
    assert len(row.points) == sum(key.startswith("y_") for key in details)
    assert row.has_tangent == ("Tg" in details)


def test_every_method_has_a_row():
    assert list(ROWS) == list(METHODS)
    assert all(METHODS[name].__name__ == name and METHODS[name].__doc__ for name in ROWS)


# ---- options


@every
def test_an_unknown_option_is_told_the_known_ones(name, record):
    """The same sentence by either way."""
    sentences = []
    for call in (lambda: identify(record, name, bad=1), lambda: METHODS[name](record, bad=1)):
        with pytest.raises(ValueError) as error:
            call()
        sentences.append(str(error.value))
    assert sentences[0] == sentences[1]
    known = ", ".join(option_names(METHODS[name]))
    assert sentences[0] == f"Method {name!r} has no option 'bad'; it has {known}."
    assert ("fixed" if name.endswith("_fit") else "delay") in known


ORDERS = {
    "tuple": (2, 3, 4, 5),
    "list": [2, 3, 4, 5],
    "range": range(2, 6),
    "set": {5, 4, 3, 2},
    "numpy": np.array([2, 3, 4, 5]),
    "numpy numbers": [np.int64(2), np.int64(3), np.int64(4), np.int64(5)],
    "jax": jnp.array([2, 3, 4, 5]),
}


@pytest.mark.parametrize("orders", ORDERS.values(), ids=ORDERS)
def test_orders_of_any_kind(record, orders):
    result = METHODS["sani_t10_t50_t90"](record, orders=orders)
    assert int(result.model.n) == 5
    assert int(METHODS["viteckova"](record, orders=orders).model.n) == 5


def test_orders_out_of_range(record):
    with pytest.raises(ValueError, match="whole numbers from 2 to 8"):
        METHODS["sani_t10_t50_t90"](record, orders=np.array([1, 3]))


def test_a_number_of_numpy_is_static(record):
    result = METHODS["viteckova"](record, order=np.array(5))
    assert result.model.n == 5 and isinstance(result.model.n, int)
