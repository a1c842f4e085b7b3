"""Messages packed on the spot, for what is sent thousands of times a second.

Why not pymavlink's classes alone: to make and pack one ATTITUDE takes 8.6 us with them and 3.2 us here. A Packer is
made once for a message and called with its values. It gives a Packed, which is sent as a message of
pymavlink is, to several peers too, with the same bytes (tests/link/mavlink/test_packing.py).
"""

from itertools import chain
from typing import Any

from fastcrc import crc16

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
    """Packs one kind of message from its values in the order of the wire (`fields`), arrays spread out.

    A real number beyond float32 becomes infinite, as on a processor that computes in float32. Any other value that does
    not fit its type raises struct.error.
    """

    def __init__(self, name: str) -> None:
        kind = dialect.load().mavlink_map[dialect.message_id(name)]
        self.name = name
        self.fields = tuple(kind.ordered_fieldnames)
        self._struct = kind.unpacker
        self._ident = dialect.message_id(name).to_bytes(3, "little")
        self._extra = bytes([kind.crc_extra])

    def __call__(self, *values: Any) -> Packed:
        """The message with these values."""
        try:
            payload = self._struct.pack(*values)
        except OverflowError:
            payload = self._struct.pack(*(_float32(value) for value in values))
        return Packed(self.name, self._ident, self._extra, payload.rstrip(b"\0") or b"\0")

    def by_name(self, **values: Any) -> Packed:
        """The message with values by name, the others 0 (text: empty); an array is a sequence of its whole length.

        For messages that are sent now and then. Raises KeyError for a field that is none.
        """
        given = dict.fromkeys(self.fields) | values
        if len(given) > len(self.fields):
            raise KeyError(f"{self.name} has no field {', '.join(sorted(given.keys() - set(self.fields)))}")
        kind = dialect.load().mavlink_map[int.from_bytes(self._ident, "little")]
        rows = zip(self.fields, kind.array_lengths, strict=True)
        types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
        return self(*chain.from_iterable(_spread(given[field], types[field], length) for field, length in rows))


def _spread(value: Any, type_name: str, length: int) -> tuple[Any, ...]:
    if type_name == "char":
        return (value or b"",)
    if length:
        return (0,) * length if value is None else tuple(value)
    return (0 if value is None else value,)


def _float32(value: Any) -> Any:
    if isinstance(value, float) and abs(value) > LARGEST_FLOAT32:
        return float("inf") if value > 0 else float("-inf")
    return value
