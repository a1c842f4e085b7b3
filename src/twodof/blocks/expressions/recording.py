"""What is being recorded, how much more of it may be, and where the user's code stands that does it."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Any

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
    """The innermost line that is outside the language and its library, as FILE:LINE."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("twodof.blocks."):
        frame = frame.f_back
    return f"{frame.f_code.co_filename}:{frame.f_lineno}"


def fault(what: str, remedy: str) -> DiagramError:
    """A mistake in a block's code, with the block and the user's line that made it."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(LANGUAGE):
        frame = frame.f_back
    line = f"{frame.f_code.co_filename}:{frame.f_lineno}"
    block = TRACING.get()
    return DiagramError(what, f"block {block}, {line}" if block else line, remedy)


def recording() -> bool:
    """Whether a block is being traced: loops are then recorded, else run."""
    return bool(TRACING.get())
