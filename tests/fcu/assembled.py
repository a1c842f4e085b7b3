"""The whole program of a drone on its virtual rig, driven by hand through bytes: no loop, no link, no clock."""

from collections.abc import Hashable
from typing import Any

from tests.fcu.command.cockpit import ME
from tests.fcu.sent_message import SentMessage
from twodof.fcu.command.command_lease import Source
from twodof.fcu.control.flight_code import ControlStep
from twodof.link.connection import Received
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import message
from twodof.sim.virtual_drone import VirtualDrone

TARGET = {"target_system": 1, "target_component": 1}
ARM, SET_MODE, INTERVAL = 400, 176, 511
OFFBOARD = (1.0, 6.0)


class Assembled:
    """A drone in its rings; `sent` are its messages, `steps` its control periods. `options` are those of VirtualDrone.

    `tick` is that of its first control period.
    """

    def __init__(self, tick: int = 0, **options: Any) -> None:
        self.drone = VirtualDrone(**{"conditions": {"rings": True, "seed": 3}, **options})
        self.sent: list[Any] = []
        self.steps: list[ControlStep] = []
        self._sequence = 0
        self.drone.assembly.px4.vehicle.send = self._send
        self.drone.controller.tick = self.drone.controller.granted = tick
        self.run()

    @property
    def tick(self) -> int:
        """Of the next control period."""
        return self.drone.controller.tick

    def say(self, sent: Any, source: Source = ME) -> None:
        """A client says something."""
        self._sequence = self._sequence + 1 & 0xFF
        (frame,) = Parser().feed(encode(sent, *source, self._sequence))
        received = Received(decode(frame), frame, "client")
        for service in self.drone.server.services:
            if service.handle(received):
                break

    def command(self, number: int, *params: float, source: Source = ME) -> None:
        """COMMAND_LONG."""
        named = {f"param{place}": value for place, value in enumerate(params, start=1)}
        self.say(message("COMMAND_LONG", command=number, **TARGET, **named), source)

    def run(self, ticks: int = 1) -> ControlStep:
        """Time passes; the last step."""
        for _ in range(ticks):
            step = self.drone.controller.step()
            self.steps.append(step)
            for service in self.drone.server.services:
                service.after(step)
        return step

    def fly(self) -> None:
        """Arms, and flies a level attitude in offboard mode."""
        self.say(message("HEARTBEAT", type=6, autopilot=8))
        self.run(60)
        self.stream()
        self.command(SET_MODE, *OFFBOARD)
        self.command(ARM, 1.0)
        self.run(2)
        assert self.steps[-1].armed, self.texts()
        self.stream()
        self.run()
        assert self.steps[-1].fore > 0.0

    def stream(self) -> None:
        """A set-point for the next control period."""
        fields = {"type_mask": 7, "q": [1.0, 0.0, 0.0, 0.0], "thrust": 0.4}
        self.say(message("SET_ATTITUDE_TARGET", **fields, **TARGET))

    def texts(self) -> str:
        """Join the texts that it sent."""
        return " / ".join(one.text for one in self.sent if one.get_type() == "STATUSTEXT")

    def _send(self, sent: Any, peer: Hashable | None = None) -> None:
        self.sent.append(SentMessage(sent))
