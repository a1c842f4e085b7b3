"""VehicleState: what the commander knows of the drone in this tick."""

from dataclasses import dataclass, field

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import Hardware
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, DISARMED, LEVEL

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
