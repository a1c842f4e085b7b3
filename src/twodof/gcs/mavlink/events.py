"""Events of a session that several of its parts care about, by type."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar


class ProgramPaused(NamedTuple):
    """This program stood still for so long [s], longer than a drone may be silent."""

    seconds: float


class DroneRestarted(NamedTuple):
    """The drone's time has gone back although nobody here has asked for that."""


class SliceStarts(NamedTuple):
    """In lockstep: the ticks from `tick` to `until` (not included) are granted next."""

    tick: int
    until: int


Event = TypeVar("Event", bound=tuple[Any, ...])


class EventBus:
    """Hands each event to those that wait for its type, in the order in which they came."""

    def __init__(self) -> None:
        self._handlers: dict[type, list[Callable[[Any], None]]] = {}

    def on(self, kind: type[Event], handler: Callable[[Event], None]) -> None:
        """Call `handler` with each event of this type, from now on."""
        self._handlers.setdefault(kind, []).append(handler)

    @contextmanager
    def handling(self, kind: type[Event], handler: Callable[[Event], None]) -> Iterator[None]:
        """As `on`, until the end of the block."""
        self.on(kind, handler)
        try:
            yield
        finally:
            self._handlers[kind].remove(handler)

    def emit(self, event: tuple[Any, ...]) -> None:
        """It has happened."""
        for handler in [*self._handlers.get(type(event), ())]:
            handler(event)
