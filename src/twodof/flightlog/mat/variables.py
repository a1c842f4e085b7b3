"""The variables of a MATLAB v5 file: structs of real numbers and lines of text, bounded before they are made.

scipy.io is not safe: one of our hostile files ends the process by a segmentation fault, another takes 10 s. A check
before it would walk the same structure. A process of its own takes .5 s of CPU time, where a flight is read in .05 s.

Source: MathWorks, "MAT-File Format", level 5. Every element's promised length is compared with what is
there. So a truncated, foreign or hostile file is named as such and cannot ask for absurd amounts of memory.
"""

import zlib
from collections.abc import Iterator
from math import prod
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twodof.errors import LogError
from twodof.flightlog.memory_budget import MemoryBudget

HEADER_BYTES = 128
MAX_VARIABLES = 1000
MAX_FIELDS = 100

_MATRIX, _COMPRESSED = 14, 15
_INT8, _INT32, _UINT32 = 1, 5, 6
_STRUCT, _CHAR = 2, 4
# double, single, int8, uint8, int16, uint16, int32, uint32: all exact in float64
_NUMERIC = frozenset({6, 7, 8, 9, 10, 11, 12, 13})
_COMPLEX_FLAG = 0x0800
_PART_BYTES = 1 << 20
# What an array's element holds: numbers as numpy calls them, letters as Python does.
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_LETTERS = {2: "latin-1", 4: "utf-16{}", 16: "utf-8", 17: "utf-16{}", 18: "utf-32{}"}


class Variable(NamedTuple):
    """One variable: `text` of one line, `fields` (rows, columns) of a 1 x 1 struct of real numbers, or neither."""

    name: str
    text: str | None = None
    fields: dict[str, NDArray[np.float64]] | None = None


def variables(data: bytes, where: str, budget: MemoryBudget) -> list[Variable]:
    """What a MATLAB v5 file holds. Raises LogError, with the byte, for a file that is truncated or foreign."""
    reader = _Reader(_byte_order(data, where), budget)
    found: dict[str, Variable] = {}
    for kind, start, body in reader.elements(memoryview(data)[HEADER_BYTES:], where, HEADER_BYTES):
        place = f"{where}, byte {start}"
        if kind == _COMPRESSED:
            inner = list(reader.elements(memoryview(_inflate(body, budget, place)), place))
            if [element[0] for element in inner] != [_MATRIX]:
                raise LogError("a compressed element holds no single variable", place, "export it again")
            body = inner[0][2]
        elif kind != _MATRIX:
            raise LogError(f"unknown element of type {kind}", place, "export it again as a MATLAB v7 file")
        variable = reader.variable(body, place)
        if variable.name in found:
            raise LogError(f"variable {variable.name!r} is there twice", where, "export it again")
        found[variable.name] = variable
        if len(found) > MAX_VARIABLES:
            raise LogError(f"more than {MAX_VARIABLES} variables", where, "this is not a flight log")
    return list(found.values())


def _byte_order(data: bytes, where: str) -> str:
    if data[:10] == b"MATLAB 7.3" or data[:4] == b"\x89HDF":
        raise LogError("is a MATLAB v7.3 (HDF5) file", where, "save it in MATLAB with save(..., '-v7')")
    mark = data[126:128]
    if len(data) < HEADER_BYTES or mark not in (b"IM", b"MI"):
        raise LogError("is not a MATLAB v5 file", where, "give a .mat log of the drone")
    order = "<" if mark == b"IM" else ">"
    version = Struct(order + "H").unpack_from(data, 124)[0]
    if version != 0x0100:
        raise LogError(f"is of unknown MAT-file version {version:#06x}", where, "save it with '-v7'")
    return order


def _inflate(body: memoryview, budget: MemoryBudget, where: str) -> bytes:
    engine = zlib.decompressobj()
    parts: list[bytes] = []
    rest: bytes | memoryview = body
    try:
        while rest and not engine.eof:
            # Twice: the parts, and the whole that they become.
            budget.take(2 * _PART_BYTES)
            parts.append(engine.decompress(rest, _PART_BYTES))
            rest = engine.unconsumed_tail
    except zlib.error as reason:
        raise LogError(f"a compressed variable is damaged: {reason}", where, "download it again") from reason
    if not engine.eof:
        raise LogError("a compressed variable is truncated", where, "record or download it again")
    return b"".join(parts)


class _Reader:
    """Reads elements of one byte order, "<" or ">"."""

    def __init__(self, order: str, budget: MemoryBudget) -> None:
        self._order, self._budget = order, budget
        self._word = Struct(order + "I")

    def elements(self, data: memoryview, where: str, first: int = 0) -> Iterator[tuple[int, int, memoryview]]:
        """Type, first byte and content of each data element; `data` begins at byte `first` of what is read."""
        at = 0
        while at < len(data):
            self._budget.record()
            if len(data) - at < 8:
                raise LogError(f"truncated in the tag at byte {first + at}", where, "record or download it again")
            kind = self._word.unpack_from(data, at)[0]
            if kind >> 16:  # a small element keeps its length in the type's upper half, its data in the tag
                kind, size, start, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
                if size > 4:
                    what = f"a small element at byte {first + at} promises {size} bytes"
                    raise LogError(what, where, "export it again")
            else:
                size, start = self._word.unpack_from(data, at + 4)[0], at + 8
                after = start + size if kind == _COMPRESSED else start + (size + 7) // 8 * 8
            there = len(data) - start
            if size > there:
                what = f"truncated: the element at byte {first + at} promises {size} bytes, {there} are there"
                raise LogError(what, where, "record or download it again")
            yield kind, first + start, data[start : start + size]
            at = after

    def variable(self, body: memoryview, where: str) -> Variable:
        """The variable that a matrix is."""
        flags, dims, name, rest = self._array(body, where)
        if flags & 0xFF == _CHAR and len(dims) == 2 and dims[0] == 1 and len(rest) == 1 and rest[0][0] in _LETTERS:
            (kind, _, letters), ends = rest[0], {"<": "-le", ">": "-be"}[self._order]
            self._budget.text(len(letters))
            return Variable(name, text=str(letters, _LETTERS[kind].format(ends), "replace"))
        if flags & 0xFF != _STRUCT or dims != (1, 1) or len(rest) < 2:
            return Variable(name)
        where = f"{where}: {name}"
        (_, _, stated), (_, _, names), *members = rest
        width = Struct(self._order + "i").unpack(stated)[0] if len(stated) == 4 else 0
        if not 0 < width <= 64 or len(names) != width * len(members) or len(members) > MAX_FIELDS:
            raise LogError("the struct's field names do not match its fields", where, "export it again")
        fields: dict[str, NDArray[np.float64]] = {}
        for k, (kind, _, member) in enumerate(members):
            field = bytes(names[k * width : (k + 1) * width]).split(b"\0", 1)[0].decode("latin-1")
            if kind != _MATRIX:
                raise LogError(f"field {field!r} is not an array", where, "export it again")
            if not member:
                return Variable(name)
            flags, dims, _, parts = self._array(member, f"{where}.{field}")
            if flags & 0xFF not in _NUMERIC or flags & _COMPLEX_FLAG or len(dims) != 2:
                return Variable(name)
            fields[field] = self._numbers(dims, parts, f"{where}.{field}")
        return Variable(name, fields=fields)

    def _array(
        self, body: memoryview, where: str
    ) -> tuple[int, tuple[int, ...], str, list[tuple[int, int, memoryview]]]:
        """Flags, dimensions, name and further elements of a matrix."""
        parts = list(self.elements(body, where))
        if [kind for kind, _, _ in parts[:3]] != [_UINT32, _INT32, _INT8] or len(parts[0][2]) != 8:
            raise LogError("an array lacks its flags, dimensions or name", where, "export it again")
        (_, _, flags), (_, _, sizes), (_, _, name), *rest = parts
        dims = tuple(np.frombuffer(sizes[: len(sizes) // 4 * 4], self._order + "i4").tolist())
        if any(size < 0 for size in dims):
            raise LogError(f"an array has dimensions {dims}", where, "export it again")
        return self._word.unpack_from(flags)[0], dims, str(name, "latin-1"), rest

    def _numbers(
        self, dims: tuple[int, ...], parts: list[tuple[int, int, memoryview]], where: str
    ) -> NDArray[np.float64]:
        """The numbers of an array: one element, exactly as many as the dimensions say."""
        if prod(dims) == 0 and not parts:
            return np.empty(dims)
        kind, _, content = parts[0] if len(parts) == 1 else (0, 0, memoryview(b""))
        if kind not in _NUMBERS:
            raise LogError("an array holds no numbers", where, "export it again")
        item = np.dtype(self._order + _NUMBERS[kind])
        if len(content) != prod(dims) * item.itemsize:
            what = f"dimensions {dims} promise {prod(dims)} numbers, there are {len(content) / item.itemsize:g}"
            raise LogError(what, where, "record or download it again")
        # A float64 of each number, before it becomes samples.
        self._budget.take(8 * prod(dims))
        self._budget.samples(prod(dims), 0)
        return np.frombuffer(content, item).astype(np.float64).reshape(dims, order="F")
