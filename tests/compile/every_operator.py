"""Every operation of the language on every type that it takes, alone, and every elementary function."""

import itertools
import random
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from tests.compile.differential import Case
from tests.compile.whole_library import SPECIAL, WORDS
from twodof import blocks
from twodof.blocks import (
    Block,
    Diagram,
    Port,
    maximum,
    minimum,
    multiply_high,
    sqrt,
    to_float32,
    to_float64,
    to_int32,
    to_real,
    to_uint32,
)
from twodof.blocks.elementary.functions import ARGUMENTS, FUNCTIONS
from twodof.blocks.expressions.conversions import OVERFLOW
from twodof.blocks.expressions.expr import bits_of, from_bits, where
from twodof.blocks.expressions.numbers import BY_NAME, FLOATS, STORED

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
FLOAT: dict[str, Operation] = {name: made for name, made in REAL.items() if name not in ("low", "high")}
STORING = {kind: getattr(blocks, f"to_{kind}") for kind in STORED}
FLOATING: dict[str, Operation] = {"single": lambda a, b: to_float32(a), "double": lambda a, b: to_float64(a)}
STORAGE: dict[str, Operation] = {
    f"{overflow}_{kind}": partial(lambda store, overflow, a, b: store(a, overflow=overflow), store, overflow)
    for kind, store in STORING.items()
    for overflow in OVERFLOW
}
"""Conversions to the kinds of 8 and 16 bits."""
SMALL: dict[str, Operation] = {
    **{f"whole_{name}": made for name, made in (COMPARISONS | ARITHMETIC | LOGIC | WHOLE).items()},
    "pick": lambda a, b: where(a < b, a, b),
    **FLOATING,
    "uint32": lambda a, b: to_uint32(a),
}
KINDS: dict[str, dict[str, Operation]] = {
    "real": COMPARISONS | ARITHMETIC | REAL | FLOATING | STORAGE,
    "float32": COMPARISONS | ARITHMETIC | FLOAT | FLOATING | STORAGE | {"real": lambda a, b: to_real(a)},
    "float64": COMPARISONS | ARITHMETIC | FLOAT | FLOATING | STORAGE | {"real": lambda a, b: to_real(a)},
    **dict.fromkeys(STORED, SMALL | STORAGE),
    "int32": COMPARISONS | ARITHMETIC | LOGIC | WHOLE | FLOATING | STORAGE | {"uint32": lambda a, b: to_uint32(a)},
    "uint32": COMPARISONS
    | ARITHMETIC
    | LOGIC
    | WHOLE
    | FLOATING
    | STORAGE
    | {"int32": lambda a, b: to_int32(a), "mulhi": multiply_high, "bits": from_bits, "word": lambda a, b: from_bits(a)},
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
ALWAYS |= {"low": "uint32", "high": "uint32", "bits": "real", "word": "real", "single": "float32", "double": "float64"}
ALWAYS |= {f"{overflow}_{kind}": kind for kind in STORED for overflow in OVERFLOW}
ALWAYS |= {f"whole_{name}": ALWAYS.get(name, "int32") for name in COMPARISONS | ARITHMETIC | LOGIC | WHOLE}
for name in ("least", "most"):  # of two that are stored: one of them
    del ALWAYS[f"whole_{name}"]


PRECISIONS = ("float32", "float64")
SELDOM = 14


class Operations(Block):
    """Operations on two inputs of one type; an output for each."""

    crossing = True

    def __init__(self, kind: str, operations: dict[str, Operation]) -> None:
        self.operations = operations
        self.inputs = [Port("a", kind), Port("b", kind)]
        self.outputs = [Port(f"{name}_", ALWAYS.get(name, kind)) for name in self.operations]

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {f"{name}_": operation(u.a, u.b) for name, operation in self.operations.items()}


def every_operator(kinds: Sequence[str] = tuple(KINDS), name: str = "operators") -> Case:
    """All operations on `kinds`, with all pairs of special values of their types."""
    d = Diagram(name)
    for kind in kinds:
        d.input(f"{kind}_a", kind)
        d.input(f"{kind}_b", kind)
        operations = KINDS[kind]
        # What costs the reference most, and what all floats share, is done seldom.
        shared = FUNCTIONS.keys() if kind in PRECISIONS else ()
        seldom = {name: made for name, made in operations.items() if name in shared or name in STORAGE}
        often = {name: made for name, made in operations.items() if name not in seldom}
        for part, made, divider in (
            (f"of_{kind}", often, 6 if kind in (*PRECISIONS, *STORED) else 1),
            (f"functions_of_{kind}", seldom, SELDOM),
        ):
            if not made:
                continue
            d.add(part, Operations(kind, made), rate=(divider, 0), a=f"{kind}_a", b=f"{kind}_b")
            for port in d.parts[part].item.outputs:
                d.output(f"{kind}_{port.name}", f"{part}.{port.name}")
    rng = random.Random(1)
    words = [*WORDS, *(rng.randrange(-(2**31), 2**31) for _ in range(9))]
    values: dict[str, list[Any]] = {"real": [*SPECIAL, -1.5, 2.25], "int32": words, "bool": [False, True]}
    values["uint32"] = [w % 2**32 for w in words]
    values |= dict.fromkeys(FLOATS, values["real"])
    for kind in STORED:
        low, high = BY_NAME[kind].low, BY_NAME[kind].high
        values[kind] = [low, low + 1, 0, 1, 33, high - 1, high, *(rng.randint(low, high) for _ in range(5))]
    pairs = {kind: itertools.cycle(itertools.product(values[kind], values[kind])) for kind in kinds}
    rows = []
    for _ in range(len(values["real"]) ** 2):
        row = {}
        for kind, pair in pairs.items():
            row[f"{kind}_a"], row[f"{kind}_b"] = next(pair)
        rows.append(row)
    return Case(d, [], rows, {})
