"""The shape of the source in numbers: `python -m tools.counts [ROOT] [--json]`, ROOT being the repository's folder.

It shows lines and files of src, the folder with most files, and public class names that two modules use, with places.
It also shows import cycles, including those for type checking and those inside functions. The tests of the how-to
pages show how many files a new block, parameter, signal or stick mode touches.
"""

import ast
import json
import sys
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.test_layers import PACKAGE, modules, own_imports


def classes(known: Mapping[str, Path]) -> dict[str, list[str]]:
    """The modules that define each public class, by its name."""
    found: dict[str, list[str]] = defaultdict(list)
    for module, path in known.items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].append(module)
    return found


def cycles(known: dict[str, Path]) -> list[list[str]]:
    """Groups of modules that all import each other, directly or not."""
    graph = {
        name: {entry.target for entry in own_imports(name, path, known) if entry.target in known}
        for name, path in known.items()
    }
    reached = {name: _reached(name, graph) for name in graph}
    groups = {tuple(sorted({b for b in reached[a] if a in reached[b]})) for a in graph if a in reached[a]}
    return [list(group) for group in sorted(groups)]


def _reached(start: str, graph: Mapping[str, set[str]]) -> set[str]:
    found: set[str] = set()
    todo = [*graph[start]]
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += graph[name]
    return found


def counts(root: Path) -> dict[str, Any]:
    """All figures of the repository in `root`."""
    source = root / "src" / PACKAGE
    known = modules(source)
    folders = Counter(path.parent.relative_to(root) for path in known.values() if path.stem != "__init__")
    folder, files = folders.most_common(1)[0]
    return {
        "lines": sum(path.read_bytes().count(b"\n") for path in known.values()),
        "files": len(known),
        "largest folder": f"{folder}: {files} files",
        "class names used twice": {name: where for name, where in classes(known).items() if len(where) > 1},
        "import cycles": cycles(known),
    }


def main(arguments: list[str]) -> None:
    """Prints them."""
    places = [one for one in arguments if not one.startswith("-")]
    found = counts(Path(places[0] if places else "."))
    if "--json" in arguments:
        sys.stdout.write(json.dumps(found, indent=1) + "\n")
        return
    for name, value in found.items():
        sys.stdout.write(f"{name}: {value if isinstance(value, int | str) else len(value)}\n")
        for row in value.items() if isinstance(value, dict) else value if isinstance(value, list) else ():
            sys.stdout.write(f"    {row[0] + ': ' + ', '.join(row[1]) if isinstance(row, tuple) else ', '.join(row)}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
