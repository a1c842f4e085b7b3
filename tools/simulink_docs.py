"""Writes docs/reference/simulink.md from the table of Simulink's blocks: `python tools/simulink_docs.py`.

A block's parameters and choices are read in the source of its rule, and the types that it takes are tried. A test
compares the page with what this gives.
"""

import ast
import inspect
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from twodof.blocks import Diagram
from twodof.blocks.bus import Bus
from twodof.blocks.declarations import Port
from twodof.errors import TwodofError
from twodof.slx.blocks import DROPPED, INPUTS, RULES, TAKES_BUSES, carried_out
from twodof.slx.model import SimulinkBlock
from twodof.slx.translation import Asked, Made, NotTranslated, Rule, Signal

PROJECT = Path(__file__).resolve().parents[1]
PAGE = PROJECT / "docs" / "reference" / "simulink.md"
NUMBERS = {"scalar", "value", "structure"}
CHOICES = {"text", "needs", "pick"}
TYPES = {"real": "double", "bool": "boolean", **{k: k for k in ("int32", "uint32", "int16", "uint16", "int8", "uint8")}}
BUS = Bus("Some", [Port("a"), Port("b")])
TRIED = (Signal(), Signal("int32"), Signal("bool"), Signal("real", 3), Signal(BUS))

INTRODUCTION = """# Simulink's blocks

Made by `tools/simulink_docs.py` from the table that `twodof slx import` uses; do not edit.
[Come from Simulink](../how-to/come-from-simulink.md) says how a model is imported. Subsystems, ports, Goto and From,
MATLAB Functions and charts are not listed here: they become diagrams.

- *Block* is the type in the file, or the name in Simulink's library.
- *Becomes* is a block of [the library](blocks.md), or the blocks of a small diagram, with the default parameters.
- *Parameters* are those that the import reads, with the value that stands for a missing one, and the choices that it
  knows. Another choice, and in the same way a type that is not taken, is refused with the block's path and the
  parameter's name.
- *Types* are those of the inputs that are taken with the default parameters: `double` stands for single too; `[n]` for
  vectors. A model that says single and double computes each in its own precision; in a model of singles alone a number
  has the precision of the build: take `float32`.
- *Tests* are the files in `tests/slx` that name the block.
"""


def render() -> str:
    """The page's text."""
    tests = {path: path.read_text(encoding="utf-8") for path in sorted((PROJECT / "tests" / "slx").glob("test_*.py"))}
    lines = [INTRODUCTION, "| block | becomes | parameters | types | tests |", "|---|---|---|---|---|"]
    for kind in sorted(set(RULES) - set(DROPPED), key=str.casefold):
        rule = RULES[kind]
        named = [path.stem.removeprefix("test_") for path, text in tests.items() if f'"{kind}"' in text]
        read = _Parameters()
        made = next(filter(None, (_tried(rule, kind, one, read) for one in TRIED)), None)
        cells = [f"`{kind}`", _becomes(made), _parameters(rule, read.read), _types(rule, kind), ", ".join(named) or "-"]
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    dropped = ", ".join(f"`{kind}`" for kind in sorted(DROPPED, key=str.casefold))
    lines += ["", f"Left out, as they compute nothing for others: {dropped}."]
    return "\n".join(lines) + "\n"


class _Parameters(dict[str, str]):
    """Parameters of a block without any in the file; `read` holds the parameters read and their defaults."""

    def __init__(self) -> None:
        super().__init__()
        self.read: dict[str, str] = {}

    def get(self, name: str, default: Any = None) -> Any:
        self.read.setdefault(name, default or "")
        return default


def _tried(rule: Rule, kind: str, signal: Signal, parameters: _Parameters | None = None) -> Made | None:
    """Return the translation of a block with default parameters for inputs of one type; None if it is refused."""
    inputs = [signal] * INPUTS.get(kind, 1)
    block = SimulinkBlock(kind, kind, "1", {})
    given = _Parameters() if parameters is None else parameters
    asked = Asked(block, kind, given, {}, inputs, 0.004, labels=[""] * len(inputs))
    if isinstance(signal.kind, Bus) and kind not in TAKES_BUSES:
        return None
    try:
        made = carried_out(asked, rule)
    except (NotTranslated, TwodofError, LookupError):
        return None
    ports = [] if made.item is None else made.item.inputs
    kinds = [port.kind for port in (ports.values() if isinstance(ports, dict) else ports)]
    fits = isinstance(signal.kind, Bus) or all(one == signal.kind for one in kinds)
    return made if fits else None


def _becomes(made: Made | None) -> str:
    if made is None:
        return "by its parameters"
    if not isinstance(made.item, Diagram):
        return "nothing: it passes its input on" if made.item is None else f"`{type(made.item).__name__}`"
    kinds: dict[str, None] = {}
    for block in _blocks(made.item):
        kinds[f"`{block}`"] = None
    return ", ".join(kinds) or "a diagram"


def _blocks(d: Diagram) -> Iterator[str]:
    for part in d.parts.values():
        if isinstance(part.item, Diagram):
            yield from _blocks(part.item)
        else:
            yield type(part.item).__name__


def _types(rule: Rule, kind: str) -> str:
    if not INPUTS.get(kind, 1):
        return "no inputs"
    taken = [name for own, name in TYPES.items() if _tried(rule, kind, Signal(own))]
    taken += ["[n]"] * any(_tried(rule, kind, Signal(own, 3)) for own in TYPES)
    taken += ["buses"] * (_tried(rule, kind, Signal(BUS)) is not None)
    return ", ".join(taken) or "by its parameters"


def _parameters(rule: Rule, read: dict[str, str]) -> str:
    """The parameters that a rule reads with their defaults, and those that its functions name, with their choices."""
    found: dict[str, list[str]] = {name: [] for name in read}
    for function in _reached(rule):
        tree = ast.parse(textwrap.dedent(_source(function)))
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "only":
                for one in node.keywords:
                    if one.arg is not None and isinstance(one.value, ast.Constant):
                        choices = found.setdefault(one.arg, [])
                        choices += [] if choices else [str(one.value.value)]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args:
                name = node.args[0]
                if node.func.attr in NUMBERS | CHOICES and isinstance(name, ast.Constant):
                    choices = found.setdefault(str(name.value), [])
                    choices += [one for one in _choices(node, function) if one not in choices]
    told = {name: f" ({', '.join(choices)})" if choices else "" for name, choices in sorted(found.items())}
    values = {name: f" = {default}" if (default := read.get(name)) else "" for name in told}
    return ", ".join(f"`{name}{values[name]}`{choices}" for name, choices in told.items()) or "-"


def _choices(call: ast.Call, function: FunctionType) -> list[str]:
    assert isinstance(call.func, ast.Attribute)
    if call.func.attr == "needs":
        return [str(one.value) for one in call.args[2:] if isinstance(one, ast.Constant)]
    if call.func.attr == "pick" and len(call.args) > 2:
        table = call.args[2]
        if isinstance(table, ast.Dict):
            return [str(one.value) for one in table.keys if isinstance(one, ast.Constant)]
        if isinstance(table, ast.Name):
            return [str(one) for one in function.__globals__.get(table.id, {})]
    return []


def _source(function: FunctionType) -> str:
    """The lines of a function. A lambda's may be a part of a statement, which is made whole."""
    text = inspect.getsource(function)
    if function.__name__ != "<lambda>":
        return text
    start = text.index("lambda")
    for end in range(len(text), start, -1):
        try:
            ast.parse(text[start:end], mode="eval")
        except SyntaxError:
            continue
        return text[start:end]
    return "pass"


def _reached(rule: Callable[..., Any]) -> list[FunctionType]:
    """The rule, what it closes over, and the functions of the room `slx` that it names, each once."""
    found: list[FunctionType] = []
    left: list[Any] = [rule]
    while left:
        one = left.pop()
        if not isinstance(one, FunctionType) or one in found or not one.__module__.startswith("twodof.slx."):
            continue
        if one.__qualname__.split(".")[0] in {name for name, _ in inspect.getmembers(Asked)}:
            continue
        found.append(one)
        left += [cell.cell_contents for cell in one.__closure__ or ()]
        left += [one.__globals__.get(name) for name in _names(one.__code__)]
    return found


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


if __name__ == "__main__":
    PAGE.write_text(render(), encoding="utf-8")
    sys.stdout.write(f"{PAGE} written\n")
