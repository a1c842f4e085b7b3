"""The companion as a MAVLink component of its own: its heartbeat, what it answers, how its computer is."""

from collections.abc import Callable
from typing import Any

from twodof.companion import frame_fields
from twodof.companion.client import CompanionClient
from twodof.companion.computer import ComputerStatus
from twodof.companion.router import Router
from twodof.link.mavlink.enums import COMPANION, NO_AUTOPILOT
from twodof.link.mavlink.framing import Frame, decode
from twodof.link.mavlink.messages import message, statustext

ONBOARD_CONTROLLER = 18
BOOTING, ACTIVE, CRITICAL = 1, 4, 5
WARNING, INFO = 4, 6
ACCEPTED, UNSUPPORTED = 0, 3
MAVLINK2 = 8192  # the one capability of MAV_PROTOCOL_CAPABILITY that it has
VERSION = 1 << 24 | 255  # 1.0.0, a release
_TIMESYNC = 111


class CompanionComponent:
    """What the companion says of itself, through `router`."""

    def __init__(self, router: Router, computer: ComputerStatus) -> None:
        self.state = BOOTING
        self._router = router
        self._computer = computer
        self._texts = 0
        router.own = self.handle

    def beat(self) -> None:
        """Once a second: the heartbeat to all, the state of the computer to the clients."""
        self._router.tell(self._heartbeat())
        self._router.tell(self._computer.status(), vehicle=False)

    def link(self, stands: bool, why: str) -> None:
        """The link to the vehicle was cut, or stands again: said at once."""
        self.state = ACTIVE if stands else CRITICAL
        self._texts = self._texts % 65535 + 1
        for part in statustext(why, INFO if stands else WARNING, self._texts):
            self._router.tell(part, vehicle=False)
        self._router.tell(self._heartbeat())

    def time(self) -> bytes:
        """A signed word to who may hear no other of us yet: a question for its time, which tells ours."""
        return self._router.said(message("TIMESYNC", ts1=self._now()))

    def handle(self, frame: Frame, client: CompanionClient | None) -> None:
        """A frame that is for the companion, from a client or (None) from the vehicle."""
        there = {"target_system": frame.system, "target_component": frame.component}
        asked = frame_fields.command(frame)
        if asked is not None and (asked.system, asked.component) == (self._router.system, COMPANION):
            what = self._asked(asked)
            result = UNSUPPORTED if what is None else ACCEPTED
            self._reply(client, message("COMMAND_ACK", command=asked.command, result=result, **there))
            if what is not None:
                self._reply(client, what)
        elif frame.message_id == _TIMESYNC:
            got: Any = decode(frame)
            if not got.tc1:
                self._reply(client, message("TIMESYNC", tc1=self._now(), ts1=got.ts1, **there))

    def _now(self) -> int:
        return max(1, int(self._router.clock() * 1e9))

    def _asked(self, asked: frame_fields.CommandFields) -> Any | None:
        """The message that a command asks for, None if we do not have it."""
        answers: dict[int, Callable[[], Any]] = {0: self._heartbeat, 148: self._version, 390: self._computer.status}
        if asked.command != frame_fields.REQUEST_MESSAGE:
            return None
        answer = answers.get(int(asked.params[0]) if 0.0 <= asked.params[0] < 65536.0 else -1)
        return answer() if answer is not None else None

    def _reply(self, client: CompanionClient | None, sent: Any) -> None:
        if client is not None:
            self._router.answer(client, sent)
        else:
            self._router.tell(sent, clients=False)

    def _heartbeat(self) -> Any:
        return message("HEARTBEAT", type=ONBOARD_CONTROLLER, autopilot=NO_AUTOPILOT, system_status=self.state)

    def _version(self) -> Any:
        return message("AUTOPILOT_VERSION", capabilities=MAVLINK2, flight_sw_version=VERSION, uid=COMPANION)
