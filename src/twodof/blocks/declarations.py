"""Declarations of a block: ports, states and parameters with their types, widths, units and bounds."""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from twodof.blocks.bus import MAX_FIELDS, MAX_LEVELS, Bus
from twodof.blocks.enumeration import enumeration_of, plain_data
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.arrays import Matrix, shape_text
from twodof.blocks.expressions.numbers import BY_NAME, INTEGERS, KINDS, Integer, Vector
from twodof.errors import DiagramError, ParameterError, TwodofError, nearest, outside, shown

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
MAX_WIDTH = 1_000_000
MAX_STEPS = 100_000_000
MAX_PATH = 64 * (MAX_LEVELS + 1)


def check_name(name: object, where: str) -> str:
    """Return `name` if it is legal (a letter, then letters, digits and _, at most 63); else raise DiagramError."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise DiagramError(
            f"{shown(name)} is not a name", where, "use a letter, then up to 62 letters, digits or _ (ASCII)"
        )
    return name


def name_of_file(file: str) -> str:
    """Return the legal name nearest to that of a file; `nameForFile` of the page gives the same."""
    return re.sub(r"^(?![A-Za-z])", "d", re.sub(r"\W+", "_", file, flags=re.ASCII))[:63]


def check_path(name: object, where: str) -> str:
    """Return `name` if it is a legal name, or the path "att.rates.p" of a bus's field; else raise DiagramError."""
    parts = name.split(".") if isinstance(name, str) and len(name) < MAX_PATH else [name]
    for part in parts:
        check_name(part, where)
    if len(parts) > MAX_LEVELS + 1:
        raise DiagramError(f"more than {MAX_LEVELS} buses within one another", where, "use fewer levels")
    return ".".join(map(str, parts))


def check_steps(steps: object, where: str) -> int:
    """Return `steps` if it is a number of steps that one call may run, 0 to MAX_STEPS; else raise DiagramError."""
    number = plain_data(steps, where)
    if type(number) is not int or not 0 <= number <= MAX_STEPS:
        raise DiagramError(
            f"{steps!r:.40} is not a possible number of steps", where, f"run 0 to {MAX_STEPS} steps in one call"
        )
    return number


def check_tick(dt: object, where: str) -> float:
    """Return `dt` [s] if it can be a base tick, finite and above 0; else raise DiagramError."""
    tick = plain_data(dt, where)
    if type(tick) not in (int, float) or not 0 < tick < math.inf:
        raise DiagramError(f"dt = {shown(dt)} is not a base tick", where, "give seconds, > 0")
    return float(tick)


def _settle(declared: "Port | State | Param", *plain: str) -> bool:
    """Turn the fields of a declaration into plain data and check them; return False for a bus.

    Values of numpy in the fields `plain` become Python's, which compare and go into files. A bus stands for its fields
    with the rest of what is declared. A kind that is an enumeration becomes int32, and what is declared of it numbers.
    """
    where = f"{declared.name!s:.80}"

    def put(name: str, value: Any) -> None:
        object.__setattr__(declared, name, value)

    for name in plain:
        put(name, plain_data(getattr(declared, name), where))
    if isinstance(declared.kind, Mapping) and "fields" in declared.kind:
        with located(where):
            put("kind", as_bus(declared.kind))
    width, single = declared.width, "one bus" if isinstance(declared.kind, Bus) else "a scalar"
    if width is not None and not (type(width) is int and 1 <= width <= MAX_WIDTH):
        raise DiagramError(f"width {shown(width)} is not in 1..{MAX_WIDTH}", where, f"use None for {single}")
    if isinstance(declared.kind, Bus):
        check_name(declared.name, "block")
        if (declared.shape, declared.unit, declared.enum) != (None, "", None):
            what = "a bus has no shape, unit or enumeration"
            raise DiagramError(what, where, "give them to its fields; an array of buses has a width")
        return False
    enumeration = enumeration_of(declared.kind if declared.enum is None else declared.enum, where)
    if enumeration is not None:
        if declared.enum is not None and declared.kind not in ("real", "int32"):
            what = f"an enumeration cannot be {shown(declared.kind)}"
            raise DiagramError(what, where, "leave the type out: it is int32")
        put("kind", "int32")
        put("enum", enumeration)
        key = "value" if isinstance(declared, Param) else "initial"
        given = getattr(declared, key, None)
        if isinstance(declared, Param) or (isinstance(declared, State) and not isinstance(given, str)):
            put(key, enumeration.plain(given, where))
    elif declared.enum is not None:
        what = f"{shown(declared.enum)} is not an enumeration"
        raise DiagramError(what, where, "give an enumeration, or leave `enum` out")
    check_path(declared.name, "block")
    if declared.shape is not None:
        size = plain_data(declared.shape, where)
        if not isinstance(size, list) or len(size) != 2 or any(type(n) is not int or n < 1 for n in size):
            what = f"the shape {shown(declared.shape)} is not one of a matrix"
            raise DiagramError(what, where, "write (rows, columns)")
        rows, columns = size
        if width not in (None, rows * columns):
            what = f"the width {shown(width)} does not fit the shape {rows}x{columns}"
            raise DiagramError(what, where, "leave the width of a matrix out")
        put("shape", (rows, columns))
        put("width", rows * columns)
    if not isinstance(declared.unit, str):
        raise DiagramError(f"the unit {shown(declared.unit)} is not text", where, 'write it as "m/s", or "" for none')
    if declared.kind not in KINDS:
        raise DiagramError(f"unknown type {shown(declared.kind)}", where, f"use one of {', '.join(KINDS)}")
    return True


def as_bus(form: Any) -> Any:
    """Return the bus described by `form`; return any other value unchanged."""
    if not isinstance(form, Mapping) or "fields" not in form:
        return form
    fields = form["fields"]
    good = isinstance(fields, list) and all(isinstance(f, dict) and set(f) <= _FIELD and "name" in f for f in fields)
    if set(form) != {"name", "fields"} or not good or len(fields) > MAX_FIELDS:
        remedy = f'write {{"name": ..., "fields": [...]}}, with at most {MAX_FIELDS} fields'
        raise DiagramError(f"{shown(form)} is not a bus", "", remedy)
    return Bus(form["name"], [Port(**field) for field in fields])


_FIELD = {"name", "kind", "width", "unit", "shape", "enum"}


@contextmanager
def located(where: str, keep: bool = False) -> Iterator[None]:
    """Give a DiagramError from the `with` block the place `where`; with `keep` before its own place."""
    try:
        yield
    except TwodofError as error:
        raise DiagramError(error.what, f"{where}, {error.where}" if keep else where, error.remedy) from error


@dataclass(frozen=True)
class Port:
    """An input, output or derived parameter: scalar if `width` is None, else an array. `unit` "" is not compared.

    With `shape`, (rows, columns), it is a matrix; its `width` is then the number of elements. A `kind` that is an
    enumeration becomes int32, and `enum` is the enumeration. A `kind` that is a Bus stands for ports named
    "att.rates.p". With a `width` it is an array of buses: a scalar field is then an array, a vector a matrix of rows.
    """

    name: str
    kind: Any = "real"
    width: int | None = None
    unit: str = ""
    shape: tuple[int, int] | None = None
    enum: Any = None

    def __post_init__(self) -> None:
        _settle(self, "width")


@dataclass(frozen=True)
class State:
    """A state. `initial` is a number, `width` numbers, the rows of a matrix, or the name of a parameter of the block.

    A discrete state changes by `update`, a continuous one (real only) by `derivative` and `project`.
    """

    name: str
    initial: Any = 0
    kind: Any = "real"
    width: int | None = None
    unit: str = ""
    continuous: bool = False
    shape: tuple[int, int] | None = None
    enum: Any = None

    def __post_init__(self) -> None:
        if not _settle(self, "initial", "width", "continuous"):
            return
        if self.continuous and self.kind != "real":
            raise DiagramError(f"a continuous state cannot be {self.kind}", self.name, "make it real, or discrete")
        if not isinstance(self.initial, str):
            _declared(self.initial, self)


@dataclass(frozen=True)
class Param:
    """A parameter: default `value`, bounds `low` and `high` (inclusive), unit, text.

    The value is a sequence if `width` is given, and a sequence of rows if `shape` is. A parameter that is not `tunable`
    is fixed once the diagram runs (it may still be set before).

    Raises DiagramError for a default that is not of its kind or not within the bounds, and for invalid bounds.
    """

    name: str
    value: Any = 0.0
    kind: Any = "real"
    width: int | None = None
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    text: str = ""
    tunable: bool = True
    shape: tuple[int, int] | None = None
    enum: Any = None

    def __post_init__(self) -> None:
        if not _settle(self, "value", "width", "low", "high", "tunable"):
            return
        given = _declared(self.value, self)
        _check_limits(self)
        free = self.kind == "bool" or (self.low == -math.inf and self.high == math.inf)
        for value in () if free else given:
            if not self.low <= value <= self.high:
                what = f"the default {value} is outside [{self.low}, {self.high}]"
                raise DiagramError(what, self.name, "change the default or the bounds")

    @property
    def is_initial(self) -> bool:
        """Return True for a value of before the start, which is no gain: the library names these `initial...`."""
        return self.name.rpartition(".")[2].startswith("initial")


class Typed(Protocol):
    """Type and size of a declaration, an expression or a signal."""

    @property
    def kind(self) -> str: ...

    @property
    def width(self) -> int | None: ...

    @property
    def shape(self) -> tuple[int, ...] | None: ...


class WithUnit(Typed, Protocol):
    """Type, size and unit of a declaration or a signal."""

    @property
    def unit(self) -> str: ...


class Declared(Protocol):
    """Part of a block that tracing needs: its declarations, and the place of its methods."""

    inputs: Sequence[Port]
    outputs: Sequence[Port]
    states: Sequence[State]
    params: Sequence[Param]
    derived: Sequence[Port]

    def written(self, method: str) -> Callable[..., Any]:
        """Return the Python function of the method named `method`, whose place an error gives."""


_WRITTEN_AS = {"inputs": "Port", "outputs": "Port", "derived": "Port", "states": "State", "params": "Param"}


def check_lists(block: Declared, where: str) -> None:
    """Raise DiagramError if the inputs, outputs, states or parameters of a block are not lists of declarations."""
    for what, example in _WRITTEN_AS.items():
        given = getattr(block, what)
        remedy = f'write {what} = [{example}("name"), ...]'
        if isinstance(given, str) or not isinstance(given, Sequence):
            raise DiagramError(f"{what} is {shown(given)}, not a list", where, remedy)
        for one in given:
            if not isinstance(getattr(one, "name", None), str):
                raise DiagramError(f"{what} holds {shown(one)}, which is not a declaration", where, remedy)
            if isinstance(getattr(one, "kind", None), Bus):
                if what == "derived":
                    raise DiagramError(f"{what} holds the bus {one.name!r}", where, "declare its fields one by one")
                how = f"set {what} to a new list with it"
                raise DiagramError(f"the bus {one.name!r} was added to the list {what}", where, how)


def shape(declared: Typed) -> str:
    """Return the type of a declaration or expression, with the size of an array: "real", "int32[3]", "real[3x2]".

    The type of an enumeration is its name.
    """
    enumeration = getattr(declared, "enum", None)
    kind: str = declared.kind if enumeration is None else enumeration.name
    if declared.width is None:
        return kind
    return f"{kind}[{'x'.join(map(str, declared.shape or (declared.width,)))}]"


def alike(one: Typed, other: Typed) -> bool:
    """Return True if both have the same type and size."""
    return shape(one) == shape(other) and getattr(one, "enum", None) == getattr(other, "enum", None)


def units_clash(one: WithUnit, other: WithUnit) -> bool:
    """Return True if both have a unit and the units differ."""
    return bool(one.unit and other.unit and one.unit != other.unit)


def mismatch(port: WithUnit, given: WithUnit, source: object) -> tuple[str, str] | None:
    """Check a wire: return the mismatch between `port` and the signal `given` of `source` with its remedy, or None.

    A signal of an enumeration may feed an int32.
    """
    wanted, found = getattr(port, "enum", None), getattr(given, "enum", None)
    if alike(port, given) or (
        wanted is None and found is not None and shape(port) == shape(given).replace(found.name, "int32")
    ):
        if units_clash(port, given):
            return f"it takes [{port.unit}] and {source} is in [{given.unit}]", "convert the unit"
        return None
    if wanted is not None and found is not None and wanted != found:
        return f"it takes {wanted} and {source} is {found}", "use the same enumeration for both, or convert the signal"
    if wanted is not None and given.kind == "int32" and given.width == port.width:
        remedy = f'put Convert("int32", {wanted.name}) between them'
        return f"it takes {shape(port)} and {source} is {shape(given)}", remedy
    return f"it takes {shape(port)} and {source} is {shape(given)}", "convert the signal, or mux and demux it"


def element_names(name: str, declared: Typed) -> list[str]:
    """Return the names of a value's elements in the order of memory: "x", or "x[0]" and so on.

    A matrix has "P[0,0]", "P[1,0]" and so on.
    """
    if declared.width is None:
        return [name]
    if declared.shape is None or len(declared.shape) < 2:
        return [f"{name}[{i}]" for i in range(declared.width)]
    rows, columns = declared.shape
    return [f"{name}[{i},{j}]" for j in range(columns) for i in range(rows)]


def _declared(value: Any, declared: State | Param) -> list[Any]:
    """Return the numbers of a declared value, as given. Raises DiagramError for one that is not of its kind."""
    kind, name = declared.kind, declared.name
    try:
        numeric(value, kind, declared.width, name, declared.shape)
    except OverflowError:
        raise DiagramError(f"{shown(value)} is not a real number", name, "make it smaller") from None
    plain = _plain(value)
    if kind in INTEGERS:  # an integer that is computed wraps around, one that is written down is a slip of the pen
        for one in plain:
            if not numbers.fits(one, kind):
                within = f"{BY_NAME[kind].low} to {BY_NAME[kind].high}"
                raise DiagramError(f"{one} does not fit {kind}", name, f"write a whole number from {within}")
    return plain


def _plain(value: Any) -> list[Any]:
    """Return the numbers of a value, as they were given."""
    scalars = value if isinstance(value, (list, tuple)) else [value]
    if scalars and isinstance(scalars[0], (list, tuple)):
        scalars = [one for row in scalars for one in row]
    return [one.value if isinstance(one, Integer) else one for one in scalars]


def check_initial(value: Any, output: Typed, where: str) -> Any:
    """Return `value` if it may be the initial value of `output`, with the name of a member as its number.

    Raises DiagramError, as for a default value, if it may not.
    """
    matrix = output.shape if output.shape and len(output.shape) == 2 else None
    with located(where):
        declared = Param("initial", value, output.kind, output.width, shape=matrix, enum=getattr(output, "enum", None))
    return value if declared.enum is None else declared.value


def _check_limits(declared: Param) -> None:
    """Raise DiagramError for bounds that are none."""
    for bound in (declared.low, declared.high):
        if isinstance(bound, bool) or not isinstance(bound, (int, float)) or math.isnan(bound):
            raise DiagramError(
                f"the bound {shown(bound)} is not a number", declared.name, "leave it out, or give a number"
            )
        if declared.kind in INTEGERS and math.isfinite(bound) and bound != int(bound):
            raise DiagramError(f"the bound {bound} of an integer is not whole", declared.name, "round it")
    if declared.low > declared.high:
        raise DiagramError(
            f"no value is within [{declared.low}, {declared.high}]", declared.name, "exchange the bounds"
        )


def narrowed(outer: Param, at: str, inner: Param, path: str) -> Param:
    """Return `outer`, the parameter `at`, with its bounds narrowed to those of `inner`, at `path` and bound to it.

    Raises DiagramError if they differ in type or unit, or if the default of `outer` is outside the bounds.
    """
    if not alike(outer, inner) or units_clash(outer, inner):
        own, bound = (f"{shape(one)} [{one.unit or '-'}]" for one in (inner, outer))
        what = f"it is {own}, and the parameter {at!r} that is bound to it is {bound}"
        raise DiagramError(what, path, "declare both with the same type, width and unit")
    low, high = max(outer.low, inner.low), min(outer.high, inner.high)
    for value in np.ravel(np.asarray(outer.value)):
        if outer.kind != "bool" and not low <= value <= high:
            what = f"it is bound to {outer.name!r}, whose default {value} is outside [{low}, {high}]"
            raise DiagramError(what, path, "change the default, or the bounds of one of them")
    return replace(outer, low=low, high=high)


def column_major(value: Any, shape: tuple[int, int], where: str) -> Any:
    """Return a matrix's elements, column after column; return a number or flat values unchanged.

    Raises DiagramError for rows of another shape than `shape`.
    """
    if isinstance(value, Matrix):
        given, flat = value.shape, value.flat
    elif isinstance(value, (list, tuple)) and not isinstance(value, Vector):
        rows = [row.tolist() if isinstance(row, np.ndarray) else row for row in value]
        lengths = {len(row) if isinstance(row, (list, tuple)) else None for row in rows}
        columns = lengths.pop() if len(lengths) == 1 else None
        given = (len(rows),) if columns is None else (len(rows), columns)
        flat = [row[j] for j in range(columns or 0) for row in rows]
    else:
        return value
    if given != shape:
        raise DiagramError(
            f"the value is {shape_text(given)}, and the array {shape_text(shape)}", where, "give a list of rows"
        )
    return flat


def rows_of(flat: Any, shape: tuple[int, int] | None) -> Any:
    """Return a matrix's elements as a list of rows, the inverse of `column_major`; any other value unchanged."""
    return flat if shape is None else [list(flat[i :: shape[0]]) for i in range(shape[0])]


def numeric(value: Any, kind: str, width: int | None, where: str, shape: tuple[int, int] | None = None) -> Any:
    """Return `value` as a number of the current precision, or as a Vector of `width` numbers.

    One number fills an array. With `shape` the value is that of a matrix: a list of rows, or a Matrix. Raises
    DiagramError for another type or length.
    """
    if isinstance(value, np.ndarray):
        value = value.tolist()
    elif isinstance(value, np.generic) and not isinstance(value, np.bool_):
        value = value.item()
    if shape is not None:
        value = column_major(value, shape, where)
    if kind == "bool" and type(value) is int and value in (0, 1):
        value = bool(value)
    if width is not None and isinstance(value, (list, tuple)):
        if len(value) != width:
            raise DiagramError(f"{len(value)} values for an array of {width}", where, f"give {width} values")
        return Vector(numeric(v, kind, None, where) for v in value)
    try:
        number = numbers.cast(value, kind)
    except DiagramError as error:
        raise DiagramError(error.what, where, error.remedy) from error
    return number if width is None else Vector([number] * width)


def limits(declared: Param) -> tuple[float, float]:
    """Return the limits of a parameter's numbers: its bounds and, for an integer, the range of its kind."""
    if declared.kind not in INTEGERS:
        return declared.low, declared.high
    kind = BY_NAME[declared.kind]
    return max(declared.low, kind.low), min(declared.high, kind.high)


def check_value(declared: Param, value: Any, path: str) -> Any:
    """Return `value` as plain numbers if the parameter may have it; else raise ParameterError.

    The bounds and the type's range are checked on the given numbers, before they are rounded.
    """
    try:
        value = plain_data(value, path)
        if declared.enum is not None:
            value = declared.enum.plain(value, path)
        with numbers.precision("float64"):
            number = numbers.plain(numeric(value, declared.kind, declared.width, path, declared.shape))
    except DiagramError as error:
        raise ParameterError(error.what, path, error.remedy) from error
    low, high = limits(declared)
    for one in _plain(value):
        if not low <= one <= high:
            raise ParameterError(outside(one, low, high, declared.unit), path, "choose a value within the bounds")
    return number


def unknown_parameter(path: object, known: Iterable[str]) -> ParameterError:
    """Return the error for an unknown parameter `path`, with up to 40 of the `known` ones, the most similar first."""
    return ParameterError(
        f"no parameter named {path!r:.120}", "", f"there are: {nearest(path, sorted(known), most=40)}"
    )


def unknown_name(what: str, name: object, known: Iterable[str], where: str) -> DiagramError:
    """Return the error for an unknown `name` of a signal, state or part (`what`), with similar `known` names."""
    return DiagramError(f"no {what} named {name!r:.120}", where, f"there are: {nearest(name, known)}")
