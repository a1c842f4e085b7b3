"""Enumeration: named int32 values, such as the modes of a controller."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from enum import IntEnum
from typing import Any

import numpy as np

from twodof.blocks.bus import Bus
from twodof.blocks.expressions.expr import Expr, during, fault, int32, recording, where
from twodof.blocks.expressions.numbers import Int32
from twodof.blocks.expressions.recording import OPERANDS
from twodof.errors import DiagramError, nearest, shown

MAX_MEMBERS = 1000
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
_MIN, _MAX = -(2**31), 2**31 - 1


class _Member(Int32):
    """Member of an enumeration: its int32 with the enumeration."""

    __slots__ = ("of",)

    def __init__(self, of: Enumeration, value: int) -> None:
        super().__init__(value)
        self.of = of


class Enumeration:
    """Named int32 values: `Mode = Enumeration("Mode", idle=0, armed=1)`; then `Mode.armed` is the int32 1.

    `members` are the values by name, in the order given. One of them must be 0, which is the value of a signal that was
    not computed yet, and of a value that is not a member. A Python `enum.IntEnum` is accepted in place of an
    Enumeration. Two are equal if their names and members are. A member with the name of an attribute is read as
    `Mode["name"]`.

    Raises DiagramError for an illegal name, a value that is not an int32 or given twice, and without a 0.
    """

    __slots__ = ("members", "name")

    name: str
    members: dict[str, int]

    def __init__(self, name: str, members: Mapping[str, int] | None = None, /, **more: int) -> None:
        where = f"enumeration {name!s:.80}"
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            remedy = "use a letter, then up to 62 letters, digits or _ (ASCII)"
            raise DiagramError(f"{shown(name)} is not a name", "enumeration", remedy)
        if members is not None and not isinstance(members, Mapping):
            what = f"the members are {shown(members)}, not a mapping"
            raise DiagramError(what, where, 'write {"idle": 0, "armed": 1}')
        given = {**(members or {}), **more}
        if not 1 <= len(given) <= MAX_MEMBERS:
            raise DiagramError(f"it has {len(given)} members", where, f"give 1 to {MAX_MEMBERS}")
        by_value: dict[int, str] = {}
        for member, value in given.items():
            if not isinstance(member, str) or not _NAME.fullmatch(member):
                raise DiagramError(f"{shown(member)} is not a name", where, "use a letter, then letters, digits or _")
            plain = value.value if isinstance(value, Int32) else value
            if isinstance(plain, bool) or not isinstance(plain, int) or not _MIN <= plain <= _MAX:
                what = f"{member} = {shown(value)} is not an int32"
                raise DiagramError(what, where, f"write a whole number from {_MIN} to {_MAX}")
            if plain in by_value:
                raise DiagramError(f"{by_value[plain]} and {member} are both {plain}", where, "give each its own value")
            by_value[int(plain)] = member
        if 0 not in by_value:
            remedy = "add one, such as none=0, for signals that were not computed yet"
            raise DiagramError("no member is 0", where, remedy)
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "members", {member: value for value, member in by_value.items()})

    def __setattr__(self, name: str, value: Any) -> None:
        what = f"{name!r} is assigned, and an enumeration cannot change"
        raise DiagramError(what, f"enumeration {self.name}", "make another enumeration")

    def __reduce__(self) -> Any:
        return Enumeration, (self.name, self.members)

    def __getitem__(self, member: str) -> Int32:
        if member not in self.members:
            raise self._unknown(member)
        return _Member(self, self.members[member]) if recording() else int32(self.members[member])

    def __getattr__(self, member: str) -> Int32:
        if member.startswith("__"):  # what Python asks for by itself, when it copies for example
            raise AttributeError(member)
        return self[member]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Enumeration) and (self.name, self.members) == (other.name, other.members)

    def __hash__(self) -> int:
        return hash((self.name, *self.members.items()))

    def __repr__(self) -> str:
        return f"Enumeration({self.name!r}, {self.members!r})"

    def __str__(self) -> str:
        return f"{self.name} ({', '.join(f'{value} {member}' for member, value in self.members.items())})"

    def name_of(self, value: Any) -> str:
        """Return the name of the member with this value; without one, the value as text."""
        return next((member for member, number in self.members.items() if number == value), str(value))

    def plain(self, value: Any, where: str) -> Any:
        """Return the number of a member's name or number, or a list of them; else raise DiagramError at `where`."""
        if isinstance(value, (list, tuple)):
            return [self.plain(one, where) for one in value]
        if isinstance(value, str):
            if value not in self.members:
                raise self._unknown(value, where)
            return self.members[value]
        number = value.value if isinstance(value, Int32) else value
        if isinstance(number, bool) or not isinstance(number, int) or number not in self.members.values():
            remedy = f"there are: {', '.join(f'{value} {member}' for member, value in self.members.items()):.400}"
            raise DiagramError(f"{shown(value)} is not a member of {self.name}", where, remedy)
        return int(number)

    def form(self) -> dict[str, Any]:
        """Return plain data, from which `enumeration_of` makes the enumeration again."""
        return {"name": self.name, "members": dict(self.members)}

    def _unknown(self, member: object, where: str = "") -> DiagramError:
        what = f"{self.name} has no member {shown(member)}"
        return DiagramError(what, where, f"there are: {nearest(member, self.members)}")


Kind = str | type[IntEnum] | Enumeration | Bus
"""The type of a port, state or parameter: "real", "int32", ..., an enumeration, or a bus."""


def enumeration_of(kind: Any, where: str = "") -> Enumeration | None:
    """Return the Enumeration for an Enumeration, a Python IntEnum or the plain form of one; None for another kind."""
    if isinstance(kind, Enumeration):
        return kind
    if isinstance(kind, type) and issubclass(kind, IntEnum):
        return Enumeration(kind.__name__, {member.name: int(member) for member in kind})
    if isinstance(kind, Mapping):
        if set(kind) != {"name", "members"}:
            raise DiagramError(f"{shown(kind)} is not an enumeration", where, 'write {"name": ..., "members": {...}}')
        return Enumeration(kind["name"], kind["members"])
    return None


def to_enumeration(kind: Kind, value: Any) -> Any:
    """Return the int32 `value` if it is a member of the enumeration `kind`, else 0; arrays element by element.

    Raises DiagramError if `kind` is not an enumeration.
    """
    enumeration = enumeration_of(kind)
    if enumeration is None:
        raise DiagramError(
            f"{shown(kind)} is not an enumeration", "to_enumeration", "give an enumeration, then a value"
        )
    found: Any = int32(0)
    for number in enumeration.members.values():
        if number:
            found = where(value == int32(number), int32(number), found)
    return found


def stays_within(enumeration: Enumeration, item: Expr, leaves: Mapping[tuple[str, str], Enumeration | None]) -> bool:
    """Return True if the graph of `item` shows that its value is always a member of `enumeration`.

    It does for members, for inputs, states and parameters of the enumeration (`leaves`, by op and name), for choices
    between such values, and for arrays of them.
    """
    values = frozenset(enumeration.members.values())
    return all(
        at.kind == "int32" and at.data in values if at.op == "const" else leaves.get((at.op, at.data)) == enumeration
        for at in _origins(item)
    )


def _origins(item: Expr) -> Iterator[Expr]:
    """Yield what the values of `item` are chosen from, through choices and arrays."""
    seen: set[Expr] = set()
    stack = [item]
    while stack:
        at = stack.pop()
        if at in seen:
            continue
        seen.add(at)
        if at.op in _PASSED:
            stack += _PASSED[at.op](at.args)
        else:
            yield at


def comparing(leaves: Mapping[tuple[str, str], Enumeration | None]) -> AbstractContextManager[None]:
    """Return a context in which a comparison of values of two enumerations raises DiagramError.

    `leaves` are the enumerations of inputs, states and parameters, by op and name.
    """

    def check(op: str, a: Any, b: Any) -> tuple[Any, Any]:
        if op in _COMPARISONS:
            one, other = (_of(value, leaves) for value in (a, b))
            if one is not None and other is not None and one != other:
                remedy = f"compare it with a member of {one.name}: {', '.join(one.members):.400}; or with a number"
                raise fault(f"a {one.name} is compared with a {other.name}", remedy)
        return a, b

    return during(OPERANDS, check) if any(leaves.values()) else nullcontext()


def _of(value: Any, leaves: Mapping[tuple[str, str], Enumeration | None]) -> Enumeration | None:
    """Return the enumeration of a value, as far as its graph shows; None for a plain number."""
    if not isinstance(value, Expr):
        return value.of if isinstance(value, _Member) else enumeration_of(type(value))
    found = {leaves.get((at.op, at.data)) for at in _origins(value) if at.op != "const"}
    return found.pop() if len(found) == 1 else None


_COMPARISONS = ("eq", "ne", "lt", "le")
_PASSED: Mapping[str, Any] = {
    "where": lambda args: args[1:],
    "select": lambda args: args[:1],
    "store": lambda args: (args[0], args[2]),
    "vector": lambda args: args,
    "build": lambda args: args,
}


_KINDS = "biufU"  # of numpy's types: bool, integer, unsigned, real, text
MAX_DEPTH = 8  # of lists within lists
_SCALARS = frozenset((float, int, bool, str, type(None)))


def plain_data(value: Any, where: str, depth: int = 0) -> Any:
    """Return `value` with numpy's arrays and scalars, at any depth, as lists and numbers of Python.

    The numbers do not change, as a float32 is also a float64. Members of an enumeration become numbers, an enumeration
    or a bus its plain form; anything else is unchanged. Raises DiagramError, at `where`, for complex numbers, for
    arrays of other things than numbers, and for lists nested too deep (`depth` counts the levels).
    """
    if type(value) in _SCALARS:
        return value
    if isinstance(value, (np.ndarray, np.generic)):
        if value.dtype.kind not in _KINDS:
            what = "an array" if isinstance(value, np.ndarray) else "a number"
            raise DiagramError(f"{what} of numpy's type {value.dtype} is given", where, "give real numbers")
        # A longdouble has no counterpart in Python.
        return (value.astype(np.float64) if value.dtype.kind == "f" else value).tolist()
    if isinstance(value, (list, tuple, range)):
        if _SCALARS.issuperset(map(type, value)):
            return list(value)
        if depth == MAX_DEPTH:
            what = f"lists are nested more than {MAX_DEPTH} deep"
            raise DiagramError(what, where, "give a number, a list or rows")
        return [plain_data(one, where, depth + 1) for one in value]
    if isinstance(value, IntEnum):
        return int(value)
    if isinstance(value, Bus):
        return value.form()
    if isinstance(value, (type, Enumeration)) and (enumeration := enumeration_of(value, where)) is not None:
        return enumeration.form()
    if isinstance(value, complex):
        raise DiagramError(f"the complex number {value} is given", where, "give real numbers")
    return value
