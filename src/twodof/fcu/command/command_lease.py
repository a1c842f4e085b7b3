"""The lease of the client that may command, and the watch on its link. The rules: docs/reference/protocol.md."""

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
"""Sender of a message: MAVLink system and component."""


class CommandResult(NamedTuple):
    """Answer to a command: a MAV_RESULT, and the reason for a refusal, a `text` for people and a code for programs."""

    result: MavResult
    text: str = ""
    reason: RefusalReason = RefusalReason.OTHER

    @property
    def accepted(self) -> bool:
        """Return whether the command was carried out."""
        return self.result == MavResult.ACCEPTED

    @property
    def in_progress(self) -> bool:
        """Return whether the answer comes later."""
        return self.result == MavResult.IN_PROGRESS


DONE = CommandResult(MavResult.ACCEPTED)


def denied(text: str = "", reason: RefusalReason = RefusalReason.OTHER) -> CommandResult:
    """Return the refusal of a command that is never valid, such as one with a wrong number."""
    return CommandResult(MavResult.DENIED, text, reason)


def rejected(text: str, reason: RefusalReason = RefusalReason.OTHER) -> CommandResult:
    """Return the refusal of a command that cannot be carried out now."""
    return CommandResult(MavResult.TEMPORARILY_REJECTED, text, reason)


def failed(text: str = "") -> CommandResult:
    """Return the answer to a command that was tried and failed."""
    return CommandResult(MavResult.FAILED, text)


def unsupported(text: str = "") -> CommandResult:
    """Return the answer to a command that this drone does not have."""
    return CommandResult(MavResult.UNSUPPORTED, text)


ACTING = (LEVEL, BRAKE, DESCEND)
"""States in which the failsafe flies."""

MOST_REMARKS = 64
"""Most remarks that wait to be sent."""


@dataclass
class VehicleState:
    """State of the vehicle that commands depend on: switches of `rig`, the last `step` (None: none yet), the failsafe.

    `now` is the next tick to be run, in which a command acts. `failsafe` is the failsafe's state. `remarks` are
    (MAV_SEVERITY, text) pairs for the clients.
    """

    rig: Hardware
    remarks: list[tuple[int, str]] = field(default_factory=list)
    now: int = 0
    armed: bool = False
    failsafe: int = DISARMED
    step: ControlStep | None = None

    @property
    def failsafe_acts(self) -> bool:
        """Return whether the failsafe flies the drone instead of the set-points."""
        return self.failsafe in ACTING

    def remark(self, severity: int, text: str) -> None:
        """Send the clients `text` with a MAV_SEVERITY."""
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
"""Most ticks for which a lease is granted at once."""


class CommandLease:
    """Lease of the right to command, with one `holder` at most (None: free); it ends when the holder falls silent.

    A sender's system must not be 0; its component may be, as in many scripts, which PX4 accepts too. `what` in the
    methods names the request in a refusal. `revision` counts the changes of holder; `changed` is called at each.

    `orphaned`: the holder fell silent or gave the lease up while armed, and no other client has taken it since. Then
    frames of other clients do not keep the link alive, because the drone has no pilot.

    With `granted` (lockstep) the holder grants the time that passes, so the link is alive in every tick. While time
    stands still (`note_standstill`), a dead holder would keep the lease for ever. So another client may take it after
    `HEARD` ticks of standing time without a frame of the holder. Until then nothing changes: a flight must not depend
    on how long a client thinks.

    `tuning_withheld`: only the holder may change parameters.
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
        """Return the ticks until the lease ends if the holder stays silent; 0 without a holder."""
        if self.holder is None:
            return 0
        left = self._end() - self._vehicle.now
        return max(0, min(left, HEARD - self._stood) if self._stood else left)

    def note_frame(self, source: Source, is_client: bool) -> None:
        """Note a frame of `source`. The holder's frames keep the link alive; without a holder, those of any client.

        `is_client`: the source is a ground station or a companion, not a vehicle.
        """
        if self.holder is None:
            self._link_heard |= is_client and not self.orphaned
        elif self.holder == source:
            self._last_heard, self._stood = self._vehicle.now, 0
            self._link_heard = True

    def take(self, source: Source, what: str = "command") -> CommandResult:
        """Take or renew the lease for a command of `source`; refuse it while another client holds the lease."""
        result = self._claim(source, f"{what} refused", "the lease")
        if result.accepted:
            self._until = max(self._until, self._vehicle.now + COMMANDING)
        return result

    def may_tune(self, source: Source) -> CommandResult:
        """Allow `source` to change parameters, unless another client withholds tuning.

        This does not take the lease, but renews it for its holder.
        """
        if not source[0]:
            return denied("parameters refused: the sender's MAVLink system is 0")
        if self.holder == source:
            return self.take(source, "parameters")
        if self.tuning_withheld:
            why = f"parameters refused: {self._who()} holds the lease and withholds tuning"
            return rejected(why, RefusalReason.LEASE)
        return DONE

    def tuned(self, source: Source, what: str) -> None:
        """Tell the clients about a change, `what`, by `source`, unless `source` holds the lease or it is free."""
        if self.holder not in (None, source):
            self._vehicle.remark(MavSeverity.INFO, f"{what}, by system {source[0]}, component {source[1]}")

    def request(self, source: Source, duration_ms: int = 0, withhold_tuning: bool = False) -> CommandResult:
        """Take or renew the lease for `duration_ms`, 30 s at most (0: 2 s); refuse it while another client holds it.

        `withhold_tuning`: other clients may not change parameters until the lease ends or is renewed without it.
        """
        result = self._claim(source, "lease refused", "it")
        if result.accepted:
            self.tuning_withheld = withhold_tuning
            ticks = round(duration_ms * 1e-3 / PERIOD) if duration_ms else COMMANDING
            self._until = self._vehicle.now + min(max(ticks, 1), LONGEST)
        return result

    def give_up(self, source: Source) -> CommandResult:
        """Give up the lease; refuse this to all but its holder."""
        if self.holder != source:
            return rejected(f"lease not given up: {self._who()} holds it", RefusalReason.LEASE)
        self._free()
        return DONE

    def begin_tick(self) -> None:
        """Begin a tick: earlier frames no longer count for the link, and the lease may end."""
        self._link_heard = False
        if self._granted:
            self._last_heard, self._stood = self._vehicle.now - 1, 0
        if self.holder is not None and self._vehicle.now >= self._end():
            self._free()
            severity = MavSeverity.WARNING if self.orphaned else MavSeverity.INFO
            self._vehicle.remark(severity, "nobody holds the lease any more")

    def note_standstill(self, ticks: int) -> None:
        """Note real time, in ticks, that passed in lockstep without a grant."""
        self._stood = min(self._stood + ticks, HEARD)

    def restart(self) -> None:
        """Restart time at 0; the holder keeps the rest of its lease."""
        self._until -= self._vehicle.now
        self._last_heard -= self._vehicle.now
        self._link_heard = False

    def _end(self) -> int:
        """Return the first tick at which the lease is free if the holder stays silent."""
        return max(self._until, self._last_heard + HEARD) if self._vehicle.armed else self._until

    def _claim(self, source: Source, refused: str, held: str) -> CommandResult:
        """Make `source` the holder, or refuse: "`refused`: system 255, component 190 holds `held`"."""
        if not source[0]:
            return denied(f"{refused}: the sender's MAVLink system is 0")
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
