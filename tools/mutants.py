"""Do the tests notice a wrong rule? Changes one place of a room at a time and runs its tests on a copy.

python -m tools.mutants SOURCE TESTS... [--sample N] [--seed S] [--jobs N] [--seconds S]

SOURCE is a file or folder below src. A mutant is killed where a test fails, cannot be collected, or runs for more than
`--seconds`. What survives is printed with its line: read it, it is a missing test or a change without a meaning.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("src", "tests", "tools", "pyproject.toml")

OTHER_COMPARISON: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
OTHER_OPERATOR: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
OTHER_FUNCTION = {"minimum": "maximum", "maximum": "minimum", "all_of": "any_of", "any_of": "all_of"}


@dataclass(frozen=True)
class Mutant:
    """One changed place: the file below the root, the line as it was and is, and the file's new text."""

    file: Path
    line: int
    before: str
    after: str
    text: str


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in the place of `node`."""
    new: ast.AST
    match node:
        case ast.Compare(ops=[op]) if type(op) in OTHER_COMPARISON:
            new = copy.deepcopy(node)
            new.ops = [OTHER_COMPARISON[type(op)]()]
            yield new
        case ast.BinOp(op=op) if type(op) in OTHER_OPERATOR:
            new = copy.deepcopy(node)
            new.op = OTHER_OPERATOR[type(op)]()
            yield new
            if isinstance(op, ast.BitAnd | ast.BitOr):
                yield copy.deepcopy(node.left)
                yield copy.deepcopy(node.right)
        case ast.UnaryOp(op=ast.Invert() | ast.USub()):
            yield copy.deepcopy(node.operand)
        case ast.Call(func=ast.Name(id="where"), args=[condition, yes, no]):
            yield ast.Call(ast.Name("where"), [condition, no, yes], [])
        case ast.Call(func=ast.Name(id=name)) if name in OTHER_FUNCTION:
            yield ast.Call(ast.Name(OTHER_FUNCTION[name]), node.args, node.keywords)
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value) | float(value)):
            yield ast.Constant(value + 1)
            if value not in (0, 1):
                yield ast.Constant(value * 2)


def mutants(file: Path) -> Iterator[Mutant]:
    """All of one file: only inside functions, where the rules stand; docstrings are left alone."""
    text = file.read_text(encoding="utf-8")
    lines = text.encode().splitlines(keepends=True)
    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    # A function inside another one is walked twice and counted once.
    for node in dict.fromkeys(node for function in functions for line in function.body for node in ast.walk(line)):
        if not isinstance(node, ast.expr) or node.end_lineno is None:
            continue
        head = b"".join(lines[: node.lineno - 1]) + lines[node.lineno - 1][: node.col_offset]
        tail = lines[node.end_lineno - 1][node.end_col_offset :] + b"".join(lines[node.end_lineno :])
        for new in changes(node):
            after = ast.unparse(ast.fix_missing_locations(new))
            changed = (head + f"({after})".encode() + tail).decode()
            yield Mutant(file.relative_to(ROOT), node.lineno, ast.unparse(node), after, changed)


def survives(mutant: Mutant, place: Path, tests: list[str], seconds: float) -> bool:
    """Runs the tests on the copy in `place` with the mutant in it, and puts the file right again."""
    file = place / mutant.file
    right = file.read_text(encoding="utf-8")
    file.write_text(mutant.text, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    # Bytecode is recognised by the second and length of its source: both may be equal here.
    environment = os.environ | {"PYTHONPATH": f"{place / 'src'}:{place}", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        ran = subprocess.run(command, cwd=place, env=environment, capture_output=True, timeout=seconds, check=False)
        return ran.returncode == 0
    except subprocess.TimeoutExpired:
        return False
    finally:
        file.write_text(right, encoding="utf-8")


def copied(place: Path) -> Path:
    """A copy of what the tests need."""
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, place / name)
    return place


def main() -> int:
    """Prints what survived and the score; 1 where something survived, 2 where the tests fail without a change."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("source", type=Path)
    arguments.add_argument("tests", nargs="+")
    arguments.add_argument("--sample", type=int, default=0, help="so many, chosen at random; 0: all")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    arguments.add_argument("--seconds", type=float, default=300.0, help="longest run of the tests")
    options = arguments.parse_args()
    source = options.source.resolve()
    files = sorted(source.rglob("*.py")) if source.is_dir() else [source]
    found = [mutant for file in files for mutant in mutants(file)]
    chosen = random.Random(options.seed).sample(found, options.sample) if options.sample else found
    with tempfile.TemporaryDirectory() as folder:
        free: SimpleQueue[Path] = SimpleQueue()
        for job in range(options.jobs):
            (Path(folder) / str(job)).mkdir()
            free.put(copied(Path(folder) / str(job)))

        def left(mutant: Mutant) -> bool:
            place = free.get()
            try:
                return survives(mutant, place, options.tests, options.seconds)
            finally:
                free.put(place)

        same = Mutant(files[0].relative_to(ROOT), 1, "", "", files[0].read_text(encoding="utf-8"))
        if not left(same):
            sys.stderr.write(f"the tests fail without a change: {' '.join(options.tests)}\n")
            return 2
        with ThreadPoolExecutor(options.jobs) as pool:
            alive = [mutant for mutant, lives in zip(chosen, pool.map(left, chosen), strict=True) if lives]
    for mutant in alive:
        sys.stdout.write(f"{mutant.file}:{mutant.line}: {mutant.before}  ->  {mutant.after}\n")
    sys.stdout.write(f"{len(chosen) - len(alive)} of {len(chosen)} killed ({len(found)} there are)\n")
    return 1 if alive else 0


if __name__ == "__main__":
    sys.exit(main())
