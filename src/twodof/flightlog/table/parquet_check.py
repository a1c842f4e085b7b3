"""The pages of a Parquet file, walked before they are decoded: what a footer says of their size may be untrue.

pyarrow alone takes 3.3 GiB for a hostile file of 30 kB. It could run in a process of its own, but to start that takes
.24 s of CPU time, where a flight of 83 s is read in .03 s.

Source: Apache Parquet format, `parquet.thrift` (PageHeader), in Thrift's compact protocol. Every page says how large
it becomes; what of a text is repeated without being stored (DELTA_BYTE_ARRAY) is refused.
"""

from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from twodof.errors import LogError
from twodof.flightlog.memory_budget import MemoryBudget

MAX_ROW_GROUPS = 10_000
_REMEDY = "write it again"
_PLAIN, _DELTA_BYTE_ARRAY = 0, 7
# Fields of PageHeader, and the field `encoding` in the heads of its kinds: data, dictionary, data of version 2.
_INFLATED, _PACKED = 2, 3
_ENCODINGS = ((5, 2), (7, 2), (8, 4))
# Kinds of values; those of a fixed size with it: true and false have none, but in a list.
_STOP, _INTEGERS, _BINARY, _LISTS, _STRUCT = 0, (4, 5, 6), 8, (9, 10), 12
_TRUE, _FALSE = 1, 2
_FIXED = {_TRUE: 0, _FALSE: 0, 3: 1, 7: 8}
_MAX_DEPTH = 8


def check_pages(file: pq.ParquetFile, data: bytes, where: str, budget: MemoryBudget) -> None:
    """Charges what the pages of a file become. Raises LogError for what is not a table of plain columns."""
    for column in file.schema_arrow:
        kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
        text = pa.types.is_string(kind) or pa.types.is_large_string(kind)
        if not (text or pa.types.is_integer(kind) or pa.types.is_floating(kind) or kind in (pa.bool_(), pa.null())):
            raise LogError(f"column {column.name[:80]!r} is of {str(kind)[:80]}", where, "write numbers and names only")
    found = file.metadata
    if found.num_row_groups > MAX_ROW_GROUPS:
        raise LogError(f"{found.num_row_groups} groups of rows", where, f"at most {MAX_ROW_GROUPS} are read")
    for group in range(found.num_row_groups):
        rows = found.row_group(group)
        for k in range(rows.num_columns):
            column = rows.column(k)
            budget.record(4)
            start = column.data_page_offset
            if column.has_dictionary_page and 0 < column.dictionary_page_offset < start:
                start = column.dictionary_page_offset
            end = start + column.total_compressed_size
            if not 0 < start <= end <= len(data):
                raise LogError(f"a column stands from byte {start} to {end} of {len(data)}", where, _REMEDY)
            _check_column(data, start, end, where, budget)


def _check_column(data: bytes, at: int, end: int, where: str, budget: MemoryBudget) -> None:
    while at < end:
        budget.record(8)
        head = _Compact(data, at, end, where)
        page = head.struct(_MAX_DEPTH)
        inflated, packed = page.get(_INFLATED), page.get(_PACKED)
        if not isinstance(inflated, int) or not isinstance(packed, int) or inflated < 0 or packed < 0:
            raise LogError(f"the page at byte {at} has no size", where, _REMEDY)
        for kind, field in _ENCODINGS:
            if isinstance(page.get(kind), dict) and page[kind].get(field, _PLAIN) == _DELTA_BYTE_ARRAY:
                raise LogError(f"the page at byte {at} is of encoding DELTA_BYTE_ARRAY", where, "write it without")
        # Once as the page and once as what is decoded from it.
        budget.take(2 * inflated)
        at = head.at + packed
    if at != end:
        raise LogError(f"the page before byte {at} passes its column's end", where, _REMEDY)


class _Compact:
    """Reads values of Thrift's compact protocol from byte `at` on."""

    def __init__(self, data: bytes, at: int, end: int, where: str) -> None:
        self._data, self.at, self._end, self._where = data, at, end, where

    def _skip(self, size: int) -> None:
        if size > self._end - self.at:
            raise LogError(f"the page's head at byte {self.at} has no end", self._where, _REMEDY)
        self.at += size

    def _byte(self) -> int:
        self._skip(1)
        return self._data[self.at - 1]

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
        raise LogError(f"a number before byte {self.at} has no end", self._where, _REMEDY)

    def _integer(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)

    def struct(self, depth: int) -> dict[int, Any]:
        """The fields of a struct by number: integers and structs, None for what is only passed over."""
        fields: dict[int, Any] = {}
        number = 0
        while (head := self._byte()) != _STOP:
            number = number + (head >> 4) if head >> 4 else self._integer()
            fields[number] = self._value(head & 0x0F, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if depth <= 0:
            raise LogError(f"the page's head before byte {self.at} is nested too deep", self._where, _REMEDY)
        if kind in _FIXED:
            return self._skip(_FIXED[kind])
        if kind in _INTEGERS:
            return self._integer()
        if kind == _BINARY:
            return self._skip(self._varint())
        if kind == _STRUCT:
            return self.struct(depth - 1)
        if kind in _LISTS:
            head = self._byte()
            count = self._varint() if head >> 4 == 15 else head >> 4
            for _ in range(min(count, self._end - self.at + 1)):
                # In a list a bool is a byte.
                self._skip(1) if head & 0x0F in (_TRUE, _FALSE) else self._value(head & 0x0F, depth - 1)
            return None
        raise LogError(f"the page's head before byte {self.at} has a value of kind {kind}", self._where, _REMEDY)
