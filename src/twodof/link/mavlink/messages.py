"""Messages by name with checked fields, and the content of twodof's own: batches of samples, excitations in pieces.

A message is an object of pymavlink's class for it. A field that is not given is 0 (text: empty).
"""

import math
import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from functools import cache
from struct import Struct, calcsize
from typing import Any

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray

from twodof.errors import LinkError, listed, shown
from twodof.excitation import Excitation
from twodof.link.mavlink import dialect

BATCH_VALUES = 60
PIECE_BYTES = 200
LONGEST_EXCITATION = 65_535
STATUSTEXT_BYTES = 50
_CHANNEL = "TWODOF_CHANNEL_"


@cache
def _layout(name: str) -> tuple[Any, dict[str, tuple[str, int]]]:
    """Return the class of a message, and type and array length (0: no array) of each field in constructor order."""
    kind = dialect.load().mavlink_map[dialect.message_id(name)]
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    rows = zip(kind.fieldnames, kind.fieldtypes, strict=True)
    return kind, {field: (type_name, lengths[field]) for field, type_name in rows}


def fields_of(name: str) -> tuple[str, ...]:
    """Return the names of a message's fields. Raises LinkError for an unknown message."""
    return tuple(_layout(name)[1])


def message(name: str, /, **fields: Any) -> Any:
    """Make the message called `name` ("COMMAND_LONG") with these fields, the others 0.

    Text may be str (UTF-8) or bytes; an array may be shorter than its field and is filled with zeros. Raises LinkError
    for an unknown name, and for text or an array that is too long. A number that does not fit its type is found when
    the message is sent.
    """
    kind, layout = _layout(name)
    unknown = fields.keys() - layout.keys()
    if unknown:
        raise LinkError(f"has no field {shown(min(unknown))}", name, f"its fields are {listed(layout)}")
    values = []
    for field, (type_name, length) in layout.items():
        value = fields.get(field)
        if type_name == "char":
            value = _text(name, field, value, length or 1)
        elif length:
            value = _array(name, field, value, length)
        elif value is None:
            value = 3 if field == "mavlink_version" else 0
        values.append(value)
    return kind(*values)


def _text(name: str, field: str, value: Any, length: int) -> bytes:
    text = b"" if value is None else value.encode() if isinstance(value, str) else value
    if not isinstance(text, bytes | bytearray) or len(text) > length:
        raise LinkError(f"{field} = {shown(value)} is not text of at most {length} bytes", name, "shorten it")
    return bytes(text)


def _array(name: str, field: str, value: Any, length: int) -> list[Any]:
    values = [] if value is None else list(value)
    if len(values) > length:
        raise LinkError(f"{field} has {len(values)} values, at most {length} fit", name, "send several messages")
    return values + [0] * (length - len(values))


def float_of_int(value: int) -> float:
    """Return the float32 with the bits of an int32, as PX4 carries int32 parameters in PARAM_VALUE and PARAM_SET.

    Raises LinkError for a value outside of int32, and for the bits of signalling NaNs, which Python's float does not
    keep (7f800001 to 7fbfffff, ff800001 to ffbfffff).
    """
    try:
        carried = float(struct.unpack("<f", struct.pack("<i", value))[0])
    except (struct.error, TypeError) as error:
        raise LinkError(f"{shown(value)} is not an int32", "PARAM_VALUE", "give -2^31 to 2^31 - 1") from error
    if int_of_float(carried) != value:
        what = f"{value} cannot be sent: its bits as a float are a signalling NaN"
        raise LinkError(what, "PARAM_VALUE", "choose a smaller whole number")
    return carried


def int_of_float(value: float) -> int:
    """Return the int32 with the bits of a received float32; the inverse of `float_of_int`."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


def statustext(text: str, severity: int = 6, number: int = 0) -> list[Any]:
    """Make the STATUSTEXT messages of a line: one, or for a long line chunks with the id `number` (1 to 65535).

    Severities are syslog's (MAV_SEVERITY): 6 is information. At most 255 chunks; the rest is cut.
    """
    data = text.encode()
    if len(data) <= STATUSTEXT_BYTES:
        return [message("STATUSTEXT", severity=severity, text=data)]
    starts = range(0, min(len(data), 255 * STATUSTEXT_BYTES), STATUSTEXT_BYTES)
    return [
        message("STATUSTEXT", severity=severity, text=data[at : at + STATUSTEXT_BYTES], id=number or 1, chunk_seq=place)
        for place, at in enumerate(starts)
    ]


@cache
def channel_bits() -> dict[str, int]:
    """Return the bit in TWODOF_BATCH.channels of each column, by its name in the dialect ("IMU_ACC_X")."""
    entries = dialect.load().enums["TWODOF_CHANNEL"]
    names = {entry.name.removeprefix(_CHANNEL): bit for bit, entry in entries.items()}
    names.pop("ENUM_END")  # the generator's own last entry
    return names


def channel_mask(columns: Sequence[str]) -> int:
    """Return TWODOF_BATCH.channels for log columns such as `imu.gyro_y`. Raises LinkError for an unknown column."""
    bits, mask = channel_bits(), 0
    for column in columns:
        bit = bits.get(column.replace(".", "_").upper())
        if bit is None:
            raise LinkError(f"no channel {shown(column)}", "TWODOF_BATCH", f"choose of {listed(bits, 64)}")
        mask |= bit
    return mask


def batch_rows(received: Any) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Return ticks (n,) and samples (n, channels by rising bit) of a TWODOF_BATCH; empty if its numbers are invalid."""
    width = int(received.channels).bit_count()
    count = min(received.rows, BATCH_VALUES // width) if width else 0
    values = np.array(received.values[: count * width], dtype=np.float32).reshape(count, width)
    ticks = (received.tick + received.every * np.arange(count, dtype=np.int64)) & 0xFFFFFFFF
    return ticks.astype(np.uint32), values


def excite(excitation: Excitation, loop: int, transfer: int, system: int, component: int) -> Iterator[Any]:
    """Cut an excitation's definition into TWODOF_EXCITE messages, to be sent in order to `system`, `component`.

    `loop` is the loop that it excites and `transfer` the number of this upload. Another TWODOF_EXCITE, with the action
    START, plays it. Raises LinkError for a definition longer than LONGEST_EXCITATION bytes.
    """
    data = excitation.to_json().encode()
    if len(data) > LONGEST_EXCITATION:
        what = f"the excitation's definition has {len(data)} bytes, at most {LONGEST_EXCITATION} can be sent"
        raise LinkError(what, "TWODOF_EXCITE", "shorten the excitation")
    return (
        message(
            "TWODOF_EXCITE",
            crc=zlib.crc32(data),
            transfer=transfer,
            offset=at,
            total=len(data),
            target_system=system,
            target_component=component,
            loop=loop,
            length=len(data[at : at + PIECE_BYTES]),
            data=data[at : at + PIECE_BYTES],
        )
        for at in range(0, len(data), PIECE_BYTES)
    )


class ExcitationReceiver:
    """Assembly of the pieces of one sender's TWODOF_EXCITE, which may be repeated and reordered."""

    def __init__(self) -> None:
        self.transfer = -1
        self._crc = 0
        self._total = 0
        self._pieces: dict[int, bytes] = {}

    @property
    def received(self) -> int:
        """Number of bytes from the first one without a gap."""
        at = 0
        while at in self._pieces:
            at += len(self._pieces[at])
        return at

    def take(self, piece: Any) -> bytes | None:
        """Return the definition's bytes once all pieces have come and the checksum holds, else None.

        A piece of another transfer, length or checksum restarts the assembly; a piece that does not fit is ignored.
        """
        if (piece.transfer, piece.crc, piece.total) != (self.transfer, self._crc, self._total):
            self.transfer, self._crc, self._total, self._pieces = piece.transfer, piece.crc, piece.total, {}
        data = bytes(piece.data[: piece.length])
        fits = piece.offset % PIECE_BYTES == 0 and piece.offset + len(data) <= self._total
        if not fits or not data or len(data) != min(PIECE_BYTES, self._total - piece.offset):
            return None
        self._pieces[piece.offset] = data
        if len(self._pieces) < math.ceil(self._total / PIECE_BYTES):
            return None
        whole = b"".join(self._pieces[at] for at in sorted(self._pieces))
        return whole if zlib.crc32(whole) == self._crc else None


LARGEST_FLOAT32 = float.fromhex("0x1.fffffep+127")
"""Largest finite float32; a larger number is infinite on the wire."""


class Packed:
    """A message whose payload is packed already."""

    __slots__ = ("_extra", "_ident", "name", "payload")

    def __init__(self, name: str, ident: bytes, extra: bytes, payload: bytes) -> None:
        self.name = name
        self.payload = payload  # as on the wire, without the zeros at its end
        self._ident = ident
        self._extra = extra

    def __repr__(self) -> str:
        return f"Packed({self.name}, {self.payload.hex()})"

    def get_type(self) -> str:
        """Return the message's name, as pymavlink's messages do."""
        return self.name

    def pack(self, sender: Any) -> bytes:
        """Return the whole frame. `sender` has the attributes of pymavlink's: seq, srcSystem, srcComponent, signing."""
        payload = self.payload
        if sender.signing.sign_outgoing:
            whole = dialect.load().MAVLink_message(int.from_bytes(self._ident, "little"), self.name)
            return bytes(whole._pack(sender, self._extra[0], payload))
        header = bytes((len(payload), 0, 0, sender.seq, sender.srcSystem, sender.srcComponent))
        body = b"%b%b%b" % (header, self._ident, payload)
        return b"\xfd%b%b" % (body, crc16.mcrf4xx(body + self._extra).to_bytes(2, "little"))


class Packer:
    """Packer of one kind of message from the values of `fields`, by default all; the other fields are 0.

    Fields are named in their order on the wire (by falling size of the type). In a call each element of an array is an
    argument of its own.

    A real number beyond float32 becomes infinite, as on a processor that computes in float32. Any other value that does
    not fit its type raises struct.error. Unknown fields, or fields out of order, raise LinkError.
    """

    def __init__(self, name: str, *fields: str) -> None:
        kind = dialect.load().mavlink_map[dialect.message_id(name)]
        self.name = name
        self.fields = tuple(field for field in kind.ordered_fieldnames if field in fields or not fields)
        if fields and self.fields != fields:
            raise LinkError(f"has no fields {listed(fields)} in this order", name, f"give {listed(self.fields, 64)}")
        # One code a field, such as "f", "16s" or "60f"; the bytes of those that are not given are pads.
        codes = zip(re.findall(r"\d*[a-zA-Z]", kind.unpacker.format), kind.ordered_fieldnames, strict=True)
        self._struct = Struct(
            "<" + "".join(code if field in self.fields else f"{calcsize('<' + code)}x" for code, field in codes)
        )
        self._ident = dialect.message_id(name).to_bytes(3, "little")
        self._extra = bytes([kind.crc_extra])

    def __call__(self, *values: Any) -> Packed:
        """Make the message with these values."""
        try:
            payload = self._struct.pack(*values)
        except OverflowError:
            payload = self._struct.pack(*(_float32(value) for value in values))
        return Packed(self.name, self._ident, self._extra, payload.rstrip(b"\0") or b"\0")


def _float32(value: Any) -> Any:
    if isinstance(value, float) and abs(value) > LARGEST_FLOAT32:
        return float("inf") if value > 0 else float("-inf")
    return value
