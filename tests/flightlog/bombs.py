"""Small files that ask for much: each a function that makes the bytes of one, by the name of the file."""

import io
import json
import zlib
from collections.abc import Callable, Iterable, Mapping
from struct import Struct
from types import MappingProxyType
from typing import Any

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from mcap.opcode import Opcode as McapOpcode
from scipy.io import savemat

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


def deflate(codec: str, plain: bytes) -> bytes:
    if codec == "lz4":
        return lz4.frame.compress(plain)
    return zstandard.compress(plain, 1) if codec else plain


_ZEROS = record(0x80, bytes(60 * MIB))
_MAT_HEAD = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


def _stream(name: str) -> McapStream:
    return stream_of(BY_MAT[name])


def _mcap(streams: Iterable[McapStream], middle: bytes, notes: Mapping[str, str] | None = None) -> bytes:
    """A closed file: head, what is given, an end without checksums."""
    head = McapEncoder(list(streams)).head({"twodof": dict(notes or {"provenance": "{}", "empty": "kept"})})
    footer = record(McapOpcode.FOOTER, bytes(20))
    return head + middle + record(McapOpcode.DATA_END, bytes(4)) + footer + MAGIC


def _chunk(plain: bytes, codec: str = "zstd", crc: int | None = None, size: int | None = None) -> bytes:
    packed = deflate(codec, plain)
    stated = zlib.crc32(plain) if crc is None else crc
    head = CHUNK_HEAD.pack(0, 1, len(plain) if size is None else size, stated)
    return record(McapOpcode.CHUNK, head + text(codec) + len(packed).to_bytes(8, "little") + packed)


def _rows(stream: McapStream, count: int, number: int = 1, start: int = 0, step: int = 4_000_000) -> np.ndarray:
    rows = np.zeros(count, stream.row)
    rows["op"], rows["length"], rows["channel"], rows["cdr"] = McapOpcode.MESSAGE, stream.content_bytes, number, 0x0100
    rows["log_time"] = start + step * np.arange(count, dtype=np.uint64)
    return rows


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


def mcap_foreign_messages() -> bytes:
    foreign = record(McapOpcode.CHANNEL, Struct("<HH").pack(9, 0) + text("/other") + text("cdr") + mapping({}))
    one = record(McapOpcode.MESSAGE, Struct("<HIQQ").pack(9, 0, 0, 0))
    return _mcap([_stream("q")], foreign + _chunk(one * (32 * MIB // len(one))) * 40)


def mcap_messages_that_alternate() -> bytes:
    a, b = (_rows(_stream(name), 1, k + 1).tobytes() for k, name in enumerate(("q", "theta")))
    return _mcap([_stream("q"), _stream("theta")], _chunk((a + b) * (40 * MIB // len(a + b))) * 20)


def mcap_one_scalar() -> bytes:
    count, stream = 1_000_000, _stream("q")
    chunks = [_chunk(_rows(stream, count, 1, 4_000_000 * count * k).tobytes()) for k in range(20)]
    return _mcap([stream], b"".join(chunks))


def mcap_a_wide_channel() -> bytes:
    stream = McapStream("/wide", "twodof_msgs/msg/Wide", "wide", "", (), 1000)
    chunk = _chunk(_rows(stream, 7000).tobytes())
    return _mcap([stream], chunk * 60)


def mcap_the_same_samples_again() -> bytes:
    return _mcap([_stream("acc")], _chunk(_rows(_stream("acc"), 800_000).tobytes()) * 24)


def mcap_many_small_chunks() -> bytes:
    return _mcap([_stream("q")], _chunk(_rows(_stream("q"), 1).tobytes()) * 200_000)


def mcap_empty_chunks() -> bytes:
    return _mcap([_stream("q")], _chunk(b"", "") * 500_000)


def mcap_empty_records() -> bytes:
    return _mcap([_stream("q")], record(McapOpcode.MESSAGE_INDEX, b"") * 5_000_000)


def mcap_table_of_small_texts() -> bytes:
    rows = {f"{k:x}": "" for k in range(600_000)}
    return _mcap([_stream("q")], record(McapOpcode.METADATA, text("m") + mapping(rows)) * 3)


def mcap_many_tables() -> bytes:
    return _mcap([_stream("q")], record(McapOpcode.METADATA, text("") + mapping({})) * 1_000_000)


def mcap_provenance_of_empty_lists() -> bytes:
    note = '{"a": [' + "[]," * 4_000_000 + "[]]}"
    return _mcap([_stream("q")], _chunk(_rows(_stream("q"), 5).tobytes()), {"provenance": note})


def mcap_provenance_that_is_deep() -> bytes:
    note = '{"a": ' + "[" * 900 + "0," * 300_000 + "0" + "]" * 900 + "}"
    return _mcap([_stream("q")], _chunk(_rows(_stream("q"), 5).tobytes()), {"provenance": note})


def mcap_many_channels() -> bytes:
    streams = [McapStream(f"/c{k}", "twodof_msgs/msg/C", f"c{k}" + "x" * 900, "", (), 1) for k in range(1000)]
    rows = b"".join(_rows(stream, 600, k + 1).tobytes() for k, stream in enumerate(streams))
    return _mcap(streams, _chunk(rows) * 3)


def mcap_more_channels_than_any() -> bytes:
    described = {"twodof": json.dumps({"name": "c", "unit": "", "fields": [""] * 1000, "width": 1000})}
    parts = [
        record(McapOpcode.CHANNEL, Struct("<HH").pack(k, 0) + text(f"/{k}") + text("cdr") + mapping(described))
        for k in range(5000)
    ]
    return _mcap([_stream("q")], b"".join(parts))


def mcap_marks_of_chunks() -> bytes:
    whole = _mcap([_stream("q")], _chunk(_rows(_stream("q"), 5).tobytes()))
    return whole[:-40] + b"\x06\xff" + b"\4\0\0\0zstd" * (4 * MIB) + b"\4\0\0\0lz4"


def mcap_damaged_chunks_that_inflate() -> bytes:
    good = _chunk(_rows(_stream("q"), 5).tobytes())
    return _mcap([_stream("q")], good + _chunk(_ZEROS, crc=1) * 400)


def mcap_many_damaged_parts() -> bytes:
    good = _chunk(_rows(_stream("q"), 5).tobytes())
    return _mcap([_stream("q")], (good + b"\x06" + b"\xff" * 20_000) * 900)


def mcap_lz4() -> bytes:
    return _mcap([_stream("q")], _chunk(_ZEROS, "lz4") * 60)


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


def _numbers(count: int, kind: int = 9, klass: int = 6) -> bytes:
    width = {9: 8, 2: 1}[kind]
    return _matrix(klass, (count, 1), "", _element(kind, bytes(width * count)))


def _struct(name: str, stamps: bytes, value: bytes, klass: int = 2) -> bytes:
    names = b"timestamp".ljust(16, b"\0") + b"value".ljust(16, b"\0")
    width = Struct("<HHi").pack(5, 4, 16)
    return _matrix(klass, (1, 1), name, width + _element(1, names) + stamps + value)


def _mat(*variables: bytes) -> bytes:
    parts = [zlib.compress(variable, 1) for variable in variables]
    return _MAT_HEAD + b"".join(Struct("<II").pack(15, len(part)) + part for part in parts)


def mat_one_variable_of_a_gigabyte() -> bytes:
    engine = zlib.compressobj(1)
    part = b"".join(engine.compress(bytes(16 * MIB)) for _ in range(64)) + engine.flush()
    return _MAT_HEAD + Struct("<II").pack(15, len(part)) + part


def mat_a_channel_of_zeros() -> bytes:
    return _mat(_struct("q", _numbers(24 * MIB), _numbers(24 * MIB)))


def mat_bytes_that_become_doubles() -> bytes:
    count = 90 * MIB
    return _mat(_struct("q", _numbers(count, 2), _numbers(count, 2)))


def mat_many_variables() -> bytes:
    part = zlib.compress(_matrix(6, (4 * MIB, 1), "a", _element(9, bytes(32 * MIB))), 1)
    return _MAT_HEAD + (Struct("<II").pack(15, len(part)) + part) * 100


def mat_a_long_provenance() -> bytes:
    note = _matrix(4, (1, 100 * MIB), "provenance", _element(16, b"[" * (100 * MIB)))
    return _mat(_struct("q", _numbers(3), _numbers(3)), note)


def mat_provenance_of_empty_lists() -> bytes:
    content = b'{"a":[' + b"[]," * 3_000_000 + b"[]]}"
    note = _matrix(4, (1, len(content)), "provenance", _element(16, content))
    stamps = _matrix(6, (3, 1), "", _element(9, np.arange(3.0).tobytes()))
    return _mat(_struct("q", stamps, _numbers(3)), note)


def mat_provenance_of_absurd_size() -> bytes:
    note = _matrix(4, (1 << 15, 1 << 15), "provenance", _element(16, b"{}"))
    stamps = _matrix(6, (3, 1), "", _element(9, np.arange(3.0).tobytes()))
    return _mat(_struct("q", stamps, _numbers(3)), note)


def mat_small_elements() -> bytes:
    return _mat(_matrix(2, (1, 1), "q", Struct("<HHI").pack(1, 1, 0) * (12 * MIB)))


def mat_small_variables() -> bytes:
    return _MAT_HEAD + _matrix(6, (1, 1), "a", b"") * 500_000


def _parquet(table: pa.Table, **options: Any) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink, **options)
    return sink.getvalue()


def _tidy(names: Any, count: int, fields: Any = None) -> pa.Table:
    fields = pa.array(np.zeros(count, np.int32)) if fields is None else fields
    return pa.table(
        {
            "channel": pa.DictionaryArray.from_arrays(pa.array(np.arange(count) % len(names), pa.int32()), names),
            "field": pa.DictionaryArray.from_arrays(fields, [""]),
            "time": np.arange(count) * 1.0,
            "value": np.zeros(count),
        }
    )


def parquet_a_column_of_zeros() -> bytes:
    count = 30_000_000
    return _parquet(pa.table({"time": np.zeros(count), "theta": np.zeros(count)}), compression="zstd")


def parquet_many_columns() -> bytes:
    count = 90_000
    columns = {f"c{k}": np.zeros(count) for k in range(900)}
    return _parquet(pa.table({"time": np.arange(count) * 1.0, **columns}), compression="zstd")


def parquet_a_long_name() -> bytes:
    return _parquet(_tidy(pa.array(["x" * (8 * MIB)]), 2_000_000), compression="zstd", store_schema=False)


def parquet_long_names_one_by_one() -> bytes:
    names = ["x" * 200_000] * 4000
    table = pa.table({"channel": names, "field": [""] * 4000, "time": np.arange(4000.0), "value": np.zeros(4000)})
    return _parquet(table, compression="zstd", use_dictionary=False)


def parquet_names_that_share_their_beginning() -> bytes:
    names = pa.array(["x" * 100_000] * 6000)
    zeros = np.zeros(6000)
    table = pa.table({"channel": names, "field": pa.array([""] * 6000), "time": np.arange(6000.0), "value": zeros})
    return _parquet(table, use_dictionary=False, column_encoding={"channel": "DELTA_BYTE_ARRAY"}, compression="none")


def parquet_lists() -> bytes:
    values = pa.ListArray.from_arrays(pa.array([0, 30_000_000], pa.int32()), np.zeros(30_000_000))
    return _parquet(pa.table({"time": [0.0], "theta": values}), compression="zstd")


def parquet_metadata_of_empty_lists() -> bytes:
    note = '{"version": 1, "channels": [' + "[]," * 3_000_000 + '[]], "provenance": {}}'
    table = pa.table({"time": [0.0], "theta": [0.0]}).replace_schema_metadata({"twodof.flightlog": note})
    return _parquet(table, compression="zstd")


def parquet_many_row_groups() -> bytes:
    table = pa.table({"time": np.arange(20_000.0), "theta": np.zeros(20_000)})
    return _parquet(table, row_group_size=1, write_statistics=False, compression="none")


def parquet_a_page_of_a_gigabyte() -> bytes:
    """Its footer says that it is small."""
    names = pa.array(["x" * (64 * MIB)] * 12)
    zeros = np.zeros(12)
    table = pa.table({"channel": names, "field": pa.array([""] * 12), "time": np.arange(12.0), "value": zeros})
    return _parquet(table, use_dictionary=False, compression="zstd", data_page_size=1 << 30)


def parquet_many_names() -> bytes:
    names = pa.array([f"c{k}" for k in range(1000)])
    return _parquet(_tidy(names, 4_000_000), compression="zstd")


def csv_a_heading_of_commas() -> bytes:
    return b"time" + b"," * (24 * MIB) + b"\n"


def csv_comments() -> bytes:
    return b"#\n" * (8 * MIB) + b"time,theta\n0,0\n"


def csv_rows_that_end_otherwise() -> bytes:
    return b"time,theta\n" + b"0,0\r" * (10 * MIB)


def csv_empty_cells() -> bytes:
    heading = ",".join(["time", *(f"c{k}" for k in range(999))]).encode()
    return heading + b"\n" + b"".join(b"%d" % k + b"," * 999 + b"\n" for k in range(50_000))


def csv_short_rows() -> bytes:
    return b"time,theta\n" + b"".join(b"%d,1\n" % k for k in range(4_000_000))


def csv_a_long_name() -> bytes:
    return b"time," + b"x" * (40 * MIB) + b"\n0,0\n"


def csv_many_names() -> bytes:
    rows = b"".join(b"c%d,,%d,0\n" % (k % 1000, k) for k in range(2_000_000))
    return b"channel,field,time,value\n" + rows


def csv_metadata_of_empty_lists() -> bytes:
    note = b'{"version": 1, "channels": [' + b"[]," * 8_000_000 + b'[]], "provenance": {}}'
    return b"# twodof.flightlog " + note + b"\ntime,theta\n0,0\n"


def csv_one_cell() -> bytes:
    return b"time,theta\n0," + b"0" * (60 * MIB) + b"\n"


def _message(letter: str, body: bytes) -> bytes:
    return MESSAGE.pack(len(body), ord(letter)) + body


def _ulg(*parts: bytes) -> bytes:
    return HEADER.pack(ULOG, 1, 0) + _message("B", bytes(40)) + b"".join(parts)


def _add(name: str, number: int = 0) -> bytes:
    return _message("A", Struct("<BH").pack(0, number) + name.encode())


def ulg_records_of_a_byte() -> bytes:
    return _ulg(_message("F", b"a:uint8_t x;"), _add("a"), _message("D", bytes(3)) * (8 * MIB))


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


def ulg_fields_of_a_byte() -> bytes:
    names = "".join(f"uint8_t out_{k};" for k in range(990))
    formats = [_message("F", f"twodof_{k}:uint64_t timestamp;{names}".encode()) for k in range(5)]
    added = [_add(f"twodof_{k}", k) for k in range(5)]
    rows = b"".join(
        _message("D", k.to_bytes(2, "little") + (t + 1).to_bytes(8, "little") + bytes(990))
        for t in range(12_000)
        for k in range(5)
    )
    return _ulg(*formats, *added, rows)


def ulg_information_of_bytes() -> bytes:
    def one(k: int) -> bytes:
        key = f"uint8_t[50000] x{k}".encode()
        return _message("I", bytes([len(key)]) + key + bytes(50_000))

    added = [_message("F", b"vehicle_attitude:uint64_t timestamp;float[4] q;"), _add("vehicle_attitude")]
    return _ulg(*(one(k) for k in range(1000)), *added, _message("D", bytes(26)))


def ulg_many_small_informations() -> bytes:
    keys = [f"bool x{k}".encode() for k in range(1_000_000)]
    return _ulg(*(_message("I", bytes([len(key)]) + key + b"\0") for key in keys))


def ulg_formats_again_and_again() -> bytes:
    one = _message("F", b"a:" + b"".join(b"bool a%d;" % k for k in range(990)))
    return _ulg(one * 3000)


def ulg_texts_and_dropouts() -> bytes:
    return _ulg(_message("L", bytes(9)) * 300_000, _message("O", bytes(2)) * 2_000_000)


def ulg_marks() -> bytes:
    mark = _message("S", bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12)))
    return _ulg(_message("F", b"a:uint8_t x;"), _add("a"), (mark + b"\0\0\0") * 1_000_000)


def _savemat() -> bytes:
    sink = io.BytesIO()
    count = 2 * MIB
    noise = np.random.default_rng(1).standard_normal((count, 1))
    savemat(sink, {"q": {"timestamp": np.arange(count)[:, None] * 0.004, "value": noise}}, do_compression=True)
    return sink.getvalue()


def mat_a_long_flight() -> bytes:
    """Not hostile: two hours of noise."""
    return _savemat()


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
