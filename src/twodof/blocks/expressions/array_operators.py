"""The operators of arrays of numbers and of arrays of nodes."""

import operator
from collections.abc import Callable
from typing import Any


class ArrayRules:
    """What the operators do. `matrix` fills it in, because numbers and nodes, which are below it, have operators too.

    `spread(f, *values)` is `f` element by element; `product(a, b)` is `a @ b`; `part(a, index)` is a slice or an
    element of a matrix.
    """

    spread: Callable[..., Any]
    product: Callable[[Any, Any], Any]
    part: Callable[[Any, Any], Any]


rules = ArrayRules()


def _operator(compute: Callable[[Any, Any], Any]) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """The methods for `self op other` and `other op self`."""
    return (
        lambda self, other: rules.spread(compute, self, other),
        lambda self, other: rules.spread(compute, other, self),
    )


class ArrayOperators:
    """The base of the arrays that are not nodes: operators element by element, and `@`."""

    __slots__ = ()
    __array_ufunc__ = None  # numpy must not make arrays of its own of these

    __add__, __radd__ = _operator(operator.add)
    __sub__, __rsub__ = _operator(operator.sub)
    __mul__, __rmul__ = _operator(operator.mul)
    __truediv__, __rtruediv__ = _operator(operator.truediv)
    __floordiv__, __rfloordiv__ = _operator(operator.floordiv)
    __mod__, __rmod__ = _operator(operator.mod)
    __lshift__, __rlshift__ = _operator(operator.lshift)
    __rshift__, __rrshift__ = _operator(operator.rshift)
    __and__, __rand__ = _operator(operator.and_)
    __or__, __ror__ = _operator(operator.or_)
    __xor__, __rxor__ = _operator(operator.xor)
    __lt__, __gt__ = _operator(operator.lt)
    __le__, __ge__ = _operator(operator.le)
    __eq__ = _operator(operator.eq)[0]
    __ne__ = _operator(operator.ne)[0]

    def __matmul__(self, other: Any) -> Any:
        return rules.product(self, other)

    def __rmatmul__(self, other: Any) -> Any:
        return rules.product(other, self)

    def __neg__(self) -> Any:
        return rules.spread(operator.neg, self)

    def __pos__(self) -> Any:
        return self

    def __abs__(self) -> Any:
        return rules.spread(abs, self)

    def __invert__(self) -> Any:
        return rules.spread(operator.invert, self)
