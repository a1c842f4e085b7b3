"""A session as bytes: a bare socket, pymavlink's stock dialect to send with, and the drone's bytes, untouched."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Iterable
from typing import Any

from pymavlink.dialects.v20 import common

from tests.patience import PATIENCE_S


class RawSession:
    """A client at a TCP port that keeps every byte it gets in `received`. Close it with `close`."""

    def __init__(self, port: int, system: int = 255) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
        self._mav = common.MAVLink(None, srcSystem=system, srcComponent=190)
        self._parser = common.MAVLink(None)
        self._parser.robust_parsing = True
        self._heartbeat_due = 0.0
        self.received = bytearray()
        self.messages: list[Any] = []

    def close(self) -> None:
        """End of the session."""
        self._socket.close()

    def send(self, message: Any) -> None:
        """One message."""
        self._socket.sendall(message.pack(self._mav))

    def command(self, number: int, *p: float, behind: Any = None) -> None:
        """COMMAND_LONG to the autopilot, then its acknowledgement; AssertionError if it is refused or does not come.

        `behind` is a message before it in one piece: however late the machine runs us, it is fresh to the autopilot.
        """
        before = len(self.messages)
        values = (*p, *[0.0] * 7)[:7]
        said = self._mav.command_long_encode(1, 1, number, 0, *values)
        self._socket.sendall(b"".join(one.pack(self._mav) for one in (behind, said) if one is not None))
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            self.listen(0.05)
            for m in self.messages[before:]:
                if m.get_type() == "COMMAND_ACK" and m.command == number and m.result != 5:  # 5: in progress
                    assert m.result == 0, m
                    return
        raise AssertionError(f"no answer to command {number}")

    def listen(self, seconds: float) -> None:
        """Takes in what comes; a heartbeat goes out each second."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            if time.monotonic() >= self._heartbeat_due:
                self._heartbeat_due = time.monotonic() + 1.0
                self.send(self._mav.heartbeat_encode(6, 8, 0, 0, 4))
            if select.select([self._socket], [], [], min(left, 0.1))[0]:
                data = self._socket.recv(65536)
                assert data, "the drone closed the connection"
                self.received += data
                self.messages += self._parser.parse_buffer(data) or []

    def want(self, numbers: Iterable[int], interval_us: float) -> None:
        """Asks for messages at an interval."""
        for number in numbers:
            self.command(511, number, interval_us)

    def attitude(self, theta_half: float, thrust: float) -> Any:
        """A set-point of attitude: pitch by the sine of half the angle."""
        q = [(1.0 - theta_half**2) ** 0.5, 0.0, theta_half, 0.0]
        return self._mav.set_attitude_target_encode(0, 1, 1, 0b00000111, q, 0, 0, 0, thrust)

    def parameters(self) -> None:
        """Asks for all parameters and waits for them."""
        self.send(self._mav.param_request_list_encode(1, 1))
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            self.listen(0.1)
            values = [m for m in self.messages if m.get_type() == "PARAM_VALUE"]
            count = max((m.param_count for m in values), default=0)
            if count and {m.param_index for m in values} >= set(range(count)):
                return
        raise AssertionError("not all parameters came")
