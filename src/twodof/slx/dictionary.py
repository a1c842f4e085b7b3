"""Data dictionaries (.sldd) of Simulink and classes of enumerations, as values of the MATLAB subset.

`dictionary(name, folders)` has the entries of a dictionary and of those that it refers to. A parameter is what it holds
in its own data type. A bus is a structure with `Elements`, each with `Name`, `DataType` and `Dimensions`. An
enumeration is a structure of its members' numbers.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twodof.errors import DiagramError, LogError
from twodof.flightlog import fence
from twodof.slx.matlab.evaluation import script_text
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.values import FUNCTIONS, KINDS, Members, Value, as_array
from twodof.slx.package import REMEDY, Element, Package

_SHAPE = re.compile(r"(\d{1,6})\*(\d{1,6})")
_CHUNK = re.compile(r"data/chunk\d+\.xml")
_CLASS = re.compile(r"^\s*classdef\b[^\n]*?\b(\w+)\s*<\s*(?:Simulink\.IntEnumType|u?int(?:8|16|32))\b", re.MULTILINE)
_MEMBERS = re.compile(r"^\s*enumeration\b(.*?)^\s*end\b", re.MULTILINE | re.DOTALL)
_MEMBER = re.compile(r"(\w+)\s*\(\s*(-?\d{1,10}|0[xX][0-9a-fA-F]{1,7})\s*\)")
_NOT_TYPED = ("", "auto", "double")
MOST_DICTIONARIES = 50


def dictionary(name: str, folders: Sequence[Path]) -> dict[str, Value]:
    """Return the values of a data dictionary, by name; {} without one.

    Raises DiagramError for a dictionary that is damaged, or is not in the folders.
    """
    found: dict[str, Value] = {}
    expressions: dict[str, tuple[str, str]] = {}
    waiting, seen = [name] if name else [], set[str]()
    while waiting and len(seen) < MOST_DICTIONARIES:
        at = waiting.pop(0)
        if at in seen:
            continue
        seen.add(at)
        file = _file(at, folders)
        if file is None:
            remedy = "name its folder with --path"
            raise DiagramError(f"the data dictionary {at} is not found", name, remedy)
        try:
            plain, _ = fence.read(plain_dictionary, file)
        except LogError as reason:
            raise DiagramError(reason.what, reason.where, reason.remedy) from reason
        for entry, value in plain["entries"].items():
            found.setdefault(entry, _value(value))
            if isinstance(value, dict) and "expression" in value:
                expressions.setdefault(entry, (value["expression"], value.get("type", "")))
        waiting += plain["references"]
    for _ in range(3):  # a parameter may be computed from another one that is computed
        for entry, (text, kind) in expressions.items():
            try:
                found[entry] = {"Value": _cast(evaluate(text, found, entry), kind)}
            except DiagramError:
                found.pop(entry, None)
    return found


def enumerations(texts: Iterable[str], folders: Sequence[Path]) -> dict[str, Value]:
    """Return the enumerations whose members are named in values, `Mode.idle`, from the files of their classes."""
    found: dict[str, Value] = {}
    for name in {name for text in texts for name in re.findall(r"\b([A-Za-z]\w*)\.[A-Za-z]", text)}:
        file = next((at for one in folders if (at := one / f"{name}.m").is_file()), None)
        if file is None:
            continue
        try:
            code, _ = fence.read(script_text, file)
        except LogError:
            continue  # a member that is asked for is refused
        head, members = _CLASS.search(code), _MEMBERS.search(code)
        if head is not None and members is not None and head[1] == name:
            found[name] = _enumeration(dict(_MEMBER.findall(re.sub(r"%[^\n]*", "", members[1]))))
    return found


def _file(name: str, folders: Sequence[Path]) -> Path | None:
    if not re.fullmatch(r"[\w -]{1,200}\.sldd", name):
        return None
    return next((at for one in folders if (at := one / name).is_file()), None)


def _enumeration(members: dict[str, str]) -> Value:
    return Members(
        {
            name: np.array([[int(number, 16 if "x" in number.lower() else 10)]], dtype=np.int32)
            for name, number in members.items()
        }
    )


def _value(plain: Any) -> Value:
    """Return an entry's value. Its plain form is a text, a list, or a dict that says by its keys what it is."""
    if isinstance(plain, str):
        return plain
    if isinstance(plain, list):
        return [_value(one) for one in plain]
    if "numbers" in plain:
        array = np.array(plain["numbers"], dtype=float).reshape(plain["shape"], order="F")
        return array.astype(KINDS[plain["type"]])
    if "members" in plain:
        return _enumeration(plain["members"])
    if "parameter" in plain:
        return {"Value": _cast(_value(plain["parameter"]), plain.get("type", ""))}
    return {name: _value(one) for name, one in plain.get("fields", {}).items()}


def _cast(value: Value, kind: str) -> Value:
    if kind in _NOT_TYPED or kind not in KINDS or not isinstance(value, np.ndarray):
        return value
    return FUNCTIONS[kind](as_array(value))


# --- behind the fence


def plain_dictionary(data: bytes, where: str) -> fence.Answer:
    """Return the entries of a dictionary's bytes as JSON values, and the dictionaries that it refers to."""
    package = Package(data, where)
    chunks = [tree for name in package.names if _CHUNK.fullmatch(name) and (tree := package.tree(name)) is not None]
    if not chunks:
        raise LogError("is no data dictionary", where, REMEDY)
    entries: dict[str, Any] = {}
    references: list[str] = []
    for part in (one for chunk in chunks for one in chunk.iterfind("Object")):
        named = {p.get("Name", ""): p for p in part.iterfind("P")}
        if part.get("Class") == "DD.DICTIONARYREFERENCE" and "Subdictionary" in named:
            references.append(named["Subdictionary"].text or "")
        elif part.get("Class") == "DD.ENTRY" and "Name" in named and "Value" in named:
            found = _plain(named["Value"], 0)
            if found is not None:
                entries[named["Name"].text or ""] = found
    return {"entries": entries, "references": references}, []


def _plain(element: Element, depth: int) -> Any:
    """Return the plain form of a value's element; None for what no block can use."""
    kind, inner = element.get("Class", ""), element.findall("Element")
    if depth > 20:
        return None
    if element.get("EnumerationType"):
        return {"numbers": [float(element.text or "0")], "shape": [1, 1], "type": "int32"}
    if kind in KINDS:
        shape = _SHAPE.fullmatch(element.get("Dimension", "1*1"))
        try:
            numbers = [float(one) for one in (element.text or "").split()]
        except ValueError:
            return None  # complex numbers
        if shape is None or len(numbers) != int(shape[1]) * int(shape[2]):
            return None
        return {"numbers": numbers, "shape": [int(shape[1]), int(shape[2])], "type": kind}
    if kind in ("char", "string") and not inner:
        return element.text or ""
    if kind == "struct" or (not kind and inner):
        made = [_plain(one, depth + 1) if one.get("Class") else _fields(one, depth) for one in inner]
        return made[0] if len(made) == 1 else [one for one in made if one is not None]
    return _object(element, kind, depth)


def _fields(element: Element, depth: int) -> Any:
    made = {p.get("Name", "").removesuffix("_internal"): _plain(p, depth + 1) for p in element.iterfind("P")}
    return {"fields": {name: one for name, one in made.items() if name and one is not None}}


def _object(element: Element, kind: str, depth: int) -> Any:
    """Return the plain form of an object: a parameter, a bus, an element of one, a type or an enumeration."""
    made = _fields(element, depth)["fields"]
    if kind.endswith(".Parameter"):  # packages have classes of their own
        said = made.get("DataType", "")
        expression = next((p for p in element.iter("P") if p.get("Name") == "ExpressionString"), None)
        if expression is not None:
            text = next((one.text for one in expression.iter("Element") if one.get("Class") == "char"), None)
            return {"expression": text or "", "type": said}
        return {"parameter": made["Value"], "type": said} if "Value" in made else None
    if kind == "Simulink.Bus":
        elements = made.get("Elements", [])
        return {"fields": {"Elements": elements if isinstance(elements, list) else [elements]}}
    if kind == "Simulink.data.dictionary.EnumTypeDefinition":
        members = made.get("Enumerals", [])
        members = [one["fields"] for one in (members if isinstance(members, list) else [members])]
        return {"members": {one["Name"]: one["Value"] for one in members if re.fullmatch(r"-?\d{1,10}", one["Value"])}}
    if kind in ("Simulink.BusElement", "Simulink.AliasType", "Simulink.NumericType"):
        wanted = ("Name", "DataType", "Dimensions", "BaseType", "DataTypeMode", "Signedness", "WordLength")
        return {"fields": {name: made[name] for name in wanted if name in made}}
    return None
