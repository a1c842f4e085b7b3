"""A vehicle made of a scripted commander and a scripted controller, with the services in front; no I/O, no clock."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from tests.fcu.sent_message import SentMessage
from twodof.fcu.assembly import MavlinkServices
from twodof.fcu.command.command_lease import DONE, CommandResult, Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.fcu.control.loop import LoopTiming
from twodof.fcu.mavlink.service import Vehicle
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.link.connection import Received
from twodof.link.mavlink import modes
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import message

SYSTEM = 1
CLIENT = (250, 1)


class Loop(NamedTuple):
    """An open-loop message."""

    tick: int = 0
    M: float = 0.0
    T: float = 0.0
    openloop: bool = False
    enableM: bool = False
    enableT: bool = False
    revision: int = 0


CLOSED = Loop()


@dataclass
class Rig:
    """Hardware of the scripted controller."""

    name: str = "scripted"
    virtual: bool = True
    seed: int = 7
    noise: float = 0.25
    rings: bool = False
    safety_off: bool = True


@dataclass
class Control:
    """Stands for the flight controller."""

    hardware: Any = field(default_factory=Rig)
    started_as: int = 7
    timing: LoopTiming = field(default_factory=LoopTiming)
    tick: int = 0
    lockstep: bool = False


class Lease:
    """Grants what its commander's `verdict` says, and notes who asked for what."""

    def __init__(self, commander: Commander) -> None:
        self.commander = commander
        self.holder: Source | None = None
        self.left = self.revision = 0
        self.tuning_withheld = False

    def take(self, source: Source, what: str = "") -> CommandResult:
        return self.commander._note("take", source, what)

    def may_tune(self, source: Source, what: str = "parameters") -> CommandResult:
        return self.commander._note("tune", source, what)

    def tuned(self, source: Source, what: str) -> None:
        self.commander.remarks.append((6, what))


@dataclass
class Commander:
    """Grants what `verdict` says, to anyone, and notes who asked for what."""

    armed: bool = False
    killed_by: Source | None = None
    unfit: Callable[[], str] = str
    base_mode: int = 65
    custom_mode: int = modes.MANUAL
    system_status: int = 3
    openloop: Loop = CLOSED
    answer: CommandResult = DONE
    verdict: CommandResult = DONE
    remarks: list[tuple[int, str]] = field(default_factory=list)
    asked: list[tuple[Any, ...]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.lease = Lease(self)

    @property
    def arming(self) -> Commander:
        """It decides over arming too."""
        return self

    def _note(self, *what: Any) -> CommandResult:
        self.asked.append(what)
        return self.verdict

    def obstacles(self) -> str:
        return self.unfit()

    def arm(self, source: Source, repeated: bool = False) -> CommandResult:
        return self._note("arm", source)

    def disarm(self, source: Source) -> CommandResult:
        return self._note("disarm", source)

    def kill(self, source: Source) -> CommandResult:
        return self._note("kill", source)

    def release(self, source: Source) -> CommandResult:
        return self._note("release", source)

    def set_mode(self, source: Source, custom_mode: int) -> CommandResult:
        if self.verdict.accepted:
            self.custom_mode = custom_mode
        return self._note("mode", source, custom_mode)


def step(tick: int = 0, **values: Any) -> ControlStep:
    """A step at rest, with what `values` say of its sample, of what was asked, or of itself."""
    sample = SensorSample(0.0, 0.0, -9.81, 0.0, 0.0, 0.0, True, 0.5, False, 0.0, 12.3, 0.8)
    asked = ControlInput()
    rest: dict[str, Any] = dict.fromkeys(ControlStep.__slots__, 0.0)
    rest |= {"armed": False, "action": 0, "state": 0, "reason": 0, "causes": 0}
    for name, value in values.items():
        if name in SensorSample._fields:
            sample = sample._replace(**{name: value})
        elif name in ControlInput._fields and name not in rest:
            asked = asked._replace(**{name: value})
        else:
            rest[name] = value
    return ControlStep(**(rest | {"tick": tick, "sample": sample, "asked": asked}))


class World:
    """The services, what they sent as (message, peer), and clients that send to them."""

    def __init__(self, lockstep: bool = False, store: ParameterStore | None = None, **options: Any) -> None:
        self.controller = Control(lockstep=lockstep)
        self.commander = Commander()
        self.store = store if store is not None else ParameterStore()
        self.sent: list[tuple[Any, Hashable]] = []
        self.restarts = 0
        options.setdefault("restart", self._restarted)
        self.px4 = MavlinkServices(Vehicle(self, SYSTEM, self.controller, self.commander, self.store), **options)
        self.services = self.px4.services
        self.sequences: dict[Hashable, int] = {}

    def _restarted(self) -> None:
        self.restarts += 1

    def send(self, sent: Any, peer: Hashable | None = None) -> None:
        """The services' link: through bytes and back, as it goes over a real one."""
        self.sent.append((SentMessage(sent), peer))

    def say(self, sent: Any, peer: Hashable = "client", source: Source = CLIENT, sequence: int | None = None) -> bool:
        """A client says something; whether any service took it."""
        if sequence is None:
            sequence = self.sequences.get(peer, 0)
            self.sequences[peer] = sequence + 1 & 0xFF
        (frame,) = Parser().feed(encode(sent, *source, sequence))
        return self.hear(Received(decode(frame), frame, peer))

    def hear(self, received: Received) -> bool:
        """A message arrives."""
        return any(service.handle(received) for service in self.services)

    def run(self, ticks: int = 1, **values: Any) -> None:
        """Time passes, each step with `values`."""
        for _ in range(ticks):
            now = step(self.controller.tick, **values)
            self.controller.tick += 1
            for service in self.services:
                service.after(now)

    def command(self, number: int, *params: float, confirmation: int = 0, **options: Any) -> int:
        """COMMAND_LONG from a client; MAV_RESULT of its acknowledgement, -1 if there was none."""
        named = {f"param{place}": value for place, value in enumerate(params, start=1)}
        target = {"target_system": SYSTEM, "target_component": 1}
        self.say(message("COMMAND_LONG", command=number, confirmation=confirmation, **target, **named), **options)
        answers = self.taken("COMMAND_ACK")
        return answers[-1].result if answers else -1

    def taken(self, name: str, peer: Hashable = ...) -> list[Any]:
        """The messages of that name that were sent (to `peer`), which are forgotten with that."""
        wanted = [one for one, to in self.sent if one.get_type() == name and peer in (..., to)]
        self.sent = [(one, to) for one, to in self.sent if not (one.get_type() == name and peer in (..., to))]
        return wanted

    def texts(self) -> str:
        """All STATUSTEXTs, as one text; forgotten with that."""
        return "".join(one.text for one in self.taken("STATUSTEXT"))
