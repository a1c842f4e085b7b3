"""Arithmetic: sums, gains, products, absolute value, sign, smallest and largest."""

from collections.abc import Sequence
from functools import reduce
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import MAX_WIDTH, Param, Port
from twodof.blocks.elementwise import (
    ORDERED,
    OneOutput,
    Pointwise,
    count,
    dot,
    matrix,
    one_of,
    port_series,
    reals,
    sized,
)
from twodof.blocks.expressions.arrays import array_of, fold, norm
from twodof.blocks.expressions.expr import maximum, minimum, where
from twodof.blocks.expressions.numbers import FLOATS, NUMERIC
from twodof.errors import DiagramError

__all__ = [
    "Abs",
    "Bias",
    "Divide",
    "DotProduct",
    "Gain",
    "MatrixGain",
    "MatrixMultiply",
    "Maximum",
    "Minimum",
    "Norm",
    "Polynomial",
    "Product",
    "Sign",
    "Sum",
    "SumOfElements",
    "Transpose",
]


def _signs(given: Any, argument: str, known: str) -> str:
    """`given` if it has one of two signs for each input; else DiagramError."""
    if not isinstance(given, str) or not given or set(given) - set(known):
        raise DiagramError(
            f"{argument}={given!r:.80}", "", f'give a {" or ".join(known)} for each input, like "{known}"'
        )
    return given


@library_block("sum")
class Sum(Pointwise):
    """y = +- a +- b +- c ..., from left to right; `signs` has a + or - for each of the inputs a, b, c, ..."""

    def __init__(self, signs: str = "++", kind: str = "real", width: int | None = None, unit: str = "") -> None:
        self.signs = _signs(signs, "signs", "+-")
        self.ports(port_series(len(signs)), one_of(kind, NUMERIC, "kind"), width, unit)

    def of(self, p: Any, *terms: Any) -> Any:
        total = terms[0] if self.signs[0] == "+" else -terms[0]
        for sign, term in zip(self.signs[1:], terms[1:], strict=True):
            total = total + term if sign == "+" else total - term
        return total


@library_block("sum_of_elements")
class SumOfElements(Block):
    """y = u[0] + u[1] + ... + u[width - 1], from left to right."""

    def __init__(self, width: int = 2, unit: str = "") -> None:
        self.width = count(width, 2, MAX_WIDTH, "width")
        self.inputs = [Port("u", width=width, unit=unit)]
        self.outputs = [Port("y", unit=unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return fold(self.width - 1, [u.u[0]], lambda i, total: [total + u.u[i + 1]])[0]


@library_block("gain")
class Gain(Pointwise):
    """y = k u."""

    def __init__(
        self, k: float = 1.0, width: int | None = None, gain_unit: str = "", input_unit: str = "", unit: str = ""
    ) -> None:
        self.ports("u", "real", width, unit, input_unit)
        self.params = [Param("k", k, unit=gain_unit)]

    def of(self, p: Any, u: Any) -> Any:
        return p.k * u


@library_block("matrix_gain")
class MatrixGain(Block):
    """y = K u, `K` a list of rows, a parameter row after row; one column makes u a scalar, one row y."""

    def __init__(self, K: Sequence[Sequence[float]] = ((1.0,),), unit: str = "") -> None:
        rows = matrix(K, None, None, "K")
        self.rows, self.columns = len(rows), len(rows[0])
        self.inputs = [Port("u", width=None if self.columns == 1 else self.columns)]
        self.outputs = [Port("y", width=None if self.rows == 1 else self.rows, unit=unit)]
        self.params = [Param("K", [v for row in rows for v in row], width=self.rows * self.columns)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        def row(i: Any) -> Any:
            if self.columns == 1:
                return p.K[i] * u.u
            return dot(self.columns, lambda j: p.K[i * self.columns + j], lambda j: u.u[j])

        return row(0) if self.rows == 1 else array_of(self.rows, row)


@library_block("bias")
class Bias(Pointwise):
    """y = u + bias."""

    def __init__(self, bias: float = 0.0, width: int | None = None, unit: str = "") -> None:
        self.ports("u", "real", width, unit)
        self.params = [Param("bias", bias, unit=unit)]

    def of(self, p: Any, u: Any) -> Any:
        return u + p.bias


@library_block("product")
class Product(Pointwise):
    """y = a b c ..., from left to right; `operations` has a * (multiply) or / (divide) for each of the inputs.

    A first / starts from 1 / a.
    """

    def __init__(self, operations: str = "**", width: int | None = None, unit: str = "") -> None:
        self.operations = _signs(operations, "operations", "*/")
        self.ports(port_series(len(operations)), "real", width, unit, "")

    def of(self, p: Any, *terms: Any) -> Any:
        total = terms[0] if self.operations[0] == "*" else 1.0 / terms[0]
        for operation, term in zip(self.operations[1:], terms[1:], strict=True):
            total = total * term if operation == "*" else total / term
        return total


@library_block("divide")
class Divide(Pointwise):
    """y = a / b; for the integer kinds it truncates and a / 0 = 0."""

    def __init__(self, kind: str = "real", width: int | None = None, unit: str = "") -> None:
        self.kind = one_of(kind, NUMERIC, "kind")
        self.ports("ab", kind, width, unit, "")

    def of(self, p: Any, a: Any, b: Any) -> Any:
        return a / b if self.kind in FLOATS else a // b


@library_block("dot_product")
class DotProduct(Block):
    """y = a[0] b[0] + a[1] b[1] + ..., from left to right."""

    def __init__(self, width: int = 2, unit: str = "") -> None:
        self.width = width
        self.inputs = [Port("a", width=width), Port("b", width=width)]
        self.outputs = [Port("y", unit=unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return dot(self.width, lambda j: u.a[j], lambda j: u.b[j])


@library_block("matrix_multiply")
class MatrixMultiply(Block):
    """y = a b; `a` and `b` are shapes: [rows, columns] of a matrix, [n] of a vector. Two vectors give a number.

    Each element is summed from left to right, from its first product.
    """

    def __init__(self, a: Sequence[int] = (2, 2), b: Sequence[int] = (2,), unit: str = "") -> None:
        self.inputs = [sized("a", a), sized("b", b)]
        if a[-1] != b[0]:
            raise DiagramError(f"a={a!r:.80}, b={b!r:.80}", "MatrixMultiply", "a has as many columns as b has rows")
        left = [*a[:-1], *b[1:]]
        self.outputs = [sized("y", left, unit=unit) if left else Port("y", unit=unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.a @ u.b


@library_block("transpose")
class Transpose(Block):
    """The transpose y of the matrix u; `shape` is [rows, columns] of u."""

    def __init__(self, shape: Sequence[int] = (2, 2), kind: str = "real", unit: str = "") -> None:
        self.inputs = [sized("u", shape, kind, unit)]
        self.outputs = [sized("y", list(shape)[::-1], kind, unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.u.T


@library_block("norm")
class Norm(Block):
    """y = the square root of the sum of the squares of u; `shape` is [n] or [rows, columns] of u."""

    def __init__(self, shape: Sequence[int] = (3,), unit: str = "") -> None:
        self.inputs = [sized("u", shape, unit=unit)]
        self.outputs = [Port("y", unit=unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return norm(u.u)


@library_block("polynomial")
class Polynomial(OneOutput):
    """y = c[0] u^n + c[1] u^(n-1) + ... + c[n] by Horner's rule, `coefficients` c."""

    def __init__(self, coefficients: Sequence[float] = (1.0, 0.0), unit: str = "") -> None:
        c = reals(coefficients, "coefficients")
        self.length = len(c)
        self.ports("u", unit=unit, input_unit="")
        self.params = [Param("coefficients", c, width=self.length)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        y = p.coefficients[0]
        for i in range(1, self.length):
            y = y * u.u + p.coefficients[i]
        return y


@library_block("abs")
class Abs(Pointwise):
    """y = |u|; for int32 the smallest number stays itself."""

    def __init__(self, kind: str = "real", width: int | None = None, unit: str = "") -> None:
        self.ports("u", one_of(kind, NUMERIC, "kind"), width, unit)

    def of(self, p: Any, u: Any) -> Any:
        return abs(u)


@library_block("sign")
class Sign(Pointwise):
    """y = 1 for u > 0, -1 for u < 0, else u itself (0, or NaN)."""

    def __init__(self, kind: str = "real", width: int | None = None) -> None:
        self.ports("u", one_of(kind, ("real", "int32"), "kind"), width)

    def of(self, p: Any, u: Any) -> Any:
        return where(u > 0, 1, where(u < 0, -1, u))


@library_block("minimum")
class Minimum(Pointwise):
    """y is the smallest of its inputs: minimum(minimum(a, b), c) with minimum(a, b) = a if a < b else b."""

    def __init__(self, inputs: int = 2, kind: str = "real", width: int | None = None, unit: str = "") -> None:
        self.ports(port_series(inputs), one_of(kind, ORDERED, "kind"), width, unit)

    def of(self, p: Any, *inputs: Any) -> Any:
        return reduce(minimum, inputs)


@library_block("maximum")
class Maximum(Pointwise):
    """y is the largest of its inputs: maximum(maximum(a, b), c) with maximum(a, b) = a if b < a else b."""

    def __init__(self, inputs: int = 2, kind: str = "real", width: int | None = None, unit: str = "") -> None:
        self.ports(port_series(inputs), one_of(kind, ORDERED, "kind"), width, unit)

    def of(self, p: Any, *inputs: Any) -> Any:
        return reduce(maximum, inputs)
