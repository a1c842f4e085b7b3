"""OnboardEventBus: tells those that asked for it when something has happened on board."""

from collections import defaultdict
from collections.abc import Callable
from typing import Any, TypeVar

Event = TypeVar("Event")


class OnboardEventBus:
    """Calls each listener of an event's class, in the order in which they subscribed, before `publish` returns."""

    def __init__(self) -> None:
        self._listeners: defaultdict[type[Any], list[Callable[[Any], object]]] = defaultdict(list)

    def subscribe(self, kind: type[Event], listener: Callable[[Event], object]) -> None:
        """Call `listener` with each event of the class `kind`, not of its subclasses."""
        self._listeners[kind].append(listener)

    def publish(self, event: object) -> None:
        """Call the listeners of this event's class; an exception of a listener is raised here."""
        for listener in self._listeners.get(type(event), ()):
            listener(event)
