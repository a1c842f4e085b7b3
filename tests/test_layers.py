"""The house's order: a room imports only from rows above its own; no cycles; no own imports in functions."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

PACKAGE = "twodof"
SOURCE = Path(__file__).resolve().parents[1] / "src" / PACKAGE

# Rooms of one row do not import each other.
ROWS = [
    {"errors"},
    {"signals", "parameters"},
    {"flightlog", "blocks", "drawing"},
    {"excitation", "models"},
    {"compile", "slx"},
    {"rig", "flight", "link"},
    {"fcu", "companion", "gcs", "identify", "design"},
    {"sim"},
    {"fleet", "ros"},
    {"experiment"},
    {"campaign"},
    {"calibrate", "report", "gym"},
    {"course"},
    {"lab"},
    {"remote"},
    {"cli"},
]
ROW_OF = {room: index for index, row in enumerate(ROWS) for room in row}
# What the rows alone would allow: the ground knows the drone by the wire, identification by the log.
NEVER = {("fcu", "rig"), ("gcs", "flight"), ("gcs", "rig"), ("identify", "link"), ("design", "link")}


@dataclass(frozen=True)
class Import:
    """One import of our own package: from module `source` to module `target`, at `line`."""

    source: str
    target: str
    line: int
    in_function: bool
    typing_only: bool


def modules(root: Path) -> dict[str, Path]:
    """Module name -> file, for every Python file under the package folder `root`."""
    found = {}
    for path in sorted(root.rglob("*.py")):
        parts = [root.name, *path.relative_to(root).with_suffix("").parts]
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def own_imports(name: str, path: Path, known: dict[str, Path]) -> Iterator[Import]:
    """Every import of the package itself in one file; `from package import module` points at the module."""
    package = name.split(".")[0]
    base = name.split(".") if path.stem == "__init__" else name.split(".")[:-1]

    def visit(node: ast.AST, in_function: bool, typing_only: bool) -> Iterator[Import]:
        targets: list[str] = []
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            stem = base[: len(base) - node.level + 1] if node.level else []
            module = ".".join([*stem, *([node.module] if node.module else [])])
            for alias in node.names:
                inner = f"{module}.{alias.name}"
                targets.append(inner if inner in known else module)
        for target in targets:
            if target.split(".")[0] == package:
                yield Import(name, target, node.lineno, in_function, typing_only)
        in_function = in_function or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            typing_only = True
        for child in ast.iter_child_nodes(node):
            yield from visit(child, in_function, typing_only)

    yield from visit(ast.parse(path.read_text()), False, False)


def room(module: str) -> str:
    """The room a module stands in; the package's own top file is the room ''."""
    return [*module.split("."), ""][1]


def breaches(root: Path) -> list[str]:
    """Every breach of the house's order in the package folder `root`, one line each."""
    known = modules(root)
    imports = [entry for name, path in known.items() for entry in own_imports(name, path, known)]
    found = [f"{name}: room {room(name)!r} has no row" for name in known if room(name) not in {*ROW_OF, ""}]
    for entry in imports:
        here, there = room(entry.source), room(entry.target)
        where = f"{entry.source}:{entry.line} imports {entry.target}"
        if entry.in_function:
            found.append(f"{where} inside a function")
        if here == there or not there:
            continue
        if not here:
            found.append(f"{where}: the package's top file loads no room")
        elif here in ROW_OF and there in ROW_OF and ROW_OF[there] >= ROW_OF[here]:
            found.append(f"{where}: {there!r} is not in a row above {here!r}")
        elif (here, there) in NEVER:
            found.append(f"{where}: {here!r} never imports {there!r}")
    graph: dict[str, set[str]] = {name: set() for name in known}
    for entry in imports:
        if not entry.typing_only and entry.target in known:
            graph[entry.source].add(entry.target)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found.append("cycle: " + " <- ".join(error.args[1]))
    return found


@pytest.mark.long
def test_the_house_is_in_order() -> None:
    assert len(modules(SOURCE)) > 1, f"nothing to read in {SOURCE}"
    assert breaches(SOURCE) == []


GOOD = {
    "__init__.py": "import importlib\n",
    "errors.py": "",
    "blocks/__init__.py": "from twodof.blocks.expr import Expr\n",
    "blocks/expr.py": "from twodof.errors import DiagramError\nExpr = int\n",
    "compile/c99.py": "from ..blocks import expr\n",
    "identify/fit.py": "from twodof.compile.c99 import expr\n",
}


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / PACKAGE / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root / PACKAGE


def test_an_orderly_package_passes(tmp_path: Path) -> None:
    assert breaches(write(tmp_path, GOOD)) == []


@pytest.mark.parametrize(
    ("file", "text", "complaint"),
    [
        ("blocks/block.py", "from twodof.compile import c99", "'compile' is not in a row above 'blocks'"),
        ("blocks/block.py", "from ..compile.c99 import expr", "'compile' is not in a row above 'blocks'"),
        ("blocks/block.py", "import twodof.compile.c99", "'compile' is not in a row above 'blocks'"),
        ("blocks/block.py", "if True:\n    from twodof import flightlog", "'flightlog' is not in a row above"),
        ("flight/core.py", "from twodof.rig import dynamics", "'rig' is not in a row above 'flight'"),
        ("gcs/drone.py", "from twodof.flight import core", "'gcs' never imports 'flight'"),
        ("kitchen/sink.py", "", "room 'kitchen' has no row"),
        ("__init__.py", "from twodof import blocks", "loads no room"),
        ("blocks/block.py", "def f():\n    from twodof.errors import X", "inside a function"),
        ("blocks/expr.py", "from twodof.blocks import Expr", "cycle: "),
        (
            "blocks/block.py",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from twodof.compile.c99 import expr",
            "'compile' is not in a row above",
        ),
    ],
)
def test_a_breach_is_found(tmp_path: Path, file: str, text: str, complaint: str) -> None:
    stubs = {"flightlog/__init__.py": "", "flight/core.py": "", "rig/dynamics.py": ""}
    found = breaches(write(tmp_path, {**GOOD, **stubs, file: text + "\n"}))
    assert len(found) == 1
    assert complaint in found[0]


def test_a_name_needed_for_typing_only_makes_no_cycle(tmp_path: Path) -> None:
    text = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from twodof.blocks import Expr\n"
    assert breaches(write(tmp_path, {**GOOD, "blocks/expr.py": text})) == []
