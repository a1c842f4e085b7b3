"""Refusals: what Python and numpy would call on a recorded value or a matrix, and what to write instead."""

from collections.abc import Callable
from typing import Any, Never

from twodof.blocks.expressions.recording import fault


def _refused(what: str, remedy: str) -> Callable[..., Never]:
    def method(*_: Any, **__: Any) -> Never:
        raise fault(what, remedy)

    return method


class Refusals:
    """The base of values of the language that are not numbers: each of these methods is an error with its remedy."""

    __slots__ = ()
    __array_ufunc__ = None  # numpy must not make object arrays of these

    __setitem__ = _refused("an element of an array is assigned", "write a = store(a, i, value), or another matrix")
    __delitem__ = _refused("an element of an array is deleted", "arrays have a fixed length: make another with vector")
    __round__ = _refused("round() does not work on recorded values", "write floor(x + 0.5)")
    __floor__ = _refused("math.floor() does not work on recorded values", "use floor of twodof.blocks")
    __ceil__ = _refused("math.ceil() does not work on recorded values", "use ceil of twodof.blocks")
    __trunc__ = _refused("math.trunc() does not work on recorded values", "use trunc of twodof.blocks")
    __divmod__ = _refused("divmod() does not work on recorded values", "write a // b and a % b (integers)")
    __rdivmod__ = __divmod__
    __array__ = _refused("a recorded value does not fit into an array of numpy", "make an array with vector([...])")

    def __array_function__(self, function: Callable[..., Any], *_: Any) -> Never:
        raise fault(
            f"{function.__module__}.{function.__name__} does not work on recorded values".replace("numpy", "np", 1),
            "use the functions of twodof.blocks, such as where, minimum, norm and fold, and @ for products",
        )
