import os
import random
import time
from pathlib import Path

import jax
import pytest


# float32 is tested beside it: the library follows the dtype of the data.
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
if not os.environ.get("STEPAX_TEST_OPTIMISED"):
    # Compiling is most of the time of the tests; `.ci/run` runs the long ones fully optimised.
    jax.config.update("jax_disable_most_optimizations", True)
    if jax.__version_info__[:2] == (0, 10):  # as in `stepax._compilation`: half of the time
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_use_fusion_emitters=false"


@pytest.fixture(scope="module")
def quick_compilation():
    """The poles in a loop, as on the command line: compiling is most of the time of these tests."""
    from stepax._compilation import quick_compilation  # checked only if imported after pytest's

    if os.environ.get("STEPAX_TEST_OPTIMISED"):
        yield
    else:
        with quick_compilation():
            yield


MOST_MAPS = 45_000
"""Memory maps of compiled code from which on it is let go; Linux ends a process at 65 530."""


@pytest.fixture(autouse=True)
def compiled_code_is_let_go():
    """A long run compiles thousands of functions, each with maps of its own."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()


def pytest_addoption(parser):
    parser.addoption("--minutes", type=float, help="let tests go that have not begun by then")
    parser.addoption("--turn", type=int, help="a number that puts the files into another order")


STARTED = pytest.StashKey[float]()


def pytest_configure(config):
    config.stash[STARTED] = time.monotonic()


def pytest_collection_modifyitems(config, items):
    """Where time may not suffice for all, each file has its turn to come first."""
    turn = config.getoption("turn")
    if turn is not None:
        items.sort(key=lambda item: random.Random(f"{turn} {item.path.name}").random())


def pytest_runtest_setup(item):
    minutes = item.config.getoption("minutes")
    if minutes and time.monotonic() - item.config.stash[STARTED] > 60 * minutes:
        pytest.skip("no time left")
