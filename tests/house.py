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
    "_status",
    "_compilation",
    "models",
    "curves",
    "records",
    "plots",
    "_result",
    "_notes",
    "fitting",
    "methods",
    "_identify",
    "_identify_each",
    "_compare",
    "study",
    "layer",
    "report",
    "_cli",
    "app",
)
"""Rooms of the house, from the ground up: a room imports only from those before it."""

PLANTS = "Hudzovic|Sani|EqualLag|PTn|FOPDT|SOPDT|SOPDTZero|IPDT"
OWNERS = re.compile(r"models/|_models|_coordinates|fitting/_families")
"""Files that may ask for the class of a plant."""


def sources(package: Path) -> dict[str, str]:
    """Text of every file by its module's name inside the package."""
    files = sorted(package.rglob("*.py"))
    return {".".join(f.relative_to(package).with_suffix("").parts): f.read_text() for f in files}


def room(module: str) -> str:
    """Room of a module: its wing, or itself."""
    return module.split(".")[0]


def imports(module: str, text: str, known: set[str]) -> Iterator[str]:
    """Modules of the package that a module imports."""
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.ImportFrom) or not node.level:
            continue
        base = module.split(".")[: -node.level]
        target = ".".join([*base, *(node.module.split(".") if node.module else [])])
        if target in known:
            yield target
        elif f"{target}.__init__" in known:
            inside = [f"{target}.{alias.name}" for alias in node.names]
            yield from [name if name in known else f"{target}.__init__" for name in inside]


def graph(package: Path = PACKAGE) -> dict[str, set[str]]:
    """Which modules each module imports; the public surface is left out."""
    texts = sources(package)
    texts.pop("__init__", None)
    return {module: set(imports(module, text, set(texts))) for module, text in texts.items()}


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
    """Places outside models and families where the class of a plant is asked for."""
    question = re.compile(
        rf"isinstance\([^)]*\b({PLANTS})\b|\bis (not )?({PLANTS})\b|issubclass\([^)]*\b({PLANTS})\b"
    )
    return [
        f"{file.relative_to(package)}:{i}"
        for file in sorted(package.rglob("*.py"))
        if not OWNERS.match(str(file.relative_to(package)))
        for i, line in enumerate(file.read_text().splitlines(), 1)
        if question.search(line)
    ]


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
