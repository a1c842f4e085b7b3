"""Messages packed on the spot, for what is sent thousands of times a second.

Why not pymavlink's classes alone: to make and pack one ATTITUDE takes 8.6 us with them and 3.2 us here. A Packer is
made once for a message and called with its values. It gives a Packed, which is sent as a message of
pymavlink is, to several peers too, with the same bytes (tests/link/mavlink/test_packing.py).
"""

import re
from struct import Struct, calcsize
from typing import Any

from fastcrc import crc16

from twodof.errors import LinkError, listed
from twodof.link.mavlink import dialect

LARGEST_FLOAT32 = float.fromhex("0x1.fffffep+127")
"""What is larger is infinity on the wire."""


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
        """The message's name, as pymavlink's messages give it."""
        return self.name

    def pack(self, sender: Any) -> bytes:
        """The whole frame. `sender` is what pymavlink asks for: seq, srcSystem, srcComponent, signing."""
        payload = self.payload
        if sender.signing.sign_outgoing:
            whole = dialect.load().MAVLink_message(int.from_bytes(self._ident, "little"), self.name)
            return bytes(whole._pack(sender, self._extra[0], payload))
        header = bytes((len(payload), 0, 0, sender.seq, sender.srcSystem, sender.srcComponent))
        body = b"%b%b%b" % (header, self._ident, payload)
        return b"\xfd%b%b" % (body, crc16.mcrf4xx(body + self._extra).to_bytes(2, "little"))


class Packer:
    """Packs one kind of message from the values of `fields`, the others being 0; without `fields` from those of all.

    Fields are named in their order on the wire (by falling size of the type), and arrays are spread out in the call.

    A real number beyond float32 becomes infinite, as on a processor that computes in float32. Any other value that does
    not fit its type raises struct.error. A field that is none, or out of order, raises LinkError.
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
        """The message with these values."""
        try:
            payload = self._struct.pack(*values)
        except OverflowError:
            payload = self._struct.pack(*(_float32(value) for value in values))
        return Packed(self.name, self._ident, self._extra, payload.rstrip(b"\0") or b"\0")


def _float32(value: Any) -> Any:
    if isinstance(value, float) and abs(value) > LARGEST_FLOAT32:
        return float("inf") if value > 0 else float("-inf")
    return value
