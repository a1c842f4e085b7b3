"""Mistakes in a block's own Python, told as an error of this package: which block and method, which line, what to do.

A method runs twice over: on recorded values when its block is traced, and on numbers in the reference. Whatever it
raises in either is told by `mistake`.
"""

from __future__ import annotations

import inspect
import sys
from traceback import walk_tb
from typing import Any

from twodof.blocks.declarations import Declared
from twodof.blocks.expressions.expr import Expr, recording
from twodof.blocks.expressions.matrix import Matrix
from twodof.errors import DiagramError

OWN = "twodof"  # the package whose blocks are tested, not guarded
_NOT_THE_USERS = sys.stdlib_module_names | {"numpy", "scipy"}
_RECORDED = (Expr.__name__, Matrix.__name__)  # as Python's own errors name them
ARGUMENTS = {"prepare": "self, p, t"}  # of the methods; all others take what `output` takes
HIDDEN = "let it depend on u, x, p and t alone: keep what changes in a state, and set attributes in __init__"


def is_users(block: Declared) -> bool:
    """Return True for a user's own block. This package's blocks are guarded by its tests, which costs no start-up."""
    return type(block).__module__.partition(".")[0] != OWN


def is_missing(block: Declared, method: str) -> bool:
    """Return True if the block's class lacks the method, so that Block's, which gives nothing, is called."""
    return getattr(block.written(method), "__module__", "") == "twodof.blocks.block"


def definition(method: str) -> str:
    """How to write a method."""
    return f"write def {method}({ARGUMENTS.get(method, 'self, u, x, p, t')})"


def place(block: Declared, method: str) -> str:
    """Where a method stands, for an error: its block, its name, file and line."""
    function: Any = inspect.unwrap(block.written(method))
    code = None if is_missing(block, method) else getattr(function, "__code__", None)
    line = f", {code.co_filename}:{code.co_firstlineno}" if code else ""
    return f"block {type(block).__name__}.{method}{line}"


def mistake(error: Exception, block: Declared, method: str) -> DiagramError:
    """Return the error to raise for an exception in a method. Call it in the caller of the method."""
    below = [(f.f_globals.get("__name__", ""), f"{f.f_code.co_filename}:{n}") for f, n in walk_tb(error.__traceback__)]
    below = below[1:]  # without the caller's own
    if not below and isinstance(error, TypeError):
        what, remedy = f"it cannot be called: {error}", definition(method)
    else:
        what, remedy = _told(error)
    users = [line for name, line in below if not name.startswith("twodof.blocks.") and _top(name) not in _NOT_THE_USERS]
    where = f"block {type(block).__name__}.{method}, {users[-1]}" if users else place(block, method)
    return DiagramError(what, where, remedy)


def _top(module: str) -> str:
    return module.partition(".")[0]


def _told(error: Exception) -> tuple[str, str]:
    """Return the fact and the remedy."""
    if isinstance(error, DiagramError):
        return error.what, error.remedy
    text = f"{type(error).__name__}: {error!s:.300}".removesuffix(": ")
    recorded = isinstance(error, (TypeError, AttributeError)) and any(name in str(error) for name in _RECORDED)
    if recorded and "ufunc" in str(error):
        return (
            "a function of numpy is applied to a recorded value",
            "use the functions of twodof.blocks, such as sin, sqrt, minimum or where",
        )
    if recorded:
        return (
            f"this is not an operation on recorded values ({text})",
            "see the operators and functions in docs/explanation/language.md, section 2",
        )
    early = recording() and isinstance(error, (LookupError, TypeError, ValueError))
    return f"its code raises {text}", f"correct this line{'; values are not numbers yet when it runs' if early else ''}"
