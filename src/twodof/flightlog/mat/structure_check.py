"""The structure of a MATLAB v5 file, walked and bounded before scipy.io reads it.

scipy.io alone is not safe: one of our hostile files ends the process by a segmentation fault, another takes 10 s. It
could run in a process of its own, but to start that takes .5 s of CPU time, where a flight of 83 s is read in .05 s.

Source: MathWorks, "MAT-File Format", level 5. Every element's promised length is compared with what is
there. So a truncated, foreign or hostile file is named as such and cannot ask for absurd amounts of memory.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from struct import Struct

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
_ITEM_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8}


@dataclass(frozen=True)
class Variable:
    """One variable of a file: `fields` has the dimensions of each field of a 1 x 1 struct of real numbers.

    `text` says that it is one line of text, of `letters` letters.
    """

    name: str
    text: bool
    fields: dict[str, tuple[int, ...]] | None
    letters: int = 0

    @property
    def numbers(self) -> int:
        """Numbers in all fields."""
        return sum(prod(dims) for dims in (self.fields or {}).values())


def variables(data: bytes, where: str, budget: MemoryBudget) -> list[Variable]:
    """What a MATLAB v5 file holds. Raises LogError, with the byte, for a file that is truncated or foreign."""
    order = _byte_order(data, where)
    found: list[Variable] = []
    for kind, start, end in _elements(data, HEADER_BYTES, order, where, budget):
        place = f"{where}, byte {start}"
        body = memoryview(data)[start:end]
        if kind == _COMPRESSED:
            body = memoryview(_inflate(body, budget, place))
            inner = list(_elements(body, 0, order, place, budget))
            if [element[0] for element in inner] != [_MATRIX]:
                raise LogError("a compressed element holds no single variable", place, "export it again")
            body = body[inner[0][1] : inner[0][2]]
        elif kind != _MATRIX:
            raise LogError(f"unknown element of type {kind}", place, "export it again as a MATLAB v7 file")
        found.append(_variable(body, order, place, budget))
        if len(found) > MAX_VARIABLES:
            raise LogError(f"more than {MAX_VARIABLES} variables", where, "this is not a flight log")
    names = [variable.name for variable in found]
    for name in names:
        if names.count(name) > 1:
            raise LogError(f"variable {name!r} is there twice", where, "export it again")
    return found


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


def _elements(
    data: bytes | memoryview, at: int, order: str, where: str, budget: MemoryBudget
) -> Iterator[tuple[int, int, int]]:
    """Type, first byte and end of each data element from byte `at` on."""
    word = Struct(order + "I")
    while at < len(data):
        budget.record()
        if len(data) - at < 8:
            raise LogError(f"truncated in the tag at byte {at}", where, "record or download it again")
        kind = word.unpack_from(data, at)[0]
        if kind >> 16:  # a small element keeps its length in the type's upper half, its data in the tag
            kind, size, start, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if size > 4:
                raise LogError(f"a small element at byte {at} promises {size} bytes", where, "export it again")
        else:
            size, start = word.unpack_from(data, at + 4)[0], at + 8
            after = start + size if kind == _COMPRESSED else start + (size + 7) // 8 * 8
        if start + size > len(data):
            raise LogError(
                f"truncated: the element at byte {at} promises {size} bytes, {len(data) - start} are there",
                where,
                "record or download it again",
            )
        yield kind, start, start + size
        at = after


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


def _variable(body: memoryview, order: str, where: str, budget: MemoryBudget) -> Variable:
    flags, dims, name, rest = _array(body, order, where, budget)
    if flags & 0xFF == _CHAR and len(dims) == 2 and len(rest) == 1:
        line = dims[0] == 1 and dims[1] <= rest[0][2] - rest[0][1]
        return Variable(name, text=line, fields=None, letters=dims[1] if line else 0)
    if flags & 0xFF != _STRUCT or dims != (1, 1) or len(rest) < 2:
        return Variable(name, text=False, fields=None)
    where = f"{where}: {name}"
    (_, a, b), (_, c, d), *members = rest
    width = Struct(order + "i").unpack_from(body, a)[0] if b - a == 4 else 0
    names = bytes(body[c:d])
    if not 0 < width <= 64 or len(names) != width * len(members) or len(members) > MAX_FIELDS:
        raise LogError("the struct's field names do not match its fields", where, "export it again")
    fields: dict[str, tuple[int, ...]] = {}
    for k, (kind, start, end) in enumerate(members):
        field = names[k * width : (k + 1) * width].split(b"\0", 1)[0].decode("latin-1")
        if kind != _MATRIX:
            raise LogError(f"field {field!r} is not an array", where, "export it again")
        if start == end:
            return Variable(name, text=False, fields=None)
        field_flags, field_dims, _, parts = _array(body[start:end], order, f"{where}.{field}", budget)
        if field_flags & 0xFF not in _NUMERIC or field_flags & _COMPLEX_FLAG or len(field_dims) != 2:
            return Variable(name, text=False, fields=None)
        _check_numbers(field_dims, parts, f"{where}.{field}")
        fields[field] = field_dims
    return Variable(name, text=False, fields=fields)


def _array(
    body: memoryview, order: str, where: str, budget: MemoryBudget
) -> tuple[int, tuple[int, ...], str, list[tuple[int, int, int]]]:
    """Flags, dimensions, name and further elements of a matrix."""
    parts = list(_elements(body, 0, order, where, budget))
    kinds = [kind for kind, _, _ in parts[:3]]
    if kinds != [_UINT32, _INT32, _INT8] or parts[0][2] - parts[0][1] != 8:
        raise LogError("an array lacks its flags, dimensions or name", where, "export it again")
    (_, a, _), (_, b, c), (_, d, e), *rest = parts
    flags = Struct(order + "I").unpack_from(body, a)[0]
    dims = tuple(size for (size,) in Struct(order + "i").iter_unpack(body[b : c - (c - b) % 4]))
    if any(size < 0 for size in dims):
        raise LogError(f"an array has dimensions {dims}", where, "export it again")
    return flags, dims, bytes(body[d:e]).decode("latin-1"), rest


def _check_numbers(dims: tuple[int, ...], parts: list[tuple[int, int, int]], where: str) -> None:
    """One element of real numbers, exactly as many as the dimensions say."""
    if prod(dims) == 0 and not parts:
        return
    kind, start, end = parts[0] if len(parts) == 1 else (0, 0, 0)
    item = _ITEM_BYTES.get(kind)
    if item is None:
        raise LogError("an array holds no numbers", where, "export it again")
    if end - start != prod(dims) * item:
        raise LogError(
            f"dimensions {dims} promise {prod(dims)} numbers, there are {(end - start) / item:g}",
            where,
            "record or download it again",
        )
