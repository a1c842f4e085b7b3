"""The expression graph: what a block's Python code records when it is traced.

An `Expr` is an immutable, typed, hash-consed node. The functions here work on numbers (`numbers.py`) and compute, or on
an Expr and record; a block's code cannot tell which.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Never
from weakref import WeakValueDictionary

import numpy as np

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.numbers import (
    BY_NAME,
    FLOATS,
    INTEGERS,
    STORED,
    TAKES,
    WORDS,
    ArrayOperators,
    Int32,
    Integer,
    Operators,
    UInt32,
    rules,
)
from twodof.blocks.expressions.recording import LINES, OPERANDS, ROOM, TRACING, Refusals, refused, users_line
from twodof.blocks.expressions.recording import at_most as at_most
from twodof.blocks.expressions.recording import during as during
from twodof.blocks.expressions.recording import fault as fault
from twodof.blocks.expressions.recording import noting_lines as noting_lines
from twodof.blocks.expressions.recording import recording as recording
from twodof.blocks.expressions.recording import tracing as tracing
from twodof.errors import DiagramError

LOOPS = ("build", "fold")
LEAVES = ("const", "input", "state", "param", "tick", "dt", "bound")

_table: WeakValueDictionary[tuple[Any, ...], Expr] = WeakValueDictionary()


class Expr(Refusals, Operators):
    """A node: `op` on `args`, of type `kind`, an array of `width` elements unless `width` is None.

    `data` holds what is not an expression: a constant's value, a leaf's name, a loop's length, a called function.
    `loops` says of which loops around it the node reads the counter or a carried value: bit d for the loop of depth d.
    """

    __slots__ = ("__weakref__", "args", "data", "kind", "loops", "op", "width")

    op: str
    kind: str
    width: int | None
    args: tuple[Expr, ...]
    data: Any
    loops: int

    @property
    def outside(self) -> tuple[Expr, ...]:
        """The arguments evaluated outside a node's loop: all of them, a fold's initial values, none of a build's."""
        if self.op == "build":
            return ()
        return self.args[: len(self.args) // 2] if self.op == "fold" else self.args

    @property
    def bodies(self) -> tuple[Expr, ...]:
        """The expressions that a loop evaluates at each turn; empty for other nodes."""
        return self.args[len(self.outside) :]

    def __setattr__(self, name: str, value: Any) -> Never:
        raise fault(f"{name!r} of a recorded value is assigned", "values do not change: compute another one")

    def __hash__(self) -> int:
        return id(self)

    __bool__ = refused(
        "a recorded value has no truth yet (`if`, `and`, `or`, `not`, `min`, `max` ask for it)",
        "use where(condition, a, b), and & | ~ on conditions",
    )
    __float__ = refused(
        "a recorded value is not a Python number yet (math.* and float() ask for one)",
        "use the functions of twodof.blocks, such as sin or sqrt",
    )
    __int__ = refused(
        "a recorded value is not a Python integer yet (int() and range() ask for one)",
        "use to_int32, or loop over a constant",
    )
    __index__ = __int__
    __pow__ = refused("** is not an operation of the language", "write x * x, or pow(x, y)")
    __rpow__ = __pow__

    def __iter__(self) -> Iterator[Expr]:
        if self.width is None:
            raise fault("a scalar is iterated over", "iterate over an array, made with vector([...])")
        return (self[i] for i in range(self.width))

    def __len__(self) -> int:
        if self.width is None:
            raise fault("a scalar has no length", "give an array, made with vector([...])")
        return self.width

    def __getitem__(self, index: Any) -> Any:
        if self.width is None:
            raise fault(f"a scalar {self.kind} is indexed", "index an array, made with vector([...])")
        if isinstance(index, (slice, tuple)):
            return rules.part(self, index)
        return node("select", self.kind, (self, position(index, self.width)))

    @property
    def shape(self) -> tuple[int, ...]:
        """() of a scalar, (n,) of an array."""
        return () if self.width is None else (self.width,)

    @property
    def T(self) -> Expr:
        """A vector itself: it is both a row and a column."""
        if self.width is None:
            raise fault("a scalar has no transpose", "only arrays have one")
        return self

    def __repr__(self) -> str:
        shape = "" if self.width is None else f"[{self.width}]"
        if not self.args:
            return f"{self.op}:{self.data}:{self.kind}{shape}"
        return f"{self.op}({len(self.args)} args):{self.kind}{shape}"

    @staticmethod
    def operation(op: str, *operands: Any) -> Any:
        return _unary(op, *operands) if len(operands) == 1 else _binary(op, *operands)


_REMEDY = {
    "div": "use // on integers (it truncates)",
    "quot": "use floor(x / y) on reals",
    "rem": "use x - y * floor(x / y) on reals",
}


def node(op: str, kind: str, args: tuple[Expr, ...] = (), data: Any = None, width: int | None = None) -> Expr:
    """Return the one node with these fields (hash-consed). Internal: the functions below check their arguments."""
    tag = data.hex() if isinstance(data, float) else data
    key = (op, kind, width, tuple(map(id, args)), tag)
    found = _table.get(key)
    if found is None:
        room = ROOM.get()
        if room is not None:
            room[0] -= 1
            if room[0] < 0:
                raise DiagramError("it records too many operations", TRACING.get(), "compute less, or in loops")
        found = Expr.__new__(Expr)
        for name, value in (("op", op), ("kind", kind), ("width", width), ("args", args), ("data", data)):
            object.__setattr__(found, name, value)
        object.__setattr__(found, "loops", _loops(found))
        _table[key] = found
    lines = LINES.get()
    if lines is not None and args and id(found) not in lines:
        lines[id(found)] = users_line()
    return found


def _loops(item: Expr) -> int:
    if item.op == "bound":
        depth: int = item.data[0]
        return 1 << depth
    found = 0
    for body in item.bodies if item.op in LOOPS else ():
        found |= body.loops
    if found:
        found &= ~(1 << item.data[1])
    for a in item.outside:
        found |= a.loops
    return found


def const(value: Any, kind: str) -> Expr:
    """Return a constant. A float is kept as the user's double and rounded once, to the final precision."""
    if kind in FLOATS:
        return node("const", kind, (), float(value))
    if kind == "bool":
        return node("const", "bool", (), bool(value))
    whole = value.value if isinstance(value, Integer) else int(value)
    if kind in STORED and not numbers.fits(whole, kind):
        raise fault(f"the literal {whole} is given for {kind}", f"write one from {_range(kind)}, or convert by name")
    return node("const", kind, (), numbers.INTEGER_TYPES[kind](whole).value)


def _range(kind: str) -> str:
    return f"{BY_NAME[kind].low} to {BY_NAME[kind].high}"


def leaf(op: str, name: str, kind: str, width: int | None = None) -> Expr:
    """Return an input, state or parameter by name (`op` is one of LEAVES)."""
    return node(op, kind, (), name, width)


def as_expr(value: Any, kind: str | None = None) -> Expr:
    """`value` as a scalar Expr of `kind` (of its own kind if None). Raises DiagramError if that needs a conversion."""
    if isinstance(value, Expr):
        if kind is not None and value.kind != kind:
            raise fault(f"{value.kind} meets {kind} in one operation", by_name(value.kind, kind))
        return value
    if isinstance(value, (np.ndarray, list, tuple)):
        raise fault(
            "a Python list or array is used as a scalar", "make an array with vector([...]), or take one element"
        )
    # A number of numpy is a literal here: the precision that it has is not the build's.
    found = "real" if isinstance(value, np.floating) else numbers.kind_of(value)
    if kind is None or found == kind:
        return const(value, found)
    if (type(value) is int and kind in INTEGERS) or (type(value) in (int, float) and kind in FLOATS):
        return const(value, kind)
    raise fault(f"the literal {value!r} meets {kind} in one operation", "write it in that type, or convert explicitly")


def by_name(one: str, other: str) -> str:
    """How to make one kind of two that meet."""
    if {one, other} <= {"real", "int32", "uint32", "bool"}:
        return "convert with to_real, to_int32 or to_uint32"
    return f"convert one of them by name: to_{other}(x), or to_{one}(y)"


def computed_in(value: Any) -> Any:
    """Return a scalar in the kind of its operations: an integer of 8 or 16 bits as int32, any other unchanged."""
    if isinstance(value, Expr):
        return node("convert", BY_NAME[value.kind].computes, (value,)) if value.kind in STORED else value
    return numbers.computed_in(value)


def of_one_kind(values: Sequence[Any]) -> Sequence[Any]:
    """`values` as they are, unless integers of 8 or 16 bits meet another kind among them: these are then int32."""
    kinds = {v.kind for v in values if isinstance(v, (Expr, Integer))}
    if len(kinds) < 2 or kinds.isdisjoint(STORED):
        return values
    return [computed_in(v) for v in values]


def position(index: Any, width: int) -> Expr:
    """Return the int32 index of an element in an array of `width` elements, from a number, literal or Expr."""
    if not isinstance(index, Expr):
        try:
            return const(numbers.clamp_index(index, width), "int32")
        except DiagramError as error:
            raise fault(error.what, error.remedy) from None
    at: Expr = computed_in(index) if index.width is None else index
    if at.kind not in WORDS or at.width is not None:
        raise fault(f"an array is indexed with a {index.kind}", "convert the index with to_int32")
    if at.kind == "int32":
        return at
    # Clamped as a signed number would be: a uint32 above 2^31 is above every length.
    return as_expr(where(index < width, to_int32(index), int32(width - 1)))


_ARRAYS = (ArrayOperators, list, tuple, np.ndarray)


def _pair(a: Any, b: Any) -> tuple[Expr, Expr]:
    anchor = a if isinstance(a, Expr) else b
    kind = anchor.kind if isinstance(anchor, Expr) else numbers.common_kind((a, b))
    return as_expr(a, kind), as_expr(b, kind)


def scalars(op: str, *args: Expr) -> None:
    """Raise DiagramError if one of `args` is an array."""
    for a in args:
        if a.width is not None:
            raise fault(
                f"{op} is applied to an array of {a.width}", "work on its elements, with array_of(n, lambda i: ...)"
            )


def _operation(op: str, *args: Expr) -> Expr:
    scalars(op, *args)
    kind = args[0].kind
    if kind not in TAKES[op]:
        raise fault(f"{op} is not defined on {kind}", _REMEDY.get(op, f"it takes {', '.join(TAKES[op])}"))
    return node(op, "bool" if op in ("lt", "le", "eq", "ne") else kind, args)


def _binary(op: str, a: Any, b: Any) -> Any:
    if arrays_among(a, b):
        return rules.spread(lambda left, right: _binary(op, left, right), a, b)
    return _operation(op, *_pair(*map(computed_in, OPERANDS.get()(op, a, b))))


def _unary(op: str, a: Expr) -> Any:
    if a.width is not None:
        return rules.spread(lambda item: _unary(op, item), a)
    return _operation(op, computed_in(a))


def arrays_among(*values: Any) -> bool:
    """Return True if one of `values` is an array, so that an operation goes element by element."""
    for v in values:
        if type(v) is Expr:
            if v.width is not None:
                return True
        elif isinstance(v, _ARRAYS):
            return True
    return False


def traced(*values: Any) -> bool:
    """Return True if an operation on `values` must be recorded: one is an Expr, or a block is being traced."""
    # While a block is traced even literals are recorded: folded here, they would round in this run's precision.
    if TRACING.get():
        return True
    return Expr in map(type, values)  # any() would cost the reference's innermost loop twice the time


def where(condition: Any, a: Any, b: Any) -> Any:
    """Return `a` where the condition holds, else `b`; both are evaluated, arrays element by element.

    Two literals give a real.
    """
    # What the reference meets all the time comes first: two numbers of one type of the language.
    if type(condition) is np.bool_ and type(a) is type(b) and type(a) in numbers.scalars() and not TRACING.get():
        return a if condition else b
    if arrays_among(condition, a, b):
        return rules.spread(where, condition, a, b)
    if traced(condition, a, b):
        c = as_expr(condition, "bool")
        left, right = _pair(*of_one_kind((a, b)))
        scalars("where", c, left, right)
        return node("where", left.kind, (c, left, right))
    a, b = of_one_kind((a, b))
    return numbers.cast(a if condition else b, numbers.common_kind((a, b)))


def minimum(a: Any, b: Any) -> Any:
    """`where(a < b, a, b)`: of two equals the second, and `b` if one is NaN."""
    return rules.spread(minimum, a, b) if arrays_among(a, b) else where(_less(a, b), a, b)


def maximum(a: Any, b: Any) -> Any:
    """`where(b < a, a, b)`: of two equals the second, and `b` if one is NaN."""
    return rules.spread(maximum, a, b) if arrays_among(a, b) else where(_less(b, a), a, b)


def _less(a: Any, b: Any) -> Any:
    return a < b if traced(a, b) else np.bool_(a < b)


def sqrt(x: Any) -> Any:
    """Return the IEEE square root of a float, in its precision; NaN below zero."""
    if arrays_among(x):
        return rules.spread(sqrt, x)
    if traced(x):
        return _operation("sqrt", as_float(x))
    return np.sqrt(numbers.cast(x, float_kind((x,))))


def float_kind(values: Iterable[Any]) -> str:
    """Return the kind of the first of `values` that is a float and no literal; "real" if there is none."""
    for v in values:
        kind = v.kind if isinstance(v, Expr) else numbers.kind_of(v) if isinstance(v, np.floating) else ""
        if kind in FLOATS:
            return kind
    return "real"


def as_float(value: Any) -> Expr:
    """`value` as an Expr of its own float kind, a literal as a real. Raises DiagramError for what is not a float."""
    return as_expr(value, value.kind if isinstance(value, Expr) and value.kind in FLOATS else "real")


def real(value: float) -> Any:
    """Return a real literal as a number of the current precision (needed only without another real operand)."""
    return const(value, "real") if recording() else numbers.cast(float(value), "real")


def int32(value: int) -> Int32:
    """Return an int32 literal."""
    return Int32(value)


def uint32(value: int) -> UInt32:
    """Return a uint32 literal."""
    return UInt32(value)


def to_int32(x: Any) -> Any:
    """To int32: a float truncates and saturates, NaN gives 0; uint32 keeps its bits; bool gives 0 or 1."""
    return convert(x, "int32")


def to_uint32(x: Any) -> Any:
    """To uint32: a float truncates and saturates, NaN gives 0; int32 keeps its bits; bool gives 0 or 1."""
    return convert(x, "uint32")


def to_real(x: Any) -> Any:
    """To real, rounded to nearest; a real is returned as it is; bool gives 0 or 1."""
    return convert(x, "real")


def convert(x: Any, kind: str) -> Any:
    """`x` as the type `kind`; see to_int32, to_uint32 and to_real. A kind of 8 or 16 bits keeps an integer's low bits.

    What is of such a kind, or becomes it, is an int32 on the way.
    """
    if arrays_among(x):
        return rules.spread(lambda item: convert(item, kind), x)
    if traced(x):
        x = as_expr(x)
        if x.kind == kind:
            return x
        if x.kind == "bool":
            return where(x, const(1, kind), const(0, kind))
        if x.kind in STORED:
            return convert(computed_in(x), kind)
        return node("convert", kind, (convert(x, "int32") if kind in STORED else x,))
    if numbers.kind_of(x) not in FLOATS:
        return numbers.scalar_types()[kind](x.value if isinstance(x, Integer) else bool(x))
    if kind in FLOATS:
        return numbers.scalar_types()[kind](x)
    if kind in STORED:
        return convert(convert(x, "int32"), kind)
    low, high = float(BY_NAME[kind].low), float(BY_NAME[kind].high)
    return numbers.INTEGER_TYPES[kind](0 if x != x else int(min(max(float(x), low), high)))


def multiply_high(a: Any, b: Any) -> Any:
    """Return the upper 32 bits of the 64-bit product of two uint32."""
    if traced(a, b):
        left, right = as_expr(a, "uint32"), as_expr(b, "uint32")
        scalars("multiply_high", left, right)
        return node("mulhi", "uint32", (left, right))
    return UInt32(numbers.cast(a, "uint32").value * numbers.cast(b, "uint32").value >> 32)


def bits_of(x: Any, word: int = 0) -> Any:
    """Return a 32-bit word of a real's IEEE pattern as uint32: word 0 the lower, word 1 the upper (float64 only).

    NaN reads as the canonical quiet NaN. The meaning depends on the precision: for definitions of elementary
    functions only, which exist once a precision.
    """
    if traced(x):
        return node("bits", "uint32", (as_expr(x, "real"),), word)
    x = numbers.cast(x, "real")
    x = numbers.real_type()("nan") if x != x else x
    pattern = int.from_bytes(np.abs(x).tobytes() if x != x else x.tobytes(), "little")
    return UInt32(pattern >> (32 * word))


def from_bits(low: Any, high: Any = None) -> Any:
    """Return the real with these IEEE words, as many as the build's precision has; undo `bits_of`.

    `low` alone is a float32, `low` and `high` are a float64.
    """
    if traced(low, high):
        words = (as_expr(low, "uint32"),) if high is None else (as_expr(low, "uint32"), as_expr(high, "uint32"))
        return node("from_bits", "real", words)
    if high is None:
        return np.uint32(numbers.cast(low, "uint32").value).view(np.float32)
    pattern = numbers.cast(high, "uint32").value << 32 | numbers.cast(low, "uint32").value
    return np.uint64(pattern).view(np.float64)


def call(name: str, *args: Expr) -> Expr:
    """Return a call of the elementary function `name`, defined in `twodof.blocks.elementary.functions`, on floats."""
    kind = float_kind(args)
    values = tuple(as_expr(a, kind) for a in args)
    scalars(name, *values)
    return node("call", kind, values, name)
