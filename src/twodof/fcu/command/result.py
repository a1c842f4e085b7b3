"""Who asks for something, and the answer that a command gets."""

from __future__ import annotations

from typing import NamedTuple

Source = tuple[int, int]
"""Who sent a message: MAVLink system and component."""


class CommandResult(NamedTuple):
    """The answer to a command: `result` is a MAV_RESULT, `text` says why it was refused."""

    result: int
    text: str = ""

    @property
    def accepted(self) -> bool:
        """Whether it was done."""
        return self.result == ACCEPTED


ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
"""MAV_RESULT."""
