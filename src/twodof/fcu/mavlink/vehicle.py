"""What the services see of the vehicle: the little that they ask of the commander and of the flight controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from twodof.fcu.command.result import CommandResult, Source
from twodof.fcu.control.hardware import Hardware
from twodof.fcu.control.timing import LoopTiming
from twodof.link.mavlink.modes import FlightMode


class LeaseView(Protocol):
    """Who may command."""

    @property
    def holder(self) -> Source | None:
        """System and component, None: nobody."""

    @property
    def left(self) -> int:
        """Ticks for which it is still held if nothing more is heard."""


class OpenLoopView(Protocol):
    """The open-loop message in use."""

    @property
    def tick(self) -> int:
        """Since when."""

    @property
    def M(self) -> float:
        """Moment."""

    @property
    def T(self) -> float:
        """Thrust."""

    @property
    def openloop(self) -> bool:
        """Whether the loop is open."""

    @property
    def enableM(self) -> bool:
        """Whether the moment is flown."""

    @property
    def enableT(self) -> bool:
        """Whether the thrust is flown."""

    @property
    def revision(self) -> int:
        """Counts the messages."""


class CommanderView(Protocol):
    """What the services ask of `fcu.command.commander.Commander`."""

    @property
    def armed(self) -> bool:
        """Whether motors may turn."""

    @property
    def killed(self) -> bool:
        """Whether a kill holds it disarmed."""

    @property
    def killed_by(self) -> Source | None:
        """Who killed it last, None: no kill holds it."""

    @property
    def unfit(self) -> Callable[[], str]:
        """Says what else speaks against arming, "" if nothing does."""

    @property
    def base_mode(self) -> int:
        """MAV_MODE_FLAG, for HEARTBEAT."""

    @property
    def custom_mode(self) -> int:
        """PX4's number of the mode, for HEARTBEAT."""

    @property
    def system_status(self) -> int:
        """MAV_STATE, for HEARTBEAT."""

    @property
    def modes(self) -> Sequence[FlightMode]:
        """All that `set_mode` knows."""

    @property
    def openloop(self) -> OpenLoopView:
        """The open-loop message in use."""

    @property
    def arming(self) -> CommandResult:
        """What became of the last `arm`; IN_PROGRESS until that is known."""

    @property
    def lease(self) -> LeaseView:
        """Who may command."""

    @property
    def tuning_withheld(self) -> bool:
        """Whether nobody but the holder of the lease may change parameters."""

    @property
    def remarks(self) -> list[tuple[int, str]]:
        """(MAV_SEVERITY, text) to be told to the clients, drained by who tells them."""

    def take(self, source: Source, what: str = "") -> CommandResult:
        """Whether `source` may command now; a free lease becomes its own. `what` it wants is named in a refusal."""

    def may_tune(self, source: Source, what: str = "parameters") -> CommandResult:
        """Whether `source` may change parameters; takes no lease. `what` it wants is named in a refusal."""

    def arm(self, source: Source, force: bool = False) -> CommandResult:
        """Arms; `force` leaves checks out that may be."""

    def disarm(self, source: Source, force: bool = False) -> CommandResult:
        """Disarms; in flight only with `force`."""

    def set_mode(self, source: Source, custom_mode: int) -> CommandResult:
        """Changes the mode."""

    def kill(self, source: Source) -> CommandResult:
        """Stops the motors in the next tick, whoever asks, and holds it disarmed."""

    def release(self, source: Source) -> CommandResult:
        """Takes a kill back."""


class ControllerView(Protocol):
    """What the services ask of `fcu.control.loop.FlightController`."""

    @property
    def hardware(self) -> Hardware:
        """What it stands on."""

    @property
    def timing(self) -> LoopTiming:
        """How it keeps its time."""

    @property
    def tick(self) -> int:
        """Of the next control period."""

    @property
    def lockstep(self) -> bool:
        """Whether time stands still until ticks are granted."""

    @property
    def started_as(self) -> int:
        """A number of this start's own, 1 to 2^32 - 1; a reset does not change it."""
