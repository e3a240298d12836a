"""The order of the rooms: what may import what, and how large a file may grow."""

import ast
import subprocess
import sys

import pytest
from tests.house import (
    ROOMS,
    _questions,
    circles,
    class_tests,
    functions,
    graph,
    imports,
    room,
    running_up,
    sources,
)


def test_every_file_stands_in_a_room():
    assert {room(module) for module in graph()} <= set(ROOMS)


def test_a_room_imports_only_from_rooms_before_it():
    assert running_up(graph()) == []


def test_no_circles():
    assert circles(graph()) == []


def test_no_file_outgrows_a_reader():
    assert {m: text.count("\n") for m, text in sources_longer_than(400).items()} == {}


def test_no_function_of_the_engine_outgrows_a_screen():
    long = [x for x in functions() if x[0] > 60 and x[1].startswith(("fitting.", "methods."))]
    assert long == []


def test_questions_and_imports_are_seen():
    """What these tests look for is found in each of its forms."""
    code = ["x is Sani", "type(m) == Sani", "isinstance(f(x),\n Sani)", "{Sani: 1}", "n == 'Sani'"]
    code += ["match m:\n case Sani():\n  pass"]
    assert all(list(_questions(ast.parse(line))) for line in code)
    assert not list(_questions(ast.parse("from .a import Sani\nSani(T=1)\ndef f(x: Sani): ...")))
    known = {"_b", "a._c", "__init__"}
    for line, target in [
        ("import stepax._b", "_b"),
        ("from stepax._b import x", "_b"),
        ("from .. import _b", "_b"),
        ("from ..a import _c", "a._c"),
        ("from .. import refine", "__init__"),
        ("def f():\n from ..a._c import x", "a._c"),
    ]:
        assert list(imports("a._d", line, known)) == [target], line


def sources_longer_than(lines):
    from tests.house import PACKAGE

    return {m: text for m, text in sources(PACKAGE).items() if text.count("\n") > lines}


def test_the_class_of_a_plant_is_asked_for_in_its_family_alone():
    assert class_tests() == []


@pytest.mark.parametrize("also", ["", "._cli"])
def test_the_import_leaves_out_what_few_need(also):
    """Files and pictures load their packages themselves; the command alone has typer and rich."""
    heavy = {"pandas", "scipy.io", "scipy.stats", "scipy.signal", "scipy.optimize", "openpyxl"}
    heavy |= {"matplotlib"} if also else {"matplotlib", "rich", "typer"}
    code = f"import sys, stepax{also}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert heavy & set(done.stdout.split()) == set()
