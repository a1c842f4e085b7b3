"""Audience: the clients that are connected, which of them stand still, and what all of them are told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twodof.lab.access.role import Role
from twodof.lab.finite_json import dumps
from twodof.lab.telemetry.outbox import Outbox

MOST_UNANSWERED = 2
"""A client that leaves more `alive` unanswered stands still: a tab that is frozen, whose browser keeps the socket."""


@dataclass
class _Listener:
    """What a client's token lets it do, whether it ever answered, and how often it has not since."""

    role: Role
    answers: bool = False
    unanswered: int = 0


class Audience:
    """Every client's outbox, with what its token lets it do and whether it is there."""

    def __init__(self) -> None:
        self._listeners: dict[Outbox, _Listener] = {}

    def __len__(self) -> int:
        return len(self._listeners)

    @property
    def commanding(self) -> int:
        """How many clients are connected that may command, without those that stand still.

        A program that never answers counts for as long as its socket is open: that closes when the program ends.
        """
        there = (one for one in self._listeners.values() if one.unanswered <= MOST_UNANSWERED)
        return sum(one.role is Role.COMMAND for one in there)

    def join(self, outbox: Outbox, role: Role) -> None:
        """One more."""
        self._listeners[outbox] = _Listener(role)

    def leave(self, outbox: Outbox) -> None:
        """One less."""
        self._listeners.pop(outbox, None)

    def asked(self, outbox: Outbox) -> None:
        """A client is asked whether it is there."""
        listener = self._listeners[outbox]
        listener.unanswered += listener.answers

    def answered(self, outbox: Outbox) -> None:
        """A client has said that it is there."""
        listener = self._listeners[outbox]
        listener.answers, listener.unanswered = True, 0

    def tell(self, event: Mapping[str, Any]) -> None:
        """Tell all an event, see docs/reference."""
        if self._listeners:
            text = dumps(event)
            for outbox in self._listeners:
                outbox.tell(text)
