"""Walks an MCAP file: what it holds, and in a damaged one what is lost; nothing in it is trusted or unbounded."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from twodof.errors import LogError, shown
from twodof.flightlog.mcap_encoder import Attachment, Samples
from twodof.flightlog.mcap_records import CHUNK_HEAD, CODECS, MAGIC, RECORD_HEAD, Cursor, Op, check_size, frame, inflate
from twodof.flightlog.mcap_stream import CDR_LITTLE_ENDIAN, MAX_CHANNELS, Stream, parse
from twodof.flightlog.settle import RECOVER, Loss

MAX_INFLATED_BYTES = 2 << 30
MAX_RECORDS = 50_000_000
# Where a chunk's codec stands in its record: after the head, its times, size and checksum.
_BEFORE_CODEC = RECORD_HEAD.size + CHUNK_HEAD.size
_STATED_MESSAGES = 8


@dataclass
class Contents:
    """What a file holds: streams, their samples in the order of the file, tables of texts, attachments.

    `ignored` counts the messages of topics that are not ours; `finished` says that the file was closed.
    """

    streams: dict[int, Stream] = field(default_factory=dict)
    samples: dict[int, list[Samples]] = field(default_factory=dict)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    ignored: dict[str, int] = field(default_factory=dict)
    lost: list[Loss] = field(default_factory=list)
    finished: bool = False

    @property
    def messages(self) -> int:
        """Samples of all streams."""
        return sum(len(part) for parts in self.samples.values() for part in parts)

    def joined(self, stream: int) -> Samples:
        """All samples of a stream, in the order of the file."""
        parts = self.samples.get(stream, [])
        stamped = self.streams[stream].stamped
        return Samples(
            np.concatenate([part.time_ns for part in parts] or [np.empty(0, np.uint64)]),
            np.concatenate([part.value for part in parts] or [np.empty((0, self.streams[stream].width))]),
            np.concatenate([part.stamp for part in parts if part.stamp is not None] or [np.empty(0)])
            if stamped
            else None,
        )


class Decoder:
    """Reads one file. `salvage` keeps what is sound of a damaged one and lists the rest in `lost`."""

    def __init__(self, data: bytes, where: str, salvage: bool) -> None:
        self._data, self._where, self._salvage = memoryview(data), where, salvage
        self._raw = data
        self._budget = MAX_INFLATED_BYTES
        self._foreign: dict[int, str] = {}
        self._stated: int | None = None
        self._total = 0
        self.contents = Contents()

    def read(self) -> Contents:
        """Everything. Raises LogError for what is no MCAP and, without `salvage`, for any damage."""
        if bytes(self._data[: len(MAGIC)]) != MAGIC:
            raise LogError("is no MCAP file", self._where, "give a recording made by twodof")
        at = len(MAGIC)
        while at < len(self._data) and not self.contents.finished:
            end = 0
            try:
                op, start, end = frame(self._data, at, self._where)
                # Reserved opcodes may come with later versions; where damage is expected they are damage.
                if self._salvage and op > Op.DATA_END:
                    raise LogError(f"unknown opcode {op:#04x} at byte {at}", self._where)
                self._record(op, at, start, end)
            except LogError as reason:
                end = self._skip(at, end, reason)
            at = end + (len(MAGIC) if self.contents.finished else 0)
        self._judge(at)
        return self.contents

    def _skip(self, at: int, end: int, reason: LogError) -> int:
        """Where to go on after the record at byte `at` that is not sound and, as it says, ends at `end`."""
        if not self._salvage or self._budget < 0:
            raise reason
        after = end if end and self._is_record(end) else self._next_chunk(at + 1)
        self.contents.lost.append(Loss(at, after - at, reason.what))
        if len(self.contents.lost) > MAX_CHANNELS:
            raise LogError(f"more than {MAX_CHANNELS} damaged parts", self._where, "nothing can be trusted in it")
        return after

    def _is_record(self, at: int) -> bool:
        """Whether a record may begin at byte `at`."""
        try:
            return at == len(self._data) or frame(self._data, at, self._where)[0] <= Op.DATA_END
        except LogError:
            return False

    def _next_chunk(self, at: int) -> int:
        """First byte of the next chunk whose checksum holds; the file's end if there is none."""
        for candidate in sorted(self._candidates(at)):
            try:
                op, start, end = frame(self._data, candidate, self._where)
                if op == Op.CHUNK and self._chunk(start, end)[1]:
                    return candidate
            except LogError:
                if self._budget < 0:
                    raise
        return len(self._data)

    def _candidates(self, at: int) -> Iterator[int]:
        for codec in CODECS:
            mark = len(codec).to_bytes(4, "little") + codec.encode()
            found = self._raw.find(mark, at + _BEFORE_CODEC)
            while found >= 0:
                yield found - _BEFORE_CODEC
                found = self._raw.find(mark, found + 1)

    def _judge(self, at: int) -> None:
        """The end of the file: closed, and as many messages as its statistics say."""
        found, total = self.contents, self.contents.messages + sum(self.contents.ignored.values())
        if self._salvage:
            if found.finished and at < len(self._data):
                found.lost.append(Loss(at, len(self._data) - at, "bytes after the end"))
            return
        if not found.finished or at != len(self._data):
            what = "was not closed: the recording was cut off" if not found.finished else "goes on after its end"
            raise LogError(what, self._where, RECOVER)
        if self._stated is not None and self._stated != total:
            raise LogError(f"{total} messages of {self._stated} are there", self._where, RECOVER)

    def _record(self, op: int, at: int, start: int, end: int) -> None:
        self._count()
        inside = Cursor(self._data, start, end, self._where)
        if op == Op.CHANNEL:
            self._channel(inside)
        elif op == Op.CHUNK:
            plain, _ = self._chunk(start, end)
            self._messages(memoryview(plain), f"{self._where}, chunk at byte {at}")
        elif op == Op.MESSAGE:
            self._messages(self._data[at:end], self._where)
        elif op == Op.METADATA:
            self.contents.metadata.append((inside.text(), inside.mapping()))
        elif op == Op.ATTACHMENT:
            self._attachment(inside, start, end)
        elif op == Op.STATISTICS:
            self._stated = inside.number(_STATED_MESSAGES)
        elif op == Op.DATA_END:
            stated = inside.number(4)
            if stated and not self._salvage and stated != zlib.crc32(self._data[:at]):
                raise LogError("the checksum of the data is wrong", self._where, RECOVER)
        elif op == Op.FOOTER:
            self._footer(inside, end)

    def _count(self) -> None:
        """One more record, or one more run of messages of one stream."""
        self._total += 1
        if self._total > MAX_RECORDS:
            self._budget = -1  # ends a recovery too
            raise LogError(f"more than {MAX_RECORDS} records", self._where, "this is no flight log")

    def _footer(self, inside: Cursor, end: int) -> None:
        summary, _, stated = inside.number(8), inside.number(8), inside.number(4)
        if bytes(self._data[end : end + len(MAGIC)]) != MAGIC:
            raise LogError("the mark at the end is missing", self._where, RECOVER)
        if stated and summary and stated != zlib.crc32(self._data[min(summary, end) : end - 4]):
            raise LogError("the checksum of the summary is wrong", self._where, RECOVER)
        self.contents.finished = True

    def _channel(self, inside: Cursor) -> None:
        number = inside.number(2)
        inside.number(2)
        name, encoding, metadata = inside.text(), inside.text(), inside.mapping()
        if number in self.contents.streams or number in self._foreign:
            return
        if len(self.contents.streams) + len(self._foreign) >= MAX_CHANNELS:
            raise LogError(f"more than {MAX_CHANNELS} channels", self._where, "this is no flight log")
        stream = parse(name, "", encoding, metadata, self._where)
        if stream is None:
            self._foreign[number] = name[:200]
        elif stream.mat in {other.mat for other in self.contents.streams.values()}:
            raise LogError(f"channel {shown(stream.mat)} is there twice", self._where, "record it again")
        else:
            self.contents.streams[number] = stream

    def _attachment(self, inside: Cursor, start: int, end: int) -> None:
        time_ns, _ = inside.number(8), inside.number(8)
        name, media_type = inside.text(), inside.text()
        data = bytes(inside.raw(inside.number(8)))
        stated = inside.number(4)
        if stated and stated != zlib.crc32(self._data[start : end - 4]):
            raise LogError(f"the checksum of attachment {shown(name)} is wrong", self._where, RECOVER)
        self.contents.attachments.append(Attachment(name, media_type, data, time_ns))

    def _chunk(self, start: int, end: int) -> tuple[bytes, bool]:
        """The plain bytes of a chunk, and whether a checksum vouches for them."""
        inside = Cursor(self._data, start, end, self._where)
        head = bytes(inside.raw(CHUNK_HEAD.size))
        _, _, size, crc = CHUNK_HEAD.unpack(head)
        codec = inside.text()
        packed = inside.raw(inside.number(8))
        # A size that is refused unread costs nothing, or one damaged length would end the whole recovery.
        check_size(size, self._where)
        # Damaged chunks count too, or a file of them would cost time without end.
        self._budget -= min(size, self._budget + 1)
        if self._budget < 0:
            raise LogError(f"inflates to more than {MAX_INFLATED_BYTES} bytes", self._where, "this is no flight log")
        return inflate(codec, packed, size, crc, self._where), crc != 0

    def _messages(self, body: memoryview, where: str) -> None:
        at = 0
        while at < len(body):
            self._count()
            op, start, end = frame(body, at, where)
            if op != Op.MESSAGE:
                if op == Op.CHANNEL:
                    self._channel(Cursor(body, start, end, where))
                at = end
                continue
            number = Cursor(body, start, end, where).number(2)
            stream = self.contents.streams.get(number)
            if stream is None:
                if number not in self._foreign:
                    raise LogError(f"a message of channel {number}, which is not described", where, RECOVER)
                name = self._foreign[number]
                self.contents.ignored[name] = self.contents.ignored.get(name, 0) + 1
                at = end
                continue
            if end - start != stream.content_bytes:
                raise LogError(f"a message of {stream.topic} has {end - start} bytes", where, RECOVER)
            at += self._run(body, at, number, stream, where)

    def _run(self, body: memoryview, at: int, number: int, stream: Stream, where: str) -> int:
        """Reads messages of one stream that follow each other as one table; returns their bytes."""
        size, head = stream.record_bytes, bytes(body[at : at + RECORD_HEAD.size + 2])
        most = (len(body) - at) // size
        count, step = 1, 1
        # Doubled as long as all match: the cost stays in proportion to what is found.
        while count < most:
            step = min(2 * step, most - count)
            if step <= 2:
                same = int(bytes(body[at + count * size :][: len(head)]) == head)
                step = 1
            else:
                rows = np.frombuffer(body, "u1", step * size, at + count * size).reshape(step, size)[:, : len(head)]
                differ = np.flatnonzero((rows != np.frombuffer(head, "u1")).any(axis=1))
                same = int(differ[0]) if differ.size else step
            count += same
            if same < step:
                break
            step = max(step, 2)
        rows = np.frombuffer(body, stream.row, count, at)
        if (rows["cdr"] != CDR_LITTLE_ENDIAN).any():
            raise LogError(f"a message of {stream.topic} is not little-endian CDR", where, "record it again")
        stamp = rows["stamp"].copy() if stream.stamped else None
        part = Samples(rows["log_time"].copy(), rows["value"].copy(), stamp)
        self.contents.samples.setdefault(number, []).append(part)
        return count * size


def scan(data: bytes, where: str, salvage: bool = False) -> Contents:
    """What an MCAP file holds. Raises LogError for what is no MCAP and, without `salvage`, for any damage."""
    return Decoder(data, where, salvage).read()
