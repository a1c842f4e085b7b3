"""What a file may ask for: one budget for everything that is made of it, charged before it is made.

Small files can inflate to gigabytes, and a text of a few bytes becomes an object of a hundred. So every decoder says
what it is about to make, in bytes of memory, copies included; nothing is ever given back. Since work is in proportion
to what is made, the budget bounds the time too.
"""

from twodof.errors import LogError

BASE_BYTES = 256 << 20
PER_BYTE = 20
"""A flight's log takes 5 to 12 times its file, in all copies; the rest is for flights in which little happens."""
MOST_BYTES = 4 << 30

# A channel's samples are copied when it is made of them, and about three times by what works on a log.
_COPIES = 4
# What one record, run of messages or row of a description costs, in objects and in time.
RECORD_BYTES = 512
RUN_BYTES = 2048
# `{"":[]}` is 7 letters and 200 bytes; four bytes a letter for a text outside Latin-1.
_JSON_FACTOR = 40
_TEXT_FACTOR = 5
_TEXT_BYTES = 512


class MemoryBudget:
    """The budget of one file of `file_bytes`; each method raises LogError before more than that is made of it."""

    def __init__(self, file_bytes: int, where: str) -> None:
        self._left = self._all = min(BASE_BYTES + PER_BYTE * file_bytes, MOST_BYTES)
        self._where = where

    @property
    def spent(self) -> bool:
        """Whether more was asked for than there is: no further part of the file may be tried."""
        return self._left < 0

    def take(self, size: int) -> None:
        """`size` bytes of memory."""
        self._left -= size
        if self._left < 0:
            what = f"asks for more than {self._all >> 20} MiB of memory"
            raise LogError(what, self._where, "this is not a flight log")

    def record(self, count: int = 1) -> None:
        """The reading of `count` small parts of a file."""
        self.take(RECORD_BYTES * count)

    def samples(self, count: int, width: int = 1) -> None:
        """A channel of `count` samples of `width` numbers, with their stamps."""
        self.take(8 * _COPIES * count * (1 + width))

    def text(self, size: int) -> None:
        """A text of `size` bytes."""
        self.take(_TEXT_BYTES + _TEXT_FACTOR * size)

    def json(self, size: int) -> None:
        """What a JSON text of `size` bytes says."""
        self.take(_JSON_FACTOR * size)
