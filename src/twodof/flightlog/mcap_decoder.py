"""Decoder of MCAP files: it walks the records, and lists the lost parts of a damaged file.

The library `mcap` reads the records and inflates the chunks. The walk is our own for two reasons. The library ends at
the first damage, and it takes one message at a time, where here a run of messages becomes a table at once.
"""

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import TypeVar

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, Chunk, Footer, Header, McapRecord, Metadata, Schema, Statistics
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream

from twodof.errors import LogError, listed, shown
from twodof.flightlog.mcap_encoder import CHECK, MAGIC, Attachment, McapSamples, Sealed, encoded, sealed
from twodof.flightlog.mcap_stream import (
    CDR_LITTLE_ENDIAN,
    MAX_CHANNELS,
    RECORD_HEAD_BYTES,
    McapStream,
    parse,
)
from twodof.flightlog.provenance import RECOVER, Loss

UNVERIFIED_NOTE = "twodof.unverified"
"""The table that keeps the rows of a table whose checksum is wrong, so that no reader takes them for true."""
_SUMMARY_ONLY = frozenset(
    {
        Opcode.FOOTER,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.STATISTICS,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
    }
)
_IN_SUMMARY = _SUMMARY_ONLY | {Opcode.SCHEMA, Opcode.CHANNEL}
_IN_DATA = frozenset(Opcode) - _SUMMARY_ONLY
_RECORD_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD_BYTES = 28
_CODEC = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
"""The codec in a chunk's record, with its length."""
_BEFORE_CODEC = RECORD_HEAD_BYTES + _CHUNK_HEAD_BYTES
_INDEX_BYTES = 16
_DAMAGE = (McapError, LookupError, ValueError, RuntimeError, MemoryError, struct.error, zstandard.ZstdError)
Record = TypeVar("Record", bound=McapRecord)


@dataclass
class McapContents:
    """Contents of a file: streams, their samples in the order of the file, tables of texts, attachments.

    `ignored` counts the messages of foreign topics; `finished` says that the file was closed. Of a damaged file `lost`
    lists the parts that were left out, and `unverified` those that were taken without a checksum that holds.
    """

    streams: dict[int, McapStream] = field(default_factory=dict)
    samples: dict[int, list[McapSamples]] = field(default_factory=dict)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    ignored: dict[str, int] = field(default_factory=dict)
    lost: list[Loss] = field(default_factory=list)
    unverified: list[str] = field(default_factory=list)
    finished: bool = False

    @property
    def messages(self) -> int:
        """Count the samples of all streams."""
        return sum(len(part) for parts in self.samples.values() for part in parts)

    def joined(self, stream: int) -> McapSamples:
        """Return all samples of a stream, in the order of the file."""
        parts = self.samples.get(stream, [])
        stamps = [part.stamp for part in parts if part.stamp is not None]
        return McapSamples(
            np.concatenate([np.empty(0, np.uint64), *(part.time_ns for part in parts)]),
            np.concatenate([np.empty((0, self.streams[stream].width)), *(part.value for part in parts)]),
            np.concatenate([np.empty(0), *stamps]) if self.streams[stream].stamped else None,
        )


def scan(data: bytes, where: str, salvage: bool = False) -> McapContents:
    """Return the contents of an MCAP file. Raises LogError for what is no MCAP and, without `salvage`, for any damage.

    `salvage` keeps the sound parts of a damaged file and lists the others in `lost`.
    """
    return _Walk(data, where, salvage).read()


def _frame(data: memoryview, at: int, where: str) -> tuple[int, int, int]:
    """Return opcode, first byte and end of the content of the record at byte `at`. Raises LogError."""
    if len(data) - at < RECORD_HEAD_BYTES:
        raise LogError(f"truncated in the head of the record at byte {at}", where, RECOVER)
    op, size = _RECORD_HEAD.unpack_from(data, at)
    start = at + RECORD_HEAD_BYTES
    if op == 0 or size > len(data) - start:
        raise LogError(
            f"the record at byte {at} (opcode {op:#04x}) promises {size} bytes, {len(data) - start} are there",
            where,
            RECOVER,
        )
    return op, start, start + size


def _content(record: McapRecord) -> bytes:
    return encoded(record)[RECORD_HEAD_BYTES:]


def _unsealed(record: Sealed, content: bytes) -> tuple[Sealed, bool | None]:
    """Return the record without the row of its checksum, and whether it holds; None where there is none."""
    rows = {key: value for key, value in record.metadata.items() if key != CHECK}
    plain = replace(record, metadata=rows)
    return plain, None if CHECK not in record.metadata else _content(sealed(plain)) == content


class _Walk:
    def __init__(self, data: bytes, where: str, salvage: bool) -> None:
        self._data, self._where, self._salvage = memoryview(data), where, salvage
        self._raw = data
        self._foreign: dict[int, str] = {}
        self._schemas: dict[int, Schema] = {}
        self._schema_of: dict[int, int] = {}
        self._stated: int | None = None
        # Whether the checksum of all data holds; None before the end of the data and without a checksum.
        self._sealed: bool | None = None
        self._in_summary = False
        # Parts without a checksum of their own, each once.
        self._doubts: dict[str, None] = {}
        self.contents = McapContents()

    def read(self) -> McapContents:
        if self._raw[: len(MAGIC)] != MAGIC:
            raise LogError("is no MCAP file", self._where, "give a recording made by twodof")
        at = len(MAGIC)
        while at < len(self._data) and not self.contents.finished:
            end = 0
            try:
                op, start, end = _frame(self._data, at, self._where)
                # Reserved opcodes may come with later versions. In a damaged file they are damage, and so is a record
                # where it does not belong: one bit makes a chunk an index.
                if self._salvage and op not in (_IN_SUMMARY if self._in_summary else _IN_DATA):
                    raise LogError(f"a record of opcode {op:#04x} does not belong there", self._where)
                self._record(op, at, start, end)
            except LogError as reason:
                end = self._after_damage(at, end, reason)
            at = end + (len(MAGIC) if self.contents.finished else 0)
        self._judge(at)
        return self.contents

    def _after_damage(self, at: int, end: int, reason: LogError) -> int:
        """Return where to go on after the damaged record at byte `at`, which by its length ends at `end`."""
        if not self._salvage:
            raise reason
        after = end if end and self._is_record(end) else self._next_chunk(at + 1)
        self.contents.lost.append(Loss(at, after - at, reason.what))
        if len(self.contents.lost) > MAX_CHANNELS:
            raise LogError(f"more than {MAX_CHANNELS} damaged parts", self._where, "nothing can be trusted in it")
        return after

    def _is_record(self, at: int) -> bool:
        try:
            return at == len(self._data) or _frame(self._data, at, self._where)[0] <= Opcode.DATA_END
        except LogError:
            return False

    def _next_chunk(self, at: int) -> int:
        """Return the first byte of the next chunk whose checksum holds; the file's end if there is none."""
        for found in _CODEC.finditer(self._raw, at + _BEFORE_CODEC):
            candidate = found.start() - _BEFORE_CODEC
            try:
                op, start, end = _frame(self._data, candidate, self._where)
                if op == Opcode.CHUNK and self._chunk(start, end)[1]:
                    return candidate
            except LogError:
                continue
        return len(self._data)

    def _judge(self, at: int) -> None:
        """Check the end of the file: closed, and as many messages as its statistics say."""
        found, total = self.contents, self.contents.messages + sum(self.contents.ignored.values())
        if self._salvage:
            if found.finished and at < len(self._data):
                found.lost.append(Loss(at, len(self._data) - at, "bytes after the end"))
            self._check_schemas()
            if self._doubts and not self._sealed:
                found.unverified.append(f"no checksum vouches for {listed(self._doubts)}")
            if self._sealed is False and not found.lost and not found.unverified:
                why = "the checksum of the file is wrong: a part was changed that is not used"
                found.lost.append(Loss(0, 0, why))
            return
        if not found.finished or at != len(self._data):
            what = "was not closed: the recording was cut off" if not found.finished else "goes on after its end"
            raise LogError(what, self._where, RECOVER)
        if self._stated is not None and self._stated != total:
            raise LogError(f"{total} messages of {self._stated} are there", self._where, RECOVER)

    def _check_schemas(self) -> None:
        """List damaged schemas as lost; the writer replaces them."""
        for number, stream in self.contents.streams.items():
            schema = self._schemas.get(self._schema_of[number])
            expected = stream.schema, "ros2msg", stream.definition.encode()
            if schema is None or (schema.name, schema.encoding, schema.data) != expected:
                self.contents.lost.append(Loss(0, 0, f"the schema of {shown(stream.topic)} is damaged, and made anew"))

    def _read(self, kind: Callable[[ReadDataStream], Record], content: bytes) -> Record:
        """Return a record. Raises LogError for one that the library cannot read, or in salvage not to the byte."""
        damaged = LogError("a record is damaged", self._where, RECOVER)
        try:
            record = kind(ReadDataStream(BytesIO(content)))
            exact = not self._salvage or _content(record) == content
        except _DAMAGE as reason:
            raise damaged from reason
        if not exact:
            raise damaged
        return record

    def _record(self, op: int, at: int, start: int, end: int) -> None:
        if op == Opcode.MESSAGE:
            self._doubts["messages outside of chunks"] = None
            self._messages(self._data[at:end], self._where)
        elif op == Opcode.CHUNK:
            plain, vouched = self._chunk(start, end)
            if not vouched:
                self._doubts[f"the chunk at byte {at}"] = None
            self._messages(memoryview(plain), f"{self._where}, chunk at byte {at}")
        elif op in (Opcode.MESSAGE_INDEX, Opcode.HEADER):
            self._unused(op, at, start, end)
        elif op == Opcode.DATA_END:
            self._data_end(at, self._raw[start:end])
        elif op == Opcode.FOOTER:
            self._footer(self._raw[start:end], end)
        elif op == Opcode.SCHEMA:
            schema = self._read(Schema.read, self._raw[start:end])
            self._schemas.setdefault(schema.id, schema)
        elif op == Opcode.CHANNEL:
            self._channel(self._raw[start:end])
        elif op == Opcode.METADATA:
            self._table(self._raw[start:end], at, end)
        elif op == Opcode.ATTACHMENT:
            self._attachment(self._raw[start:end])
        elif op == Opcode.STATISTICS:
            self._stated = self._read(Statistics.read, self._raw[start:end]).message_count

    def _unused(self, op: int, at: int, start: int, end: int) -> None:
        """Check a record that is not used: another record may look like it because of a changed bit."""
        if not self._salvage:
            return
        if op == Opcode.HEADER and at == len(MAGIC):
            self._read(Header.read, self._raw[start:end])
            return
        stated = int.from_bytes(self._raw[start + 2 : start + 6], "little")
        if op == Opcode.HEADER or stated != end - start - 6 or stated % _INDEX_BYTES:
            raise LogError(f"the record at byte {at} is damaged", self._where)

    def _data_end(self, at: int, content: bytes) -> None:
        self._in_summary = True
        stated = int.from_bytes(content[:4], "little")
        self._sealed = stated == zlib.crc32(self._data[:at]) if stated else None
        if self._sealed is False and not self._salvage:
            raise LogError("the checksum of the data is wrong", self._where, RECOVER)

    def _footer(self, content: bytes, end: int) -> None:
        footer = self._read(Footer.read, content)
        if self._raw[end : end + len(MAGIC)] != MAGIC:
            raise LogError("the mark at the end is missing", self._where, RECOVER)
        summary = self._data[min(footer.summary_start, end) : end - 4]
        if footer.summary_crc and footer.summary_start and footer.summary_crc != zlib.crc32(summary):
            raise LogError("the checksum of the summary is wrong", self._where, RECOVER)
        self.contents.finished = True

    def _table(self, content: bytes, at: int, end: int) -> None:
        table, sound = _unsealed(self._read(Metadata.read, content), content)
        if sound is False:
            reason = LogError(f"the checksum of table {shown(table.name)} is wrong", self._where, RECOVER)
            if not self._salvage:
                raise reason
            self.contents.metadata.append((UNVERIFIED_NOTE, {"table": table.name[:200], **table.metadata}))
            self.contents.lost.append(Loss(at, end - at, reason.what))
            self.contents.unverified.append(f"table {shown(table.name)}, which is kept as table {UNVERIFIED_NOTE!r}")
            return
        if sound is None:
            self._doubts[f"table {shown(table.name)}"] = None
        self.contents.metadata.append((table.name, table.metadata))

    def _channel(self, content: bytes) -> None:
        channel, sound = _unsealed(self._read(Channel.read, content), content)
        number, name = channel.id, channel.topic
        if number in self.contents.streams or number in self._foreign:
            return
        if len(self.contents.streams) + len(self._foreign) >= MAX_CHANNELS:
            raise LogError(f"more than {MAX_CHANNELS} channels", self._where, "this is not a flight log")
        if sound is False and not self._salvage:
            raise LogError(f"the checksum of topic {shown(name)} is wrong", self._where, RECOVER)
        schema = self._schemas.get(channel.schema_id)
        stream = parse(
            name, "" if schema is None else schema.name, channel.message_encoding, channel.metadata, self._where
        )
        if stream is None:
            self._foreign[number] = name[:200]
        elif stream.mat in {other.mat for other in self.contents.streams.values()}:
            raise LogError(f"channel {shown(stream.mat)} is there twice", self._where, "record it again")
        else:
            self.contents.streams[number] = stream
            self._schema_of[number] = channel.schema_id
        if sound is False:
            why = f"the description of topic {shown(name)}, whose checksum is wrong: its name, unit and fields"
            self.contents.unverified.append(why)
        elif sound is None and stream is not None:
            self._doubts[f"the description of topic {shown(name)}"] = None

    def _attachment(self, content: bytes) -> None:
        stated = int.from_bytes(content[-4:], "little")
        # The library writes a checksum and reads none.
        sound = content[:-4] + zlib.crc32(content[:-4]).to_bytes(4, "little")
        kept = self._read(AttachmentRecord.read, sound)
        if not stated:
            self._doubts[f"attachment {shown(kept.name)}"] = None
        elif sound != content:
            raise LogError(f"the checksum of attachment {shown(kept.name)} is wrong", self._where, RECOVER)
        self.contents.attachments.append(Attachment(kept.name, kept.media_type, kept.data, kept.log_time))

    def _chunk(self, start: int, end: int) -> tuple[bytes, bool]:
        """Return the inflated bytes of a chunk, and whether a checksum vouches for them. Raises LogError."""
        chunk = self._read(Chunk.read, self._raw[start:end])
        try:
            if chunk.compression == "zstd" and zstandard.frame_content_size(chunk.data) > chunk.uncompressed_size:
                raise ValueError("it inflates to more than it says")
            stream, size = get_chunk_data_stream(chunk, validate_crc=True)
            plain = stream.read(size)
        except CRCValidationError as reason:
            raise LogError("a chunk's checksum is wrong", self._where, RECOVER) from reason
        except _DAMAGE as reason:
            raise LogError(f"a chunk is damaged: {reason!s:.200}", self._where, RECOVER) from reason
        if size != chunk.uncompressed_size:
            raise LogError(f"a chunk inflates to {size} bytes, not {chunk.uncompressed_size}", self._where, RECOVER)
        return plain, chunk.uncompressed_crc != 0

    def _messages(self, body: memoryview, where: str) -> None:
        at = 0
        while at < len(body):
            op, start, end = _frame(body, at, where)
            number = int.from_bytes(body[start : start + 2], "little") if end - start >= 2 else -1
            stream = self.contents.streams.get(number) if op == Opcode.MESSAGE else None
            if stream is not None:
                if end - start != stream.content_bytes:
                    raise LogError(f"a message of {stream.topic} has {end - start} bytes", where, RECOVER)
                at += self._run(body, at, number, stream, where)
                continue
            if op == Opcode.MESSAGE:
                name = self._foreign.get(number, f"channel {number}, which is not described")
                if number not in self._foreign and not self._salvage:
                    raise LogError(f"a message of {name}", where, RECOVER)
                self.contents.ignored[name] = self.contents.ignored.get(name, 0) + 1
            elif op == Opcode.CHANNEL:
                self._channel(bytes(body[start:end]))
            at = end

    def _run(self, body: memoryview, at: int, number: int, stream: McapStream, where: str) -> int:
        """Read messages of one stream that follow each other as one table; return their bytes."""
        size, head = stream.record_bytes, body[at : at + RECORD_HEAD_BYTES + 2]
        most = (len(body) - at) // size
        count = step = 1
        # Doubled as long as all match: the cost stays in proportion to what is found.
        while count < most and body[at + count * size :][: len(head)] == head:
            step = min(2 * step, most - count)
            rows = np.frombuffer(body, "u1", step * size, at + count * size).reshape(step, size)
            differ = np.flatnonzero((rows[:, : len(head)] != np.frombuffer(head, "u1")).any(axis=1))
            count += int(differ[0]) if differ.size else step
        rows = np.frombuffer(body, stream.row, count, at)
        if (rows["cdr"] != CDR_LITTLE_ENDIAN).any():
            raise LogError(f"a message of {stream.topic} is not little-endian CDR", where, "record it again")
        stamp = rows["stamp"].copy() if stream.stamped else None
        part = McapSamples(rows["log_time"].copy(), rows["value"].copy(), stamp)
        self.contents.samples.setdefault(number, []).append(part)
        return count * size
