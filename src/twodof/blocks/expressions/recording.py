"""Recording of expressions: the traced block, the room left for nodes, and the user's line; and its refusals."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Any, Never

from twodof.errors import DiagramError

LANGUAGE = (
    "twodof.blocks.expressions.",
    "twodof.blocks.elementary.",
    "twodof.blocks.namespaces",
    "twodof.blocks.block",
)
"""How the names of modules begin whose frames are not the user's."""

TRACING: ContextVar[str] = ContextVar("tracing", default="")
ROOM: ContextVar[list[int] | None] = ContextVar("room", default=None)  # nodes that may still be recorded
OPERANDS: ContextVar[Callable[[str, Any, Any], tuple[Any, Any]]] = ContextVar(
    "operands", default=lambda op, a, b: (a, b)
)
"""Sees what an operation of two is given, before it is recorded, and gives it back."""
LINES: ContextVar[dict[int, str] | None] = ContextVar("lines", default=None)


@contextmanager
def during(variable: ContextVar[Any], value: Any) -> Iterator[None]:
    """Set a context variable while the enclosed code runs."""
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


def at_most(nodes: int) -> AbstractContextManager[None]:
    """Raise DiagramError as soon as the enclosed code has recorded more than `nodes` new nodes."""
    return during(ROOM, [nodes])


def noting_lines(lines: dict[int, str]) -> AbstractContextManager[None]:
    """Note in `lines`, by the id of each operation, the user's file and line at which the enclosed code records it."""
    return during(LINES, lines)


def tracing(path: str) -> AbstractContextManager[None]:
    """Name the block that is being traced, for the errors that its code may cause."""
    return during(TRACING, path)


def users_line() -> str:
    """Return the innermost line that is outside the language and its library, as FILE:LINE."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("twodof.blocks."):
        frame = frame.f_back
    return f"{frame.f_code.co_filename}:{frame.f_lineno}"


def fault(what: str, remedy: str) -> DiagramError:
    """Return the error for a mistake in a block's code, with the block and the user's line."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(LANGUAGE):
        frame = frame.f_back
    line = f"{frame.f_code.co_filename}:{frame.f_lineno}"
    block = TRACING.get()
    return DiagramError(what, f"block {block}, {line}" if block else line, remedy)


def recording() -> bool:
    """Return True while a block is being traced: loops are then recorded, else run."""
    return bool(TRACING.get())


def refused(what: str, remedy: str) -> Callable[..., Never]:
    """Return a method that is an error."""

    def method(*_: Any, **__: Any) -> Never:
        raise fault(what, remedy)

    return method


class Refusals:
    """The base of values of the language that are not numbers: each of these methods is an error with its remedy."""

    __slots__ = ()
    __array_ufunc__ = None  # numpy must not make object arrays of these

    __setitem__ = refused("an element of an array is assigned", "write a = store(a, i, value), or another matrix")
    __delitem__ = refused("an element of an array is deleted", "arrays have a fixed length: make another with vector")
    __round__ = refused("round() does not work on recorded values", "write floor(x + 0.5)")
    __floor__ = refused("math.floor() does not work on recorded values", "use floor of twodof.blocks")
    __ceil__ = refused("math.ceil() does not work on recorded values", "use ceil of twodof.blocks")
    __trunc__ = refused("math.trunc() does not work on recorded values", "use trunc of twodof.blocks")
    __divmod__ = refused("divmod() does not work on recorded values", "write a // b and a % b (integers)")
    __rdivmod__ = __divmod__
    __array__ = refused("a recorded value does not fit into an array of numpy", "make an array with vector([...])")

    def __array_function__(self, function: Callable[..., Any], *_: Any) -> Never:
        what = f"{function.__module__}.{function.__name__} does not work on recorded values".replace("numpy", "np", 1)
        remedy = "use the functions of twodof.blocks, such as where, minimum, norm and fold, and @ for products"
        raise fault(what, remedy)
