"""The commander's services before a real commander and control loop, with a flight code of two lines; no I/O."""

from collections.abc import Hashable, Mapping
from typing import Any

from tests.fcu.command.cockpit import ME, Failsafe
from tests.fcu.sent_message import SentMessage
from twodof.errors import ParameterError, RefusalReason
from twodof.fcu.command.command_lease import CommandResult, Source
from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.fcu.control.loop import FlightController, TimeRestarted
from twodof.fcu.mavlink.clients import LeaseService
from twodof.fcu.mavlink.encoders import TelemetryEncoders
from twodof.fcu.mavlink.lockstep import LockstepService
from twodof.fcu.mavlink.service import Vehicle
from twodof.fcu.mavlink.setpoint_service import ExcitationService, SetpointService
from twodof.fcu.parameters.parameter_store import ParameterStore
from twodof.link.connection import Received
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import message

SYSTEM = 1
TARGET = {"target_system": SYSTEM, "target_component": 1}


class Code:
    """A flight code that arms and flies nothing."""

    sandbox = None
    user_fault = ""

    def __init__(self) -> None:
        self.failsafe = Failsafe()

    def step(self, tick: int, sample: SensorSample, asked: ControlInput, rings: bool, late: bool) -> ControlStep:
        """One tick."""
        return self.failsafe.step(tick, asked)

    def reset(self, states: Mapping[str, Any]) -> None:
        """From the start."""
        self.failsafe = Failsafe()


class Bench:
    """Stands for a virtual rig."""

    name, virtual, seed, noise, rings, safety_off = "bench", True, 7, 1.0, False, True

    def read(self) -> SensorSample:
        """Return the sample of a rig at rest."""
        return SensorSample(0.0, 0.0, -9.81, 0.0, 0.0, 0.0, True, 0.5, False, 0.0, 12.3, 0.8)

    def drive(self, fore: float, aft: float) -> None:
        """Do nothing."""

    def stop(self) -> None:
        """Do nothing."""

    def release(self) -> None:
        """Do nothing."""

    def reset(self, seed: int, x: float, noise: float, rings: bool) -> dict[str, Any]:
        """Begins again."""
        if not abs(x) <= 0.4:
            raise ParameterError(f"x = {x:g} is beyond the rail", "x", "start inside")
        if not 0.0 <= noise < 1e6:
            raise ParameterError(f"a noise of {noise:g}", "noise", "give 0 or more")
        self.seed, self.noise, self.rings = seed, noise, rings
        return {}


class Desk:
    """The services, what they sent as (message, peer), and clients that talk to them."""

    def __init__(self, lockstep: bool = False) -> None:
        self.bench, self.code = Bench(), Code()
        self.commander = Commander(self.bench, lambda: 0.375, lockstep)
        self.controller = FlightController(self.bench, self.code, self.commander, lockstep)
        self.sent: list[tuple[Any, Hashable]] = []
        self.told: list[str] = []
        self.reasons: list[RefusalReason] = []
        store = ParameterStore(bus=self.controller.bus)
        vehicle = Vehicle(self, SYSTEM, self.controller, self.commander, store)
        vehicle.refuse = self._refuse
        self.excite = ExcitationService(vehicle)
        answer = TelemetryEncoders(self.controller, self.commander).rig
        self.services = [LeaseService(vehicle), SetpointService(vehicle), self.excite, LockstepService(vehicle, answer)]
        self.controller.bus.subscribe(TimeRestarted, lambda _: [one.restart() for one in self.services])
        self.sequence = 0

    def send(self, sent: Any, peer: Hashable | None = None) -> None:
        """The services' link: through bytes and back, as it goes over a real one."""
        self.sent.append((SentMessage(sent), peer))

    def say(self, sent: Any, source: Source = ME, peer: Hashable = "client") -> bool:
        """A client says something; whether a service took it."""
        self.sequence = self.sequence + 1 & 0xFF
        (frame,) = Parser().feed(encode(sent, *source, self.sequence))
        return any(service.handle(Received(decode(frame), frame, peer)) for service in self.services)

    def run(self, ticks: int = 1) -> ControlInput:
        """Time passes; what was asked in the last tick."""
        for _ in range(ticks):
            step = self.controller.step()
            for service in self.services:
                service.after(step)
        return step.asked

    def run_granted(self) -> None:
        """Runs what was granted."""
        self.run(self.controller.granted - self.controller.tick)

    def taken(self, name: str) -> list[Any]:
        """The messages of that name that were sent, which are forgotten with that."""
        wanted = [one for one, _ in self.sent if one.get_type() == name]
        self.sent = [pair for pair in self.sent if pair[0].get_type() != name]
        return wanted

    def arm(self) -> None:
        """Armed, its link heard."""
        self.say(message("HEARTBEAT", type=6, autopilot=8))
        self.run(3)
        assert self.commander.arming.arm(ME).result == 5
        self.run()
        assert self.commander.armed

    def _refuse(self, received: Received, result: CommandResult) -> None:
        self.told.append(result.text)
        self.reasons.append(result.reason)
