"""Both ends of a router without sockets: frames made by name, transports that keep what they were given."""

from collections.abc import Hashable
from typing import Any, cast

from twodof.companion.client import CompanionClient, profile, whole
from twodof.companion.router import Router
from twodof.companion.uplink_queue import UplinkQueue
from twodof.link.mavlink.framing import Frame, Parser, decode, encode
from twodof.link.mavlink.messages import message
from twodof.link.transport.base import Transport

SYSTEM = 1


class Sink:
    """Keeps what is sent; `backlog` is what it says still waits."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.backlog = 0

    def send(self, data: bytes, to: Hashable | None = None) -> None:
        """Keep it."""
        self.sent.append(data)

    def take(self) -> list[Frame]:
        """The frames sent since the last call."""
        frames = [frame for data in self.sent for frame in Parser().feed(data, whole=True)]
        self.sent = []
        return frames


def frame(name: str, system: int, component: int, sequence: int = 0, **fields: Any) -> Frame:
    """A message as the frame that a parser makes of it."""
    return Parser().feed(encode(message(name, **fields), system, component, sequence))[0]


def names(frames: list[Frame]) -> list[str]:
    """Names of the messages in frames."""
    return [decode(one).get_type() for one in frames]


class Ends:
    """A router with a line and clients that keep everything; `now` [s] is its clock."""

    def __init__(self, *rates: str, line_rate: float | None = None) -> None:
        self.now = 100.0
        self.up = Sink()
        self.line = UplinkQueue(line_rate)
        self.line.connect(cast(Transport, self.up))
        self.router = Router(SYSTEM, self.line, lambda: self.now)
        self.sinks: dict[CompanionClient, Sink] = {}
        self.clients = [self.join(one) for one in rates]
        self._sequence = 0
        self.answer()

    def join(self, rates: str = "onboard") -> CompanionClient:
        """One more client."""
        sink = Sink()
        client = CompanionClient(cast(Transport, sink), len(self.sinks), profile(rates), self.now)
        self.sinks[client] = sink
        self.router.add(client)
        return client

    def answer(self, result: int = 0) -> list[tuple[int, float]]:
        """The vehicle answers what it is asked to stream: (message, interval)."""
        asked = []
        for sent in self.up.take():
            one = decode(sent)
            if one.get_type() == "COMMAND_LONG" and one.command == 511:
                asked.append((whole(one.param1), one.param2))
                to = {"target_system": sent.system, "target_component": sent.component}
                self.vehicle("COMMAND_ACK", command=511, result=result, **to)
        return asked

    def vehicle(self, name: str, component: int = 1, **fields: Any) -> None:
        """The vehicle sends a message."""
        self.router.from_vehicle(frame(name, SYSTEM, component, self._sequence, **fields))
        self._sequence = (self._sequence + 1) & 0xFF

    def says(self, client: CompanionClient, name: str, system: int, component: int = 190, **fields: Any) -> None:
        """A client sends a message."""
        self.router.from_client(client, frame(name, system, component, **fields))

    def heard(self, client: CompanionClient) -> list[Frame]:
        """Return the frames that a client was sent since the last call."""
        return self.sinks[client].take()

    def settle(self) -> None:
        """Forget everything sent so far."""
        self.answer()
        self.up.sent = []
        for sink in self.sinks.values():
            sink.sent = []
