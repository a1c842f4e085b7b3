"""Every operation of the language on every type that it takes, alone, and every elementary function."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from typing import Any

from tests.compile.differential import Case
from tests.compile.whole_library import SPECIAL, WORDS
from twodof.blocks import Block, Diagram, Port, maximum, minimum, multiply_high, sqrt, to_int32, to_real, to_uint32
from twodof.blocks.elementary.functions import ARGUMENTS, FUNCTIONS
from twodof.blocks.expressions.expr import bits_of, from_bits, where

Operation = Callable[[Any, Any], Any]
COMPARISONS: dict[str, Operation] = {
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
}
LOGIC: dict[str, Operation] = {
    "and": lambda a, b: a & b,
    "or": lambda a, b: a | b,
    "xor": lambda a, b: a ^ b,
    "not": lambda a, b: ~a,
}
ARITHMETIC: dict[str, Operation] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "neg": lambda a, b: -a,
    "abs": lambda a, b: abs(a),
    "least": minimum,
    "most": maximum,
}
WHOLE: dict[str, Operation] = {
    "quot": lambda a, b: a // b,
    "rem": lambda a, b: a % b,
    "shl": lambda a, b: a << b,
    "shr": lambda a, b: a >> b,
    "real": lambda a, b: to_real(a),
}
REAL: dict[str, Operation] = {
    "div": lambda a, b: a / b,
    "sqrt": lambda a, b: sqrt(a),
    "int32": lambda a, b: to_int32(a),
    "uint32": lambda a, b: to_uint32(a),
    "low": lambda a, b: bits_of(a, 0),
    "high": lambda a, b: bits_of(a, 1),
    "pick": lambda a, b: where(a < 0.5, b, a),
    **{name: lambda a, b, f=f: f(a) for name, f in FUNCTIONS.items() if ARGUMENTS[name] == 1},
    **{name: lambda a, b, f=f: f(a, b) for name, f in FUNCTIONS.items() if ARGUMENTS[name] == 2},
}
KINDS: dict[str, dict[str, Operation]] = {
    "real": COMPARISONS | ARITHMETIC | REAL,
    "int32": COMPARISONS | ARITHMETIC | LOGIC | WHOLE | {"uint32": lambda a, b: to_uint32(a)},
    "uint32": COMPARISONS
    | ARITHMETIC
    | LOGIC
    | WHOLE
    | {
        "int32": lambda a, b: to_int32(a),
        "mulhi": multiply_high,
        "bits": from_bits,
        "word": lambda a, b: from_bits(a),
    },
    "bool": LOGIC
    | {
        "eq": COMPARISONS["eq"],
        "ne": COMPARISONS["ne"],
        "pick": lambda a, b: where(a, b, ~b),
        "real": lambda a, b: to_real(a),
        "int32": lambda a, b: to_int32(a),
        "uint32": lambda a, b: to_uint32(a),
    },
}
ALWAYS = {**dict.fromkeys(("lt", "le", "eq", "ne"), "bool"), "real": "real", "int32": "int32", "uint32": "uint32"}
ALWAYS |= {"low": "uint32", "high": "uint32", "bits": "real", "word": "real"}


class Operations(Block):
    """Each operation on two inputs of one type; an output for each."""

    def __init__(self, kind: str) -> None:
        self.operations = KINDS[kind]
        self.inputs = [Port("a", kind), Port("b", kind)]
        self.outputs = [Port(f"{name}_", ALWAYS.get(name, kind)) for name in self.operations]

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {f"{name}_": operation(u.a, u.b) for name, operation in self.operations.items()}


def every_operator() -> Case:
    """All operations, with all pairs of special values of their types."""
    d = Diagram("operators")
    for kind in KINDS:
        d.input(f"{kind}_a", kind)
        d.input(f"{kind}_b", kind)
        d.add(f"of_{kind}", Operations(kind), a=f"{kind}_a", b=f"{kind}_b")
        for port in d.parts[f"of_{kind}"].item.outputs:
            d.output(f"{kind}_{port.name}", f"of_{kind}.{port.name}")
    rng = random.Random(1)
    words = [*WORDS, *(rng.randrange(-(2**31), 2**31) for _ in range(9))]
    values: dict[str, list[Any]] = {"real": [*SPECIAL, -1.5, 2.25], "int32": words, "bool": [False, True]}
    values["uint32"] = [w % 2**32 for w in words]
    pairs = {kind: itertools.cycle(itertools.product(v, v)) for kind, v in values.items()}
    rows = []
    for _ in range(len(values["real"]) ** 2):
        row = {}
        for kind, pair in pairs.items():
            row[f"{kind}_a"], row[f"{kind}_b"] = next(pair)
        rows.append(row)
    return Case(d, [], rows, {})
