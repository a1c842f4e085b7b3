"""Encoder of MCAP files: it makes their bytes part after part and keeps what the index will need.

The library `mcap` has the records; its writer takes one message at a time, and cannot take back a part that the disk
refused. Tables and channels carry the checksum of their own record, so that recovery can tell sound ones from damaged.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment as AttachmentRecord
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

import twodof
from twodof.flightlog.mcap_stream import CDR_LITTLE_ENDIAN, RECORD_HEAD_BYTES, McapStream

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "ros2"
CODEC = "zstd"
CHECK = "crc32"
"""The last row of a table or of a channel's metadata: the checksum of what stands before it in its record."""
_LEVEL = 1
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEXED = (Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)
Sealed = TypeVar("Sealed", Channel, Metadata)


@dataclass(frozen=True)
class McapSamples:
    """Samples of one stream: `time_ns` (n,), `value` (n, width), and `stamp` (n,) [s] of a stamped stream."""

    time_ns: NDArray[np.uint64]
    value: NDArray[np.float64]
    stamp: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.time_ns)

    def part(self, rows: slice | NDArray[np.intp]) -> "McapSamples":
        """Return the samples of the given `rows`."""
        stamp = None if self.stamp is None else self.stamp[rows]
        return McapSamples(self.time_ns[rows], self.value[rows], stamp)


@dataclass(frozen=True)
class Attachment:
    """A file kept beside the samples, such as the diagram that flew."""

    name: str
    media_type: str
    data: bytes
    time_ns: int = 0


@dataclass(frozen=True)
class _Written:
    """The state of a file so far: bytes, their checksum, index records, messages by channel, times."""

    position: int = 0
    crc: int = 0
    indexes: int = 0
    messages: Mapping[int, int] = field(default_factory=dict)
    start: int = 1 << 64
    end: int = 0


def encoded(record: McapRecord) -> bytes:
    """Return the bytes of a record."""
    builder = RecordBuilder()
    record.write(builder)
    made: bytes = builder.end()  # type: ignore[no-untyped-call]
    return made


def sealed(record: Sealed) -> Sealed:
    """Return the record with a checksum of itself added to its metadata."""
    crc = zlib.crc32(encoded(record)[RECORD_HEAD_BYTES:])
    return replace(record, metadata={**record.metadata, CHECK: f"{crc:08x}"})


class McapEncoder:
    """Encoder of a file with these streams; each method returns the bytes of the next part of the file."""

    def __init__(self, streams: Sequence[McapStream]) -> None:
        self._streams = tuple(streams)
        self._deflate = zstandard.ZstdCompressor(level=_LEVEL).compress
        self._now = self._before = _Written()
        self._indexes: list[tuple[Opcode, bytes]] = []
        numbered = list(enumerate(self._streams, 1))
        self._schemas = b"".join(
            encoded(Schema(k, stream.definition.encode(), "ros2msg", stream.schema)) for k, stream in numbered
        )
        self._channels = b"".join(
            encoded(sealed(Channel(k, stream.topic, "cdr", stream.metadata, k))) for k, stream in numbered
        )

    def cut(self, position: int) -> None:
        """Forget the last part if the file ends at `position`, before it."""
        if self._now.position > position:
            self._now = self._before
            del self._indexes[self._now.indexes :]

    def head(self, metadata: Mapping[str, Mapping[str, str]], attachments: Sequence[Attachment] = ()) -> bytes:
        """Return everything before the first sample."""
        header = encoded(Header(PROFILE, f"twodof {twodof.__version__}"))
        made = self._made(MAGIC + header + self._schemas + self._channels)
        made += b"".join(self.metadata(name, rows) for name, rows in metadata.items())
        return made + b"".join(map(self._attachment, attachments))

    def metadata(self, name: str, rows: Mapping[str, str]) -> bytes:
        """Return the record of a table of texts, `rows` by key."""
        made = encoded(sealed(Metadata(name=name, metadata=dict(rows))))
        return self._made(made, Opcode.METADATA_INDEX, MetadataIndex(self._now.position, len(made), name))

    def chunk(self, samples: Mapping[int, McapSamples]) -> bytes:
        """Return one chunk of samples, given by the number of their stream, and its indexes; b"" for no samples."""
        now, plain, indexes, offsets = self._now, bytearray(), bytearray(), {}
        counts = Counter(now.messages)
        filled = {stream + 1: some for stream, some in samples.items() if len(some)}
        if not filled:
            return b""
        for channel, some in filled.items():
            rows = self._rows(channel, some, counts[channel])
            entries = np.empty((len(some), 2), dtype="<u8")
            entries[:, 0] = some.time_ns
            entries[:, 1] = len(plain) + rows.itemsize * np.arange(len(some))
            offsets[channel] = len(indexes)
            indexes += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes)
            indexes += entries.tobytes()
            plain += rows.tobytes()
            counts[channel] += len(some)
        start = min(int(some.time_ns.min()) for some in filled.values())
        end = max(int(some.time_ns.max()) for some in filled.values())
        packed = self._deflate(plain)
        made = encoded(Chunk(CODEC, packed, end, start, zlib.crc32(plain), len(plain)))
        offsets = {channel: now.position + len(made) + at for channel, at in offsets.items()}
        index = ChunkIndex(len(made), now.position, CODEC, len(packed), end, len(indexes), offsets, start, len(plain))
        made = self._made(made + bytes(indexes), Opcode.CHUNK_INDEX, index)
        self._now = replace(self._now, messages=counts, start=min(start, now.start), end=max(end, now.end))
        return made

    def tail(self) -> bytes:
        """Return the end of the data and the summary, which readers that seek need."""
        now = self._now
        groups = {op: [one for of, one in self._indexes if of == op] for op in _INDEXED}
        statistics = Statistics(
            attachment_count=len(groups[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(self._streams),
            channel_message_counts=dict(now.messages),
            chunk_count=len(groups[Opcode.CHUNK_INDEX]),
            message_count=sum(now.messages.values()),
            message_end_time=now.end,
            message_start_time=now.start if now.messages else 0,
            metadata_count=len(groups[Opcode.METADATA_INDEX]),
            schema_count=len(self._streams),
        )
        parts = {
            Opcode.SCHEMA: self._schemas,
            Opcode.CHANNEL: self._channels,
            Opcode.STATISTICS: encoded(statistics),
            **{op: b"".join(group) for op, group in groups.items()},
        }
        data_end, summary, offsets = encoded(DataEnd(now.crc)), b"", b""
        start = now.position + len(data_end)
        for op, part in parts.items():
            if part:
                offsets += encoded(SummaryOffset(op, start + len(summary), len(part)))
                summary += part
        footer = encoded(Footer(start, start + len(summary), 0))[:-4]
        # The checksum covers everything before it, the first parts of the footer too.
        crc = zlib.crc32(summary + offsets + footer)
        return data_end + summary + offsets + footer + crc.to_bytes(4, "little") + MAGIC

    def _made(self, part: bytes, op: Opcode | None = None, index: McapRecord | None = None) -> bytes:
        """Return a part, once the state and the indexes have it."""
        if op is not None and index is not None:
            self._indexes.append((op, encoded(index)))
        self._before = now = self._now
        crc, position = zlib.crc32(part, now.crc), now.position + len(part)
        self._now = replace(now, position=position, crc=crc, indexes=len(self._indexes))
        return part

    def _rows(self, channel: int, some: McapSamples, sequence: int) -> NDArray[np.void]:
        stream = self._streams[channel - 1]
        rows = np.empty(len(some), dtype=stream.row)
        rows["op"], rows["length"], rows["channel"] = Opcode.MESSAGE, stream.content_bytes, channel
        # The specification's sequence number has 32 bits; it wraps after 198 days at 250 Hz.
        rows["sequence"] = (sequence + np.arange(len(some), dtype=np.uint64)).astype(np.uint32)
        rows["log_time"] = rows["publish_time"] = some.time_ns
        rows["cdr"] = CDR_LITTLE_ENDIAN
        rows["value"] = some.value
        if stream.stamped:
            rows["stamp"] = some.stamp
        return rows

    def _attachment(self, kept: Attachment) -> bytes:
        time, size = kept.time_ns, len(kept.data)
        made = encoded(AttachmentRecord(time, time, kept.name, kept.media_type, kept.data))
        index = AttachmentIndex(self._now.position, len(made), time, time, size, kept.name, kept.media_type)
        return self._made(made, Opcode.ATTACHMENT_INDEX, index)
