"""Encoder of MCAP files: it makes their bytes part after part and keeps what the index will need.

The library `mcap` has the records; its writer takes one message at a time, and cannot take back a part that the disk
refused. Tables and channels carry the checksum of their own record, so that recovery can tell sound ones from damaged.
"""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment as AttachmentRecord,
)
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
        """Return some of the samples."""
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
    """The state of a file so far: bytes, their checksum, messages of each channel, times."""

    position: int = 0
    crc: int = 0
    messages: Mapping[int, int] = field(default_factory=dict)
    start: int = 0
    end: int = 0


def encoded(record: McapRecord) -> bytes:
    """Return the bytes of a record."""
    builder = RecordBuilder()
    record.write(builder)
    made: bytes = builder.end()  # type: ignore[no-untyped-call]
    return made


def sealed(record: Sealed) -> Sealed:
    """Return a record whose metadata has the checksum of the record without it."""
    crc = zlib.crc32(encoded(record)[RECORD_HEAD_BYTES:])
    return replace(record, metadata={**record.metadata, CHECK: f"{crc:08x}"})


class McapEncoder:
    """Bytes of a file with these streams; each method returns the next part of the file.

    `keep` says that everything returned so far is in the file; `undo` forgets what was returned since.
    """

    def __init__(self, streams: Sequence[McapStream]) -> None:
        self._streams = tuple(streams)
        self._dtypes = tuple(stream.row for stream in self._streams)
        self._described = [self._description(k, stream) for k, stream in enumerate(self._streams)]
        self._deflate = zstandard.ZstdCompressor(level=_LEVEL).compress
        self._now = _Written()
        # Appended to in place, since a recording of hours has 10^5 of them; `keep` remembers how many hold.
        self._indexes: dict[Opcode, list[bytes]] = {
            Opcode.CHUNK_INDEX: [],
            Opcode.ATTACHMENT_INDEX: [],
            Opcode.METADATA_INDEX: [],
        }
        self.keep()

    def keep(self) -> None:
        """Take everything returned so far as written."""
        self._sure = self._now, {op: len(made) for op, made in self._indexes.items()}

    def undo(self) -> None:
        """Forget what was returned since `keep`: it is not in the file."""
        self._now, counts = self._sure
        for op, count in counts.items():
            del self._indexes[op][count:]

    def head(self, metadata: Mapping[str, Mapping[str, str]], attachments: Sequence[Attachment] = ()) -> bytes:
        """Return everything before the first sample."""
        begin = MAGIC + encoded(Header(PROFILE, f"twodof {twodof.__version__}"))
        made = self._made(begin + b"".join(schema + channel for schema, channel in self._described))
        made += b"".join(self.metadata(name, rows) for name, rows in metadata.items())
        return made + b"".join(map(self._attachment, attachments))

    def metadata(self, name: str, rows: Mapping[str, str]) -> bytes:
        """Return a table of texts."""
        made = encoded(sealed(Metadata(name=name, metadata=dict(rows))))
        self._index(Opcode.METADATA_INDEX, MetadataIndex(self._now.position, len(made), name))
        return self._made(made)

    def chunk(self, samples: Mapping[int, McapSamples]) -> bytes:
        """Return one chunk of samples, by the number of their stream, and its indexes; nothing for no samples."""
        filled = {stream: some for stream, some in samples.items() if len(some)}
        if not filled:
            return b""
        bodies, indexes, at = [], {}, 0
        totals = dict(self._now.messages)
        for stream, some in filled.items():
            rows = self._rows(stream, some, totals.get(stream, 0))
            bodies.append(rows.tobytes())
            entries = np.empty((len(some), 2), dtype="<u8")
            entries[:, 0] = some.time_ns
            entries[:, 1] = at + np.arange(len(some), dtype=np.uint64) * np.uint64(rows.itemsize)
            indexes[stream] = entries
            at += len(bodies[-1])
            totals[stream] = totals.get(stream, 0) + len(some)
        start = min(int(some.time_ns.min()) for some in filled.values())
        end = max(int(some.time_ns.max()) for some in filled.values())
        made = self._chunk(b"".join(bodies), indexes, start, end)
        first = not self._now.messages
        self._now = replace(
            self._now,
            messages=totals,
            start=start if first else min(start, self._now.start),
            end=end if first else max(end, self._now.end),
        )
        return self._made(made)

    def tail(self) -> bytes:
        """Return the end of the data and the summary, which readers that seek need."""
        now = self._now
        data_end = encoded(DataEnd(now.crc))
        start = now.position + len(data_end)
        statistics = Statistics(
            attachment_count=len(self._indexes[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(self._streams),
            channel_message_counts={stream + 1: count for stream, count in now.messages.items()},
            chunk_count=len(self._indexes[Opcode.CHUNK_INDEX]),
            message_count=sum(now.messages.values()),
            message_end_time=now.end,
            message_start_time=now.start,
            metadata_count=len(self._indexes[Opcode.METADATA_INDEX]),
            schema_count=len(self._streams),
        )
        groups = [
            (Opcode.SCHEMA, b"".join(schema for schema, _ in self._described)),
            (Opcode.CHANNEL, b"".join(channel for _, channel in self._described)),
            (Opcode.STATISTICS, encoded(statistics)),
            *((op, b"".join(made)) for op, made in self._indexes.items()),
        ]
        summary, offsets = b"", b""
        for op, group in groups:
            if group:
                offsets += encoded(SummaryOffset(op, start + len(summary), len(group)))
                summary += group
        footer = encoded(Footer(start, start + len(summary), 0))
        # The checksum covers everything before it, the first parts of the footer too.
        crc = zlib.crc32(summary + offsets + footer[:-4])
        return self._made(data_end + summary + offsets + footer[:-4] + crc.to_bytes(4, "little") + MAGIC)

    def _index(self, op: Opcode, record: McapRecord) -> None:
        self._indexes[op].append(encoded(record))

    def _made(self, part: bytes) -> bytes:
        crc = zlib.crc32(part, self._now.crc)
        self._now = replace(self._now, position=self._now.position + len(part), crc=crc)
        return part

    def _rows(self, stream: int, some: McapSamples, sequence: int) -> NDArray[np.void]:
        described = self._streams[stream]
        rows = np.empty(len(some), dtype=self._dtypes[stream])
        rows["op"], rows["length"], rows["channel"] = Opcode.MESSAGE, described.content_bytes, stream + 1
        # The specification's sequence number has 32 bits; it wraps after 198 days at 250 Hz.
        rows["sequence"] = (sequence + np.arange(len(some), dtype=np.uint64)).astype(np.uint32)
        rows["log_time"] = rows["publish_time"] = some.time_ns
        rows["cdr"] = CDR_LITTLE_ENDIAN
        rows["value"] = some.value
        if described.stamped:
            rows["stamp"] = some.stamp
        return rows

    def _chunk(self, plain: bytes, indexes: Mapping[int, NDArray[np.uint64]], start: int, end: int) -> bytes:
        packed = self._deflate(plain)
        made = encoded(Chunk(CODEC, packed, end, start, zlib.crc32(plain), len(plain)))
        where, chunk_length = self._now.position, len(made)
        offsets = {}
        for stream, entries in indexes.items():
            offsets[stream + 1] = where + len(made)
            content = (stream + 1).to_bytes(2, "little") + entries.nbytes.to_bytes(4, "little") + entries.tobytes()
            made += bytes((Opcode.MESSAGE_INDEX,)) + len(content).to_bytes(8, "little") + content
        index = ChunkIndex(
            chunk_length, where, CODEC, len(packed), end, len(made) - chunk_length, offsets, start, len(plain)
        )
        self._index(Opcode.CHUNK_INDEX, index)
        return made

    def _attachment(self, kept: Attachment) -> bytes:
        time, size = kept.time_ns, len(kept.data)
        made = encoded(AttachmentRecord(time, time, kept.name, kept.media_type, kept.data))
        index = AttachmentIndex(self._now.position, len(made), time, time, size, kept.name, kept.media_type)
        self._index(Opcode.ATTACHMENT_INDEX, index)
        return self._made(made)

    @staticmethod
    def _description(k: int, stream: McapStream) -> tuple[bytes, bytes]:
        """Return the records of a stream's schema and channel."""
        schema = Schema(id=k + 1, data=stream.definition.encode(), encoding="ros2msg", name=stream.schema)
        channel = Channel(k + 1, stream.topic, "cdr", stream.metadata, k + 1)
        return encoded(schema), encoded(sealed(channel))
