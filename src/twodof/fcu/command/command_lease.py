"""The lease: who may command, and whether the drone hears it. The rules are those of docs/reference/protocol.md."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from twodof.errors import RefusalReason
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import Hardware
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, DISARMED, LEVEL
from twodof.link.mavlink.dialect import MavResult, MavSeverity
from twodof.signals import PERIOD

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


ACTING = (LEVEL, BRAKE, DESCEND)
"""States in which the failsafe flies."""

MOST_REMARKS = 64
"""Remarks that are kept if nobody takes them."""


@dataclass
class VehicleState:
    """The hardware's switches (`rig`), the last `step` (None: none yet), and what the failsafe said in it.

    `now` is the first tick that was not asked for yet: a command acts there. `failsafe` is the failsafe's state.
    `remarks` are (MAV_SEVERITY, text) pairs for the clients.
    """

    rig: Hardware
    remarks: list[tuple[int, str]] = field(default_factory=list)
    now: int = 0
    armed: bool = False
    failsafe: int = DISARMED
    step: ControlStep | None = None

    @property
    def failsafe_acts(self) -> bool:
        """Return whether the failsafe flies, and not the set-points."""
        return self.failsafe in ACTING

    def remark(self, severity: int, text: str) -> None:
        """Tell the clients `text`, with a MAV_SEVERITY."""
        if len(self.remarks) < MOST_REMARKS:
            self.remarks.append((severity, text))

    def restart(self) -> None:
        """Restart at tick 0: disarmed, without a step."""
        self.now, self.armed, self.failsafe, self.step = 0, False, DISARMED, None


COMMANDING = round(2.0 / PERIOD)
"""Ticks after the holder's last command for which it keeps the lease while disarmed."""

HEARD = round(3.0 / PERIOD)
"""Ticks after the holder's last frame of any kind for which it keeps the lease while armed."""

LONGEST = round(30.0 / PERIOD)
"""Most ticks that a lease is asked for at once."""


class CommandLease:
    """One `holder` at most (None: nobody); its lease ends by itself when it falls silent.

    A sender is one whose system is not 0; its component may be, as that of many a script is, and PX4 takes those too.
    `what` a sender wanted is named in a refusal. `revision` counts the changes of holder; `changed` is called at each.

    `orphaned`: the holder fell silent or gave it up while armed, and nobody took the lease since. Then no other
    client keeps the link alive: the drone is without its pilot, also where others listen.

    With `granted` the time that passes was granted by the holder, so the link is alive in every tick. Where time
    stands still until then (`stands`), a dead holder would hold the lease for ever. So another may take it after
    `HEARD` ticks of standing time without a word of the holder. Until another does, nothing changes: a flight must not
    depend on how long a client thinks.

    `tuning_withheld`: nobody but the holder may change parameters.
    """

    def __init__(self, vehicle: VehicleState, granted: bool, changed: Callable[[], None]) -> None:
        self.holder: Source | None = None
        self.orphaned = False
        self.revision = 0
        self.tuning_withheld = False
        self._vehicle = vehicle
        self._granted = granted
        self._changed = changed
        self._link_heard = False  # in the tick that comes
        self._until = 0
        self._last_heard = 0
        self._stood = 0

    @property
    def link_alive(self) -> bool:
        """Return whether the link is alive in the coming tick."""
        return self._link_heard or self._granted

    @property
    def left(self) -> int:
        """Return the ticks until it ends if nothing more is heard; 0 without a holder."""
        if self.holder is None:
            return 0
        left = self._end() - self._vehicle.now
        return max(0, min(left, HEARD - self._stood) if self._stood else left)

    def hear(self, source: Source, is_client: bool) -> None:
        """Note a frame: the holder's keeps the link alive, and without a holder any client's does.

        `is_client`: it is of a ground station or companion, not of a vehicle.
        """
        if self.holder is None:
            self._link_heard |= is_client and not self.orphaned
        elif self.holder == source:
            self._last_heard, self._stood = self._vehicle.now, 0
            self._link_heard = True

    def take(self, source: Source, what: str = "command") -> CommandResult:
        """Take or renew the lease for a command of `source`; refused while another holds it."""
        result = self._claim(source, f"{what} refused", "the lease")
        if result.accepted:
            self._until = max(self._until, self._vehicle.now + COMMANDING)
        return result

    def may_tune(self, source: Source, what: str = "parameters") -> CommandResult:
        """Allow `source` to change parameters, unless the holder withholds it.

        It takes no lease; that of its holder it renews.
        """
        if not source[0]:
            return denied(f"{what} refused: it has no sender")
        if self.holder == source:
            return self.take(source, what)
        if self.tuning_withheld:
            return rejected(f"{what} refused: {self._who()} holds the lease and withholds tuning", RefusalReason.LEASE)
        return DONE

    def tuned(self, source: Source, what: str) -> None:
        """Tell the clients `what` was changed, if `source` does not hold the lease."""
        if self.holder not in (None, source):
            self._vehicle.remark(MavSeverity.INFO, f"{what}, by system {source[0]}, component {source[1]}")

    def ask(self, source: Source, duration_ms: int = 0, withhold_tuning: bool = False) -> CommandResult:
        """Take the lease, or renew it, for 30 s at most (0: 2 s); refused while another holds it.

        `withhold_tuning`: until it is renewed without that, or ends, nobody else may change parameters.
        """
        result = self._claim(source, "lease refused", "it")
        if result.accepted:
            self.tuning_withheld = withhold_tuning
            ticks = round(duration_ms * 1e-3 / PERIOD) if duration_ms else COMMANDING
            self._until = self._vehicle.now + min(max(ticks, 1), LONGEST)
        return result

    def give_up(self, source: Source) -> CommandResult:
        """Free the lease; refused to all but its holder."""
        if self.holder != source:
            return rejected(f"lease not given up: {self._who()} holds it", RefusalReason.LEASE)
        self._free()
        return DONE

    def pass_tick(self) -> None:
        """Begin a tick: frames of before no longer count, and the lease may end."""
        self._link_heard = False
        if self._granted:
            self._last_heard, self._stood = self._vehicle.now - 1, 0
        if self.holder is not None and self._vehicle.now >= self._end():
            self._free()
            severity = MavSeverity.WARNING if self.orphaned else MavSeverity.INFO
            self._vehicle.remark(severity, "nobody holds the lease any more")

    def stands(self, ticks: int) -> None:
        """Note real time, in ticks, that passed in lockstep without a grant."""
        self._stood = min(self._stood + ticks, HEARD)

    def restart(self) -> None:
        """Restart time at 0; the holder keeps the rest of its lease."""
        self._until -= self._vehicle.now
        self._last_heard -= self._vehicle.now
        self._link_heard = False

    def _end(self) -> int:
        """Return the first tick at which it is free if nothing more is heard."""
        return max(self._until, self._last_heard + HEARD) if self._vehicle.armed else self._until

    def _claim(self, source: Source, refused: str, held: str) -> CommandResult:
        """Make `source` the holder, unless another is; then it is `refused`, as the other holds what is `held`."""
        if not source[0]:
            return denied(f"{refused}: it has no sender")
        if self.holder is None or (self.holder != source and self._stood >= HEARD):
            self.holder, self.orphaned, self.tuning_withheld = source, False, False
            self._until = self._vehicle.now
            self.revision += 1
            self._changed()
        elif self.holder != source:
            return rejected(f"{refused}: {self._who()} holds {held}", RefusalReason.LEASE)
        self._last_heard, self._stood = self._vehicle.now, 0
        self._link_heard = True
        return DONE

    def _free(self) -> None:
        self.holder, self.tuning_withheld, self.orphaned = None, False, self._vehicle.armed
        self.revision += 1
        self._changed()

    def _who(self) -> str:
        return f"system {self.holder[0]}, component {self.holder[1]}" if self.holder is not None else "nobody"
