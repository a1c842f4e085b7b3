"""The types and messages of ULog, PX4's log format: names, sizes, descriptions of records.

Source: PX4 user guide, "ULog file format", version 1. All numbers are little-endian; a message is a length (u16), a
type (one letter) and that many bytes. A description such as `uint64_t timestamp;float[3] xyz;` names the fields of
a record, which may be records themselves; padding at the end of a record is described but not written.
"""

import re
from collections.abc import Mapping, Sequence
from struct import Struct
from types import MappingProxyType

import numpy as np

from twodof.errors import LogError, shown
from twodof.flightlog.memory_budget import MemoryBudget
from twodof.flightlog.sanitise import RECOVER

MAGIC = b"ULog\x01\x12\x35"
HEADER = Struct("<7sBQ")
MESSAGE = Struct("<HB")
SYNC = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))
LETTERS = frozenset(b"BFIMPQARDLCSO")
MAX_RECORD = 65_533
"""Longest record: a message holds 65,535 bytes, two of them its number."""
MAX_DEPTH = 8
MAX_FIELDS = 1000
MAX_FORMATS = 2000

# A bool is any byte: kept as a number, so that 2 stays 2.
BASIC: Mapping[str, str] = MappingProxyType(
    {
        "int8_t": "i1",
        "uint8_t": "u1",
        "int16_t": "<i2",
        "uint16_t": "<u2",
        "int32_t": "<i4",
        "uint32_t": "<u4",
        "int64_t": "<i8",
        "uint64_t": "<u8",
        "float": "<f4",
        "double": "<f8",
        "bool": "u1",
        "char": "S1",
    }
)
_FIELD = re.compile(r"([A-Za-z0-9_\-/]+)(?:\[(\d{1,5})\])? ([A-Za-z0-9_]+)")

ULogField = tuple[str, int, str]
"""Type, number of elements (0: not an array) and name."""


def fields_of(description: str, where: str) -> list[ULogField]:
    """The fields of a description. Raises LogError."""
    parts = [part for part in description.split(";") if part]
    if not 0 < len(parts) <= MAX_FIELDS:
        raise LogError(f"a format of {len(parts)} fields", where, f"1 to {MAX_FIELDS} are read")
    found: list[ULogField] = []
    for part in parts:
        match = _FIELD.fullmatch(part.strip())
        if match is None or match[2] == "0":
            raise LogError(f"no field of a format: {shown(part)}", where, RECOVER)
        found.append((match[1], int(match[2] or 0), match[3]))
    if len({name for _, _, name in found}) != len(found):
        raise LogError("a format names a field twice", where, RECOVER)
    return found


def record_type(
    name: str, formats: Mapping[str, Sequence[ULogField]], where: str, budget: MemoryBudget, depth: int = 0
) -> np.dtype[np.void]:
    """The layout of the records called `name`, `depth` deep in others, without padding at its end. Raises LogError."""
    fields = list(formats.get(name, ()))
    while not depth and fields and fields[-1][2].startswith("_padding"):
        fields.pop()
    budget.record(1 + len(fields))
    if not fields:
        raise LogError(f"no format {shown(name)}", where, RECOVER)
    if depth > MAX_DEPTH:
        raise LogError(f"format {shown(name)} is nested more than {MAX_DEPTH} deep", where, "it holds itself")
    parts: list[tuple[str, np.dtype[np.generic], tuple[int, ...]]] = []
    size = 0
    for kind, count, field in fields:
        known = kind in BASIC
        one = np.dtype(BASIC[kind]) if known else record_type(kind, formats, where, budget, depth + 1)
        if kind == "char" and count:
            one, count = np.dtype(f"S{count}"), 0
        size += one.itemsize * max(count, 1)
        if size > MAX_RECORD:
            raise LogError(f"a record of {shown(name)} has {size} bytes", where, f"at most {MAX_RECORD} are possible")
        parts.append((field, one, (count,) if count else ()))
    return np.dtype(parts)
