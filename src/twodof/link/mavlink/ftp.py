"""Packets of MAVLink FTP: the payload of FILE_TRANSFER_PROTOCOL (MAVLink guide, "File Transfer Protocol")."""

from __future__ import annotations

from enum import IntEnum
from struct import Struct
from typing import Any, NamedTuple

from twodof.link.mavlink.messages import message

_HEADER = Struct("<HBBBBBxI")
MOST_DATA = 239
_PAYLOAD = 251


class FtpOperation(IntEnum):
    """Operation codes of MAVLink FTP."""

    NONE = 0
    TERMINATE = 1
    RESET = 2
    LIST = 3
    OPEN_RO = 4
    READ = 5
    CREATE = 6
    WRITE = 7
    REMOVE = 8
    CREATE_FOLDER = 9
    REMOVE_FOLDER = 10
    OPEN_WO = 11
    TRUNCATE = 12
    RENAME = 13
    CRC32 = 14
    BURST = 15
    ACK = 128
    NAK = 129


class FtpError(IntEnum):
    """Error codes in a NAK of MAVLink FTP."""

    FAIL = 1
    ERRNO = 2
    DATA_SIZE = 3
    SESSION = 4
    NO_SESSIONS = 5
    END = 6
    UNKNOWN = 7
    PROTECTED = 9
    NOT_FOUND = 10


class FtpPacket(NamedTuple):
    """One packet, a request or an answer; in an answer, `asked` is the operation of its request."""

    sequence: int
    session: int
    op: int
    size: int
    asked: int
    complete: int
    offset: int
    data: bytes

    @property
    def text(self) -> str:
        """Path in a request, up to the first zero."""
        return self.data[: self.size].split(b"\0")[0].decode("utf-8", "replace")

    def ack(self, data: bytes = b"", **changed: Any) -> FtpPacket:
        """Return the positive answer to this request; `changed` are fields that differ from the request."""
        return self._answer(FtpOperation.ACK, data, **changed)

    def nak(self, fault: int, errno: int = 0) -> FtpPacket:
        """Return the negative answer to this request: an FtpError, for ERRNO with the system's `errno`."""
        return self._answer(FtpOperation.NAK, bytes((fault, errno & 0xFF) if fault == FtpError.ERRNO else (fault,)))

    def part(self, number: int, offset: int, data: bytes, last: bool) -> FtpPacket:
        """Return part `number` (from 0) of the answer to this burst request."""
        return self._answer(FtpOperation.ACK, data, number, offset=offset, complete=int(last))

    def _answer(self, op: int, data: bytes, number: int = 0, **changed: Any) -> FtpPacket:
        sequence = (self.sequence + 1 + number) & 0xFFFF
        answer = self._replace(sequence=sequence, op=op, size=len(data), asked=self.op, complete=0, data=data)
        return answer._replace(**changed)


def read_packet(payload: bytes) -> FtpPacket:
    """Read the packet in the 251 bytes of a message; `size` is not verified."""
    return FtpPacket._make((*_HEADER.unpack_from(payload), payload[_HEADER.size : _PAYLOAD]))


def packed(packet: FtpPacket, system: int, component: int) -> Any:
    """Return the FILE_TRANSFER_PROTOCOL message that carries a packet to the client `system`, `component`."""
    payload = _HEADER.pack(*packet[:-1]) + packet.data
    return message("FILE_TRANSFER_PROTOCOL", target_system=system, target_component=component, payload=payload)
