"""Bus: named fields that connect as one wire."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from twodof.blocks.expressions.expr import fault
from twodof.blocks.namespaces import BusView
from twodof.errors import DiagramError, nearest, shown

MAX_FIELDS = 1000
"""Largest number of fields of a bus, with those of the buses in it."""
MAX_LEVELS = 8
"""Deepest nesting of buses."""


class Bus:
    """Named fields that connect as one wire: `Bus("Attitude", [Port("roll", unit="rad"), Port("rates", Rates)])`.

    A field is a Port: a scalar, vector or matrix of any kind with its unit, or another bus. A bus is used in place of a
    kind. Calling it makes a value of it, `Attitude(roll=..., rates=Rates(...))`, that a method returns. `leaves` are
    the fields that are not buses themselves, by path ("rates.p"), in the order given.

    Raises DiagramError for fields that are not Ports, have the same name, or are too many or nested too deep.
    """

    __slots__ = ("fields", "leaves", "name")

    name: str
    fields: tuple[Any, ...]
    leaves: tuple[Any, ...]

    def __init__(self, name: str, fields: Sequence[Any]) -> None:
        where = f"bus {name!s:.80}"
        if not isinstance(name, str) or not name.isidentifier() or len(name) > 63:
            raise DiagramError(f"{shown(name)} is not a name", "bus", "use a letter, then letters, digits or _")
        if isinstance(fields, (str, Mapping)) or not isinstance(fields, Sequence) or not fields:
            what = f"the fields are {shown(fields)}, not a list"
            raise DiagramError(what, where, 'write [Port("roll", unit="rad"), ...]')
        leaves: list[Any] = []
        for one in fields:
            if not isinstance(getattr(one, "name", None), str) or not hasattr(one, "kind"):
                raise DiagramError(f"the field {shown(one)} is not a Port", where, 'write Port("name")')
            inside = leaves_of(one)
            if any(leaf.name.count(".") >= MAX_LEVELS for leaf in inside):
                raise DiagramError(f"more than {MAX_LEVELS} buses within one another", where, "use fewer levels")
            leaves += inside
            if len(leaves) > MAX_FIELDS:
                raise DiagramError(f"it has more than {MAX_FIELDS} fields", where, "use arrays")
        check_paths([leaf.name for leaf in leaves], where)
        for key, value in (("name", name), ("fields", tuple(fields)), ("leaves", tuple(leaves))):
            object.__setattr__(self, key, value)

    def __setattr__(self, name: str, value: Any) -> None:
        raise DiagramError(f"{name!r} is assigned, and a bus cannot change", f"bus {self.name}", "make another bus")

    def __reduce__(self) -> Any:
        return Bus, (self.name, self.fields)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Bus) and (self.name, self.leaves) == (other.name, other.leaves)

    def __hash__(self) -> int:
        return hash((self.name, *(leaf.name for leaf in self.leaves)))

    def __repr__(self) -> str:
        return f"Bus({self.name!r}, {list(self.fields)!r})"

    def __call__(self, **values: Any) -> dict[str, Any]:
        """Return a value of the bus: all fields by name. Raises DiagramError for a missing or unknown field."""
        known = list(dict.fromkeys(leaf.name.partition(".")[0] for leaf in self.leaves))
        for name in values:
            if name not in known:
                raise fault(f"{self.name} has no field {name!r}", f"there are: {nearest(name, known)}")
        for name in known:
            if name not in values:
                raise fault(f"{self.name} is made without its field {name!r}", "give all its fields")
        return {name: values[name] for name in known}

    def form(self) -> dict[str, Any]:
        """Return the bus as plain data, which `as_bus` reads."""
        return {"name": self.name, "fields": [_form(leaf) for leaf in self.leaves]}


def _form(leaf: Any) -> dict[str, Any]:
    form = {"name": leaf.name, "kind": leaf.kind}
    for key in ("width", "unit", "shape"):
        if getattr(leaf, key) and not (key == "width" and leaf.shape):
            form[key] = list(leaf.shape) if key == "shape" else getattr(leaf, key)
    return form if leaf.enum is None else {**form, "enum": leaf.enum.form()}


def leaves_of(declared: Any) -> list[Any]:
    """Return the declarations of the fields of a declared bus, named "att.rates.p"; else the declaration alone.

    The value of a state or parameter is the same for all fields, or a mapping by field, in which 0 may be left out. If
    a state starts from a parameter that is a bus, each field starts from that parameter's field. In an array of `width`
    buses each scalar field is an array, and each vector a matrix with a row per bus. Its value may be a list of
    mappings.
    """
    if not isinstance(declared.kind, Bus):
        return [declared]
    key = next((key for key in ("initial", "value") if hasattr(declared, key)), "")
    given = getattr(declared, key, 0)
    bus, count = declared.kind, declared.width
    given = transposed(given)
    if isinstance(given, Mapping):
        names = [leaf.name for leaf in bus.leaves]
        given = fields_given(given, names, declared.name)
        for name in given:
            if name not in names:
                there = f"there are: {nearest(name, names)}"
                raise DiagramError(f"{bus.name} has no field {name!r:.120}", declared.name, there)
    made = []
    for leaf in bus.leaves:
        changes = {"name": f"{declared.name}.{leaf.name}", "kind": leaf.kind, "enum": leaf.enum, "unit": leaf.unit}
        if count is not None and leaf.shape:
            what = f"an array of buses cannot have the matrix {leaf.name}"
            raise DiagramError(what, declared.name, "make the field a vector")
        rows = None if leaf.width is None or count is None else (count, leaf.width)
        width = count if count is not None else leaf.width
        changes |= {"width": None if leaf.shape or rows else width, "shape": leaf.shape or rows}
        if key and isinstance(given, str):
            changes[key] = f"{given}.{leaf.name}"
        elif key:
            value = given.get(leaf.name, 0) if isinstance(given, Mapping) else given
            changes[key] = 0 if type(value) is float and value == 0.0 else value
        made.append(replace(declared, **changes))
    return made


def transposed(values: Any) -> Any:
    """Return a list of buses as a mapping from each field to the list of its values; any other value unchanged.

    Raises DiagramError for buses that do not have the same fields.
    """
    if not isinstance(values, (list, tuple)) or not values:
        return values
    buses = [vars(v) if isinstance(v, BusView) else v for v in values]
    if not any(isinstance(bus, Mapping) for bus in buses):
        return values
    if any(not isinstance(bus, Mapping) or bus.keys() != buses[0].keys() for bus in buses):
        raise DiagramError("the buses of an array do not have the same fields", "", "give each bus all its fields")
    return {name: transposed([bus[name] for bus in buses]) for name in buses[0]}


def expanded(declared: Any) -> Any:
    """Return declarations with each bus replaced by its fields."""
    if not isinstance(declared, Sequence) or not any(isinstance(getattr(d, "kind", None), Bus) for d in declared):
        return declared
    return [leaf for d in declared for leaf in (leaves_of(d) if hasattr(d, "kind") else [d])]


def grouped(ports: Iterable[Any]) -> list[Any]:
    """Return ports with the fields of each bus replaced by the bus, at the place of the first: undo `expanded`."""
    found: dict[str, Any] = {}
    inside: dict[str, list[Any]] = {}
    for port in ports:
        name, dot, field = port.name.partition(".")
        found.setdefault(name, port)
        if dot:
            inside.setdefault(name, []).append(replace(port, name=field))
    plain = {"width": None, "unit": "", "shape": None, "enum": None}
    buses = {n: replace(found[n], name=n, kind=Bus(n, fields), **plain) for n, fields in inside.items()}
    return [buses.get(name, port) for name, port in found.items()]


def check_paths(names: Iterable[str], where: str) -> None:
    """Raise DiagramError if two names are equal, or one is that of a bus and of a field at once."""
    leaves: set[str] = set()
    buses: set[str] = set()
    for name in names:
        parts = name.split(".")
        above = {".".join(parts[:k]) for k in range(1, len(parts))}
        if name in leaves or name in buses or not above.isdisjoint(leaves):
            raise DiagramError(f"two fields are named {name!r:.120}", where, "names are unique")
        leaves.add(name)
        buses |= above


def fields_given(values: Mapping[Any, Any], known: Sequence[str], where: str) -> dict[str, Any]:
    """Return the values of nested mappings by path. `known` are the fields' paths; other keys are kept as they are.

    Raises DiagramError for a bus whose value is not a mapping of its fields.
    """
    buses = {name[:i] for name in known for i, c in enumerate(name) if c == "."}
    found: dict[str, Any] = {}
    stack = [("", values)]
    while stack:
        prefix, at = stack.pop()
        for key, value in at.items():
            name = f"{prefix}{key}"
            if name not in buses:
                found[name] = value
                continue
            inner = vars(value) if isinstance(value, BusView) else transposed(value)
            if not isinstance(inner, Mapping):
                fields = nearest("", [n.removeprefix(f"{name}.") for n in known if n.startswith(f"{name}.")])
                raise DiagramError(
                    f"the value of the bus {name!r} is {shown(value)}", where, f"give a value for each field: {fields}"
                )
            stack.append((f"{name}.", inner))
    return found
