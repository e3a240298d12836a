"""The order of the rooms: what may import what, and how large a file may grow."""

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
