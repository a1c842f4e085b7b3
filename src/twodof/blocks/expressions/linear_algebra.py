"""Functions of vectors and matrices, written with the operators of arrays."""

from collections.abc import Sequence
from functools import reduce
from typing import Any

from twodof.blocks.expressions.arrays import array_of, fold, vector
from twodof.blocks.expressions.expr import Expr, fault, sqrt
from twodof.blocks.expressions.matrix import WRITTEN, Matrix, flat_of, matrix, shape_of, shape_text


def zeros(*shape: int) -> Any:
    """A real vector `zeros(n)` or matrix `zeros(rows, columns)` of zeros."""
    if len(shape) == 2:
        return matrix([[0.0] * shape[1]] * shape[0])
    return vector([0.0] * shape[0])


def eye(size: int) -> Any:
    """The identity matrix."""
    return diag([1.0] * size)


def diag(values: Any) -> Any:
    """The square matrix with these values on its diagonal, or, of a matrix, its diagonal as a vector."""
    shape = shape_of(values)
    if len(shape) == 2:
        return vector([values[i, i] for i in range(min(shape))])
    size = len(values)
    return matrix([[values[i] if i == j else 0.0 for j in range(size)] for i in range(size)])


def concatenate(arrays: Sequence[Any], axis: int = 0) -> Any:
    """Vectors one after the other, or matrices below (axis 0) or beside (axis 1) one another."""
    shapes = [shape_of(a) for a in arrays]
    if {len(s) for s in shapes} == {1} and axis == 0:
        return vector([v for a in arrays for v in a])
    if {len(s) for s in shapes} != {2} or axis not in (0, 1) or len({s[1 - axis] for s in shapes}) > 1:
        met = ", ".join(shape_text(s) for s in shapes)
        raise fault(f"arrays of {met} along axis {axis}", "give vectors, or matrices that fit together, axis 0 or 1")
    if axis == 0:
        return matrix([row for a in arrays for row in a])
    return matrix([[v for a in arrays for v in a[i]] for i in range(shapes[0][0])])


def outer(a: Any, b: Any) -> Any:
    """The matrix of a[i] * b[j]."""
    rows, columns = len(a), len(b)
    if isinstance(a, Expr) and isinstance(b, Expr) and rows * columns > WRITTEN:
        flat = array_of(columns, lambda j: array_of(rows, lambda i: a[i] * b[j]))
        return Matrix(flat, (rows, columns), lambda i, j: a[i] * b[j])
    return matrix([[left * right for right in b] for left in a])


def cross(a: Any, b: Any) -> Any:
    """The vector product of two vectors of three."""
    if shape_of(a) != (3,) or shape_of(b) != (3,):
        raise fault(f"cross of {shape_text(shape_of(a))} and {shape_text(shape_of(b))}", "give two vectors of 3")
    return vector([a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)])


def sum(a: Any) -> Any:
    """a[0] + a[1] + ..., from the left; of a matrix column after column."""
    if not shape_of(a):
        raise fault("sum of a scalar", "give an array")
    flat = flat_of(a)
    if isinstance(flat, Expr) and len(flat) > WRITTEN:
        return fold(len(flat) - 1, [flat[0]], lambda i, total: [total + flat[i + 1]])[0]
    return reduce(lambda total, v: total + v, flat)


def norm(a: Any) -> Any:
    """The square root of the sum of the squares of all elements."""
    flat = flat_of(a)
    return sqrt(sum(flat * flat))
