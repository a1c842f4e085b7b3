"""Who asks for something, and the answer that a command gets."""

from typing import NamedTuple

from twodof.errors import Refusal
from twodof.link.mavlink.enums import MavResult

Source = tuple[int, int]
"""Who sent a message: MAVLink system and component."""


class CommandResult(NamedTuple):
    """The answer to a command: a MAV_RESULT, and why it was refused, as a `text` for people and a code for programs."""

    result: MavResult
    text: str = ""
    reason: Refusal = Refusal.OTHER

    @property
    def accepted(self) -> bool:
        """Whether it was done."""
        return self.result == MavResult.ACCEPTED

    @property
    def in_progress(self) -> bool:
        """Whether the answer comes later."""
        return self.result == MavResult.IN_PROGRESS


DONE = CommandResult(MavResult.ACCEPTED)


def denied(text: str = "", reason: Refusal = Refusal.OTHER) -> CommandResult:
    """Return the answer to what makes no sense, now or later."""
    return CommandResult(MavResult.DENIED, text, reason)


def rejected(text: str, reason: Refusal = Refusal.OTHER) -> CommandResult:
    """Return the answer to what cannot be done now."""
    return CommandResult(MavResult.TEMPORARILY_REJECTED, text, reason)


def failed(text: str = "") -> CommandResult:
    """It was tried, and did not succeed."""
    return CommandResult(MavResult.FAILED, text)


def unsupported(text: str = "") -> CommandResult:
    """It is not done here."""
    return CommandResult(MavResult.UNSUPPORTED, text)
