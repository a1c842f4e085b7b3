"""Comparisons, logic, and small state machines: edge detector, counter, flip-flop, timer."""

import operator
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

from twodof.blocks.block import EDGES, Block, Clock, edge_of, library_block
from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.elementwise import OneOutput, Pointwise, Recurrent, comparable, one_of, port_series
from twodof.blocks.enumeration import Kind
from twodof.blocks.expressions.expr import to_real, to_uint32, where
from twodof.blocks.expressions.numbers import INTEGERS, WORDS

__all__ = ["Bitwise", "Compare", "CompareToConstant", "Counter", "EdgeDetector", "FlipFlop", "Logic", "Timer"]

COMPARISONS: Mapping[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
BITWISE: Mapping[str, Callable[[Any, Any], Any]] = {
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "left": operator.lshift,
    "right": operator.rshift,
}
INVERTED = {"nand": "and", "nor": "or", "not": "and"}


@library_block("compare")
class Compare(Pointwise):
    """y = (a operation b), a bool; `operation` is <, <=, >, >=, == or !=. A comparison with NaN is false, != true."""

    def __init__(self, operation: str = "<", kind: Kind = "real", width: int | None = None, unit: str = "") -> None:
        self.operation = one_of(operation, list(COMPARISONS), "operation")
        comparable(kind, operation)
        self.inputs = [Port("a", kind, width, unit), Port("b", kind, width, unit)]
        self.outputs = [Port("y", "bool", width)]

    def of(self, p: Any, a: Any, b: Any) -> Any:
        return COMPARISONS[self.operation](a, b)


@library_block("compare_to_constant")
class CompareToConstant(Pointwise):
    """y = (u operation constant), a bool; `operation` is <, <=, >, >=, == or !=."""

    def __init__(
        self, operation: str = ">", constant: Any = 0.0, kind: Kind = "real", width: int | None = None, unit: str = ""
    ) -> None:
        self.operation = one_of(operation, list(COMPARISONS), "operation")
        comparable(kind, operation)
        self.inputs = [Port("u", kind, width, unit)]
        self.outputs = [Port("y", "bool", width)]
        whole = kind in INTEGERS
        self.params = [Param("constant", int(constant) if whole else constant, kind, unit=unit)]

    def of(self, p: Any, u: Any) -> Any:
        return COMPARISONS[self.operation](u, p.constant)


@library_block("logic")
class Logic(Pointwise):
    """y = a operation b operation c ..., bools.

    `operation` is `and`, `or`, `xor`, `nand`, `nor`, or `not` (of one input).
    """

    def __init__(self, operation: str = "and", inputs: int = 2, width: int | None = None) -> None:
        self.operation = one_of(operation, ("and", "or", "xor", *INVERTED), "operation")
        self.ports(port_series(1 if operation == "not" else inputs), "bool", width)

    def of(self, p: Any, *values: Any) -> Any:
        y = reduce(BITWISE[INVERTED.get(self.operation, self.operation)], values)
        return ~y if self.operation in INVERTED else y


@library_block("bitwise")
class Bitwise(Pointwise):
    """y = a operation b on the bits of integers; `operation` is and, or, xor, left or right.

    left and right shift a by the lower 5 bits of b; right keeps the sign of an int32.
    """

    def __init__(self, operation: str = "and", kind: str = "uint32", width: int | None = None) -> None:
        self.operation = one_of(operation, list(BITWISE), "operation")
        self.ports("ab", one_of(kind, WORDS, "kind"), width)

    def of(self, p: Any, a: Any, b: Any) -> Any:
        return BITWISE[self.operation](a, b)


@library_block("edge_detector")
class EdgeDetector(OneOutput):
    """y is true in the sample in which u becomes true ("rising"), false ("falling") or changes ("either").

    `initial` is u before the start.
    """

    def __init__(self, edge: str = "rising", initial: bool = False) -> None:
        self.edge = one_of(edge, EDGES, "edge")
        self.ports("u", "bool")
        self.params = [Param("initial", initial, "bool")]
        self.states = [State("x", "initial", "bool")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return edge_of(self.edge, x.x, u.u)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.u


@library_block("counter")
class Counter(Recurrent):
    """y = how many samples u was true in, this one included, since the start or the last `clear`; modulo `modulus`.

    A sample with `clear` true starts anew from 0 (and counts itself). modulus 0: modulo 2^32. For events rather than
    samples put an edge detector before it.
    """

    def __init__(self, modulus: int = 0) -> None:
        self.inputs = [Port("u", "bool"), Port("clear", "bool")]
        self.outputs = [Port("y", "uint32")]
        self.params = [Param("modulus", modulus, "uint32")]
        self.states = [State("x", 0, "uint32")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        raised = where(u.clear, 0, x.x) + to_uint32(u.u)
        return where(p.modulus == 0, raised, raised % p.modulus)


@library_block("flip_flop")
class FlipFlop(Recurrent):
    """Set-reset flip-flop: `set` makes y true, `clear` false, else it stays; with both the `dominant` one counts."""

    def __init__(self, dominant: str = "clear", initial: bool = False) -> None:
        self.dominant = one_of(dominant, ("set", "clear"), "dominant")
        self.ports(("set", "clear"), "bool")
        self.params = [Param("initial", initial, "bool")]
        self.states = [State("x", "initial", "bool")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        if self.dominant == "set":
            return u.set | (x.x & ~u.clear)
        return (u.set | x.x) & ~u.clear


@library_block("timer")
class Timer(Block):
    """How long u has been true without a break: `elapsed` [s], 0 in its first true sample; `done` from `duration` on.

    Counted in the block's own periods, `duration` to the nearest; while u is false elapsed = 0 and done is false.
    """

    def __init__(self, duration: float = 1.0) -> None:
        self.inputs = [Port("u", "bool")]
        self.outputs = [Port("done", "bool"), Port("elapsed", unit="s")]
        self.params = [Param("duration", duration, unit="s", low=0.0)]
        self.derived = [Port("enough", "uint32")]
        self.states = [State("x", 0, "uint32")]

    def prepare(self, p: Any, t: Clock) -> Any:
        return to_uint32(p.duration / t.dt + 0.5)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {"done": u.u & (p.enough <= x.x), "elapsed": where(u.u, to_real(x.x) * t.dt, 0.0)}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        # It stays at the largest number: after 2^32 samples a timer that began anew would undo `done`.
        return where(u.u, where(x.x == 2**32 - 1, x.x, x.x + 1), 0)
