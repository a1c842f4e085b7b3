"""Makes the bytes of an MCAP file, part after part, and keeps what its index will need."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from struct import Struct

import numpy as np
from numpy.typing import NDArray

import twodof
from twodof.flightlog.mcap.records import CHUNK_HEAD, MAGIC, McapOpcode, checked, counts, deflate, mapping, record, text
from twodof.flightlog.mcap.topic_stream import CDR_LITTLE_ENDIAN, McapStream

PROFILE = "ros2"
CODEC = "zstd"
_INDEX = Struct("<QQ")


@dataclass(frozen=True)
class McapSamples:
    """Samples of one stream: `time_ns` (n,), `value` (n, width), and `stamp` (n,) [s] of a stamped stream."""

    time_ns: NDArray[np.uint64]
    value: NDArray[np.float64]
    stamp: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.time_ns)

    def part(self, rows: slice | NDArray[np.intp]) -> "McapSamples":
        """Some of them."""
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
    """What has been made: bytes, their checksum, messages of each channel, times."""

    position: int = 0
    crc: int = 0
    messages: Mapping[int, int] = field(default_factory=dict)
    start: int = 0
    end: int = 0


class McapEncoder:
    """Bytes of a file with these streams; each method returns what comes next in the file.

    `keep` says that everything returned so far is in the file; `undo` forgets what was returned since.
    """

    def __init__(self, streams: Sequence[McapStream]) -> None:
        self._streams = tuple(streams)
        self._dtypes = tuple(stream.row for stream in self._streams)
        self._now = _Written()
        # Appended to in place, since a recording of hours has 10^5 of them; `keep` remembers how many hold.
        self._indexes: dict[McapOpcode, list[bytes]] = {
            McapOpcode.CHUNK_INDEX: [],
            McapOpcode.ATTACHMENT_INDEX: [],
            McapOpcode.METADATA_INDEX: [],
        }
        self.keep()

    def head(self, metadata: Mapping[str, Mapping[str, str]], attachments: Sequence[Attachment] = ()) -> bytes:
        """Everything before the first sample."""
        parts = [
            MAGIC,
            record(McapOpcode.HEADER, text(PROFILE) + text(f"twodof {twodof.__version__}")),
            self._channels(),
        ]
        made = self._made(b"".join(parts))
        made += b"".join(self.metadata(name, rows) for name, rows in metadata.items())
        return made + b"".join(map(self._attachment, attachments))

    def metadata(self, name: str, rows: Mapping[str, str]) -> bytes:
        """A table of texts, with its checksum: what a crash or a bad disk leaves of the file has no other."""
        made = record(McapOpcode.METADATA, text(name) + mapping(checked(text(name), rows)))
        self._index(McapOpcode.METADATA_INDEX, _INDEX.pack(self._now.position, len(made)) + text(name))
        return self._made(made)

    def chunk(self, samples: Mapping[int, McapSamples]) -> bytes:
        """Samples by the number of their stream, one chunk and its indexes; nothing for no samples."""
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
        """The end of the data and the summary: what readers that seek need."""
        now = self._now
        data_end = record(McapOpcode.DATA_END, now.crc.to_bytes(4, "little"))
        start = now.position + len(data_end)
        statistics = Struct("<QHIIIIQQ").pack(
            sum(now.messages.values()),
            len(self._streams),
            len(self._streams),
            len(self._indexes[McapOpcode.ATTACHMENT_INDEX]),
            len(self._indexes[McapOpcode.METADATA_INDEX]),
            len(self._indexes[McapOpcode.CHUNK_INDEX]),
            now.start,
            now.end,
        ) + counts({stream + 1: count for stream, count in now.messages.items()})
        groups = [
            (McapOpcode.SCHEMA, b"".join(map(self._schema, range(len(self._streams))))),
            (McapOpcode.CHANNEL, b"".join(map(self._channel, range(len(self._streams))))),
            (McapOpcode.STATISTICS, record(McapOpcode.STATISTICS, statistics)),
            *((op, b"".join(made)) for op, made in self._indexes.items()),
        ]
        summary, offsets = b"", b""
        for op, group in groups:
            if group:
                offsets += record(McapOpcode.SUMMARY_OFFSET, Struct("<BQQ").pack(op, start + len(summary), len(group)))
            summary += group
        footer = Struct("<BQQQ").pack(McapOpcode.FOOTER, 20, start, start + len(summary))
        body = summary + offsets + footer
        return data_end + body + zlib.crc32(body).to_bytes(4, "little") + MAGIC

    def keep(self) -> None:
        """What was returned so far is in the file."""
        self._kept = self._now, {op: len(made) for op, made in self._indexes.items()}

    def undo(self) -> None:
        """What was returned since the last `keep` is not in the file."""
        self._now, counts = self._kept
        for op, count in counts.items():
            del self._indexes[op][count:]

    def _index(self, op: McapOpcode, content: bytes) -> None:
        self._indexes[op].append(record(op, content))

    def _made(self, part: bytes) -> bytes:
        crc = zlib.crc32(part, self._now.crc)
        self._now = replace(self._now, position=self._now.position + len(part), crc=crc)
        return part

    def _rows(self, stream: int, some: McapSamples, sequence: int) -> NDArray[np.void]:
        described = self._streams[stream]
        rows = np.empty(len(some), dtype=self._dtypes[stream])
        rows["op"], rows["length"], rows["channel"] = McapOpcode.MESSAGE, described.content_bytes, stream + 1
        # The specification's sequence number has 32 bits; it wraps after 198 days at 250 Hz.
        rows["sequence"] = (sequence + np.arange(len(some), dtype=np.uint64)).astype(np.uint32)
        rows["log_time"] = rows["publish_time"] = some.time_ns
        rows["cdr"] = CDR_LITTLE_ENDIAN
        rows["value"] = some.value
        if described.stamped:
            rows["stamp"] = some.stamp
        return rows

    def _chunk(self, plain: bytes, indexes: Mapping[int, NDArray[np.uint64]], start: int, end: int) -> bytes:
        packed = deflate(CODEC, plain)
        content = CHUNK_HEAD.pack(start, end, len(plain), zlib.crc32(plain)) + text(CODEC)
        chunk = record(McapOpcode.CHUNK, content + len(packed).to_bytes(8, "little") + packed)
        where = self._now.position
        parts, offsets, at = [chunk], {}, where + len(chunk)
        for stream, entries in indexes.items():
            raw = entries.tobytes()
            index = Struct("<HI").pack(stream + 1, len(raw)) + raw
            offsets[stream + 1] = at
            parts.append(record(McapOpcode.MESSAGE_INDEX, index))
            at += len(parts[-1])
        lengths = (at - where - len(chunk)).to_bytes(8, "little") + text(CODEC) + _INDEX.pack(len(packed), len(plain))
        times = Struct("<QQQQ").pack(start, end, where, len(chunk))
        self._index(McapOpcode.CHUNK_INDEX, times + counts(offsets) + lengths)
        return b"".join(parts)

    def _attachment(self, kept: Attachment) -> bytes:
        times = _INDEX.pack(kept.time_ns, kept.time_ns)
        names = text(kept.name) + text(kept.media_type)
        content = times + names + len(kept.data).to_bytes(8, "little") + kept.data
        made = record(McapOpcode.ATTACHMENT, content + zlib.crc32(content).to_bytes(4, "little"))
        index = _INDEX.pack(self._now.position, len(made)) + times + len(kept.data).to_bytes(8, "little") + names
        self._index(McapOpcode.ATTACHMENT_INDEX, index)
        return self._made(made)

    def _channels(self) -> bytes:
        return b"".join(self._schema(k) + self._channel(k) for k in range(len(self._streams)))

    def _schema(self, k: int) -> bytes:
        stream = self._streams[k]
        names = text(stream.schema) + text("ros2msg")
        return record(McapOpcode.SCHEMA, (k + 1).to_bytes(2, "little") + names + text(stream.definition))

    def _channel(self, k: int) -> bytes:
        stream = self._streams[k]
        head = Struct("<HH").pack(k + 1, k + 1) + text(stream.topic) + text("cdr")
        return record(McapOpcode.CHANNEL, head + mapping(checked(head, stream.metadata)))
