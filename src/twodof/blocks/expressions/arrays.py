"""Arrays of fixed length: vectors, matrices, their operators, and loops that stay loops when they are recorded.

The same code computes on numbers and records nodes, so that the order of roundings is the same for both.
"""

import operator
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from functools import reduce
from typing import Any

import numpy as np

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import (
    Expr,
    as_expr,
    computed_in,
    during,
    fault,
    int32,
    maximum,
    minimum,
    node,
    of_one_kind,
    position,
    recording,
    scalars,
    sqrt,
    traced,
)
from twodof.blocks.expressions.numbers import BY_NAME, ArrayOperators, Int32, Integer, Vector, rules
from twodof.blocks.expressions.recording import Refusals

LOOPS: ContextVar[tuple[int, ...]] = ContextVar("loops", default=())
"""Lengths of the loops around the code that is being recorded, the outermost first."""


def vector(elements: Sequence[Any]) -> Any:
    """Return an array of the given scalars, all of one type."""
    if isinstance(elements, np.ndarray):
        elements = elements.tolist()
    if not elements:
        raise fault("an array of no elements", "an array has at least one element")
    elements = of_one_kind(elements)
    anchor = next((v for v in elements if isinstance(v, Expr)), None)
    kind = anchor.kind if anchor is not None else numbers.common_kind(elements)
    if not traced(*elements):
        return Vector(numbers.cast(v, kind) for v in elements)
    items = tuple(as_expr(e, kind) for e in elements)
    scalars("vector", *items)
    return node("vector", kind, items, None, len(items))


def store(array: Any, index: Any, value: Any) -> Any:
    """Return `array` with the element at the clamped `index` replaced; compiled to a write in place if possible."""
    if traced(array, index, value):
        base = array if isinstance(array, Expr) else vector(list(array))
        if base.width is None:
            raise fault("store into a scalar", "give an array, made with vector([...])")
        item = as_expr(value, base.kind)
        scalars("store", item)
        return node("store", base.kind, (base, position(index, base.width), item), None, base.width)
    items = list(array)
    items[numbers.clamp_index(index, len(items))] = numbers.cast(value, numbers.kind_of(items[0]))
    return Vector(items)


def array_of(length: int, element: Callable[[Any], Any]) -> Any:
    """Return the array of `element(i)` for the int32 i = 0 .. length - 1; stays a loop when compiled.

    If the elements are arrays themselves, they are concatenated.
    """
    if length < 1:
        raise fault("an array of no elements", "an array has at least one element")
    if not recording():
        made = [element(Int32(i)) for i in range(length)]
        return vector([v for one in made for v in (one if isinstance(one, (list, tuple)) else (one,))])
    depth = len(LOOPS.get())
    with during(LOOPS, (*LOOPS.get(), length)):
        made = element(node("bound", "int32", (), (depth, 0)))
        body = vector(made) if isinstance(made, (list, tuple)) else as_expr(made)
    return node("build", body.kind, (body,), (length, depth), length * (body.width or 1))


def fold(length: int, initial: Sequence[Any], step: Callable[..., Sequence[Any]]) -> tuple[Any, ...]:
    """Repeat `values = step(i, *values)` for the int32 i = 0 .. length - 1 from `initial`, and return the last values.

    It stays a loop when compiled. The values are scalars; `step` returns as many as it takes, of the same types. An
    integer of 8 or 16 bits is carried as int32.
    """
    initial = [computed_in(v) for v in initial]
    if not recording():
        kinds = [numbers.kind_of(v) for v in initial]
        values = tuple(numbers.cast(v, k) for v, k in zip(initial, kinds, strict=True))
        for i in range(length):
            values = tuple(numbers.cast(v, k) for v, k in zip(step(Int32(i), *values), kinds, strict=True))
        return values
    starts = tuple(as_expr(v) for v in initial)
    scalars("fold", *starts)
    depth = len(LOOPS.get())
    index = node("bound", "int32", (), (depth, 0))
    carried = [node("bound", s.kind, (), (depth, j + 1)) for j, s in enumerate(starts)]
    with during(LOOPS, (*LOOPS.get(), length)):
        results = tuple(step(index, *carried))
    if len(results) != len(starts):
        what = f"the body of fold returns {len(results)} values and takes {len(starts)}"
        raise fault(what, "return one value for each initial value")
    bodies = tuple(as_expr(r, s.kind) for r, s in zip(results, starts, strict=True))
    scalars("fold", *bodies)
    # One node an output; all share (starts, bodies), so a compiler can emit them as one loop.
    return tuple(node("fold", s.kind, starts + bodies, (length, depth, j)) for j, s in enumerate(starts))


UNROLLED = 16  # products of a matrix product that are written out; more are a loop
WRITTEN = 4  # elements of another array that are written out; more are a loop, which compilers vectorise
LONGEST_SUM = 32  # terms of one element of a product that are written out; more are a loop within the loop

Shape = tuple[int, ...]
"""A shape: () of a scalar, (n,) of a vector, (rows, columns) of a matrix."""


class Matrix(Refusals, ArrayOperators):
    """A matrix of `shape` (rows, columns) over the array `flat`, which holds column after column.

    `m[i, j]` is an element, `m[i]` a row, `m[:, j]` a column, `m[0:2, 1:3]` a part. Length and iteration are over rows.

    `element`, if given, computes the element at a literal or counted i, j in a few operations. An operation that reads
    each element once uses it in place of `flat`, which then need not be computed. `moved` is true if `element` only
    reads an element of another array, as for a transpose.
    """

    __slots__ = ("element", "flat", "moved", "shape")

    def __init__(
        self, flat: Any, shape: Shape, element: Callable[[Any, Any], Any] | None = None, moved: bool = False
    ) -> None:
        self.flat = flat
        self.shape = shape
        self.element = element
        self.moved = moved

    def at(self, i: Any, j: Any) -> Any:
        """Return the element in row i and column j, which must be inside the matrix."""
        if self.element is not None:
            return self.element(i, j)
        literal = isinstance(i, int) and isinstance(j, int)
        return (_pick if literal else operator.getitem)(self.flat, place(i, j, self.shape[0]))

    @property
    def T(self) -> Any:
        """The transpose."""
        rows, columns = self.shape
        if rows * columns <= WRITTEN or isinstance(self.flat, (Vector, list)):
            flat = _gather(self.flat, [i + j * rows for i in range(rows) for j in range(columns)])
            return Matrix(flat, (columns, rows))
        flat = array_of(rows, lambda i: array_of(columns, lambda j: self.at(i, j)))
        return Matrix(flat, (columns, rows), lambda i, j: self.at(j, i), self.moved or self.element is None)

    def __getitem__(self, index: Any) -> Any:
        return rules.part(self, index)

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(self.shape[0]))

    def __bool__(self) -> bool:
        raise fault("a matrix has no truth (`if`, `and`, `or`, `not` ask for it)", "compare its elements one by one")

    def __repr__(self) -> str:
        return f"Matrix({self.flat!r}, {self.shape})"


def place(i: Any, j: Any, rows: int) -> Any:
    """Return the index of the element in row i and column j in an array of column after column."""
    if isinstance(j, int):
        return i + j * rows if j else i
    return j * rows + i if not isinstance(i, int) or i else j * rows


def shape_text(shape: Shape) -> str:
    """Return a shape as errors show it: "a scalar", "3", "3x2"."""
    return "x".join(map(str, shape)) or "a scalar"


def shape_of(value: Any) -> Shape:
    """Return the shape of a number, a node, an array, or a list or numpy array of such."""
    found: Shape = getattr(_operand(value), "shape", ())
    return found


def shaped(flat: Any, shape: Shape | None) -> Any:
    """Return an array as a block's method sees it: a Matrix if `shape` is that of a matrix."""
    return flat if shape is None else Matrix(flat, shape)


def flat_of(value: Any) -> Any:
    """Return a Matrix's elements, column after column; any other value unchanged."""
    return value.flat if isinstance(value, Matrix) else value


def matrix(rows: Any) -> Any:
    """Return the matrix with these rows: lists or vectors of one length, or a numpy array of two dimensions."""
    made = _of_lists(rows.tolist() if isinstance(rows, np.ndarray) else list(rows))
    if not isinstance(made, Matrix):
        raise fault("a matrix is made of rows, and these are scalars", "write matrix([[...], [...]])")
    return Matrix(vector(made.flat), made.shape)


def _of_lists(value: Any) -> Any:
    """Return a list of scalars unchanged, and a list of lists (or vectors) as a Matrix."""
    rows = [row.tolist() if isinstance(row, np.ndarray) else row for row in value]
    widths = {len(row) if _is_array(row) else None for row in rows}
    if not rows or widths == {0}:
        raise fault("an array of no elements", "an array has at least one element")
    if widths == {None}:
        return _Literals(rows)
    if len(widths) > 1:
        raise fault("the rows of a matrix have different lengths", "give each row as many elements")
    if any(_is_array(element) for row in rows for element in row):
        raise fault("an array of more than two dimensions", "use a vector or a matrix")
    (columns,) = (int(w) for w in widths if w is not None)
    return Matrix(_Literals(row[j] for j in range(columns) for row in rows), (len(rows), columns))


class _Literals(list[Any]):
    """List of scalars, Python's own numbers among them."""

    @property
    def shape(self) -> Shape:
        return (len(self),)


def _is_array(value: Any) -> bool:
    if isinstance(value, Expr):
        return value.width is not None
    return isinstance(value, (ArrayOperators, list, tuple, np.ndarray))


def _operand(value: Any) -> Any:
    """Return a list or numpy array as an array of the language; any other value unchanged."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)) and not isinstance(value, (Vector, _Literals)):
        return _of_lists(value)
    return value


def _pick(flat: Any, at: int) -> Any:
    """Return the element at a literal place, without making an array only to read it."""
    return flat.args[at] if isinstance(flat, Expr) and flat.op == "vector" else flat[at]


def _gather(flat: Any, places: Sequence[int]) -> Any:
    return vector([_pick(flat, at) for at in places])


def spread(f: Callable[..., Any], *values: Any) -> Any:
    """Return `f` of scalars, or the array of `f` element by element for arrays of one shape and scalars."""
    operands = [_operand(v) for v in values]
    shapes = {s for s in map(shape_of, operands) if s}
    if len(shapes) > 1:
        met = " and ".join(shape_text(s) for s in map(shape_of, operands) if s)
        raise fault(f"arrays of {met} are in one operation", "give them the same shape; scalars go with all shapes")
    if not shapes:  # an array of numpy without a dimension is a number
        return f(*operands)
    shape = shapes.pop()
    length = int(np.prod(shape))
    parts = [(flat_of(v), bool(shape_of(v))) for v in operands]
    # In a loop each operand must be one array: literals and numbers are written out.
    written = any(isinstance(flat, (list, Vector)) for flat, array in parts if array)
    computed = [v for v in operands if isinstance(v, Matrix) and v.element is not None]
    if written or length <= WRITTEN:
        flat = vector([f(*(_pick(v, k) if array else v for v, array in parts)) for k in range(length)])
    elif computed:
        rows, columns = shape

        def column(j: Any) -> Any:
            return array_of(rows, lambda i: f(*(v.at(i, j) if isinstance(v, Matrix) else v for v in operands)))

        flat = array_of(columns, column)
    else:
        flat = array_of(length, lambda i: f(*(v[i] if array else v for v, array in parts)))
    return shaped(flat, shape if len(shape) == 2 else None)


def product(a: Any, b: Any) -> Any:
    """Return `a @ b`. Each element is a(i, 0) * b(0, j) + a(i, 1) * b(1, j) + ..., summed from the left."""
    left, right = _operand(a), _operand(b)
    first, second = shape_of(left), shape_of(right)
    if not first or not second or first[-1] != second[0]:
        what = f"{shape_text(first)} @ {shape_text(second)} is not possible"
        raise fault(what, "give the first as many columns as the second has rows; with a scalar, write *")
    rows, inner, columns = (first[0] if len(first) == 2 else 1), second[0], (second[1] if len(second) == 2 else 1)
    a_flat, b_flat = _array(flat_of(left), flat_of(right)), _array(flat_of(right), flat_of(left))
    of_left, of_right = _factor(left, a_flat, (rows, inner)), _factor(right, b_flat, (inner, columns))

    def element(i: Any, j: Any) -> Any:
        """One element; `i` and `j` are literals, or counted by a loop."""
        if inner > LONGEST_SUM:
            start = of_left.at(i, 0) * of_right.at(0, j)
            return fold(inner - 1, [start], lambda k, total: [total + of_left.at(i, k + 1) * of_right.at(k + 1, j)])[0]
        return reduce(operator.add, (of_left.at(i, k) * of_right.at(k, j) for k in range(inner)))

    numeric = isinstance(a_flat, Vector) and isinstance(b_flat, Vector)
    if numeric or rows * inner * columns <= UNROLLED or rows * columns == 1:
        items = [element(i, j) for j in range(columns) for i in range(rows)]
        if len(first) == len(second) == 1:
            return items[0]
        flat = vector(items)
    elif columns == 1:
        flat = array_of(rows, lambda i: element(i, 0))
    elif rows == 1:
        flat = array_of(columns, lambda j: element(0, j))
    else:
        flat = array_of(columns, lambda j: array_of(rows, lambda i: element(i, j)))
    return shaped(flat, (rows, columns) if len(first) == len(second) == 2 else None)


def _factor(value: Any, flat: Any, shape: Shape) -> Matrix:
    """Return a factor of a product as an array, since its elements are read often."""
    if isinstance(value, Matrix) and value.moved:
        return value
    return Matrix(flat, shape)


def _array(flat: Any, other: Any) -> Any:
    """Literals as an array of the other operand's type."""
    if not isinstance(flat, _Literals):
        return flat
    anchor = other if isinstance(other, Expr) else next((v for v in other if isinstance(v, Expr)), None)
    kind = BY_NAME[numbers.common_kind(other) if anchor is None else anchor.kind].computes
    return vector([as_expr(v, kind) if traced(*flat) else numbers.cast(v, kind) for v in flat])


def part(array: Any, index: Any) -> Any:
    """Return `array[index]`, for slices with constant bounds, and with one index for each dimension of a matrix."""
    shape = shape_of(array)
    if len(shape) == 1:
        if isinstance(index, tuple):
            raise fault(f"an array of {shape_text(shape)} has {len(index)} indices", "give it one")
        return _gather(array, _places(index, shape[0]))
    given = index if isinstance(index, tuple) else (index, slice(None))
    if len(given) != 2:
        raise fault(f"a matrix of {shape_text(shape)} has {len(given)} indices", "give it two")
    chosen = [_places(i, n) if isinstance(i, slice) else [_place(i, n)] for i, n in zip(given, shape, strict=True)]
    literal = all(isinstance(i, int) for places in chosen for i in places)
    read = _pick if literal else operator.getitem
    items = [read(array.flat, i + j * shape[0]) for j in chosen[1] for i in chosen[0]]
    whole = [isinstance(i, slice) for i in given]
    if not any(whole):
        return items[0]
    return shaped(vector(items), (len(chosen[0]), len(chosen[1])) if all(whole) else None)


def _places(index: slice, length: int) -> list[int]:
    """Return the places that a slice names, all of them inside."""
    if any(isinstance(b, (Expr, Integer)) for b in (index.start, index.stop, index.step)):
        raise fault("a slice has a bound that is computed", "use literals, or array_of(n, lambda i: a[start + i])")
    try:
        places = list(range(length))[index]
    except (TypeError, ValueError) as error:
        raise fault(f"a slice is not one: {error}", "its bounds are whole numbers, its step is not 0") from None
    bounds = [b for b in (index.start, index.stop) if b is not None]
    if not places or any(not -length <= b <= length for b in bounds):
        text = ":".join("" if b is None else str(b) for b in (index.start, index.stop))
        what = f"the slice {text} does not fit an array of {length}"
        raise fault(what, "take one or more elements, all of them inside")
    return places


def _place(index: Any, length: int) -> Any:
    """Return an index of a matrix: a literal one is checked, a computed one is clamped to its own dimension."""
    if isinstance(index, Integer):
        return numbers.clamp_index(index, length)
    at = position(index, length)
    if at.op == "const":
        return at.data
    counted = at.op == "bound" and at.data[1] == 0 and LOOPS.get()[at.data[0]] <= length
    return at if counted else maximum(minimum(at, int32(length - 1)), int32(0))


rules.spread, rules.product, rules.part = spread, product, part


def zeros(*shape: int) -> Any:
    """Return a real vector `zeros(n)` or matrix `zeros(rows, columns)` of zeros."""
    if len(shape) == 2:
        return matrix([[0.0] * shape[1]] * shape[0])
    return vector([0.0] * shape[0])


def eye(size: int) -> Any:
    """Return the identity matrix of `size` rows and columns."""
    return diag([1.0] * size)


def diag(values: Any) -> Any:
    """Return the square matrix with the vector `values` on its diagonal; of a matrix, its diagonal as a vector."""
    shape = shape_of(values)
    if len(shape) == 2:
        return vector([values[i, i] for i in range(min(shape))])
    size = len(values)
    return matrix([[values[i] if i == j else 0.0 for j in range(size)] for i in range(size)])


def concatenate(arrays: Sequence[Any], axis: int = 0) -> Any:
    """Return vectors joined one after the other, or matrices joined below (axis 0) or beside (axis 1) one another."""
    shapes = [shape_of(a) for a in arrays]
    if {len(s) for s in shapes} == {1} and axis == 0:
        return vector([v for a in arrays for v in a])
    if {len(s) for s in shapes} != {2} or axis not in (0, 1) or len({s[1 - axis] for s in shapes}) > 1:
        met = ", ".join(shape_text(s) for s in shapes)
        what = f"arrays of {met} cannot be joined along axis {axis}"
        raise fault(what, "give vectors, or matrices that fit together, axis 0 or 1")
    if axis == 0:
        return matrix([row for a in arrays for row in a])
    return matrix([[v for a in arrays for v in a[i]] for i in range(shapes[0][0])])


def outer(a: Any, b: Any) -> Any:
    """Return the matrix of a[i] * b[j]."""
    rows, columns = len(a), len(b)
    if isinstance(a, Expr) and isinstance(b, Expr) and rows * columns > WRITTEN:
        flat = array_of(columns, lambda j: array_of(rows, lambda i: a[i] * b[j]))
        return Matrix(flat, (rows, columns), lambda i, j: a[i] * b[j])
    return matrix([[left * right for right in b] for left in a])


def cross(a: Any, b: Any) -> Any:
    """Return the vector product of two vectors of three."""
    if shape_of(a) != (3,) or shape_of(b) != (3,):
        what = f"cross cannot take {shape_text(shape_of(a))} and {shape_text(shape_of(b))}"
        raise fault(what, "give two vectors of 3")
    return vector([a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)])


def sum(a: Any) -> Any:
    """Return a[0] + a[1] + ..., from the left; of a matrix column after column."""
    if not shape_of(a):
        raise fault("sum cannot take a scalar", "give an array")
    flat = flat_of(a)
    if isinstance(flat, Expr) and len(flat) > WRITTEN:
        return fold(len(flat) - 1, [flat[0]], lambda i, total: [total + flat[i + 1]])[0]
    return reduce(lambda total, v: total + v, flat)


def norm(a: Any) -> Any:
    """Return the square root of the sum of the squares of all elements."""
    flat = flat_of(a)
    return sqrt(sum(flat * flat))
