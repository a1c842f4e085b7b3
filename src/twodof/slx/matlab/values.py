"""Values of the MATLAB subset: arrays, texts, structures, cells; operators and functions on them."""

import math
import re
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from functools import reduce
from itertools import product
from operator import and_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.elementary.functions import round_half_away
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.arrays import vector
from twodof.blocks.expressions.conversions import to_float64, to_stored
from twodof.blocks.expressions.expr import Expr, convert, to_int32, where
from twodof.blocks.expressions.numbers import FLOATS, INTEGER_TYPES, WORDS

Array = NDArray[Any]
Value = Any
"""An array, a text, a structure, a list of structures or a cell array."""
MOST_ELEMENTS = 1_000_000
MOST_STRUCTURES = 10_000
KINDS = {
    "double": np.float64, "single": np.float32, "int8": np.int8, "int16": np.int16, "int32": np.int32,
    "int64": np.int64, "uint8": np.uint8, "uint16": np.uint16, "uint32": np.uint32, "uint64": np.uint64,
    "logical": np.bool_, "boolean": np.bool_,
}  # fmt: skip


class MatlabTable(np.ndarray):
    """Numbers of a table, of which braces take elements too."""


class Members(dict[str, Value]):
    """An enumeration: the numbers of its members by name."""


class Cells(list[Value]):
    """A cell array: its cells row after row, of which each has this many."""

    def __init__(self, rows: Sequence[Sequence[Value]]) -> None:
        super().__init__(value for row in rows for value in row)
        self.columns = len(rows[0]) if rows else 0
        if any(len(row) != self.columns for row in rows):
            raise NotComputed("the rows of a cell array differ in length")

    @property
    def shape(self) -> tuple[int, int]:
        """Return rows and columns."""
        return len(self) // max(self.columns, 1), self.columns

    def place(self, *index: int) -> int:
        """Return where the cell at a row and a column is, or at one index, which counts down the columns."""
        rows, columns = self.shape
        row, column = (
            index if len(index) == 2 else ((index[0] - 1) % max(rows, 1) + 1, (index[0] - 1) // max(rows, 1) + 1)
        )
        if not (1 <= row <= rows and 1 <= column <= columns):
            raise NotComputed(f"no cell {index[0]}")
        return (row - 1) * columns + column - 1


class String(str):
    """A text in double quotes: it is compared as a whole, and any other text letter by letter."""

    __slots__ = ()


class NotComputed(Exception):
    """Reason why an expression is not computed: it is beyond the subset, or wrong."""


def number(value: Value) -> Value:
    """Return a value for a block: what a `Simulink.Parameter` holds in place of itself."""
    return value["Value"] if isinstance(value, dict) and "Value" in value else value


def as_array(value: Value) -> Array:
    """Return a value as an array: a text as its codes. Raises NotComputed for a structure or a cell."""
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, str):
        return np.array([[float(ord(letter)) for letter in value]])
    raise NotComputed("an array is expected")


def numeric(array: Array) -> Array:
    """Return an array with 1 and 0 for logical values."""
    return array.astype(float) if array.dtype == np.bool_ else array


def is_empty(value: Value) -> bool:
    """Return True for an array without elements."""
    return isinstance(value, np.ndarray) and value.size == 0


def scalar(value: Value) -> float:
    """Return the one number of a value. Raises NotComputed for any other."""
    array = as_array(number(value))
    if is_signal(array):
        raise NotComputed("a number that depends on signals stands where a constant is expected")
    if array.size != 1:
        raise NotComputed("one number is expected")
    return float(array.flat[0])


def bounded(value: Value) -> Value:
    """Return a result as a value. Raises NotComputed for one that is too large or complex."""
    if isinstance(value, np.ndarray) and value.size > MOST_ELEMENTS:
        raise NotComputed(f"an array has more than {MOST_ELEMENTS} elements")
    if isinstance(value, np.ndarray) and np.iscomplexobj(value):
        raise NotComputed("complex numbers are not computed")
    if isinstance(value, bool | int | float | np.generic):
        return np.array([[value]]) if isinstance(value, bool | np.generic) else np.array([[float(value)]])
    return value


def _matched(a: Array, b: Array) -> tuple[Array, Array]:
    """Return two operands in the type of the result: whole numbers and single win over double."""
    a, b = numeric(a), numeric(b)
    for kind in (np.integer, np.float32):
        for one in (a, b):
            if np.issubdtype(one.dtype, kind):
                return a.astype(one.dtype), b.astype(one.dtype)
    return a, b


def _computed(function: Callable[[Array, Array], Array]) -> Callable[[Array, Array], Array]:
    def operate(a: Array, b: Array) -> Array:
        kinds = [one.dtype for one in (a, b) if np.issubdtype(one.dtype, np.integer)]
        if kinds:  # MATLAB computes in double, rounds and saturates
            limits = np.iinfo(kinds[0])
            exact = function(a.astype(float), b.astype(float))
            return np.asarray(np.clip(_round(exact), limits.min, limits.max)).astype(kinds[0])
        return function(*_matched(a, b))

    return operate


def _left_division(a: Array, b: Array) -> Array:
    if a.size == 1:
        return b / a
    return np.linalg.solve(a, b) if a.shape[0] == a.shape[1] else np.linalg.lstsq(a, b, rcond=None)[0]


def _matrix_power(a: Array, b: Array) -> Array:
    if a.size == 1 and b.size == 1:
        return _power(a, b)
    if b.size == 1 and float(b.flat[0]).is_integer() and abs(float(b.flat[0])) < 1000:
        return np.linalg.matrix_power(a, int(b.flat[0]))
    raise ValueError("this power of a matrix is not computed")


def joined(rows: list[list[Value]]) -> Value:
    """Return the matrix of these rows; of texts their text, of structures their list."""
    if rows and all(isinstance(value, dict) for row in rows for value in row):
        return [value for row in rows for value in row]
    if rows and all(isinstance(value, str) for row in rows for value in row):
        return "".join(value for row in rows for value in row)
    if any(isinstance(value, dict | list) for row in rows for value in row):
        raise NotComputed("an array of structures or cells is not computed")
    if any(is_signal(value) for row in rows for value in row):
        return _joined_signals([[as_array(value) for value in row] for row in rows])
    try:
        made = [np.hstack([as_array(v) for v in row if as_array(v).size] or [np.zeros((0, 0))]) for row in rows]
        return bounded(np.vstack([row for row in made if row.size] or [np.zeros((0, 0))]))
    except ValueError:
        raise NotComputed("the rows of a matrix differ in length") from None


def _places(index: Value, size: int) -> Array:
    if isinstance(index, str) and index == ":":
        return np.arange(size)
    array = as_array(index)
    if array.dtype == np.bool_:
        return np.flatnonzero(array.flatten(order="F"))
    places = array.astype(float).flatten(order="F") - 1
    if (places != np.floor(places)).any() or (places < 0).any() or (places >= MOST_ELEMENTS).any():
        raise NotComputed("an index is not a whole number from 1 on")
    return places.astype(int)


def indexed(value: Value, index: list[Value]) -> Value:
    """Return the elements of a value at one index or two; ":" stands for all."""
    index = _in_plane(index)
    if isinstance(value, Members) and len(index) == 1:
        # Mode(2), the member of this number
        return converted(index[0], "int32") if is_signal(index[0]) else as_array(index[0]).astype(np.int32)
    if isinstance(value, dict) and all(isinstance(i, np.ndarray) and i.size == 1 and i.flat[0] == 1 for i in index):
        return value  # s(1) of one structure
    if isinstance(value, list) and all(isinstance(one, dict) for one in value) and len(index) == 1:
        (place,) = _places(index[0], len(value)).tolist() if np.size(index[0]) == 1 else [-1]
        if 0 <= place < len(value):
            return value[place]
    if isinstance(value, dict | list) or len(index) > 2:
        raise NotComputed("an array of structures or cells, or of three dimensions, is not computed")
    if not index:
        return value
    array = as_array(value)
    flat, (rows, columns), shape = _grid(array, index)
    if not any(map(is_signal, index)):
        return flat[np.ix_(rows, columns)].reshape(shape, order="F")
    # A place outside is, as in no program, the nearest.
    elements = vector(list(converted(flat, class_of(flat)).flatten(order="F")))
    return filled(shape, (elements[c * flat.shape[0] + r] for c in columns for r in rows))


def _in_plane(index: Sequence[Value]) -> list[Value]:
    """Return indices without those of further dimensions, along which an array has one element: 1 and ":"."""
    further = [one for one in index[2:] if not isinstance(one, str) and (is_signal(one) or not np.all(one == 1))]
    return [*index] if further else [*index[:2]]


def stored(old: Value, steps: list[Any], value: Value) -> Value:
    """Return `old` with `value` stored at a path of fields, indices and, as a list, places of a cell array."""
    if not steps:
        return value
    step, rest = steps[0], steps[1:]
    if isinstance(step, str):
        made = dict(old) if isinstance(old, dict) else {}
        made[step] = stored(made.get(step), rest, value)
        return made
    if isinstance(step, list):
        if not isinstance(old, Cells):
            raise NotComputed("braces store into a cell array only")
        cells, place = copy(old), old.place(*step)
        cells[place] = stored(old[place], rest, value)
        return cells
    step = _in_plane(step)
    step = step[:1] if len(step) == 2 and isinstance(value, dict) and np.all(step[1] == 1) else step
    old = None if is_empty(old) and isinstance(value, dict) else old
    if (isinstance(value, dict) or rest) and len(step) == 1 and (old is None or isinstance(old, dict | list)):
        elements = [*old] if isinstance(old, list) else [] if old is None else [old]
        place = int(scalar(step[0])) - 1
        if not 0 <= place < MOST_STRUCTURES or not all(isinstance(one, dict) for one in elements):
            raise NotComputed(f"an array has at most {MOST_STRUCTURES} structures")
        elements += [{}] * (place + 1 - len(elements))
        elements[place] = stored(elements[place], rest, value)
        return elements[0] if len(elements) == 1 else elements
    if rest or isinstance(old, dict | list | str):
        raise NotComputed("an array of structures or cells is not computed")
    array, new = (np.zeros((0, 0)) if old is None else old), as_array(value)
    if array.ndim != 2 or new.ndim != 2 or len(step) > 2:
        raise NotComputed("an array of other than two dimensions is not computed")
    if any(map(is_signal, step)):
        return _replaced(array, step, new)
    if is_signal(array) or is_signal(new):
        new = converted(new, class_of(array) if array.size else class_of(new))
        array = lifted(array)
    elif np.issubdtype(array.dtype, np.integer):
        new = _cast(array.dtype.type)(new)
    index = step if len(step) == 2 else (np.ones((1, 1)), *step) if array.shape[0] <= 1 else (*step, np.ones((1, 1)))
    rows, columns = (_places(i, max(array.shape[n], new.shape[n])) for n, i in enumerate(index))
    shape = [max(array.shape[n], int(p.max(initial=-1)) + 1) for n, p in enumerate((rows, columns))]
    if math.prod(shape) > MOST_ELEMENTS:
        raise NotComputed(f"an array has more than {MOST_ELEMENTS} elements")
    grown = np.zeros(shape, array.dtype)
    grown[: array.shape[0], : array.shape[1]] = array
    try:
        vectors = 1 in (len(rows), len(columns)) and 1 in new.shape  # a row goes into a column, and the other way
        grown[np.ix_(rows, columns)] = new.reshape(len(rows), len(columns)) if vectors and new.size > 1 else new
    except ValueError:
        raise NotComputed("what is assigned has another size") from None
    return grown


# --- arrays that hold recorded signals: of type object, with expressions, numbers of the language and literals


def is_signal(value: Value) -> bool:
    """Return True for an array that holds recorded signals."""
    return isinstance(value, np.ndarray) and value.dtype == object


def filled(shape: tuple[int, ...], elements: Iterable[Any]) -> Array:
    """Return an array of signals, from its elements column after column."""
    made = np.empty(math.prod(shape), dtype=object)
    for k, element in enumerate(elements):
        made[k] = element
    return made.reshape(shape, order="F")


def is_literal(element: Any) -> bool:
    """Return True for a constant element that is a double or logical."""
    return type(element) in (int, float, bool)


def kind_of(element: Any) -> str:
    """Return the kind of an element in the block language; a single is real, and stays single."""
    found = element.kind if isinstance(element, Expr) else numbers.kind_of(element)
    return "real" if found == "float32" else found


def class_of(array: Array) -> str:
    """Return the kind of all elements; where several meet, of the array that MATLAB makes of them."""
    kinds = [kind_of(element) for element in lifted(array).flatten(order="F")]
    if "float64" in kinds:  # what holds a whole number of 64 bits
        if set(kinds) != {"float64"}:
            raise NotComputed("a whole number of 64 bits beside others is not translated: convert it")
        return "float64"
    whole = [kind for kind in kinds if kind in INTEGER_TYPES]
    return next((one for one in (*whole[:1], "real", "bool") if one in kinds), "real")


def lifted(array: Array) -> Array:
    """Return an array as one of signals. Raises NotComputed for integers of 64 bits."""
    if is_signal(array):
        return array
    kind = array.dtype.name
    if kind in INTEGER_TYPES:
        elements = [INTEGER_TYPES[kind](int(one)) for one in array.flatten(order="F")]
    elif kind in ("float64", "float32", "bool"):
        elements = array.flatten(order="F").tolist()
    else:
        raise NotComputed(f"{kind} beside a signal is not translated")
    return filled(array.shape, elements)


def lowered(value: Value) -> Value:
    """Return an array of constants that was computed as signals as a plain one; of several each."""
    if isinstance(value, list):
        return [lowered(one) for one in value]
    if not is_signal(value) or any(isinstance(one, Expr) for one in value.flat):
        return value
    plain = [getattr(one, "value", one) for one in value.flatten(order="F")]
    kind = {"real": "float64"}.get(class_of(value), class_of(value))
    return np.array(plain, dtype=kind).reshape(value.shape, order="F")


def cast(element: Any, kind: str) -> Any:
    """Return an element converted as MATLAB does: to integers it rounds half away from 0 and saturates."""
    own = kind_of(element)
    if own == kind:
        return element
    if is_literal(element):
        value = np.array([[element]])
        if kind in INTEGER_TYPES:
            return INTEGER_TYPES[kind](int(_cast(KINDS[kind])(value)[0, 0]))
        return bool(element) if kind == "bool" else float(element)
    if kind == "bool":
        return element != 0
    if kind in FLOATS:
        return convert(element, kind)
    whole = round_half_away(element if own in FLOATS else to_float64(element))
    return convert(whole, kind) if kind in WORDS else to_stored(whole, kind, "saturate")


def converted(array: Array, kind: str) -> Array:
    """Return an array of signals in which each element is of this kind."""
    source = lifted(array)
    return filled(source.shape, (cast(element, kind) for element in source.flatten(order="F")))


def _joined_signals(rows: list[list[Array]]) -> Array:
    kind = class_of(np.hstack([lifted(one).reshape(1, -1) for row in rows for one in row]))
    try:
        filled_rows = [[converted(one, kind) for one in row if one.size] for row in rows]
        return np.vstack([np.hstack(row) for row in filled_rows if row])
    except ValueError:
        raise NotComputed("the rows of a matrix differ in length") from None


def _place(element: Any) -> Any:
    """Return the place, from 0, that an index stands for: a number, or a signal."""
    if is_literal(element) and element == int(element) and element >= 1 and not isinstance(element, bool):
        return int(element) - 1
    if is_literal(element) or kind_of(element) == "bool":
        raise NotComputed("an index is not a whole number from 1 on")
    return to_int32(element) - 1


def _grid(array: Array, index: Sequence[Value]) -> tuple[Array, list[list[Any]], tuple[int, ...]]:
    """Return the array that one index or two address, the places of each, and the size of what they address."""
    if any(is_signal(one) and class_of(one) == "bool" for one in index):
        raise NotComputed("a logical index that depends on signals selects a number of elements that is not fixed")
    flat = array.reshape((-1, 1), order="F") if len(index) == 1 else array
    indices = [*index, np.ones((1, 1))][:2]
    places = [
        [_place(one) for one in each.flatten(order="F")]
        if is_signal(each)
        else list(map(int, _places(each, flat.shape[n])))
        for n, each in enumerate(indices)
    ]
    if any(isinstance(one, int) and one >= flat.shape[n] for n, each in enumerate(places) for one in each):
        raise NotComputed(f"an index is beyond an array of {array.shape[0]} by {array.shape[1]}")
    count, shape = len(places[0]), (len(places[0]), len(places[1]))
    if len(index) == 1 and not isinstance(index[0], str):
        shape = as_array(index[0]).shape
        if class_of(as_array(index[0])) == "bool":
            shape = (1, count) if shape[0] == 1 else (count, 1)
        if 1 in array.shape and array.size > 1 and 1 in shape:  # of a vector: as that one lies
            shape = (count, 1) if array.shape[1] == 1 else (1, count)
    return flat, places, shape


def _replaced(array: Array, index: Sequence[Value], new: Array) -> Array:
    """Return an array with the elements at indices that are signals replaced."""
    kind = class_of(array)
    cells, values = converted(array, kind), converted(new, kind)
    if len(index) == 1 and class_of(as_array(index[0])) == "bool":
        mask = as_array(index[0])
        if new.size != 1 or mask.shape != array.shape:
            raise NotComputed("a logical index that depends on signals takes one value")
        chosen = (
            where(m, values[0, 0], c) for m, c in zip(mask.flatten(order="F"), cells.flatten(order="F"), strict=True)
        )
        return filled(array.shape, chosen)
    flat, (rows, columns), _ = _grid(cells, index)
    if new.size not in (1, len(rows) * len(columns)):
        raise NotComputed("what is assigned has another size")
    given = (
        np.broadcast_to(values.reshape(-1, order="F"), len(rows) * len(columns))
        if new.size == 1
        else values.flatten(order="F")
    )
    flat = flat.copy()
    for (c, r), value in zip(product(columns, rows), given, strict=True):
        for i in [r] if isinstance(r, int) else range(flat.shape[0]):
            for j in [c] if isinstance(c, int) else range(flat.shape[1]):
                here = [place == at for place, at in ((r, i), (c, j)) if not isinstance(place, int)]
                flat[i, j] = where(reduce(and_, here), value, flat[i, j]) if here else value
    return flat.reshape(array.shape, order="F")


# --- functions


def _each(function: Callable[..., Any]) -> Callable[..., Array]:
    return lambda *values: np.asarray(function(*(numeric(as_array(number(v))) for v in values)))


def _filled(value: float) -> Callable[..., Array]:
    def make(*sizes: Value) -> Array:
        kind = next((KINDS[s] for s in sizes if isinstance(s, str) and s in KINDS), np.float64)
        numbers = [int(n) for s in sizes if not isinstance(s, str) for n in as_array(s).flatten()]
        numbers = numbers[:2] if numbers[2:] == [1] * len(numbers[2:]) else numbers
        rows, columns = (numbers * 2)[:2] if len(numbers) < 2 else numbers[:2] if numbers else (1, 1)
        if max(rows, 0) * max(columns, 0) > MOST_ELEMENTS or len(numbers) > 2:
            raise ValueError("too many elements or dimensions")
        return np.full((max(rows, 0), max(columns, 0)), value, dtype=kind)

    return lambda *sizes: make(*sizes) if sizes else np.array([[value]])


def _reduced(function: Callable[..., Any]) -> Callable[..., Array]:
    def reduce(value: Value, dimension: Value = None) -> Array:
        array = numeric(as_array(value))
        axis = int(scalar(dimension)) - 1 if dimension is not None else 1 if array.shape[0] == 1 else 0
        return np.asarray(function(array, axis=axis, keepdims=True))

    return reduce


def _extreme(two: Callable[..., Any], one: Callable[..., Any]) -> Callable[..., Array]:
    return lambda *v: _each(two)(*v) if len(v) == 2 else _reduced(one)(*v) if as_array(v[0]).size else as_array(v[0])


def _found(value: Value, most: Value = None) -> Array:
    array = as_array(value)
    places = np.flatnonzero(array.flatten(order="F"))[: None if most is None else int(scalar(most))] + 1.0
    if array.size <= 1 and not places.size:
        return np.zeros((0, 0))
    return places[None, :] if array.shape[0] == 1 else places[:, None]


def _size(value: Value, dimension: Value = None) -> Array:
    shape = np.array([value.shape if isinstance(value, Cells) else as_array(value).shape], dtype=float)
    return shape if dimension is None else np.append(shape, [[1.0]], axis=1)[:, [min(int(scalar(dimension)), 3) - 1]]


def _struct(*pairs: Value) -> dict[str, Value]:
    if len(pairs) % 2 or not all(isinstance(name, str) for name in pairs[::2]):
        raise ValueError("takes names and values")
    return dict(zip(pairs[::2], pairs[1::2], strict=True))


def _whole(a: Array, b: Array) -> Array:
    """Return where a / b is a whole number but for rounding: MATLAB's mod and rem are exactly 0 there."""
    ratio = a / b
    return np.asarray(np.abs(ratio - np.round(ratio)) < np.finfo(float).eps * np.abs(ratio))


def _real(function: Callable[..., Any], low: float, high: float = math.inf) -> Callable[..., Array]:
    """Return a function that is real between two bounds and refused beyond."""

    def compute(value: Value) -> Array:
        array = numeric(as_array(number(value)))
        if (array < low).any() or (array > high).any():
            raise ValueError("complex numbers are not computed")
        return np.asarray(function(array))

    return compute


def _power(a: Array, b: Array) -> Array:
    if ((a < 0) & (b != np.floor(b))).any():
        raise ValueError("complex numbers are not computed")
    return np.asarray(np.power(a, b))


def _round(array: Array) -> Array:
    return np.floor(np.abs(array) + 0.5) * np.sign(array)


_ESCAPED = {"%%": "%", r"\n": "\n", r"\t": "\t", r"\r": "\r", "\\\\": "\\"}


def _formatted(text: Value) -> Value:
    """Return the text of a format without values."""
    marks = re.findall(r"%.?|\\.?", text) if isinstance(text, str) else ["%"]
    if not set(marks) <= set(_ESCAPED):
        raise NotComputed("sprintf of a value is not computed")
    return re.sub(r"%.|\\.", lambda one: _ESCAPED[one[0]], str(text))


def _cast(kind: Any) -> Callable[[Value], Array]:
    def cast(value: Value) -> Array:
        array = as_array(number(value))
        if np.issubdtype(kind, np.integer):
            limits = np.iinfo(kind)
            whole = np.nan_to_num(_round(array.astype(float)), posinf=np.inf, neginf=-np.inf)
            return np.asarray(np.clip(whole, float(limits.min), float(limits.max)).astype(kind))
        return array.astype(kind)

    return cast


OPERATORS: dict[str, Callable[[Array, Array], Array]] = {
    "+": _computed(np.add), "-": _computed(np.subtract), ".*": _computed(np.multiply), "./": _computed(np.divide),
    ".\\": _computed(lambda a, b: b / a), "\\": _computed(_left_division),
    "*": _computed(lambda a, b: a * b if 1 in (a.size, b.size) else a @ b),
    "/": _computed(lambda a, b: a / b if b.size == 1 else _left_division(b.T, a.T).T), ".^": _computed(_power),
    "^": _computed(_matrix_power), "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal,
    "==": np.equal, "~=": np.not_equal, "!=": np.not_equal, "&": np.logical_and, "|": np.logical_or,
    "&&": lambda a, b: np.array([[bool(a.all()) and bool(b.all())]]),
    "||": lambda a, b: np.array([[bool(a.all()) or bool(b.all())]]),
}  # fmt: skip


FUNCTIONS: dict[str, Callable[..., Value]] = {
    "pi": _filled(math.pi), "inf": _filled(math.inf), "Inf": _filled(math.inf), "nan": _filled(math.nan),
    "NaN": _filled(math.nan), "eps": _filled(float(np.finfo(float).eps)), "zeros": _filled(0.0),
    "ones": _filled(1.0), "true": lambda *s: _filled(1.0)(*s).astype(bool),
    "eye": lambda *s: np.eye(*_filled(0.0)(*s).shape), "false": lambda *s: _filled(0.0)(*s).astype(bool),
    "realmax": _filled(float(np.finfo(float).max)), "realmin": _filled(float(np.finfo(float).tiny)),
    "size": _size,
    "cell": lambda *s: Cells([[np.zeros((0, 0))] * len(row) for row in _filled(0.0)(*s)]),
    "diag": lambda v: np.diag(as_array(v).flatten()) if 1 in as_array(v).shape else np.diag(as_array(v))[:, None],
    **{name: _each(getattr(np, name)) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "floor", "ceil",
       "sign", "hypot", "sinc")},
    "log2": _real(np.log2, 0.0), "log10": _real(np.log10, 0.0),
    "abs": _each(np.abs), "sqrt": _real(np.sqrt, 0.0), "log": _real(np.log, 0.0), "asin": _real(np.arcsin, -1.0, 1.0),
    "acos": _real(np.arccos, -1.0, 1.0), "atan": _each(np.arctan), "atan2": _each(np.arctan2), "fix": _each(np.trunc),
    "round": _each(_round), "rem": _each(lambda a, b: np.where(_whole(a, b), 0.0, np.fmod(a, b))),
    "mod": _each(lambda a, b: np.where(b == 0, a, np.where(_whole(a, b), 0.0, np.mod(a, b)))),
    "max": _extreme(np.maximum, np.max), "min": _extreme(np.minimum, np.min), "sum": _reduced(np.sum),
    "prod": _reduced(np.prod), "mean": _reduced(np.mean), "any": _reduced(np.any), "all": _reduced(np.all),
    "cumsum": lambda v: np.cumsum(as_array(v), axis=1 if as_array(v).shape[0] == 1 else 0),
    "numel": lambda v: float(len(v) if isinstance(v, list) else as_array(v).size),
    "length": lambda v: float(len(v) if isinstance(v, list) else max(as_array(v).shape) if as_array(v).size else 0),
    "isempty": lambda v: bool(not (len(v) if isinstance(v, list | str | dict) else as_array(v).size)),
    "norm": lambda v: float(np.linalg.norm(as_array(v).flatten() if 1 in as_array(v).shape else as_array(v), 2)),
    "inv": lambda v: np.linalg.inv(as_array(v)), "pinv": lambda v: np.linalg.pinv(as_array(v)),
    "det": lambda v: float(np.linalg.det(as_array(v))), "transpose": lambda v: as_array(v).T,
    "blkdiag": lambda *v: _block_diagonal([as_array(one) for one in v]),
    "kron": lambda a, b: np.kron(as_array(a), as_array(b)),
    "dot": lambda a, b: float(np.dot(as_array(a).flatten(), as_array(b).flatten())),
    "reshape": lambda v, *s: as_array(v).reshape(
        [int(n) for one in s for n in (as_array(one).flatten() if as_array(one).size else [-1])], order="F"
    ),
    "repmat": lambda v, *s: _bounded_tile(v, [int(n) for one in s for n in as_array(one).flatten()]),
    "struct": _struct, "Simulink.Parameter": lambda value=None: {"Value": np.zeros((0, 0)) if value is None else value},
    "Simulink.Bus": lambda: {"Elements": []}, "Simulink.BusElement.empty": lambda *sizes: np.zeros((0, 0)),
    "ss": lambda a, b, c, d, period=0.0: {"A": a, "B": b, "C": c, "D": d, "Ts": as_array(bounded(period))},
    "Simulink.BusElement": lambda: {"Name": "", "DataType": "double", "Dimensions": np.ones((1, 1))},
    "Simulink.AliasType": lambda base="double": {"BaseType": base},
    "horzcat": lambda *v: joined([list(v)]), "vertcat": lambda *v: joined([[one] for one in v]),
    "isreal": lambda v: isinstance(v, np.ndarray | str), "isscalar": lambda v: as_array(v).size == 1,
    "isvector": lambda v: 1 in as_array(v).shape, "isrow": lambda v: as_array(v).shape[0] == 1,
    "iscolumn": lambda v: as_array(v).shape[1] == 1, "ischar": lambda v: isinstance(v, str),
    "isnumeric": lambda v: isinstance(v, np.ndarray) and class_of(v) != "bool",
    "isstruct": lambda v: isinstance(v, dict),
    "lower": lambda v: str(v).lower(), "upper": lambda v: str(v).upper(),
    "strcmpi": lambda a, b: str(a).lower() == str(b).lower(),
    "find": _found, "tril": lambda v, k=None: np.tril(as_array(v), 0 if k is None else int(scalar(k))),
    "triu": lambda v, k=None: np.triu(as_array(v), 0 if k is None else int(scalar(k))),
    "circshift": lambda v, k: np.roll(as_array(v), int(scalar(k)), axis=int(as_array(v).shape[0] == 1)),
    "conv": lambda a, b: np.convolve(as_array(a).flatten(), as_array(b).flatten())[None, :],
    "poly": lambda v: np.poly(as_array(v).flatten())[None, :], "fliplr": lambda v: as_array(v)[:, ::-1],
    "polyval": lambda p, x: np.polyval(as_array(p).flatten(), as_array(x)), "flipud": lambda v: as_array(v)[::-1],
    "flip": lambda v: as_array(v)[:, ::-1] if as_array(v).shape[0] == 1 else as_array(v)[::-1],
    **{f"is{name}": _each(getattr(np, f"is{name}")) for name in ("nan", "inf", "finite")},
    "strcmp": lambda a, b: bool(isinstance(a, str) and a == b), "sprintf": _formatted,
    "bin2dec": lambda text: float(int(text, 2)),
    "intmax": lambda k="int32": np.array([[np.iinfo(k).max]], k), "cast": lambda v, k: _cast(KINDS[k])(v),
    "intmin": lambda k="int32": np.array([[np.iinfo(k).min]], k),
    "isfield": lambda s, name: bool(isinstance(s, dict) and name in s),
    **{name: _cast(kind) for name, kind in KINDS.items()},
}  # fmt: skip


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    shape = [sum(one.shape[axis] for one in blocks) for axis in (0, 1)]
    if math.prod(shape) > MOST_ELEMENTS:
        raise ValueError("too many elements")
    made, row, column = np.zeros(shape), 0, 0
    for one in blocks:
        made[row : row + one.shape[0], column : column + one.shape[1]] = one
        row, column = row + one.shape[0], column + one.shape[1]
    return made


def _bounded_tile(value: Value, times: list[int]) -> Array:
    array, repeats = as_array(value), (times * 2)[:2] if len(times) == 1 else times
    if array.size * max(math.prod(repeats), 0) > MOST_ELEMENTS or len(repeats) > 2:
        raise ValueError("too many elements or dimensions")
    return np.tile(array, [max(n, 0) for n in repeats])
