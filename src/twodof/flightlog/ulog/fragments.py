"""A ULog that is still being written, cut into pieces for a message each, with where messages begin in them."""

from collections import deque
from typing import NamedTuple

from twodof.flightlog.ulog.format import HEADER, MESSAGE

MOST = 249
"""Bytes of LOGGING_DATA."""
NO_MESSAGE = 255
_RECORDS = frozenset(b"DLO")
"""Messages with which the log itself begins: records, texts, dropouts."""


class ULogFragment(NamedTuple):
    """Bytes of a log; `first` is where the first message begins in them, NO_MESSAGE if none does.

    `described`: it belongs to what stands before the first record, without which nothing can be read.
    """

    data: bytes
    first: int
    described: bool


class ULogFragments:
    """Takes the bytes of a file in their order and gives them in pieces; places count from the file's first byte."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._given = 0
        self._starts: deque[int] = deque([0])  # of messages, and of the file, that were not given yet
        self._next = HEADER.size  # start of the next message, whose length is not known yet
        self._records: int | None = None  # start of the first record

    @property
    def waiting(self) -> int:
        """Bytes that were taken and not given."""
        return len(self._bytes)

    def feed(self, data: bytes) -> None:
        """Takes what follows."""
        self._bytes += data
        end = self._given + len(self._bytes)
        while self._next + MESSAGE.size <= end:
            length, letter = MESSAGE.unpack_from(self._bytes, self._next - self._given)
            if letter in _RECORDS and self._records is None:
                self._records = self._next
            self._starts.append(self._next)
            self._next += MESSAGE.size + length

    def next(self) -> ULogFragment | None:
        """The next piece, None while there is none; the first record begins one."""
        at = self._given
        end = min(at + MOST, at + len(self._bytes), self._next)
        described = self._records is None or at < self._records
        if self._records is not None and described:
            end = min(end, self._records)
        if end == at:
            return None
        first = self._starts[0] - at if self._starts and self._starts[0] < end else NO_MESSAGE
        while self._starts and self._starts[0] < end:
            self._starts.popleft()
        data = bytes(self._bytes[: end - at])
        del self._bytes[: end - at]
        self._given = end
        return ULogFragment(data, first, described)
