"""Do the tests notice a wrong rule? Changes one place of a room at a time and runs its tests on a copy.

python -m tools.mutants SOURCE TESTS... [--sample N] [--seed S] [--jobs N] [--seconds S]
python -m tools.mutants --draw N [--seed S] [--jobs N] [--seconds S]

SOURCE is a file or folder below src. A mutant is killed if a test fails, cannot be collected, or runs for more than
`--seconds`. Survivors are printed with their lines: each is a missing test or a change without a meaning.

`--draw` draws N mutants over all rooms, by their number of places, and prints the killed share of each room.
A mutant meets the tests of its room that name its module, or import a helper that does; if there are none, all tests of
the room.
"""

import argparse
import ast
import copy
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
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


FAILED, NOT_COLLECTED = 1, 2
"""Exit statuses of pytest."""


@dataclass(frozen=True)
class Mutant:
    """One changed place: the file below the root, the line as it was and is, and the file's new text."""

    file: Path
    line: int
    before: str
    after: str
    text: str


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield each mutant of `node`."""
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


def drawn(files: Sequence[Path], count: int, seed: int) -> tuple[list[Mutant], int]:
    """Return `count` mutants of the files (0: all) and how many there are; each holds the text of its file."""
    every = sum(1 for file in files for _ in mutants(file))
    taken = range(every) if not count else {*random.Random(seed).sample(range(every), min(count, every))}
    numbered = enumerate(mutant for file in files for mutant in mutants(file))
    return [mutant for number, mutant in numbered if number in taken], every


def survives(mutant: Mutant, place: Path, tests: Sequence[str], seconds: float) -> bool:
    """Run the tests on the copy in `place` with the mutant in it, and restore the file."""
    file = place / mutant.file
    right = file.read_text(encoding="utf-8")
    file.write_text(mutant.text, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    # Bytecode is recognised by the second and length of its source: both may be equal here.
    environment = os.environ | {"PYTHONPATH": f"{place / 'src'}:{place}", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        ran = subprocess.run(command, cwd=place, env=environment, capture_output=True, timeout=seconds, check=False)
        return ran.returncode not in (FAILED, NOT_COLLECTED)
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


def with_helpers(test: Path) -> str:
    """Return the text of a test and of the modules of `tests` that it imports."""
    text = test.read_text(encoding="utf-8")
    helpers = re.findall(r"^from (tests\.[\w.]+) import", text, re.MULTILINE)
    paths = [ROOT / f"{helper.replace('.', '/')}.py" for helper in helpers]
    return text + "".join(path.read_text(encoding="utf-8") for path in paths if path.is_file())


def related_tests(file: Path) -> tuple[str, ...]:
    """Return the tests of the file's room that name its module, with their helpers; else the room's folder."""
    room, module = file.parts[2], ".".join(file.with_suffix("").parts[1:]).removesuffix(".__init__")
    folder = ROOT / "tests" / room
    if not folder.is_dir():  # a module that is a room of its own
        return tuple(str(path.relative_to(ROOT)) for path in (ROOT / "tests").glob(f"test_{file.stem}*.py"))
    parent, _, name = module.rpartition(".")
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    defined = {name, *(node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef))}
    named = re.compile(rf"\b{re.escape(module)}\b")
    from_parent = re.compile(rf"from {re.escape(parent)} import (\([^)]*\)|.*)")

    def names_it(text: str) -> bool:
        """Return True if a text names the module, or imports what it defines from its package."""
        return bool(named.search(text)) or any(
            defined & {*re.findall(r"\w+", part)} for part in from_parent.findall(text)
        )

    tests = sorted(folder.rglob("test_*.py"))
    found = [path for path in tests if path.stem == f"test_{file.stem}" or names_it(with_helpers(path))]
    return tuple(str(path.relative_to(ROOT)) for path in found) or (str(folder.relative_to(ROOT)),)


def judged(
    chosen: Sequence[Mutant], tests_of: Callable[[Mutant], Sequence[str]], jobs: int, seconds: float
) -> list[bool | None]:
    """Return True for each mutant that survives, None if its tests fail without a change."""
    unchanged: dict[tuple[str, ...], bool] = {}
    with tempfile.TemporaryDirectory() as folder:
        free: SimpleQueue[Path] = SimpleQueue()
        for job in range(jobs):
            (Path(folder) / str(job)).mkdir()
            free.put(copied(Path(folder) / str(job)))

        def judge(mutant: Mutant) -> bool | None:
            tests = tuple(tests_of(mutant))
            place = free.get()
            try:
                if not tests or survives(mutant, place, tests, seconds):
                    return True
                if tests not in unchanged:
                    text = (ROOT / mutant.file).read_text(encoding="utf-8")
                    unchanged[tests] = survives(replace(mutant, text=text), place, tests, seconds)
                return False if unchanged[tests] else None
            finally:
                free.put(place)

        with ThreadPoolExecutor(jobs) as pool:
            return list(pool.map(judge, chosen))


def print_rooms(chosen: Sequence[Mutant], results: Sequence[bool | None]) -> None:
    """Print the killed share of each room and of all."""
    rooms: dict[str, list[bool | None]] = {}
    for mutant, lives in zip(chosen, results, strict=True):
        rooms.setdefault(mutant.file.parts[2].removesuffix(".py"), []).append(lives)
    for room, found in [*sorted(rooms.items()), ("all", list(results))]:
        known = [lives for lives in found if lives is not None]
        unknown = f", {len(found) - len(known)} not judged: tests fail unchanged" if len(known) < len(found) else ""
        share = f"{100.0 * known.count(False) / len(known):.0f} %" if known else "-"
        sys.stdout.write(f"{room:12} {known.count(False):4} of {len(known):4} killed  {share}{unknown}\n")


def main() -> int:
    """Print survivors and score; return 1 if one survived, 2 if the tests fail without a change."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("source", type=Path, nargs="?")
    arguments.add_argument("tests", nargs="*")
    arguments.add_argument("--draw", type=int, default=0, metavar="N", help="N mutants over all rooms, by room")
    arguments.add_argument("--sample", type=int, default=0, help="so many, chosen at random; 0: all")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    arguments.add_argument("--seconds", type=float, default=300.0, help="longest run of the tests")
    options = arguments.parse_args()
    if bool(options.draw) == bool(options.tests):
        arguments.error("give SOURCE and TESTS, or --draw N")
    if missing := [test for test in options.tests if not Path(test.partition("::")[0]).exists()]:
        arguments.error(f"there are no such tests: {', '.join(missing)}")
    source = (ROOT / "src" / "twodof") if options.draw else options.source.resolve()
    files = sorted(source.rglob("*.py")) if source.is_dir() else [source]
    chosen, every = drawn(files, options.draw or options.sample, options.seed)
    tests_of = (lambda mutant: related_tests(mutant.file)) if options.draw else (lambda _: options.tests)
    results = judged(chosen, tests_of, options.jobs, options.seconds)
    if None in results and not options.draw:
        sys.stderr.write(f"the tests fail without a change: {' '.join(options.tests)}\n")
        return 2
    for mutant, lives in zip(chosen, results, strict=True):
        if lives:
            sys.stdout.write(f"{mutant.file}:{mutant.line}: {mutant.before}  ->  {mutant.after}\n")
    if options.draw:
        print_rooms(chosen, results)
    else:
        sys.stdout.write(f"{results.count(False)} of {len(chosen)} killed ({every} there are)\n")
    return 1 if True in results else 0


if __name__ == "__main__":
    sys.exit(main())
