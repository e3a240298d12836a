"""The order of the rooms: what may import what, and how large a file may grow."""

import subprocess
import sys

import pytest
from tests.house import ROOMS, circles, class_tests, graph, room, running_up, sources


def test_every_file_stands_in_a_room():
    assert {room(module) for module in graph()} <= set(ROOMS)


def test_a_room_imports_only_from_rooms_before_it():
    assert running_up(graph()) == []


def test_no_circles():
    assert circles(graph()) == []


def test_no_file_outgrows_a_reader():
    assert {m: text.count("\n") for m, text in sources_longer_than(400).items()} == {}


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
