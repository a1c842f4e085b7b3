"""Arming: the commander's word to the failsafe, its answer, and the latch of a kill."""

from __future__ import annotations

from twodof.fcu.command.result import ACCEPTED, FAILED, IN_PROGRESS, TEMPORARILY_REJECTED, CommandResult, Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.flight.failsafe.causes import named_causes
from twodof.flight.failsafe.state_machine import MAY_TURN, REFUSED

PATIENCE = 25
"""Ticks within which the failsafe has answered; it does in the tick in which it is asked."""


class ArmingState:
    """`word` is what the flight code is told, `answer` what became of the last request to arm.

    `killed_by` is who killed it, which holds it disarmed, over disarmings and resets, until it is None again.
    """

    def __init__(self, killed_by: Source | None = None) -> None:
        self.word = False
        self.killed_by = killed_by
        self.answer = CommandResult(ACCEPTED)
        self._from = 0

    @property
    def pending(self) -> bool:
        """Whether the failsafe has not answered yet."""
        return self.answer.result == IN_PROGRESS

    def pull(self, tick: int) -> CommandResult:
        """Asks the failsafe to arm at `tick`. It acts on an edge: until then the word is not given."""
        self._from = tick
        self.answer = CommandResult(IN_PROGRESS)
        return self.answer

    def speak(self, tick: int) -> None:
        """Called before each tick while it is pending: gives the word when its tick has come."""
        self.word = tick >= self._from

    def release(self) -> None:
        """The word is taken back; one who waits for an answer to an arming has it."""
        self.word = False
        if self.pending:
            self.answer = CommandResult(FAILED, "disarmed before it had armed")

    def seen(self, step: ControlStep) -> None:
        """Takes the failsafe's answer; called after each tick while it is pending."""
        if step.tick < self._from:
            return
        if step.state in MAY_TURN:
            self.answer = CommandResult(ACCEPTED)
        elif step.state == REFUSED:
            self.word = False
            # Without a cause only what lingers (failsafe.py: level_lasts, brake_lasts) speaks against it.
            causes = ", ".join(named_causes(step.reason or step.causes)) or "it levelled or braked a moment ago"
            self.answer = CommandResult(TEMPORARILY_REJECTED, f"not armed: {causes}")
        elif step.tick >= self._from + PATIENCE:
            self.word = False
            self.answer = CommandResult(FAILED, "not armed: the flight code did not answer")
