"""Synchronous classes made of asynchronous ones: the same calls, each run by the drone's own thread.

What `synchronous` adds at import, tools/sync_stub.py writes into drone.pyi for editors and for mypy. Both read the
annotations as text, so the modules of such classes import `annotations` from the future.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager, contextmanager, suppress
from functools import wraps
from typing import Any, TypeVar

from twodof.errors import TwodofError
from twodof.gcs.loop_thread import LoopThread

Kind = TypeVar("Kind", bound=type)
_CONTEXT = "AbstractAsyncContextManager"


class SyncFace:
    """Stands for `there`, which lives in the loop of `runner`."""

    def __init__(self, there: Any, runner: LoopThread) -> None:
        self.there = there
        self._runner = runner

    @contextmanager
    def _within(self, manager: AbstractAsyncContextManager[Any]) -> Iterator[Any]:
        """An asynchronous context as one for `with`."""
        entered = self._runner.run(manager.__aenter__())
        try:
            yield entered
        except BaseException as error:
            with suppress(TwodofError):  # what went wrong in the block says more
                self._runner.run(manager.__aexit__(type(error), error, error.__traceback__))
            raise
        self._runner.run(manager.__aexit__(None, None, None))


def synchronous(there: type) -> Callable[[Kind], Kind]:
    """Gives a SyncFace every public method and property of the class `there` that it lacks.

    Raises TypeError for a method whose annotations are not text.
    """

    def filled(kind: Kind) -> Kind:
        for name in dir(there):
            member = inspect.getattr_static(there, name)
            if not name.startswith("_") and not hasattr(kind, name) and not isinstance(member, classmethod):
                setattr(kind, name, _property(name, member) if isinstance(member, property) else _method(member))
        return kind

    return filled


def _property(name: str, there: property) -> property:
    return property(lambda self: getattr(self.there, name), doc=there.__doc__)


def _method(there: Any) -> Any:
    signature = inspect.signature(there)
    if not isinstance(signature.return_annotation, str):  # a context would silently become no context
        raise TypeError(f"{there.__qualname__}: its module must import `annotations` from the future")
    context = signature.return_annotation.startswith(_CONTEXT)
    waits = inspect.iscoroutinefunction(there)

    @wraps(there)
    def call(self: SyncFace, *args: Any, **named: Any) -> Any:
        if waits:
            return self._runner.run(there(self.there, *args, **named))
        if context:
            return self._within(there(self.there, *args, **named))
        return self._runner.call(lambda: there(self.there, *args, **named))

    returned = signature.return_annotation.replace(_CONTEXT, "AbstractContextManager")
    call.__doc__ = (there.__doc__ or "").replace("`async with`", "`with`")
    call.__signature__ = signature.replace(return_annotation=returned)  # type: ignore[attr-defined]
    return call
