"""Small files that ask for much: each a function that makes the bytes of one, by the name of the file."""

import io
import json
import zlib
from collections.abc import Callable, Iterable, Mapping
from struct import Struct
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from mcap.opcode import Opcode as McapOpcode

from twodof.flightlog.mcap_encoder import MAGIC, McapEncoder
from twodof.flightlog.mcap_stream import McapStream, stream_of
from twodof.flightlog.ulog_writer import HEADER, MESSAGE
from twodof.flightlog.ulog_writer import MAGIC as ULOG
from twodof.signals import BY_MAT

MIB = 1 << 20
CHUNK_HEAD = Struct("<QQQI")


def text(value: str) -> bytes:
    raw = value.encode()
    return len(raw).to_bytes(4, "little") + raw


def mapping(rows: Mapping[str, str]) -> bytes:
    raw = b"".join(text(key) + text(value) for key, value in rows.items())
    return len(raw).to_bytes(4, "little") + raw


def record(op: int, content: bytes) -> bytes:
    return Struct("<BQ").pack(op, len(content)) + content


_ZEROS = record(0x80, bytes(60 * MIB))
_MAT_HEAD = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


def _stream(name: str) -> McapStream:
    return stream_of(BY_MAT[name])


def _mcap(streams: Iterable[McapStream], middle: bytes, notes: Mapping[str, str] | None = None) -> bytes:
    """A closed file: head, what is given, an end without checksums."""
    head = McapEncoder(list(streams)).head({"twodof": dict(notes or {"provenance": "{}", "empty": "kept"})})
    footer = record(McapOpcode.FOOTER, bytes(20))
    return head + middle + record(McapOpcode.DATA_END, bytes(4)) + footer + MAGIC


def _chunk(plain: bytes, crc: int | None = None) -> bytes:
    packed = zstandard.compress(plain, 1)
    head = CHUNK_HEAD.pack(0, 1, len(plain), zlib.crc32(plain) if crc is None else crc)
    return record(McapOpcode.CHUNK, head + text("zstd") + len(packed).to_bytes(8, "little") + packed)


def _rows(stream: McapStream, count: int, number: int = 1) -> np.ndarray:
    rows = np.zeros(count, stream.row)
    rows["op"], rows["length"], rows["channel"], rows["cdr"] = McapOpcode.MESSAGE, stream.content_bytes, number, 0x0100
    rows["log_time"] = 4_000_000 * np.arange(count, dtype=np.uint64)
    return rows


_GOOD = _chunk(_rows(stream_of(BY_MAT["q"]), 5).tobytes())
"""A sound chunk of the channel q."""


def _samples(channels: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> bytes:
    """A sound file of ours without indexes: channel -> times (n,) [ns], values (n, k)."""
    streams = [_stream(name) for name in channels]
    chunks = []
    for k, (times, values) in enumerate(channels.values()):
        for at in range(0, len(times), 200_000):
            part = slice(at, at + 200_000)
            rows = _rows(streams[k], len(times[part]), k + 1)
            rows["log_time"], rows["value"] = times[part], values[part]
            chunks.append(_chunk(rows.tobytes()))
    return _mcap(streams, b"".join(chunks))


def _flight(count: int, **own: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    times = 4_000_000 * np.arange(count, dtype=np.uint64)
    values = {name: np.zeros(count) for name in ("T", "M", "q0", "theta0", "q", "theta")} | own
    return {name: (times, value if value.ndim == 2 else value[:, None]) for name, value in values.items()}


def _flips(count: int) -> np.ndarray:
    return np.arange(count) % 2 * 1.0


def mcap_chunks_of_zeros() -> bytes:
    return _mcap([_stream("q")], _chunk(_ZEROS) * 300)


def mcap_a_wide_channel() -> bytes:
    stream = McapStream("/wide", "twodof_msgs/msg/Wide", "wide", "", (), 1000)
    chunk = _chunk(_rows(stream, 7000).tobytes())
    return _mcap([stream], chunk * 60)


def mcap_provenance_of_empty_lists() -> bytes:
    note = '{"a": [' + "[]," * 4_000_000 + "[]]}"
    return _mcap([_stream("q")], _GOOD, {"provenance": note})


def mcap_provenance_that_is_deep() -> bytes:
    note = '{"a": ' + "[" * 900 + "0," * 300_000 + "0" + "]" * 900 + "}"
    return _mcap([_stream("q")], _GOOD, {"provenance": note})


def mcap_more_channels_than_any() -> bytes:
    described = {"twodof": json.dumps({"name": "c", "unit": "", "fields": [""] * 1000, "width": 1000})}
    parts = [
        record(McapOpcode.CHANNEL, Struct("<HH").pack(k, 0) + text(f"/{k}") + text("cdr") + mapping(described))
        for k in range(5000)
    ]
    return _mcap([_stream("q")], b"".join(parts))


def mcap_marks_of_chunks() -> bytes:
    whole = _mcap([_stream("q")], _GOOD)
    return whole[:-40] + b"\x06\xff" + b"\4\0\0\0zstd" * (4 * MIB) + b"\4\0\0\0lz4"


def mcap_damaged_chunks_that_inflate() -> bytes:
    return _mcap([_stream("q")], _GOOD + _chunk(_ZEROS, crc=1) * 400)


def mcap_many_damaged_parts() -> bytes:
    return _mcap([_stream("q")], (_GOOD + b"\x06" + b"\xff" * 20_000) * 900)


def mcap_gaps_everywhere() -> bytes:
    count = 300_000
    times = np.cumsum(np.where(np.arange(count) % 3, 4_000_000, 40_000_000)).astype(np.uint64)
    flight = _flight(count, T=np.ones(count), M=_flips(count))
    return _samples({name: (times, value) for name, (_, value) in flight.items()})


def mcap_thrust_that_flips() -> bytes:
    return _samples(_flight(300_000, T=_flips(300_000)))


def mcap_modes_that_flip() -> bytes:
    return _samples(_flight(300_000, T=np.ones(300_000), mode=2 + _flips(300_000)))


def mcap_open_loop_that_flips() -> bytes:
    messages = np.zeros((300_000, 5))
    messages[:, 0], messages[:, 2] = _flips(300_000), 1.0
    return _samples(_flight(300_000, T=np.ones(300_000), M=_flips(300_000), lmnf=messages))


def mcap_steps_far_apart() -> bytes:
    flight = _flight(300_000, T=np.ones(300_000), theta0=_flips(300_000), mode=np.full(300_000, 3.0))
    return _samples({name: (250 * times, value) for name, (times, value) in flight.items()})


def mcap_failsafe_that_flips() -> bytes:
    stream = McapStream("/safety", "twodof_msgs/msg/Safety", "safety", "-", ("action", "reasons", "causes"), 3)
    rows = _rows(stream, 1_000_000, 2)
    rows["value"][:, 0], rows["value"][:, 1] = 1.0 + _flips(1_000_000), np.arange(1_000_000)
    q = _rows(_stream("q"), 1_000_000).tobytes()
    return _mcap([_stream("q"), stream], _chunk(q) + _chunk(rows.tobytes()))


def mcap_a_span_of_centuries() -> bytes:
    count = 3000
    flight = _flight(count, T=np.ones(count), theta0=np.where(np.arange(count) > 1500, 0.1, 0.0))
    late = 4_000_000 * np.arange(count, dtype=np.uint64)
    late[2000:] += np.uint64(9 * 10**18)
    every = {**flight, **{name: (late, np.zeros((count, 1))) for name in ("x", "v", "x0", "v0")}}
    return _samples({name: (late, value) for name, (_, value) in every.items()})


def _element(kind: int, content: bytes) -> bytes:
    return Struct("<II").pack(kind, len(content)) + content + bytes(-len(content) % 8)


def _matrix(kind: int, dims: tuple[int, ...], name: str, rest: bytes) -> bytes:
    head = _element(6, Struct("<II").pack(kind, 0)) + _element(5, np.array(dims, "<i4").tobytes())
    return _element(14, head + _element(1, name.encode()) + rest)


def _log(note: bytes) -> bytes:
    """Return a channel of three samples, and what is given beside it."""
    names = b"timestamp".ljust(16, b"\0") + b"value".ljust(16, b"\0")
    three = _matrix(6, (3, 1), "", _element(9, np.arange(3.0).tobytes()))
    parts = Struct("<HHi").pack(5, 4, 16) + _element(1, names) + three + three
    return _mat(_matrix(2, (1, 1), "q", parts), note)


def _mat(*variables: bytes) -> bytes:
    parts = [zlib.compress(variable, 1) for variable in variables]
    return _MAT_HEAD + b"".join(Struct("<II").pack(15, len(part)) + part for part in parts)


def mat_one_variable_of_a_gigabyte() -> bytes:
    engine = zlib.compressobj(1)
    part = b"".join(engine.compress(bytes(16 * MIB)) for _ in range(64)) + engine.flush()
    return _MAT_HEAD + Struct("<II").pack(15, len(part)) + part


def mat_many_variables() -> bytes:
    part = zlib.compress(_matrix(6, (4 * MIB, 1), "a", _element(9, bytes(32 * MIB))), 1)
    return _MAT_HEAD + (Struct("<II").pack(15, len(part)) + part) * 100


def mat_provenance_of_empty_lists() -> bytes:
    content = b'{"a":[' + b"[]," * 3_000_000 + b"[]]}"
    note = _matrix(4, (1, len(content)), "provenance", _element(16, content))
    return _log(note)


def mat_provenance_of_absurd_size() -> bytes:
    note = _matrix(4, (1 << 15, 1 << 15), "provenance", _element(16, b"{}"))
    return _log(note)


def mat_small_variables() -> bytes:
    return _MAT_HEAD + _matrix(6, (1, 1), "a", b"") * 500_000


def _parquet(table: pa.Table, **options: Any) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink, **options)
    return sink.getvalue()


def parquet_a_column_of_zeros() -> bytes:
    count = 30_000_000
    return _parquet(pa.table({"time": np.zeros(count), "theta": np.zeros(count)}), compression="zstd")


def parquet_a_page_of_a_gigabyte() -> bytes:
    """Its footer says that it is small."""
    names = pa.array(["x" * (64 * MIB)] * 12)
    zeros = np.zeros(12)
    table = pa.table({"channel": names, "field": pa.array([""] * 12), "time": np.arange(12.0), "value": zeros})
    return _parquet(table, use_dictionary=False, compression="zstd", data_page_size=1 << 30)


def parquet_many_names() -> bytes:
    count = 4_000_000
    names = pa.array([f"c{k}" for k in range(1000)])
    channel = pa.DictionaryArray.from_arrays(pa.array(np.arange(count) % 1000, pa.int32()), names)
    field = pa.DictionaryArray.from_arrays(pa.array(np.zeros(count, np.int32)), [""])
    table = pa.table({"channel": channel, "field": field, "time": np.arange(count) * 1.0, "value": np.zeros(count)})
    return _parquet(table, compression="zstd")


def csv_a_heading_of_commas() -> bytes:
    return b"time" + b"," * (24 * MIB) + b"\n"


def csv_comments() -> bytes:
    return b"#\n" * (8 * MIB) + b"time,theta\n0,0\n"


def csv_metadata_of_empty_lists() -> bytes:
    note = b'{"version": 1, "channels": [' + b"[]," * 8_000_000 + b'[]], "provenance": {}}'
    return b"# twodof.flightlog " + note + b"\ntime,theta\n0,0\n"


def _message(letter: str, body: bytes) -> bytes:
    return MESSAGE.pack(len(body), ord(letter)) + body


def _ulg(*parts: bytes) -> bytes:
    return HEADER.pack(ULOG, 1, 0) + _message("B", bytes(40)) + b"".join(parts)


def _add(name: str, number: int = 0) -> bytes:
    return _message("A", Struct("<BH").pack(0, number) + name.encode())


def ulg_formats_that_nest() -> bytes:
    formats = [_message("F", f"f0:{''.join(f'uint8_t a{k};' for k in range(250))}".encode())]
    formats += [_message("F", f"f1:{''.join(f'f0 a{k};' for k in range(250))}".encode())]
    return _ulg(*formats, *(_add("f1", k) for k in range(4000)))


def ulg_a_format_that_holds_itself() -> bytes:
    formats = [_message("F", f"f{n}:{''.join(f'f{n + 1} a{k};' for k in range(9))}".encode()) for n in range(12)]
    return _ulg(*formats, *(_add("f0", k % 5000) for k in range(1_000_000)))


def ulg_topics_again_and_again() -> bytes:
    every = [_message("A", Struct("<BH").pack(k % 250, k) + b"a") for k in range(4900)]
    return _ulg(_message("F", b"a:uint8_t x;"), *every, every[-1] * 1_000_000)


def ulg_information_of_bytes() -> bytes:
    def one(k: int) -> bytes:
        key = f"uint8_t[50000] x{k}".encode()
        return _message("I", bytes([len(key)]) + key + bytes(50_000))

    added = [_message("F", b"vehicle_attitude:uint64_t timestamp;float[4] q;"), _add("vehicle_attitude")]
    return _ulg(*(one(k) for k in range(1000)), *added, _message("D", bytes(26)))


def ulg_marks() -> bytes:
    mark = _message("S", bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12)))
    return _ulg(_message("F", b"a:uint8_t x;"), _add("a"), (mark + b"\0\0\0") * 1_000_000)


def _suffix(name: str) -> str:
    return name.partition("_")[0]


BOMBS: Mapping[str, Callable[[], bytes]] = MappingProxyType(
    {
        f"{name.partition('_')[2]}.{_suffix(name)}": make
        for name, make in list(globals().items())
        if _suffix(name) in ("mcap", "mat", "parquet", "csv", "ulg") and callable(make)
    }
)
"""File name -> its bytes, less than 64 MB."""
