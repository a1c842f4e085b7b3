"""The companion as a MAVLink component: its heartbeat, its answers, and the state of its computer."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from twodof.companion import frame_fields
from twodof.companion.client import CompanionClient
from twodof.companion.router import Router
from twodof.link.mavlink.dialect import COMPANION, NO_AUTOPILOT, MavResult, MavSeverity
from twodof.link.mavlink.framing import Frame, decode
from twodof.link.mavlink.messages import message, statustext

ONBOARD_CONTROLLER = 18
BOOTING, ACTIVE, CRITICAL = 1, 4, 5
MAVLINK2 = 8192
"""The one capability of MAV_PROTOCOL_CAPABILITY that the companion has."""
VERSION = 1 << 24 | 255
"""1.0.0, a release."""
_TIMESYNC = 111
MOST_CORES, MOST_LINKS = 8, 6
NO_CORE, NO_NUMBER, NO_TEMPERATURE, NO_FAN = 255, 2**32 - 1, 127, 32767
MIB, KIB = 1 << 20, 1 << 10


class Traffic(NamedTuple):
    """Bytes that a link has sent and received so far, and the most it carries [byte/s], 0 if unknown."""

    sent: int
    received: int
    most: float = 0.0


class ComputerStatus:
    """State of this computer, read from /proc; rates are those since the last call. `clock` gives seconds."""

    def __init__(
        self, links: Callable[[], Sequence[Traffic]] = tuple, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._links = links
        self._clock = clock
        self._started = self._last = clock()
        self._busy: list[tuple[int, int]] = []
        self._traffic: list[Traffic] = []

    def status(self) -> Any:
        """Return the message ONBOARD_COMPUTER_STATUS; a field that cannot be read has MAVLink's value for unknown."""
        now = self._clock()
        since, self._last = max(now - self._last, 1e-3), now
        used, total = self._memory()
        links = [*self._links()][:MOST_LINKS]
        before = self._traffic if len(self._traffic) == len(links) else links
        self._traffic = links
        sent = [round((one.sent - old.sent) / since / KIB) for one, old in zip(links, before, strict=True)]
        received = [round((one.received - old.received) / since / KIB) for one, old in zip(links, before, strict=True)]
        most = [round(one.most / KIB) or NO_NUMBER for one in links]
        return message(
            "ONBOARD_COMPUTER_STATUS",
            time_usec=int(time.time() * 1e6),
            uptime=int((now - self._started) * 1e3) & 0xFFFFFFFF,
            cpu_cores=_filled(self._loads(), MOST_CORES, NO_CORE),
            cpu_combined=[NO_CORE] * 10,
            gpu_cores=[NO_CORE] * 4,
            gpu_combined=[NO_CORE] * 10,
            temperature_board=NO_TEMPERATURE,
            temperature_core=[NO_TEMPERATURE] * 8,
            fan_speed=[NO_FAN] * 4,
            ram_usage=used,
            ram_total=total,
            storage_type=[NO_NUMBER] * 4,
            storage_usage=[NO_NUMBER] * 4,
            storage_total=[NO_NUMBER] * 4,
            link_tx_rate=_filled(sent, MOST_LINKS, NO_NUMBER),
            link_rx_rate=_filled(received, MOST_LINKS, NO_NUMBER),
            link_tx_max=_filled(most, MOST_LINKS, NO_NUMBER),
            link_rx_max=_filled(most, MOST_LINKS, NO_NUMBER),
        )

    def _loads(self) -> list[int]:
        """Return the load of each core [%] since the last call."""
        rows = [line.split() for line in self._lines("stat") if line.startswith("cpu") and line[3:4].isdigit()]
        times = [[int(word) for word in row[1:9] if word.isdigit()] for row in rows[:MOST_CORES]]
        busy = [(sum(row), sum(row) - sum(row[3:5])) for row in times]  # all time, and the busy part of it
        before, self._busy = self._busy, busy
        if len(before) != len(busy):
            return []
        return [
            round(100 * (working - old_working) / max(all_time - old_all, 1))
            for (all_time, working), (old_all, old_working) in zip(busy, before, strict=True)
        ]

    def _memory(self) -> tuple[int, int]:
        """Return the used and the total memory [MiB]."""
        rows = dict(line.split()[:2] for line in self._lines("meminfo") if len(line.split()) >= 2)
        try:
            total, free = int(rows["MemTotal:"]), int(rows["MemAvailable:"])
        except (KeyError, ValueError):
            return NO_NUMBER, NO_NUMBER
        return (total - free) * KIB // MIB, total * KIB // MIB

    def _lines(self, name: str) -> list[str]:
        try:
            with Path("/proc", name).open("rb") as file:
                return file.read(65_536).decode("ascii", "replace").splitlines()
        except OSError:  # no /proc: another system
            return []


def _filled(values: Sequence[int], length: int, unknown: int) -> list[int]:
    rows = [min(max(value, 0), unknown) for value in values][:length]
    return rows + [unknown] * (length - len(rows))


class CompanionComponent:
    """The companion as a component of the drone, which speaks through `router`."""

    def __init__(self, router: Router, computer: ComputerStatus) -> None:
        self.state = BOOTING
        self._router = router
        self._computer = computer
        self._texts = 0
        router.handle_own = self.handle

    def beat(self) -> None:
        """Send the heartbeat to all and the state of the computer to the clients; called once a second."""
        self._router.tell(self._heartbeat())
        self._router.tell(self._computer.status(), vehicle=False)

    def link(self, stands: bool, why: str) -> None:
        """Report at once that the link to the vehicle works again (`stands`) or is lost, with `why` as the text."""
        self.state = ACTIVE if stands else CRITICAL
        self._texts = self._texts % 65535 + 1
        for part in statustext(why, MavSeverity.INFO if stands else MavSeverity.WARNING, self._texts):
            self._router.tell(part, vehicle=False)
        self._router.tell(self._heartbeat())

    def time(self) -> bytes:
        """Return an encoded TIMESYNC request. Its signature tells our time to a peer that gets no other message yet."""
        return self._router.encoded(message("TIMESYNC", ts1=self._now()))

    def handle(self, frame: Frame, client: CompanionClient | None) -> None:
        """Handle a frame for the companion, from a client or (None) from the vehicle."""
        there = {"target_system": frame.system, "target_component": frame.component}
        asked = frame_fields.command(frame)
        if asked is not None and (asked.system, asked.component) == (self._router.system, COMPANION):
            found = self._asked(asked)
            result = MavResult.UNSUPPORTED if found is None else MavResult.ACCEPTED
            self._reply(client, message("COMMAND_ACK", command=asked.command, result=result, **there))
            if found is not None:
                self._reply(client, found)
        elif frame.message_id == _TIMESYNC:
            got: Any = decode(frame)
            if not got.tc1:
                self._reply(client, message("TIMESYNC", tc1=self._now(), ts1=got.ts1, **there))

    def _now(self) -> int:
        return max(1, int(self._router.clock() * 1e9))

    def _asked(self, asked: frame_fields.CommandFields) -> Any | None:
        """Return the message that a command asks for, None if the companion does not have it."""
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
