"""Files: what the drone lets a client read and write by MAVLink FTP: logs, descriptions, controllers."""

from __future__ import annotations

import struct
from typing import Any

from twodof.errors import Rejected
from twodof.gcs.deadline import Deadline
from twodof.gcs.session import Session
from twodof.gcs.texts import Texts
from twodof.link.ftp import MOST_DATA, Fault, Op, Packet, packed, read_packet

LARGEST = 1 << 29
"""Bytes of the largest file that is read."""


class Files:
    """Files of one drone; one call at a time. `words` of a refusal are what the drone says besides.

    Every call raises Rejected with the drone's reason, LinkLost and Timeout.
    """

    def __init__(self, session: Session, texts: Texts) -> None:
        self._session = session
        self._texts = texts
        self._sequence = 0

    async def write(self, path: str, content: bytes, timeout: float = 60.0) -> None:
        """Makes `content` the file `path`, whole or not at all."""
        deadline = self._deadline(timeout, f"sending {path}")
        number = (await self._ask(Op.CREATE, deadline, data=path.encode())).session
        for start in range(0, len(content), MOST_DATA):
            piece = content[start : start + MOST_DATA]
            await self._ask(Op.WRITE, deadline, number, start, piece)
        await self._ask(Op.TERMINATE, deadline, number)

    async def read(self, path: str, timeout: float = 60.0) -> bytes:
        """What is in the file `path`."""
        deadline = self._deadline(timeout, f"reading {path}")
        opened = await self._ask(Op.OPEN_RO, deadline, data=path.encode())
        (size,) = struct.unpack("<I", opened.data[:4])
        if size > LARGEST:
            raise Rejected(f"{size} bytes", deadline.where, f"{LARGEST} are read at most")
        content = bytearray()
        while len(content) < size:
            part = await self._ask(Op.READ, deadline, opened.session, len(content), wanted=MOST_DATA)
            if not part.size:
                break
            content += part.data[: part.size]
        await self._ask(Op.TERMINATE, deadline, opened.session)
        return bytes(content)

    async def remove(self, path: str, timeout: float = 5.0) -> None:
        """Deletes the file `path`."""
        await self._ask(Op.REMOVE, self._deadline(timeout, f"removing {path}"), data=path.encode())

    async def _ask(
        self, op: Op, deadline: Deadline, number: int = 0, offset: int = 0, data: bytes = b"", wanted: int | None = None
    ) -> Packet:
        session, spoken = self._session, self._texts.count
        sequence = self._sequence
        self._sequence = (sequence + 2) & 0xFFFF
        size = len(data) if wanted is None else wanted
        asked = Packet(sequence, number, op, size, 0, 0, offset, data)
        question = packed(asked, session.system, session.component)

        def answer(got: Any) -> Packet | None:
            found = read_packet(bytes(got.payload))
            fits = found.asked == op and found.sequence == (sequence + 1) & 0xFFFF
            return found if fits and found.op in (Op.ACK, Op.NAK) else None

        found = await session.ask(lambda _: question, ("FILE_TRANSFER_PROTOCOL",), answer, deadline)
        if found.op == Op.ACK:
            return found
        code = found.data[0] if found.size else 0
        said = "; ".join(line.text for line in self._texts.since(spoken)[-3:])
        words = Fault(code).name.lower().replace("_", " ") if code in [*Fault] else f"error {code}"
        raise Rejected(said or words, f"{deadline.where}, {deadline.doing}", "see what the drone says")

    def _deadline(self, timeout: float, doing: str) -> Deadline:
        return Deadline(timeout, doing, f"drone {self._session.system}")
