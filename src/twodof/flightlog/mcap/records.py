"""Records of the MCAP container, as bytes and back: framing, strings, maps, checksums, bounds.

Source: the MCAP format specification, version 0. All integers are little-endian. A record is an opcode (u8), the
length of its content (u64) and its content.
"""

import zlib
from collections.abc import Mapping
from enum import IntEnum
from struct import Struct

import pyarrow as pa

from twodof.errors import LogError
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.sanitise import RECOVER

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = Struct("<BQ")
CHUNK_HEAD = Struct("<QQQI")
MESSAGE_HEAD = Struct("<HIQQ")
MAX_CHUNK_BYTES = 1 << 26
"""Largest chunk that is inflated."""
MAX_TEXT_BYTES = 1 << 24
"""Largest string in a record: the provenance of a log, its diagram included, is far below it."""
CHECK = "crc32"
"""The row, the last, of a table or of a channel's metadata that has the checksum of what stands before it."""
# pyarrow's "lz4" is the frame format, which is what MCAP calls lz4.
CODECS = ("zstd", "lz4")


class McapOpcode(IntEnum):
    """The opcodes of the specification."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


SUMMARY_ONLY = frozenset(
    {
        McapOpcode.FOOTER,
        McapOpcode.CHUNK_INDEX,
        McapOpcode.ATTACHMENT_INDEX,
        McapOpcode.STATISTICS,
        McapOpcode.METADATA_INDEX,
        McapOpcode.SUMMARY_OFFSET,
    }
)
"""What stands behind the end of the data, and nowhere else."""


def record(op: McapOpcode, content: bytes) -> bytes:
    """One record."""
    return RECORD_HEAD.pack(op, len(content)) + content


def text(value: str) -> bytes:
    """A string with its length."""
    raw = value.encode()
    return len(raw).to_bytes(4, "little") + raw


def mapping(rows: Mapping[str, str]) -> bytes:
    """A map of strings, with its length in bytes."""
    raw = b"".join(text(key) + text(value) for key, value in rows.items())
    return len(raw).to_bytes(4, "little") + raw


def checked(head: bytes, rows: Mapping[str, str]) -> dict[str, str]:
    """`rows` and the row with their checksum and that of `head`, which is what stands before them in their record."""
    crc = zlib.crc32(head + mapping(rows))
    return {**rows, CHECK: f"{crc:08x}"}


def unchecked(head: bytes, rows: Mapping[str, str]) -> tuple[dict[str, str], bool | None]:
    """The rows without that of their checksum, and whether it holds; None without one, as earlier versions wrote."""
    plain = {key: value for key, value in rows.items() if key != CHECK}
    if CHECK not in rows:
        return plain, None
    return plain, list(checked(head, plain).items()) == list(rows.items())


def counts(rows: Mapping[int, int]) -> bytes:
    """A map from u16 to u64, with its length in bytes."""
    pair = Struct("<HQ")
    raw = b"".join(pair.pack(key, value) for key, value in rows.items())
    return len(raw).to_bytes(4, "little") + raw


def frame(data: memoryview, at: int, where: str) -> tuple[int, int, int]:
    """Opcode, first byte and end of the content of the record at byte `at`. Raises LogError."""
    if len(data) - at < RECORD_HEAD.size:
        raise LogError(f"truncated in the head of the record at byte {at}", where, RECOVER)
    op, size = RECORD_HEAD.unpack_from(data, at)
    start = at + RECORD_HEAD.size
    if op == 0 or size > len(data) - start:
        raise LogError(
            f"the record at byte {at} (opcode {op:#04x}) promises {size} bytes, {len(data) - start} are there",
            where,
            RECOVER,
        )
    return op, start, start + size


def check_size(size: int, where: str) -> None:
    """Raises LogError for a chunk larger than MAX_CHUNK_BYTES."""
    if size > MAX_CHUNK_BYTES:
        raise LogError(f"a chunk of {size} bytes", where, f"at most {MAX_CHUNK_BYTES} are inflated")


def inflate(codec: str, packed: memoryview, size: int, crc: int, where: str) -> bytes:
    """The plain bytes of a chunk, exactly `size`, which `check_size` has seen. Raises LogError."""
    if codec == "":
        plain = bytes(packed)
    elif codec not in CODECS:
        raise LogError(f"a chunk is compressed by {codec[:20]!r}", where, f"known are {', '.join(CODECS)}")
    else:
        try:
            plain = pa.decompress(pa.py_buffer(packed), size, codec=codec, asbytes=True) if size else b""
        except (OSError, ValueError) as reason:
            raise LogError(f"a chunk is damaged: {reason}", where, RECOVER) from reason
    if len(plain) != size:
        raise LogError(f"a chunk inflates to {len(plain)} bytes, not {size}", where, RECOVER)
    if crc and zlib.crc32(plain) != crc:
        raise LogError("a chunk's checksum is wrong", where, RECOVER)
    return plain


def deflate(codec: str, plain: bytes) -> bytes:
    """The bytes of a chunk as they are kept."""
    return pa.compress(plain, codec=codec, asbytes=True) if codec else plain


class RecordCursor:
    """Reads the parts of one record's content in order; `at` is the byte that is read next.

    Every length is held against what is there.
    """

    def __init__(self, data: memoryview, start: int, end: int, where: str, budget: MemoryBudget) -> None:
        self._data, self.at, self._end, self._where, self._budget = data, start, end, where, budget

    def number(self, size: int) -> int:
        """An unsigned integer of `size` bytes. Raises LogError."""
        return int.from_bytes(self.raw(size), "little")

    def raw(self, size: int) -> memoryview:
        """The next `size` bytes. Raises LogError."""
        if size > self._end - self.at:
            raise LogError(f"a part of {size} bytes at byte {self.at} passes its record's end", self._where, RECOVER)
        part = self._data[self.at : self.at + size]
        self.at += size
        return part

    def text(self) -> str:
        """A string. Raises LogError for one that is not UTF-8 or longer than MAX_TEXT_BYTES."""
        size = self.number(4)
        if size > MAX_TEXT_BYTES:
            raise LogError(f"a text of {size} bytes at byte {self.at}", self._where, "this is not a flight log")
        self._budget.text(size)
        try:
            return str(self.raw(size), "utf-8")
        except UnicodeDecodeError as reason:
            raise LogError(f"a text before byte {self.at} is not UTF-8", self._where, RECOVER) from reason

    def mapping(self) -> dict[str, str]:
        """A map of strings. Raises LogError."""
        start, size = self.at + 4, self.number(4)
        self.raw(size)
        inner = RecordCursor(self._data, start, self.at, self._where, self._budget)
        rows = {}
        while inner.left:
            key = inner.text()
            rows[key] = inner.text()
        return rows

    def since(self, at: int) -> bytes:
        """The bytes from byte `at` to the one that is read next."""
        return bytes(self._data[at : self.at])

    def end(self) -> None:
        """Raises LogError if the record goes on."""
        if self.left:
            raise LogError(f"{self.left} bytes too many at byte {self.at}", self._where, RECOVER)

    @property
    def left(self) -> int:
        """Bytes of the content that are not read yet."""
        return self._end - self.at
