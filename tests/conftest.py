import os
from pathlib import Path

import jax
import pytest


# float32 is tested beside it: the library follows the dtype of the data.
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
if not os.environ.get("STEPAX_TEST_OPTIMISED"):
    # Compiling is most of the time of the tests; `.ci/run` runs the long ones fully optimised.
    jax.config.update("jax_disable_most_optimizations", True)


@pytest.fixture(scope="module")
def quick_compilation():
    """The poles in a loop, as on the command line: compiling is most of the time of these tests."""
    from stepax._compilation import quick_compilation  # checked only if imported after pytest's

    if os.environ.get("STEPAX_TEST_OPTIMISED"):
        yield
    else:
        with quick_compilation():
            yield


MOST_MAPS = 30_000
"""Memory maps of compiled code from which on it is let go; Linux ends a process at 65 530."""


@pytest.fixture(autouse=True)
def compiled_code_is_let_go():
    """A long run compiles thousands of functions, each with maps of its own."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
