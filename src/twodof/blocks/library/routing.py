"""Signal routing: switches, mux, demux and selector; the choice of one action among several and the merge of theirs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from operator import and_, or_
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.bus import Bus, expanded
from twodof.blocks.declarations import MAX_WIDTH, Param, Port, State
from twodof.blocks.elementwise import Recurrent, count, counts, elementwise, port_series, sized
from twodof.blocks.enumeration import Kind
from twodof.blocks.expressions.arrays import concatenate, flat_of, shaped, vector
from twodof.blocks.expressions.expr import int32, where
from twodof.errors import DiagramError, nearest

__all__ = [
    "BusAssign",
    "BusCreate",
    "BusSelect",
    "CaseChoice",
    "Concatenate",
    "Demux",
    "FirstTrue",
    "Index",
    "Merge",
    "MultiportSwitch",
    "Mux",
    "Reshape",
    "Selector",
    "Switch",
]


@library_block("switch")
class Switch(Block):
    """y = a where the bool `condition` is true, else b."""

    def __init__(self, kind: Kind = "real", width: int | None = None, unit: str = "") -> None:
        self.inputs = [Port("condition", "bool"), Port("a", kind, width, unit), Port("b", kind, width, unit)]
        self.outputs = [Port("y", kind, width, unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return elementwise(lambda a, b: where(u.condition, a, b), u.a, u.b)


@library_block("reshape")
class Reshape(Block):
    """The elements of u as an array of another shape, column after column.

    `shape` is that of u, `to` that of y: [n] of a vector, [rows, columns] of a matrix.
    """

    def __init__(
        self, shape: Sequence[int] = (4,), to: Sequence[int] = (2, 2), kind: Kind = "real", unit: str = ""
    ) -> None:
        self.inputs = [sized("u", shape, kind, unit)]
        self.outputs = [sized("y", to, kind, unit)]
        if self.inputs[0].width != self.outputs[0].width:
            raise DiagramError(f"shape={shape!r:.80}, to={to!r:.80}", "Reshape", "both have as many elements")

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return shaped(flat_of(u.u), self.outputs[0].shape)


@library_block("multiport_switch")
class MultiportSwitch(Block):
    """y is the input that the int32 `index` selects, from 0 on. An index beyond the ends takes the first or last."""

    def __init__(self, inputs: int = 2, kind: Kind = "real", width: int | None = None, unit: str = "") -> None:
        self.names = port_series(inputs)
        self.inputs = [Port("index", "int32"), *(Port(name, kind, width, unit) for name in self.names)]
        self.outputs = [Port("y", kind, width, unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        def of(*values: Any, first: int = 0) -> Any:
            """Halved again and again: a chain of a thousand conditions takes a C compiler a minute."""
            if len(values) == 1:
                return values[0]
            half = (len(values) - 1) // 2 + 1
            low, high = of(*values[:half], first=first), of(*values[half:], first=first + half)
            return where(u.index < first + half, low, high)

        return elementwise(of, *(u[name] for name in self.names))


@library_block("mux")
class Mux(Block):
    """y = [a, b, c, ...]: an array of the scalar inputs."""

    def __init__(self, inputs: int = 2, kind: Kind = "real", unit: str = "") -> None:
        self.inputs = [Port(name, kind, unit=unit) for name in port_series(inputs)]
        self.outputs = [Port("y", kind, inputs, unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return vector([u[port.name] for port in self.inputs])


@library_block("demux")
class Demux(Block):
    """a = u[0], b = u[1], ...: the elements of an array as scalar outputs."""

    def __init__(self, outputs: int = 2, kind: Kind = "real", unit: str = "") -> None:
        self.outputs = [Port(name, kind, unit=unit) for name in port_series(outputs)]
        self.inputs = [Port("u", kind, outputs, unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {port.name: u.u[i] for i, port in enumerate(self.outputs)}


@library_block("selector")
class Selector(Block):
    """y[i] = u[indices[i]], u of `width` elements, indices from 0; one index gives a scalar."""

    def __init__(self, width: int = 2, indices: Sequence[int] = (0,), kind: Kind = "real", unit: str = "") -> None:
        self.indices = counts(indices, 0, count(width, 1, MAX_WIDTH, "width") - 1, "indices")
        count(len(self.indices), 1, MAX_WIDTH, "number of indices")
        self.inputs = [Port("u", kind, width, unit)]
        self.outputs = [Port("y", kind, None if len(self.indices) == 1 else len(self.indices), unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        if len(self.indices) == 1:
            return u.u[self.indices[0]]
        return vector([u.u[i] for i in self.indices])


@library_block("index")
class Index(Block):
    """y = u[index], `index` an int32 input counted from 0 and clamped to the array."""

    def __init__(self, width: int = 2, kind: Kind = "real", unit: str = "") -> None:
        self.inputs = [Port("u", kind, width, unit), Port("index", "int32")]
        self.outputs = [Port("y", kind, unit=unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.u[u.index]


@library_block("concatenate")
class Concatenate(Block):
    """y = the elements of a, then of b, c, ...; `widths` are the widths of the inputs."""

    def __init__(self, widths: Sequence[int] = (2, 2), kind: Kind = "real", unit: str = "") -> None:
        sizes = counts(widths, 1, MAX_WIDTH, "widths")
        self.inputs = [Port(n, kind, w, unit) for n, w in zip(port_series(len(sizes)), sizes, strict=True)]
        self.outputs = [Port("y", kind, sum(sizes), unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return concatenate([u[port.name] for port in self.inputs])


@library_block("bus_create")
class BusCreate(Block):
    """bus = the inputs as fields of a bus. An input has its field's name; one that is a bus itself is one input."""

    def __init__(self, bus: Any = ("a", "b")) -> None:
        made = _bus(bus)
        self.inputs = made.leaves
        self.outputs = [Port("bus", made)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {f"bus.{port.name}": u[port.name] for port in self.inputs}


@library_block("bus_select")
class BusSelect(Block):
    """Fields of a bus as outputs of their own names, "rates.p" as `rates_p`; a field that is a bus stays one.

    Where a signal is named, the path of a field ("imu.att.rates.p") does the same without a block.
    """

    def __init__(self, bus: Any = ("a", "b"), fields: Sequence[str] = ("a",)) -> None:
        made = _bus(bus)
        self.inputs = [Port("bus", made)]
        self.outputs = []
        self.sources: dict[str, str] = {}
        for field in fields:
            found = [leaf for leaf in made.leaves if leaf.name == field or leaf.name.startswith(f"{field}.")]
            if not found:
                there = nearest(field, [leaf.name for leaf in made.leaves])
                raise DiagramError(
                    f"{made.name} has no field {field!r:.120}", "BusSelect.fields", f"there are: {there}"
                )
            for leaf in found:
                name = f"{field.replace('.', '_')}{leaf.name[len(field) :]}"
                self.outputs = [*self.outputs, replace(leaf, name=name)]
                self.sources[name] = f"bus.{leaf.name}"

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {name: u[source] for name, source in self.sources.items()}


@library_block("bus_assign")
class BusAssign(Block):
    """y = the bus u with some fields replaced by the inputs of their names; "rates.p" is replaced by `rates_p`."""

    def __init__(self, bus: Any = ("a", "b"), fields: Sequence[str] = ("a",)) -> None:
        made = _bus(bus)
        select = BusSelect(made, fields)
        self.sources = {source.removeprefix("bus."): name for name, source in select.sources.items()}
        self.inputs = [*expanded([Port("u", made)]), *select.outputs]
        self.outputs = [Port("y", made)]
        self.leaves = [leaf.name for leaf in made.leaves]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {f"y.{name}": u[self.sources.get(name, f"u.{name}")] for name in self.leaves}


def _bus(given: Any) -> Bus:
    """Return the bus that an argument describes: a Bus, its plain form, or a list of the names of real fields."""
    if isinstance(given, (list, tuple)) and all(isinstance(name, str) for name in given):
        given = Bus("bus", [Port(name) for name in given])
    kind = Port("bus", given).kind if isinstance(given, (Bus, Mapping)) else None
    if not isinstance(kind, Bus):
        raise DiagramError(f"bus={given!r:.80}", "", 'give Bus("Name", [Port(...), ...]), or names of real fields')
    return kind


@library_block("first_true")
class FirstTrue(Block):
    """if, else if, else: the output of the first true condition is true, else `otherwise` is.

    The conditions are a, b, ... in this order. Exactly one output is true. `action_group` (module
    `twodof.blocks.action_group`) makes sub-diagrams act by it.
    """

    def __init__(self, conditions: int = 2) -> None:
        self.names = port_series(conditions)
        self.inputs = [Port(name, "bool") for name in self.names]
        self.outputs = [Port(name, "bool") for name in (*self.names, "otherwise")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        found: dict[str, Any] = {}
        none: Any = None  # whether none was true so far
        for name in self.names:
            found[name] = u[name] if none is None else u[name] & none
            none = ~u[name] if none is None else none & ~u[name]
        return {**found, "otherwise": none}


@library_block("case_choice")
class CaseChoice(Block):
    """switch: the output of the first case that has the int32 u among its values is true, else `otherwise` is.

    `cases` are lists of whole numbers, one for each output a, b, ...; exactly one output is true.
    """

    def __init__(self, cases: Sequence[Sequence[int]] = ((0,), (1,))) -> None:
        self.names = port_series(len(cases))
        self.cases = [counts(values, -(2**31), 2**31 - 1, "case") for values in cases]
        for values in self.cases:
            count(len(values), 1, MAX_WIDTH, "number of values of a case")
        self.inputs = [Port("u", "int32")]
        self.outputs = [Port(name, "bool") for name in (*self.names, "otherwise")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        found: dict[str, Any] = {}
        seen: set[int] = set()
        for name, values in zip(self.names, self.cases, strict=True):
            fresh = [v for v in dict.fromkeys(values) if v not in seen]  # the first case that has a value gets it
            seen.update(fresh)
            found[name] = reduce(or_, (u.u == int32(v) for v in fresh)) if fresh else False
        return {**found, "otherwise": reduce(and_, (u.u != int32(v) for v in sorted(seen)))}


@library_block("merge")
class Merge(Recurrent):
    """y is the input whose part acts: a where `a_acts`, else b where `b_acts`, ...; where none acts the last y stays.

    Before the first y is `initial`. For the outputs of parts of which at most one acts at a time.
    """

    def __init__(
        self, inputs: int = 2, initial: Any = 0, kind: Kind = "real", width: int | None = None, unit: str = ""
    ) -> None:
        self.names = port_series(inputs)
        self.ports(self.names, kind, width, unit)
        self.inputs = [*self.inputs, *(Port(f"{name}_acts", "bool") for name in self.names)]
        self.params = [Param("initial", initial, kind, width, unit)]
        self.states = [State("x", "initial", kind, width, unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        def of(last: Any, *values: Any) -> Any:
            y = last
            for name, value in reversed(list(zip(self.names, values, strict=True))):
                y = where(u[f"{name}_acts"], value, y)
            return y

        return elementwise(of, x.x, *(u[name] for name in self.names))
