"""Sender of a command, and the answer that it gets."""

from typing import NamedTuple

from twodof.errors import RefusalReason
from twodof.link.mavlink.enums import MavResult

Source = tuple[int, int]
"""Who sent a message: MAVLink system and component."""


class CommandResult(NamedTuple):
    """The answer to a command: a MAV_RESULT, and why it was refused, as a `text` for people and a code for programs."""

    result: MavResult
    text: str = ""
    reason: RefusalReason = RefusalReason.OTHER

    @property
    def accepted(self) -> bool:
        """Return whether it was done."""
        return self.result == MavResult.ACCEPTED

    @property
    def in_progress(self) -> bool:
        """Return whether the answer comes later."""
        return self.result == MavResult.IN_PROGRESS


DONE = CommandResult(MavResult.ACCEPTED)


def denied(text: str = "", reason: RefusalReason = RefusalReason.OTHER) -> CommandResult:
    """Return the answer to what makes no sense, now or later."""
    return CommandResult(MavResult.DENIED, text, reason)


def rejected(text: str, reason: RefusalReason = RefusalReason.OTHER) -> CommandResult:
    """Return the answer to what cannot be done now."""
    return CommandResult(MavResult.TEMPORARILY_REJECTED, text, reason)


def failed(text: str = "") -> CommandResult:
    """Return the answer to what was tried and did not succeed."""
    return CommandResult(MavResult.FAILED, text)


def unsupported(text: str = "") -> CommandResult:
    """Return the answer to what the drone does not do."""
    return CommandResult(MavResult.UNSUPPORTED, text)
