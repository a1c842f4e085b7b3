"""MATLAB's operators and functions on arrays that hold recorded signals, in MATLAB's classes.

Logical values compute as doubles. An integer wins over a double: it is computed in double, rounded half away from 0,
and saturated. Single is computed in the precision of the build, as in the rest of a model.
"""

import math
import operator
from collections.abc import Callable, Sequence
from functools import partial, reduce
from operator import and_, or_
from typing import Any

import numpy as np

from twodof.blocks.elementary import functions
from twodof.blocks.expressions.conversions import to_float64, to_stored
from twodof.blocks.expressions.expr import Expr, convert, minimum, sqrt, where
from twodof.blocks.expressions.numbers import INTEGER_TYPES, STORED, UInt32
from twodof.slx.matlab.values import (
    FUNCTIONS,
    KINDS,
    Array,
    NotComputed,
    Value,
    as_array,
    cast,
    class_of,
    converted,
    filled,
    is_literal,
    is_signal,
    kind_of,
    lifted,
    scalar,
)

Elementwise = Callable[..., Any]


def _double(element: Any) -> Any:
    return to_float64(float(element) if is_literal(element) else element)


def _common(*elements: Any) -> str:
    """Return the class in which MATLAB computes with elements of these classes."""
    kinds = {kind_of(one) for one in elements}
    if "float64" in kinds:
        raise NotComputed("whole numbers of 64 bits are not computed: convert them to double")
    whole = kinds & INTEGER_TYPES.keys()
    if len(whole) > 1:
        raise NotComputed(f"{' and '.join(sorted(kinds))} in one operation")
    return whole.pop() if whole else "real"


def _arithmetic(compute: Elementwise) -> Elementwise:
    """Return an operation in the common class of its operands."""

    def operate(*elements: Any) -> Any:
        kind = _common(*elements)
        if kind in INTEGER_TYPES:
            return cast(compute(*map(_double, elements)), kind)
        if all(map(is_literal, elements)):
            with np.errstate(all="ignore"):
                found = compute(*map(np.float64, elements))
                return found if isinstance(found, Expr) else float(found)
        return compute(*(cast(one, kind) for one in elements))

    return operate


def _comparison(compute: Elementwise) -> Elementwise:
    def compare(a: Any, b: Any) -> Any:
        kinds = {kind_of(a), kind_of(b)}
        if "bool" in kinds and kinds <= {"bool", "real"}:
            a, b = cast(a, "real"), cast(b, "real")
        elif len(kinds) > 1:
            a, b = _double(a), _double(b)
        return compute(a, b)

    return compare


def _logical(compute: Elementwise) -> Elementwise:
    return lambda *elements: compute(*(cast(one, "bool") for one in elements))


def _not(element: Any) -> Any:
    truth = cast(element, "bool")
    return not truth if is_literal(truth) else ~truth


def _power(x: Any, y: Any) -> Any:
    if is_literal(y) and float(y) in (1.0, 2.0, 3.0):
        return reduce(operator.mul, [x] * int(y))
    if is_literal(y) and y == 0.5:
        return sqrt(x)
    return functions.pow(x, y)


_add, _subtract, _times, _divide = map(_arithmetic, (operator.add, operator.sub, operator.mul, operator.truediv))
_less, _greater = _comparison(operator.lt), _comparison(operator.gt)


def _each(compute: Elementwise) -> Callable[..., Array]:
    """Return the operation on arrays, element by element, scalars with every size."""

    def operate(*arrays: Value) -> Array:
        lifts = [lifted(as_array(one)) for one in arrays]
        try:
            shape = np.broadcast_shapes(*(one.shape for one in lifts))
        except ValueError:
            sizes = " and ".join(f"{one.shape[0]} by {one.shape[1]}" for one in lifts)
            raise NotComputed(f"arrays of {sizes} do not fit each other") from None
        columns = (np.broadcast_to(one, shape).flatten(order="F") for one in lifts)
        return filled(shape, map(compute, *columns))

    return operate


def _product(a: Array, b: Array) -> Array:
    """Return the matrix product; each element is summed from the left."""
    if a.size == 1 or b.size == 1:
        return _each(_times)(a, b)
    if a.shape[1] != b.shape[0]:
        raise NotComputed(f"a product of {a.shape[0]} by {a.shape[1]} and {b.shape[0]} by {b.shape[1]}")
    left, right = lifted(a), lifted(b)
    return filled(
        (a.shape[0], b.shape[1]),
        (reduce(_add, (_times(x, y) for x, y in zip(row, column, strict=True))) for column in right.T for row in left),
    )


def _matrix_power(a: Array, b: Array) -> Array:
    if a.size == b.size == 1:
        return _each(_arithmetic(_power))(a, b)
    if is_signal(b) or b.size != 1 or not 0 < float(b.flat[0]) <= 16 or not float(b.flat[0]).is_integer():
        raise NotComputed("this power of a matrix with signals is not translated")
    return reduce(_product, [a] * int(b.flat[0]))


def truth(value: Value) -> Any:
    """Return whether an `if` holds: a bool for a constant, else a signal."""
    array = as_array(value)
    if not is_signal(array):
        return bool(array.size and np.all(array))
    return reduce(and_, (cast(one, "bool") for one in array.flatten())) if array.size else False


def chosen(condition: Any, a: Value, b: Value, name: str) -> Value:
    """Return `a` where the condition holds, else `b`. Raises NotComputed for values of two classes or sizes."""
    if a is b:
        return a
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return {key: chosen(condition, a[key], b[key], f"{name}.{key}") for key in a}
    if not isinstance(a, np.ndarray) or not isinstance(b, np.ndarray):
        if type(a) is type(b) and not isinstance(a, dict | list) and a == b:
            return a
        raise NotComputed(f"{name} has values in two branches that are not one class")
    if a.shape != b.shape:
        sizes = " and ".join(f"{one.shape[0]} by {one.shape[1]}" for one in (a, b))
        raise NotComputed(f"{name} is {sizes} in two branches")
    if not is_signal(a) and not is_signal(b) and a.dtype == b.dtype and a.tobytes() == b.tobytes():
        return a
    if class_of(a) != class_of(b):
        raise NotComputed(f"{name} is {class_of(a)} and {class_of(b)} in two branches")
    pairs = zip(lifted(a).flatten(order="F"), lifted(b).flatten(order="F"), strict=True)
    return filled(a.shape, (one if one is other else where(condition, one, other) for one, other in pairs))


def _both(compute: Elementwise) -> Callable[[Array, Array], Array]:
    return lambda a, b: filled((1, 1), [compute(truth(a), truth(b))])


OPERATORS: dict[str, Callable[..., Array]] = {
    "+": _each(_add), "-": _each(_subtract), ".*": _each(_times), "./": _each(_divide),
    ".\\": _each(lambda a, b: _divide(b, a)), "*": _product, ".^": _each(_arithmetic(_power)), "^": _matrix_power,
    "/": _each(_divide), "\\": _each(lambda a, b: _divide(b, a)),
    "<": _each(_less), ">": _each(_greater), "<=": _each(_comparison(operator.le)),
    ">=": _each(_comparison(operator.ge)), "==": _each(_comparison(operator.eq)),
    "~=": _each(_comparison(operator.ne)), "!=": _each(_comparison(operator.ne)), "&": _each(_logical(and_)),
    "|": _each(_logical(or_)), "&&": _both(and_), "||": _both(or_), "~": _each(_not),
    "negative": _each(_arithmetic(operator.neg)),
}  # fmt: skip


def in_c(operator_: str, left: Value, right: Value, wraps: bool) -> tuple[str, Value, Value]:
    """Return an operation of C as one of `OPERATORS`, with its operands converted by C's rules.

    Whole numbers and truth are of int32, or uint32 beside one of these; beside a double they are doubles. Overflow
    saturates, or `wraps`. Source: C11, 6.3.1.1 and 6.3.1.8, for an int of 32 bits.
    """
    a, b = as_array(left), as_array(right)
    kinds = [class_of(one) for one in (a, b)]
    whole = operator_ in ("+", "-", "*", "/", "bitand", "bitor", "bitshift")
    if not whole or {*kinds} == {"real"} or "float64" in kinds:
        return operator_, left, right
    if "real" in kinds:
        return operator_, converted(a, "real"), converted(b, "real")
    word = "uint32" if "uint32" in kinds else "int32"
    signed = [one for one, kind in zip((a, b), kinds, strict=True) if kind[0] == "i"]
    if word == "uint32" and any(isinstance(v, Expr) or v.value < 0 for one in signed for v in lifted(one).flat):
        raise NotComputed(f"{' and '.join(kinds)} in one operation of C is not translated")
    if operator_ == "/" and any(isinstance(v, Expr) or v == 0 for v in lifted(b).flat):
        raise NotComputed("a quotient of whole numbers in C by another number than a literal is not translated")
    named = "whole /" if operator_ == "/" else f"wrapped {operator_}" if wraps and len(operator_) == 1 else operator_
    return named, converted(a, word), converted(b, word)


def wrapped(array: Array, kind: str) -> Array:
    """Return whole numbers as those of another class, without the bits that it does not hold."""
    fit = (lambda one: to_stored(one, kind, "wrap")) if kind in STORED else (lambda one: convert(one, kind))
    return _each(fit)(array)


OPERATORS |= {f"wrapped {name}": _each(of) for name, of in (("+", operator.add), ("-", operator.sub))}
OPERATORS |= {"wrapped *": _each(operator.mul)}
OPERATORS |= {"whole /": _each(lambda a, b: cast(functions.trunc(_double(a) / _double(b)), kind_of(a)))}


# --- functions


def _rounded(compute: Elementwise) -> Elementwise:
    return lambda element: element if kind_of(element) in INTEGER_TYPES else _float(compute)(element)


def _float(compute: Elementwise) -> Elementwise:
    """Return a function of floats: logical values are doubles to it, integers have none."""

    def operate(*elements: Any) -> Any:
        kind = _common(*elements)
        if kind in INTEGER_TYPES:
            raise NotComputed(f"a function of floats meets {kind}")
        return compute(*(cast(one, kind) for one in elements))

    return operate


def _is_nan(x: Any) -> Any:
    return x != x


def _better(larger: bool) -> Elementwise:
    """Return whether the second element is to be taken: it is beyond the first, or the first is NaN and it is not."""

    def better(a: Any, b: Any) -> Any:
        beyond = b > a if larger else b < a
        return beyond if kind_of(a) in INTEGER_TYPES else beyond | (_is_nan(a) & (b == b))

    return better


def _extreme(larger: bool) -> Callable[..., Any]:
    better = _better(larger)

    def two(a: Any, b: Any) -> Any:
        kind = _common(a, b)
        if is_literal(a) and is_literal(b):
            return float((np.fmax if larger else np.fmin)(a, b))
        a, b = cast(a, kind), cast(b, kind)
        return where(better(a, b), b, a)

    def position(a: tuple[Any, Any], b: tuple[Any, Any]) -> tuple[Any, Any]:
        kind = _common(a[0], b[0])
        first, second = cast(a[0], kind), cast(b[0], kind)
        if is_literal(first) and is_literal(second):
            taken = second > first if larger else second < first
            return b if taken or (first != first and second == second) else a
        taken = better(first, second)
        return where(taken, second, first), where(taken, b[1], a[1])

    def compute(*values: Value, count: int = 1) -> Value:
        if len(values) == 2 and as_array(values[1]).size:
            return _each(two)(*values)
        array = lifted(as_array(values[0]))
        if count == 1:
            return _reduced(two)(array, *values[2:])
        if len(values) > 1 or 1 not in array.shape:
            raise NotComputed("the place of an extreme is found in a vector only")
        best, at = reduce(position, ((one, float(k + 1)) for k, one in enumerate(array.flatten(order="F"))))
        return [filled((1, 1), [best]), filled((1, 1), [at])]

    return compute


def _reduced(two: Elementwise, one: Elementwise = lambda v: v) -> Callable[..., Array]:
    """Return a function that takes the elements along a dimension together, from the first on."""

    def compute(value: Value, dimension: Value = None) -> Array:
        array = lifted(as_array(value))
        axis = int(scalar(dimension)) - 1 if dimension is not None else 1 if array.shape[0] == 1 else 0
        if axis not in (0, 1) or not array.size:
            raise NotComputed("this dimension is not translated")
        lines = array.T if axis == 0 else array
        made = filled((len(lines), 1), (reduce(two, map(one, line)) for line in lines))
        return made.T if axis == 0 else made

    return compute


def _number(element: Any) -> Any:
    return cast(element, "real") if kind_of(element) == "bool" else element


def _remainder(x: Any, y: Any) -> Any:
    """Return the exact remainder of x / y with the sign of x, as C's fmod; NaN for y = 0."""
    whole = functions.trunc(x / y)
    # whole * y and its rounding error, by Veltkamp's and Dekker's products: their difference to x is exact.
    parts = []
    for factor in (whole, y):
        split = factor * 134217729.0
        high = split - (split - factor)
        parts += [high, factor - high]
    rounded = whole * y
    error = ((parts[0] * parts[2] - rounded) + parts[0] * parts[3] + parts[1] * parts[2]) + parts[1] * parts[3]
    left = (x - rounded) - error
    size = abs(y)
    left = where((left != 0.0) & ((left < 0.0) != (x < 0.0)), left + where(x < 0.0, -size, size), left)
    return where(size == math.inf, where(abs(x) == math.inf, math.nan, x), left)


def _near_multiple(x: Any, y: Any) -> Any:
    """Return whether x / y is a whole number but for rounding, where y is none: MATLAB's remainders are 0 there."""
    ratio = abs(x / y)
    off = abs(ratio - functions.floor(ratio + 0.5))
    return (y != functions.floor(y)) & (off <= float(np.finfo(float).eps) * ratio)


def rem(x: Any, y: Any) -> Any:
    """Return the exact remainder with the sign of x; NaN for y = 0. Source: Simulink, Math Function, rem."""
    return where(_near_multiple(x, y), 0.0, _remainder(x, y))


def mod(x: Any, y: Any) -> Any:
    """Return the remainder with the sign of y; x for y = 0. Source: Simulink, Math Function, mod."""
    left = _remainder(x, y)
    turned = where((left != 0.0) & ((x < 0.0) != (y < 0.0)), left + y, left)
    return where(y == 0.0, x, where(_near_multiple(x, y), 0.0, turned))


def _sine(x: Any, quarters: float = 0.0) -> Any:
    """Return the sine of x degrees and some right angles: exact at multiples of 90."""
    whole = functions.round_half_away(x / 90.0)
    left = (x - whole * 90.0) * (math.pi / 180.0)
    whole = whole + quarters
    quarter = whole - 4.0 * functions.floor(whole / 4.0)
    size = where((quarter == 1.0) | (quarter == 3.0), functions.cos(left), functions.sin(left))
    return where(quarter >= 2.0, -size, size)


def _in_degrees(name: str, *elements: Any) -> Any:
    return getattr(functions, name)(*elements) * (180.0 / math.pi)


def _wrapped(x: Any, half: float, symmetric: bool) -> Any:
    """Return an angle from 0 to two halves; if symmetric, from -half to half. A bound keeps its sign."""
    if symmetric:
        return where(abs(x) > half, _wrapped(x + half, half, False) - half, x)
    left = mod(x, 2.0 * half)
    return where((left == 0.0) & (x > 0.0), 2.0 * half, left)


def _bits(compute: Elementwise) -> Elementwise:
    def operate(a: Any, b: Any) -> Any:
        kind = _common(a, b)
        if kind not in INTEGER_TYPES:
            raise NotComputed("bits of a double are not translated: convert it to an integer")
        found = compute(cast(a, kind), cast(b, kind))
        return to_stored(found, kind, "wrap") if kind in STORED else found

    return operate


_BYTES = {"int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4}


def _shift(element: Any, by: Any) -> Any:
    """Return bits shifted to the left, or for a negative `by` to the right, where a signed number keeps its sign."""
    kind = kind_of(element)
    if kind not in _BYTES:
        raise NotComputed(f"a shift of {kind} is not translated")
    wide = convert(element, "uint32" if kind.startswith("u") else "int32")
    zero = INTEGER_TYPES[kind_of(wide)](0)
    if is_literal(by):
        size = min(abs(int(by)), 31)
        up, down, inside, right = wide << size, wide >> size, abs(by) < 32, by < 0
        return convert(down if right and (inside or kind[0] == "i") else up if inside and not right else zero, kind)
    count = convert(by, "int32")
    size = abs(count)
    inside, size = size < 32, convert(minimum(size, 31), kind_of(wide))
    down = wide >> size
    kept = down if kind.startswith("i") else where(inside, down, zero)
    return convert(where(count < 0, kept, where(inside, wide << size, zero)), kind)


def _with_bit(value: Value, place: Value, bit: Value = None) -> Array:
    """Return integers with the bit of this number, from 1, set or cleared."""

    def one(element: Any, on: Any) -> Any:
        kind, word = kind_of(element), convert(element, "uint32")
        mask = UInt32(1 << int(scalar(place)) - 1)
        return convert(where(cast(on, "bool"), word | mask, word & ~mask), kind)

    return _each(one)(_whole(value), np.ones((1, 1)) if bit is None else bit)


def _whole(value: Value) -> Array:
    """Return an array of integers. Raises NotComputed for another class."""
    if class_of(as_array(value)) not in _BYTES:
        raise NotComputed("bits of a double are not translated: convert it to an integer")
    return as_array(value)


def _typecast(value: Value, kind: Value) -> Array:
    """Return the bytes of integers, the lowest first, as integers of another class."""
    array = lifted(_whole(value))
    if kind not in _BYTES:
        raise NotComputed(f"typecast to {kind} is not translated")
    old, new = _BYTES[class_of(array)], _BYTES[kind]
    words = [convert(one, "uint32") for one in array.flatten(order="F")]
    parts = [word >> 8 * k & 255 for word in words for k in range(old)]
    if len(parts) % new:
        raise NotComputed(f"typecast of {len(parts)} bytes to {kind}")
    made = [
        convert(reduce(or_, (parts[at + k] << 8 * k for k in range(new))), kind) for at in range(0, len(parts), new)
    ]
    return filled((1, len(made)) if array.shape[0] == 1 else (len(made), 1), made)


_SHAPES = ("reshape", "transpose", "numel", "size", "length", "repmat", "diag", "isempty", "fliplr", "flipud",
           "horzcat", "vertcat", "isreal", "isscalar", "isvector", "isrow", "iscolumn", "isnumeric", "ischar",
           "isstruct", "circshift", "tril", "triu")  # fmt: skip
"""Functions that arrange elements, whatever they are."""
SIGNAL_FUNCTIONS: dict[str, Callable[..., Value]] = {
    **{name: _each(_float(getattr(functions, name))) for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2",
       "tanh", "exp", "log", "hypot")},
    "sqrt": _each(_float(sqrt)), "abs": _each(_arithmetic(abs)),
    "sign": _each(_arithmetic(lambda x: where(x > 0.0, 1.0, where(x < 0.0, -1.0, x)))),
    "floor": _each(_rounded(functions.floor)), "ceil": _each(_rounded(functions.ceil)),
    "fix": _each(_rounded(functions.trunc)), "round": _each(_rounded(functions.round_half_away)),
    "sinc": _each(_float(lambda x: where(x == 0.0, 1.0, functions.sin(math.pi * x) / (math.pi * x)))),
    "sinh": _each(_float(lambda x: (functions.exp(x) - functions.exp(-x)) / 2.0)),
    "cosh": _each(_float(lambda x: (functions.exp(x) + functions.exp(-x)) / 2.0)),
    "sec": _each(_float(lambda x: 1.0 / functions.cos(x))), "csc": _each(_float(lambda x: 1.0 / functions.sin(x))),
    "cot": _each(_float(lambda x: 1.0 / functions.tan(x))), "sind": _each(_float(_sine)),
    "cosd": _each(_float(lambda x: _sine(x, 1.0))), "tand": _each(_float(lambda x: _sine(x) / _sine(x, 1.0))),
    **{f"{name}d": _each(_float(partial(_in_degrees, name))) for name in ("asin", "acos", "atan", "atan2")},
    **{f"wrapTo{end}": _each(_float(partial(_wrapped, half=half, symmetric=symmetric))) for end, half, symmetric in
       (("Pi", math.pi, True), ("2Pi", math.pi, False), ("180", 180.0, True), ("360", 180.0, False))},
    "deg2rad": _each(_float(lambda x: x * (math.pi / 180.0))), "max": _extreme(True), "min": _extreme(False),
    "rad2deg": _each(_float(lambda x: x * (180.0 / math.pi))), "sum": _reduced(_add, _number),
    "prod": _reduced(_times, _number), "realsqrt": _each(_float(sqrt)),
    "any": _reduced(or_, lambda one: cast(one, "bool")), "all": _reduced(and_, lambda one: cast(one, "bool")),
    "mod": _each(_arithmetic(mod)), "rem": _each(_arithmetic(rem)), "isnan": _each(_is_nan),
    "isinf": _each(_float(lambda x: abs(x) == math.inf)), "isfinite": _each(_float(lambda x: abs(x) < math.inf)),
    "not": OPERATORS["~"], "bitshift": _each(_shift), "xor": _each(_logical(operator.ne)),
    "bitand": _each(_bits(and_)), "bitor": _each(_bits(or_)), "bitxor": _each(_bits(operator.xor)),
    "bitset": _with_bit, "typecast": _typecast,
    "bitget": lambda a, k: _each(lambda one: convert(convert(one, "uint32") >> int(scalar(k)) - 1 & 1, kind_of(one)))(
        _whole(a)
    ),
    "cast": lambda value, kind: SIGNAL_FUNCTIONS[kind](value),
}  # fmt: skip


def _conversion(kind: str) -> Callable[[Value], Array]:
    return lambda value: converted(as_array(value), kind)


_CLASSES = {"double": "real", "single": "real", "logical": "bool", "boolean": "bool"}
SIGNAL_FUNCTIONS |= {name: _conversion(_CLASSES.get(name, name)) for name in KINDS if not name.endswith("int64")}


def of_signals(name: str, arguments: Sequence[Value], count: int = 1) -> Value:
    """Return a function of arrays of which some hold signals; for `count` results of max and min, their list.

    Raises NotComputed for a function that is not translated.
    """
    if name in _SHAPES:
        return FUNCTIONS[name](*arguments)
    if name not in SIGNAL_FUNCTIONS:
        raise NotComputed(f"{name} of a signal is not translated")
    return SIGNAL_FUNCTIONS[name](*arguments, **({"count": count} if count > 1 else {}))
