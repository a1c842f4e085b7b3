"""A message that went out as bytes, as over a real link; it is read back where a test looks at a field."""

from functools import cached_property
from typing import Any

from twodof.link.mavlink.framing import Parser, decode, encode


class SentMessage:
    """Message as a client receives it. It is decoded when a field is read, as decoding costs most."""

    def __init__(self, sent: Any) -> None:
        self._name = sent.get_type()
        self._frame = encode(sent, 1, 1, 0)

    def get_type(self) -> str:
        """The message's name."""
        return str(self._name)

    @cached_property
    def _read(self) -> Any:
        (frame,) = Parser().feed(self._frame)
        return decode(frame)

    def __getattr__(self, field: str) -> Any:
        return getattr(self._read, field)

    def __str__(self) -> str:
        return str(self._read)
