"""Names in docstrings exist."""

import ast
import builtins
import re
from collections.abc import Iterator

from tests.house import PACKAGE, sources

import stepax
from stepax import METHODS
from stepax._result import DETAILS


NAME = re.compile(r"`(?:stepax\.)?([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)(?:\([^`]*\))?`")
# Words of other packages that docstrings use, and what is a file or a test.
OTHERS = set("curve_fit betainc TransferFunction ZerosPolesGain equinox filter_grad".split())
ELSEWHERE = re.compile(r"test_|.*\.(py|csv|png)$")


def trees() -> Iterator[ast.Module]:
    return map(ast.parse, sources(PACKAGE).values())


def known_names() -> set[str]:
    """What is defined, assigned, a parameter, an option or a text anywhere in the package."""
    names = set(dir(builtins)) | set(dir(stepax)) | set(METHODS) | set(DETAILS) | OTHERS
    names |= {part for module in sources(PACKAGE) for part in module.split(".")}
    for node in (node for tree in trees() for node in ast.walk(tree)):
        said = [getattr(node, field, None) for field in ("id", "attr", "arg", "name", "value")]
        names |= {x for text in said if isinstance(text, str) for x in text.split(".")}
    return names


def docstrings() -> Iterator[str]:
    for node in (node for tree in trees() for node in ast.walk(tree)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module):
            yield ast.get_docstring(node) or ""


def test_names_in_docstrings_exist():
    named = {name for said in docstrings() for name in NAME.findall(said)}
    assert len(named) > 250  # they are found
    named = {name for name in named if not ELSEWHERE.match(name)}
    known = known_names()
    assert {name for name in named if not set(name.split(".")) <= known} == set()
