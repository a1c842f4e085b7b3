"""Decoder of MCAP files: it walks the records, and lists the lost parts of a damaged file.

The library `mcap` reads the records and inflates the chunks. The walk is our own for two reasons. The library ends at
the first damage, and it takes one message at a time, where here a run of messages becomes a table at once.
"""

import re
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import TypeVar

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, McapRecord, Metadata, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream

from twodof.errors import LogError, listed, shown
from twodof.flightlog.mcap_encoder import CHECK, MAGIC, Attachment, McapSamples, Sealed, encoded, sealed
from twodof.flightlog.mcap_stream import CDR_LITTLE_ENDIAN, MAX_CHANNELS, RECORD_HEAD_BYTES, McapStream, parse
from twodof.flightlog.provenance import RECOVER, Loss

UNVERIFIED_NOTE = "twodof.unverified"
"""The table that keeps the rows of a table whose checksum is wrong, so that no reader takes them for true."""
_SUMMARY_ONLY = {
    Opcode.FOOTER,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.STATISTICS,
    Opcode.METADATA_INDEX,
    Opcode.SUMMARY_OFFSET,
}
_IN_SUMMARY = _SUMMARY_ONLY | {Opcode.SCHEMA, Opcode.CHANNEL}
_IN_DATA = {*Opcode} - _SUMMARY_ONLY
_NAMES = {int(op): op.name.lower().replace("_", " ") for op in Opcode}
_RECORD_HEAD = struct.Struct("<BQ")
_CODEC = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
"""The codec in a chunk's record, with its length."""
_BEFORE_CODEC = RECORD_HEAD_BYTES + 28
_INDEX_BYTES = 16
Record = TypeVar("Record", bound=McapRecord)


@dataclass
class McapContents:
    """Contents of a file: streams, their samples in the order of the file, tables of texts, attachments.

    `ignored` counts the messages of foreign topics; `finished` says that the file was closed. For a damaged file `lost`
    lists the parts that were left out, and `unverified` those that were kept without a right checksum.
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
    """Return the contents of an MCAP file. Raises LogError for any other file and, without `salvage`, for any damage.

    `salvage` keeps the sound parts of a damaged file and lists the others in `lost`.
    """
    return _Walk(data, where, salvage).read()


def _frame(data: memoryview, at: int) -> tuple[int, int, int]:
    """Return opcode, first byte and end of the content of the record at byte `at`. Raises ValueError."""
    start = at + RECORD_HEAD_BYTES
    if len(data) < start:
        raise ValueError(f"truncated in the head of the record at byte {at}")
    op, size = _RECORD_HEAD.unpack_from(data, at)
    if op == 0 or size > len(data) - start:
        there = len(data) - start
        raise ValueError(f"the record at byte {at} (opcode {op:#04x}) promises {size} bytes, {there} are there")
    return op, start, start + size


def _read(kind: Callable[[ReadDataStream], Record], content: bytes, extended: bool = False) -> Record:
    """Return a record. Raises ValueError if its bytes differ from those that its fields encode to.

    An `extended` one may have further fields at its end, as the format allows to later versions.
    """
    record = kind(ReadDataStream(BytesIO(content)))
    plain = encoded(record)[RECORD_HEAD_BYTES:]
    if plain != (content[: len(plain)] if extended else content):
        raise ValueError("it does not consist of its parts")
    return record


def _unsealed(record: Sealed, content: bytes) -> tuple[Sealed, bool | None]:
    """Return the record without the row of its checksum, and whether it holds; None where there is none."""
    rows = {key: value for key, value in record.metadata.items() if key != CHECK}
    plain = replace(record, metadata=rows)
    sound = encoded(sealed(plain))[RECORD_HEAD_BYTES:] == content
    return plain, sound if CHECK in record.metadata else None


def _chunk(content: bytes) -> tuple[bytes, bool]:
    """Return the inflated bytes of a chunk, and whether a checksum vouches for them. Raises ValueError."""
    chunk = _read(Chunk.read, content)
    if chunk.compression == "zstd" and zstandard.frame_content_size(chunk.data) > chunk.uncompressed_size:
        raise ValueError("it inflates to more than it says")
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    if size != chunk.uncompressed_size:
        raise ValueError(f"it inflates to {size} bytes, not {chunk.uncompressed_size}")
    return stream.read(size), chunk.uncompressed_crc != 0


class _Walk:
    def __init__(self, data: bytes, where: str, salvage: bool) -> None:
        self._raw, self._where, self._salvage = data, where, salvage
        self._data = memoryview(data)
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
            op, end = 0, 0
            try:
                op, start, end = _frame(self._data, at)
                # Reserved opcodes may come with later versions. In a damaged file they are damage, and so is a record
                # where it does not belong: one bit makes a chunk an index.
                if self._salvage and op not in (_IN_SUMMARY if self._in_summary else _IN_DATA):
                    raise ValueError("it does not belong there")
                self._record(op, at, start, end)
            except MemoryError:  # no damage: the fence says it
                raise
            except Exception as reason:  # noqa: BLE001  the library may raise anything on damaged bytes
                why = reason.what if isinstance(reason, LogError) else f"{reason!s:.200}"
                what = f"the {_NAMES.get(op, f'record {op:#04x}')} at byte {at} is damaged: {why}" if end else why
                end = self._after_damage(at, end) if self._salvage else at
                self._lose(at, end - at, what)
            at = end
        self._judge(at + len(MAGIC) * self.contents.finished)
        return self.contents

    def _lose(self, at: int, size: int, why: str) -> None:
        """List a part as lost. Raises LogError without `salvage`, and for too many of them."""
        if not self._salvage:
            raise LogError(why, self._where, RECOVER)
        self.contents.lost.append(Loss(at, size, why))
        if len(self.contents.lost) > MAX_CHANNELS:
            raise LogError(
                f"more than {MAX_CHANNELS} damaged parts", self._where, "copy the file again from where it was recorded"
            )

    def _after_damage(self, at: int, end: int) -> int:
        """Return where to go on after the damaged record at byte `at`, which by its length ends at `end`.

        That is its end if a record begins there, or else the next chunk whose checksum holds.
        """
        with suppress(ValueError):
            if end and (end == len(self._data) or _frame(self._data, end)[0] <= Opcode.DATA_END):
                return end
        for found in _CODEC.finditer(self._raw, at + 1 + _BEFORE_CODEC):
            candidate = found.start() - _BEFORE_CODEC
            with suppress(Exception):
                op, start, stop = _frame(self._data, candidate)
                if op == Opcode.CHUNK and _chunk(self._raw[start:stop])[1]:
                    return candidate
        return len(self._data)

    def _judge(self, at: int) -> None:
        """Check the end of the file: closed, sealed, and as many messages as its statistics say."""
        found, total = self.contents, self.contents.messages + sum(self.contents.ignored.values())
        if not self._salvage and not found.finished:
            raise LogError("was not closed: the recording was cut off", self._where, RECOVER)
        if at < len(self._data):
            self._lose(at, len(self._data) - at, "goes on after its end")
        if self._doubts and not self._sealed:
            found.unverified.append(f"no checksum vouches for {listed(self._doubts)}")
        if self._sealed is False and not self._salvage:
            self._lose(0, 0, "the checksum of the data is wrong")
        if not found.lost and not found.unverified:
            if self._sealed is False:
                self._lose(0, 0, "the checksum of the file is wrong: a part was changed that is not used")
            elif self._stated not in (None, total):
                self._lose(0, 0, f"{total} messages of {self._stated} are there")
        if self._salvage:
            self._check_schemas()

    def _check_schemas(self) -> None:
        """List damaged schemas as lost; the writer replaces them."""
        for number, stream in self.contents.streams.items():
            schema = self._schemas.get(self._schema_of[number])
            expected = stream.schema, "ros2msg", stream.definition.encode()
            if schema is None or (schema.name, schema.encoding, schema.data) != expected:
                self._lose(0, 0, f"the schema of {shown(stream.topic)} is damaged, and made anew")

    def _record(self, op: int, at: int, start: int, end: int) -> None:
        content = self._raw[start:end]
        match op:
            case Opcode.MESSAGE:
                self._doubts["messages outside of chunks"] = None
                self._messages(self._data[at:end])
            case Opcode.CHUNK:
                plain, vouched = _chunk(content)
                if not vouched:
                    self._doubts[f"the chunk at byte {at}"] = None
                self._messages(memoryview(plain))
            case Opcode.MESSAGE_INDEX:
                # It is not used; but because of a changed bit another record may look like it.
                stated = int.from_bytes(content[2:6], "little")
                if stated != len(content) - 6 or stated % _INDEX_BYTES:
                    raise ValueError("its length is wrong")
            case Opcode.HEADER:
                if at != len(MAGIC):
                    raise ValueError("it does not belong there")
                self._read(Header.read, content)
            case Opcode.SCHEMA:
                schema = self._read(Schema.read, content)
                self._schemas.setdefault(schema.id, schema)
            case Opcode.CHANNEL:
                self._channel(content)
            case Opcode.METADATA:
                self._table(content, at, end)
            case Opcode.ATTACHMENT:
                self._attachment(content)
            case Opcode.DATA_END:
                self._in_summary = True
                sum_stated = self._read(DataEnd.read, content).data_section_crc
                self._sealed = sum_stated == zlib.crc32(self._data[:at]) if sum_stated else None
            case Opcode.STATISTICS:
                self._stated = self._read(Statistics.read, content).message_count
            case Opcode.FOOTER:
                self._footer(content, end)

    def _read(self, kind: Callable[[ReadDataStream], Record], content: bytes) -> Record:
        return _read(kind, content, extended=not self._salvage)  # in a damaged file it has swallowed the next record

    def _footer(self, content: bytes, end: int) -> None:
        footer = self._read(Footer.read, content)
        if self._raw[end : end + len(MAGIC)] != MAGIC:
            raise ValueError("the mark at the end is missing")
        summary = self._data[min(footer.summary_start, end) : end - 4]
        if footer.summary_crc and footer.summary_start and footer.summary_crc != zlib.crc32(summary):
            raise ValueError("the checksum of the summary is wrong")
        self.contents.finished = True

    def _table(self, content: bytes, at: int, end: int) -> None:
        table, sound = _unsealed(self._read(Metadata.read, content), content)
        name, rows = table.name, table.metadata
        if sound is False:
            self._lose(at, end - at, f"the checksum of table {shown(name)} is wrong")
            self.contents.unverified.append(f"table {shown(name)}, which is kept as table {UNVERIFIED_NOTE!r}")
            name, rows = UNVERIFIED_NOTE, {"table": name[:200], **rows}
        elif sound is None:
            self._doubts[f"table {shown(name)}"] = None
        self.contents.metadata.append((name, rows))

    def _channel(self, content: bytes) -> None:
        channel, sound = _unsealed(self._read(Channel.read, content), content)
        number, name, found = channel.id, channel.topic, self.contents
        if number in found.streams or number in self._foreign:
            return
        if len(found.streams) + len(self._foreign) >= MAX_CHANNELS:
            raise ValueError(f"more than {MAX_CHANNELS} channels")
        if sound is False and not self._salvage:
            raise ValueError(f"the checksum of topic {shown(name)} is wrong")
        schema = self._schemas.get(channel.schema_id)
        stream = parse(channel, "" if schema is None else schema.name)
        if stream is None:
            self._foreign[number] = name[:200]
            return
        if stream.mat in {other.mat for other in found.streams.values()}:
            raise ValueError(f"channel {shown(stream.mat)} is there twice")
        found.streams[number] = stream
        self._schema_of[number] = channel.schema_id
        if sound is False:
            why = f"the description of topic {shown(name)}, whose checksum is wrong: its name, unit and fields"
            found.unverified.append(why)
        elif sound is None:
            self._doubts[f"the description of topic {shown(name)}"] = None

    def _attachment(self, content: bytes) -> None:
        stated = int.from_bytes(content[-4:], "little")
        # The library writes a checksum and reads none.
        sound = content[:-4] + zlib.crc32(content[:-4]).to_bytes(4, "little")
        kept = _read(AttachmentRecord.read, sound)
        if not stated:
            self._doubts[f"attachment {shown(kept.name)}"] = None
        elif sound != content:
            raise ValueError(f"the checksum of attachment {shown(kept.name)} is wrong")
        self.contents.attachments.append(Attachment(kept.name, kept.media_type, kept.data, kept.log_time))

    def _messages(self, body: memoryview) -> None:
        at, streams, ignored = 0, self.contents.streams, self.contents.ignored
        while at < len(body):
            op, start, end = _frame(body, at)
            number = int.from_bytes(body[start : start + 2], "little") if op == Opcode.MESSAGE else -1
            if number in streams:
                at += self._run(body, at, end - start, number)
                continue
            if op == Opcode.MESSAGE:
                name = self._foreign.get(number, f"channel {number}, which is not described")
                if number not in self._foreign and not self._salvage:
                    raise ValueError(f"a message of {name}")
                ignored[name] = ignored.get(name, 0) + 1
            elif op == Opcode.CHANNEL:
                self._channel(bytes(body[start:end]))
            at = end

    def _run(self, body: memoryview, at: int, length: int, number: int) -> int:
        """Read the next messages of one stream, which follow each other, as one table; return their bytes."""
        stream = self.contents.streams[number]
        if length != stream.content_bytes:
            raise ValueError(f"a message of {stream.topic} has {length} bytes")
        size = stream.row.itemsize
        most, count, step, found = (len(body) - at) // size, 0, 1, 1
        # Doubled as long as all belong to the stream: the cost stays in proportion to what is found.
        while count < most and found == step:
            rows = np.frombuffer(body, stream.row, min(2 * step, most - count), at + count * size)
            alike = (rows["op"] == Opcode.MESSAGE) & (rows["length"] == length) & (rows["channel"] == number)
            step, found = len(rows), int(np.append(alike, False).argmin())
            count += found
        rows = np.frombuffer(body, stream.row, count, at)
        if (rows["cdr"] != CDR_LITTLE_ENDIAN).any():
            raise ValueError(f"a message of {stream.topic} is not little-endian CDR")
        stamp = rows["stamp"].copy() if stream.stamped else None
        part = McapSamples(rows["log_time"].copy(), rows["value"].copy(), stamp)
        self.contents.samples.setdefault(number, []).append(part)
        return len(rows) * size
