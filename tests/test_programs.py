"""What was traced is kept between processes: read back, not read where anything differs."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from stepax import FOPDT, METHODS, StepRecord, _programs
from stepax._compilation import compiled, quick_compilation
from stepax._programs import Shelf, Signature, program


TRACED = []


def scaled(model, factor, *, power=1, other=None):
    """A function of a plant; it remembers that it was traced."""
    TRACED.append(power)
    return dataclasses.replace(model, T=factor * model.T**power), {"power": power, "x": factor + 1}


@pytest.fixture
def folder(tmp_path):
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    TRACED.clear()
    yield tmp_path / "stepax"
    jax.config.update("jax_compilation_cache_dir", before)


def run(*args, **options):
    """As in a new process: nothing is remembered but the folder."""
    with quick_compilation():
        return compiled(scaled)(*args, **options)


def test_a_program_is_traced_once_and_read_for_other_numbers(folder):
    model, rest = run(FOPDT(T=3.0), jnp.asarray(2.0))
    assert TRACED == [1] and len(list(folder.iterdir())) == 1
    again, same_rest = run(FOPDT(T=5.0), jnp.asarray(4.0))
    assert TRACED == [1]
    assert isinstance(again, FOPDT) and (model.T, again.T) == (6.0, 20.0)
    assert rest["power"] == same_rest["power"] == 1 and same_rest["x"] == 5.0


def test_whatever_differs_in_form_is_another_program(folder):
    for factor, options in [
        (jnp.asarray(2.0), {}),
        (jnp.asarray(2.0), {"power": 2}),
        (jnp.asarray(2.0), {"power": 2.0}),
        (jnp.asarray(2.0, jnp.float32), {}),
        (jnp.ones(3), {}),
        (2.0, {}),
    ]:
        run(FOPDT(T=3.0), factor, **options)
    assert len(TRACED) == len(list(folder.iterdir())) == 6
    with jax.default_matmul_precision("float32"):
        run(FOPDT(T=3.0), jnp.asarray(2.0))
    assert len(TRACED) == 7


def test_a_damaged_file_is_written_again(folder):
    run(FOPDT(T=3.0), jnp.asarray(2.0))
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    for text in (b"", whole[: len(whole) // 2], b"no pickle"):
        path.write_bytes(text)
        assert run(FOPDT(T=3.0), jnp.asarray(2.0))[0].T == 6.0
        assert len(path.read_bytes()) == len(whole)
    assert len(TRACED) == 4


class Foreign:
    """Of a module that nobody knows the version of."""


def test_what_cannot_be_kept_is_computed_all_the_same(folder):
    other = Foreign()
    assert run(FOPDT(T=3.0), jnp.asarray(2.0), other=other)[0].T == 6.0
    assert not folder.exists() and len(TRACED) == 1


def test_a_folder_that_cannot_be_written_is_no_error(folder):
    folder.parent.joinpath("stepax").write_text("a file")
    assert run(FOPDT(T=3.0), jnp.asarray(2.0))[0].T == 6.0


def test_errors_of_options_are_the_same(folder):
    record = StepRecord(np.linspace(0, 10, 40), 1 - np.exp(-np.linspace(0, 10, 40)))
    with quick_compilation(), pytest.raises(ValueError, match="constants must be"):
        METHODS["viteckova_1"](record, constants="wrong")


def test_equal_objects_have_one_name():
    """Of two equal tuples and of one tuple twice, as they come from a file and from tracing."""
    one, other = tuple("ab"), tuple("ab")
    assert one is not other and _programs._pickled((one, one)) == _programs._pickled((one, other))


def test_a_shelf_forgets_what_was_not_used_for_the_longest_time():
    TRACED.clear()
    shelf, model = Shelf(2), FOPDT(T=3.0)

    def call(power: int):
        arguments = (model, jnp.asarray(2.0)), {"power": power}
        made = shelf.program(power, lambda: program(scaled, Signature(arguments), {}))
        return made(*arguments[0], **arguments[1])[0].T

    assert [float(call(power)) for power in (1, 2, 1, 3)] == [6.0, 18.0, 6.0, 54.0]
    assert TRACED == [1, 2, 3]
    call(1)
    assert TRACED == [1, 2, 3]
    call(2)
    assert TRACED == [1, 2, 3, 2]


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="Linux alone tells its maps")
def test_a_forgotten_program_frees_its_memory_maps():
    def maps() -> int:
        with open("/proc/self/maps") as file:
            return sum(1 for _ in file)

    before = maps()
    t = np.linspace(0, 10, 40)
    record = StepRecord(t, 1 - np.exp(-t))
    made = program(METHODS["strejc"].__wrapped__, Signature(((record,), {})), {})
    result = made(record)
    taken = maps() - before
    assert not bool(jnp.isnan(result.rmse)) and taken > 10
    made.forget()
    assert maps() - before < 0.2 * taken
