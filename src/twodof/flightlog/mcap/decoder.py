"""Walks an MCAP file: what it holds, and in a damaged one what is lost; nothing in it is trusted or unbounded."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from twodof.errors import LogError, listed, shown
from twodof.flightlog.mcap.encoder import Attachment, McapSamples
from twodof.flightlog.mcap.records import (
    CHUNK_HEAD,
    CODECS,
    MAGIC,
    RECORD_HEAD,
    SUMMARY_ONLY,
    McapOpcode,
    RecordCursor,
    check_size,
    frame,
    inflate,
    text,
    unchecked,
)
from twodof.flightlog.mcap.topic_stream import CDR_LITTLE_ENDIAN, MAX_CHANNELS, McapStream, parse
from twodof.flightlog.memory_budget import RUN_BYTES, MemoryBudget
from twodof.flightlog.sanitise import RECOVER, Loss

UNVERIFIED_NOTE = "twodof.unverified"
"""The table in which a table whose checksum is wrong goes on, so that nobody takes it for true."""
CHUNK_BYTES = 3 * RUN_BYTES
"""What a chunk costs, beside its messages."""
_IN_BOTH = frozenset({McapOpcode.SCHEMA, McapOpcode.CHANNEL})
_IN_SUMMARY = _IN_BOTH | SUMMARY_ONLY
_IN_DATA = frozenset(McapOpcode) - SUMMARY_ONLY
# Where a chunk's codec stands in its record: after the head, its times, size and checksum.
_BEFORE_CODEC = RECORD_HEAD.size + CHUNK_HEAD.size
_STATED_MESSAGES = 8
_INDEX_BYTES = 16


@dataclass
class McapContents:
    """What a file holds: streams, their samples in the order of the file, tables of texts, attachments.

    `ignored` counts the messages of topics that are not ours; `finished` says that the file was closed. Of a damaged
    file `lost` is what is not in it, and `unverified` what is and has no checksum that holds, in words.
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
        """Samples of all streams."""
        return sum(len(part) for parts in self.samples.values() for part in parts)

    def joined(self, stream: int) -> McapSamples:
        """All samples of a stream, in the order of the file."""
        parts = self.samples.get(stream, [])
        stamps = [part.stamp for part in parts if part.stamp is not None]
        return McapSamples(
            np.concatenate([np.empty(0, np.uint64), *(part.time_ns for part in parts)]),
            np.concatenate([np.empty((0, self.streams[stream].width)), *(part.value for part in parts)]),
            np.concatenate([np.empty(0), *stamps]) if self.streams[stream].stamped else None,
        )


class McapDecoder:
    """Reads one file. `salvage` keeps what is sound of a damaged one and lists the rest in `lost`."""

    def __init__(self, data: bytes, where: str, salvage: bool, budget: MemoryBudget) -> None:
        self._data, self._where, self._salvage = memoryview(data), where, salvage
        self._raw = data
        self._budget = budget
        self._foreign: dict[int, str] = {}
        self._schemas: dict[int, tuple[str, bytes]] = {}
        self._schema_of: dict[int, int] = {}
        self._stated: int | None = None
        # Whether the checksum of all data holds; None before the end of the data and without one.
        self._sealed: bool | None = None
        self._in_summary = False
        # What is taken without a checksum of its own, each once.
        self._doubts: dict[str, None] = {}
        self._marks = dict.fromkeys(CODECS, 0)
        self.contents = McapContents()

    def read(self) -> McapContents:
        """Everything. Raises LogError for what is no MCAP and, without `salvage`, for any damage."""
        if bytes(self._data[: len(MAGIC)]) != MAGIC:
            raise LogError("is no MCAP file", self._where, "give a recording made by twodof")
        at = len(MAGIC)
        while at < len(self._data) and not self.contents.finished:
            end = 0
            try:
                op, start, end = frame(self._data, at, self._where)
                # Reserved opcodes may come with later versions; where damage is expected they are damage, and so is
                # a record where it does not belong: one bit makes a chunk an index.
                if self._salvage and op not in (_IN_SUMMARY if self._in_summary else _IN_DATA):
                    raise LogError(f"a record of opcode {op:#04x} does not belong there", self._where)
                self._record(op, at, start, end)
            except LogError as reason:
                end = self._skip(at, end, reason)
            at = end + (len(MAGIC) if self.contents.finished else 0)
        self._judge(at)
        return self.contents

    def _skip(self, at: int, end: int, reason: LogError) -> int:
        """Where to go on after the record at byte `at` that is not sound and, as it says, ends at `end`."""
        if not self._salvage or self._budget.spent:
            raise reason
        after = end if end and self._is_record(end) else self._next_chunk(at + 1)
        self.contents.lost.append(Loss(at, after - at, reason.what))
        if len(self.contents.lost) > MAX_CHANNELS:
            raise LogError(f"more than {MAX_CHANNELS} damaged parts", self._where, "nothing can be trusted in it")
        return after

    def _is_record(self, at: int) -> bool:
        """Whether a record may begin at byte `at`."""
        try:
            return at == len(self._data) or frame(self._data, at, self._where)[0] <= McapOpcode.DATA_END
        except LogError:
            return False

    def _next_chunk(self, at: int) -> int:
        """First byte of the next chunk whose checksum holds; the file's end if there is none."""
        for candidate in self._candidates(at):
            try:
                op, start, end = frame(self._data, candidate, self._where)
                if op == McapOpcode.CHUNK and self._chunk(start, end)[1]:
                    return candidate
            except LogError:
                if self._budget.spent:
                    raise
        return len(self._data)

    def _candidates(self, at: int) -> Iterator[int]:
        """Where a chunk may begin from byte `at` on, in order; no byte is searched twice."""
        while True:
            for codec, known in self._marks.items():
                if known < at + _BEFORE_CODEC:
                    found = self._raw.find(text(codec), at + _BEFORE_CODEC)
                    self._marks[codec] = found if found >= 0 else len(self._raw) + _BEFORE_CODEC
            first = min(self._marks.values()) - _BEFORE_CODEC
            if first >= len(self._raw):
                return
            self._budget.take(RUN_BYTES)
            yield first
            at = first + 1

    def _judge(self, at: int) -> None:
        """The end of the file: closed, and as many messages as its statistics say."""
        found, total = self.contents, self.contents.messages + sum(self.contents.ignored.values())
        if self._salvage:
            if found.finished and at < len(self._data):
                found.lost.append(Loss(at, len(self._data) - at, "bytes after the end"))
            self._doubt_schemas()
            if self._doubts and not self._sealed:
                found.unverified.append(f"no checksum vouches for {listed(self._doubts)}")
            if self._sealed is False and not found.lost and not found.unverified:
                why = "the checksum of the file is wrong: something was changed that is not used"
                found.lost.append(Loss(0, 0, why))
            return
        if not found.finished or at != len(self._data):
            what = "was not closed: the recording was cut off" if not found.finished else "goes on after its end"
            raise LogError(what, self._where, RECOVER)
        if self._stated is not None and self._stated != total:
            raise LogError(f"{total} messages of {self._stated} are there", self._where, RECOVER)

    def _doubt_schemas(self) -> None:
        """Names the schemas that are not those of their topics: they are made anew, so that nobody reads false ones."""
        for number, stream in self.contents.streams.items():
            expected = text(stream.schema) + text("ros2msg") + text(stream.definition)
            schema = self._schemas.get(self._schema_of[number])
            if schema is None or schema[1] != expected:
                self.contents.lost.append(Loss(0, 0, f"the schema of {shown(stream.topic)} is damaged, and made anew"))

    def _record(self, op: int, at: int, start: int, end: int) -> None:
        self._budget.record(2)
        inside = RecordCursor(self._data, start, end, self._where, self._budget)
        if op == McapOpcode.SCHEMA:
            self._schema(inside, start, end)
        elif op == McapOpcode.CHANNEL:
            self._channel(inside)
        elif op == McapOpcode.CHUNK:
            plain, vouched = self._chunk(start, end)
            if not vouched:
                self._doubts[f"the chunk at byte {at}"] = None
            self._messages(memoryview(plain), f"{self._where}, chunk at byte {at}")
        elif op == McapOpcode.MESSAGE:
            self._doubts["messages outside of chunks"] = None
            self._messages(self._data[at:end], self._where)
        elif op == McapOpcode.METADATA:
            self._table(inside, at, end)
        elif op == McapOpcode.ATTACHMENT:
            self._attachment(inside, start, end)
        elif op == McapOpcode.STATISTICS:
            self._stated = inside.number(_STATED_MESSAGES)
        elif op == McapOpcode.DATA_END:
            self._in_summary = True
            stated = inside.number(4)
            self._sealed = stated == zlib.crc32(self._data[:at]) if stated else None
            if self._sealed is False and not self._salvage:
                raise LogError("the checksum of the data is wrong", self._where, RECOVER)
        elif op == McapOpcode.FOOTER:
            self._footer(inside, end)
        elif self._salvage and op == McapOpcode.HEADER and at == len(MAGIC):
            inside.text()
            inside.text()
            inside.end()
        elif self._salvage and op in (McapOpcode.HEADER, McapOpcode.MESSAGE_INDEX):
            # An index is not used, but what passes for one may be something else that a changed bit hides.
            inside.number(2)
            if inside.number(4) != inside.left or inside.left % _INDEX_BYTES or op == McapOpcode.HEADER:
                raise LogError(f"the record at byte {at} is damaged", self._where)

    def _table(self, inside: RecordCursor, at: int, end: int) -> None:
        self._budget.take(RUN_BYTES)
        name, stored = inside.text(), inside.mapping()
        if self._salvage:
            inside.end()
        rows, sound = unchecked(text(name), stored)
        if sound is False:
            reason = LogError(f"the checksum of table {shown(name)} is wrong", self._where, RECOVER)
            if not self._salvage:
                raise reason
            self.contents.metadata.append((UNVERIFIED_NOTE, {"table": name[:200], **rows}))
            self.contents.lost.append(Loss(at, end - at, reason.what))
            self.contents.unverified.append(f"table {shown(name)}, which is kept as table {UNVERIFIED_NOTE!r}")
            return
        if sound is None:
            self._doubts[f"table {shown(name)}"] = None
        self.contents.metadata.append((name, rows))

    def _schema(self, inside: RecordCursor, start: int, end: int) -> None:
        number, name = inside.number(2), inside.text()
        if self._salvage:
            inside.text()
            inside.text()
            inside.end()
        if number not in self._schemas:
            self._schemas[number] = name, bytes(self._data[start + 2 : end])

    def _footer(self, inside: RecordCursor, end: int) -> None:
        summary, _, stated = inside.number(8), inside.number(8), inside.number(4)
        if bytes(self._data[end : end + len(MAGIC)]) != MAGIC:
            raise LogError("the mark at the end is missing", self._where, RECOVER)
        if stated and summary and stated != zlib.crc32(self._data[min(summary, end) : end - 4]):
            raise LogError("the checksum of the summary is wrong", self._where, RECOVER)
        self.contents.finished = True

    def _channel(self, inside: RecordCursor) -> None:
        start = inside.at
        number, schema = inside.number(2), inside.number(2)
        name, encoding = inside.text(), inside.text()
        head, stored = inside.since(start), inside.mapping()
        if self._salvage:
            inside.end()
        if number in self.contents.streams or number in self._foreign:
            return
        if len(self.contents.streams) + len(self._foreign) >= MAX_CHANNELS:
            raise LogError(f"more than {MAX_CHANNELS} channels", self._where, "this is not a flight log")
        metadata, sound = unchecked(head, stored)
        if sound is False and not self._salvage:
            raise LogError(f"the checksum of topic {shown(name)} is wrong", self._where, RECOVER)
        named = self._schemas.get(schema, ("", b""))[0]
        stream = parse(name, named, encoding, metadata, self._where, self._budget)
        if stream is None:
            self._foreign[number] = name[:200]
        elif stream.mat in {other.mat for other in self.contents.streams.values()}:
            raise LogError(f"channel {shown(stream.mat)} is there twice", self._where, "record it again")
        else:
            self.contents.streams[number] = stream
            self._schema_of[number] = schema
        if sound is False:
            why = f"the description of topic {shown(name)}, whose checksum is wrong: its name, unit and fields"
            self.contents.unverified.append(why)
        elif sound is None and stream is not None:
            self._doubts[f"the description of topic {shown(name)}"] = None

    def _attachment(self, inside: RecordCursor, start: int, end: int) -> None:
        time_ns, _ = inside.number(8), inside.number(8)
        name, media_type = inside.text(), inside.text()
        data = bytes(inside.raw(inside.number(8)))
        stated = inside.number(4)
        self._budget.take(len(data))
        if self._salvage:
            inside.end()
        if not stated:
            self._doubts[f"attachment {shown(name)}"] = None
        elif stated != zlib.crc32(self._data[start : end - 4]):
            raise LogError(f"the checksum of attachment {shown(name)} is wrong", self._where, RECOVER)
        self.contents.attachments.append(Attachment(name, media_type, data, time_ns))

    def _chunk(self, start: int, end: int) -> tuple[bytes, bool]:
        """The plain bytes of a chunk, and whether a checksum vouches for them."""
        inside = RecordCursor(self._data, start, end, self._where, self._budget)
        head = bytes(inside.raw(CHUNK_HEAD.size))
        _, _, size, crc = CHUNK_HEAD.unpack(head)
        codec = inside.text()
        packed = inside.raw(inside.number(8))
        # A size that is refused unread costs nothing, or one damaged length would end the whole recovery.
        check_size(size, self._where)
        # Damaged chunks count too, or a file of them would cost time without end.
        self._budget.take(CHUNK_BYTES + size)
        return inflate(codec, packed, size, crc, self._where), crc != 0

    def _messages(self, body: memoryview, where: str) -> None:
        at = 0
        while at < len(body):
            op, start, end = frame(body, at, where)
            number = int.from_bytes(body[start : start + 2], "little") if end - start >= 2 else -1
            stream = self.contents.streams.get(number) if op == McapOpcode.MESSAGE else None
            if stream is not None:
                if end - start != stream.content_bytes:
                    raise LogError(f"a message of {stream.topic} has {end - start} bytes", where, RECOVER)
                at += self._run(body, at, number, stream, where)
                continue
            self._budget.record()
            if op == McapOpcode.MESSAGE:
                name = self._foreign.get(number, f"channel {number}, which is not described")
                if number not in self._foreign and not self._salvage:
                    raise LogError(f"a message of {name}", where, RECOVER)
                self.contents.ignored[name] = self.contents.ignored.get(name, 0) + 1
            elif op == McapOpcode.CHANNEL:
                self._channel(RecordCursor(body, start, end, where, self._budget))
            at = end

    def _run(self, body: memoryview, at: int, number: int, stream: McapStream, where: str) -> int:
        """Reads messages of one stream that follow each other as one table; returns their bytes."""
        size, head = stream.record_bytes, body[at : at + RECORD_HEAD.size + 2]
        most = (len(body) - at) // size
        count = step = 1
        # Doubled as long as all match: the cost stays in proportion to what is found.
        while count < most and body[at + count * size :][: len(head)] == head:
            step = min(2 * step, most - count)
            rows = np.frombuffer(body, "u1", step * size, at + count * size).reshape(step, size)
            differ = np.flatnonzero((rows[:, : len(head)] != np.frombuffer(head, "u1")).any(axis=1))
            count += int(differ[0]) if differ.size else step
        self._budget.take(RUN_BYTES)
        # The table that is read, and the channel that is made of it.
        self._budget.take(8 * count * (1 + stream.width + stream.stamped))
        self._budget.samples(count, stream.width)
        rows = np.frombuffer(body, stream.row, count, at)
        if (rows["cdr"] != CDR_LITTLE_ENDIAN).any():
            raise LogError(f"a message of {stream.topic} is not little-endian CDR", where, "record it again")
        stamp = rows["stamp"].copy() if stream.stamped else None
        part = McapSamples(rows["log_time"].copy(), rows["value"].copy(), stamp)
        self.contents.samples.setdefault(number, []).append(part)
        return count * size


def scan(data: bytes, where: str, salvage: bool = False, budget: MemoryBudget | None = None) -> McapContents:
    """What an MCAP file holds. Raises LogError for what is no MCAP and, without `salvage`, for any damage."""
    return McapDecoder(data, where, salvage, budget or MemoryBudget(len(data), where)).read()
