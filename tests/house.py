"""The structure of the package, measured from its source: `python -m tests.house [FOLDER]`.

Imports are read from the syntax tree, those inside functions too; nothing is executed.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path


PACKAGE = Path(__file__).parents[1] / "src" / "stepax"

ROOMS = (
    "_arrays",
    "_orthonormal",
    "_status",
    "_batches",
    "_programs",
    "_compilation",
    "models",
    "curves",
    "records",
    "plots",
    "_notes",
    "summary",
    "report",
    "_result",
    "fitting",
    "methods",
    "_identify",
    "_identify_each",
    "_compare",
    "study",
    "layer",
    "_setup",
    "app",
    "_cli_picture",
    "_cli_study",
    "_options",
    "_cli_lookup",
    "_cli",
)
"""Rooms of the house, from the ground up: a room imports only from those before it."""

PLANTS = frozenset(
    "Hudzovic Sani EqualLag PTn FOPDT SOPDT SOPDTZero IPDT"
    " AbstractSpreadChain AbstractChain".split()
)
OWNERS = re.compile(r"models/|fitting/_families")
"""Files that may ask for the class of a plant."""


def sources(package: Path) -> dict[str, str]:
    """Text of every file by its module's name inside the package."""
    files = sorted(package.rglob("*.py"))
    return {".".join(f.relative_to(package).with_suffix("").parts): f.read_text() for f in files}


def room(module: str) -> str:
    """Room of a module: its wing, or itself."""
    return module.split(".")[0]


def imports(module: str, text: str, known: set[str]) -> Iterator[str]:
    """Modules of the package that a module imports, relatively or by the package's name."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
            wanted = [name.split(".")[1:] for name in targets if name.split(".")[0] == "stepax"]
            yield from (found for name in wanted for found in _resolved(name, known))
        elif isinstance(node, ast.ImportFrom):
            parts = node.module.split(".") if node.module else []
            if node.level:
                base = [*module.split(".")[: -node.level], *parts]
            elif parts[:1] == ["stepax"]:
                base = parts[1:]
            else:
                continue
            for alias in node.names:
                yield from _resolved([*base, alias.name], known)


def _resolved(name: list[str], known: set[str]) -> Iterator[str]:
    """The module that a dotted name leads into; the public surface counts as one."""
    for length in range(len(name), 0, -1):
        for candidate in (".".join(name[:length]), ".".join([*name[:length], "__init__"])):
            if candidate in known:
                yield candidate
                return
    yield "__init__"


def graph(package: Path = PACKAGE) -> dict[str, set[str]]:
    """Which modules each module imports; the public surface is left out."""
    texts = sources(package)
    known = set(texts)
    texts.pop("__init__", None)
    return {module: set(imports(module, text, known)) for module, text in texts.items()}


def circles(arrows: dict[str, set[str]]) -> list[set[str]]:
    """Groups of modules that import each other, directly or not."""
    reach = {module: set(targets) for module, targets in arrows.items()}
    for through in arrows:
        for module in arrows:
            if through in reach[module]:
                reach[module] |= reach[through]
    found: list[set[str]] = []
    for module in arrows:
        group = {x for x in arrows if x in reach[module] and module in reach[x]}
        if group and group not in found:
            found.append(group)
    return found


def running_up(arrows: dict[str, set[str]], rooms=ROOMS) -> list[tuple[str, str]]:
    """Imports from a room that does not lie before one's own."""
    place = {name: i for i, name in enumerate(rooms)}
    return [
        (module, target)
        for module, targets in arrows.items()
        for target in sorted(targets)
        if room(module) != room(target)
        and place.get(room(target), len(rooms)) >= place.get(room(module), -1)
    ]


def class_tests(package: Path = PACKAGE) -> list[str]:
    """Places outside models and families where the class of a plant is asked for.

    In a comparison, a `match`, a dictionary's keys, or a question such as `isinstance`, by the
    class itself or by its name.
    """
    return [
        f"{file.relative_to(package)}:{line}"
        for file in sorted(package.rglob("*.py"))
        if not OWNERS.match(str(file.relative_to(package)))
        for line in sorted(set(_questions(ast.parse(file.read_text()))))
    ]


def _questions(tree: ast.AST) -> Iterator[int]:
    for node in ast.walk(tree):
        asked: list[ast.AST | None] = []
        if isinstance(node, ast.Compare):
            asked = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            asked = list(node.args) if node.func.id in ("isinstance", "issubclass") else []
        elif isinstance(node, ast.MatchClass):
            asked = [node.cls]
        elif isinstance(node, ast.Dict):
            asked = list(node.keys)
        inside = [x for part in asked if part is not None for x in ast.walk(part)]
        if any(_name(x) in PLANTS for x in inside):
            yield node.lineno  # pyright: ignore[reportAttributeAccessIssue]


def _name(node: ast.AST) -> str:
    """Name, attribute or text that a node is."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    return getattr(node, "id", getattr(node, "attr", ""))


def functions(package: Path = PACKAGE) -> list[tuple[int, str]]:
    """Length of every function, docstring included, longest first."""
    found = []
    for module, text in sources(package).items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                assert node.end_lineno is not None
                found.append((node.end_lineno - node.lineno + 1, f"{module}.{node.name}"))
    return sorted(found, reverse=True)


def comments(text: str) -> int:
    """Lines that hold a comment."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return len({token.start[0] for token in tokens if token.type == tokenize.COMMENT})


def main() -> None:
    """Print the measures of a package, by default of this one."""
    package = Path(sys.argv[1]) if len(sys.argv) > 1 else PACKAGE
    arrows, texts = graph(package), sources(package)
    lines = {module: text.count("\n") for module, text in texts.items()}
    longest = max(lines, key=lambda module: lines[module])
    engine = [x for x in functions(package) if "fitting" in x[1] or x[1].startswith("_")]
    print(f"files                     {len(texts)}")
    print(f"lines                     {sum(lines.values())}")
    print(f"circles                   {[sorted(group) for group in circles(arrows)]}")
    print(f"imports that run up       {len(running_up(arrows))}")
    print(f"class tests elsewhere     {len(class_tests(package))}")
    print(f"longest file              {lines[longest]} ({longest})")
    print("longest functions         " + ", ".join(f"{n} ({x})" for n, x in functions(package)[:4]))
    print("  of them in the engine   " + ", ".join(f"{n} ({x})" for n, x in engine[:3]))
    marked = sum(map(comments, texts.values()))
    print(f"comments per 100 lines    {100 * marked / sum(lines.values()):.1f}")


if __name__ == "__main__":
    main()
