"""Audience: the clients that are connected, and what all of them are told."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twodof.lab.access.role import Role
from twodof.lab.finite_json import dumps
from twodof.lab.telemetry.outbox import Outbox


class Audience:
    """Every client's outbox, with what its token lets it do."""

    def __init__(self) -> None:
        self._outboxes: dict[Outbox, Role] = {}

    def __len__(self) -> int:
        return len(self._outboxes)

    @property
    def commanding(self) -> int:
        """How many clients are connected that may command."""
        return sum(role is Role.COMMAND for role in self._outboxes.values())

    def join(self, outbox: Outbox, role: Role) -> None:
        """One more."""
        self._outboxes[outbox] = role

    def leave(self, outbox: Outbox) -> None:
        """One less."""
        self._outboxes.pop(outbox, None)

    def tell(self, event: Mapping[str, Any]) -> None:
        """Tell all an event, see docs/reference."""
        if self._outboxes:
            text = dumps(event)
            for outbox in self._outboxes:
                outbox.tell(text)
