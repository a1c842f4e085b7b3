"""Translation of one Simulink block: what is asked, what it became, and the types of its signals."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.block import Block as LibraryBlock
from twodof.blocks.bus import Bus
from twodof.blocks.declarations import Port
from twodof.blocks.elementwise import port_series
from twodof.blocks.enumeration import Kind
from twodof.blocks.expressions.conversions import may_overflow
from twodof.blocks.expressions.numbers import BY_NAME, FLOATS, INTEGERS
from twodof.blocks.library import Convert, Demux, Gain, MatrixGain, Mux, ZeroOrderHold
from twodof.errors import DiagramError
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.values import Value, number
from twodof.slx.model import SimulinkBlock, collapsed


class NotTranslated(Exception):
    """Why a block cannot be imported."""


@dataclass(frozen=True)
class Signal:
    """The type of a signal: its kind in the block language, and its width; None of a scalar."""

    kind: Kind = "real"
    width: int | None = None
    """Number of elements: of a matrix too."""
    shape: tuple[int, int] | None = None
    bits: int = 0
    """Number of bits of a field of bits, which is narrower than its kind; 0 of another number."""

    def port(self, name: str) -> Port:
        """Return a port of this type."""
        return Port(name, self.kind, self.width, shape=self.shape)

    @property
    def number(self) -> str:
        """The kind of a number. Raises NotTranslated for a bus."""
        if not isinstance(self.kind, str):
            raise NotTranslated(f"an input that is {self} is not translated")
        return self.kind

    def like(self, other: "Signal") -> bool:
        """Return True if both have the same size and kind; of buses only the fields count."""
        kinds = [one.kind.leaves if isinstance(one.kind, Bus) else one.kind for one in (self, other)]
        return kinds[0] == kinds[1] and (self.width, self.shape) == (other.width, other.shape)

    def __str__(self) -> str:
        kind = f"the bus {self.kind.name}" if isinstance(self.kind, Bus) else str(self.kind)
        size = " x ".join(map(str, self.shape)) if self.shape else self.width
        return kind if size is None else f"{kind} [{size}]"


@dataclass
class Asked:
    """A block to be translated: its values as text, the names that they may use, and the signals at its inputs."""

    block: SimulinkBlock
    path: str
    values: dict[str, str]
    names: dict[str, Value]
    inputs: list[Signal]
    dt: float
    labels: list[str] = field(default_factory=list)
    """Names of the lines at the inputs; "" for a line without one."""
    loose: Sequence[int] = ()
    """Numbers of the inputs that nothing drives."""
    notes: list[str] = field(default_factory=list)
    """What is approximated."""
    folders: Sequence[Path] = ()
    """Where .m files of functions are."""

    def text(self, name: str, default: str = "") -> str:
        """Return a choice as it stands in the file."""
        return collapsed(self.values.get(name, default))

    def value(self, name: str, default: str) -> np.ndarray[Any, Any]:
        """Return a parameter's array. Raises NotTranslated, naming it."""
        found = self.structure(name, default)
        if not isinstance(found, np.ndarray):
            raise NotTranslated(f"parameter {name} = {self.values.get(name, default)[:60]} is not a number")
        return found

    def structure(self, name: str, default: str) -> Value:
        """Return a parameter's value of any kind. Raises NotTranslated, naming it."""
        try:
            return number(evaluate(self.values.get(name, default), self.names, name))
        except DiagramError as error:
            raise NotTranslated(f"parameter {name}: {error.what}") from None

    def scalar(self, name: str, default: str) -> float:
        """Return a parameter of one number. Raises NotTranslated for an array."""
        found = self.value(name, default)
        if found.size != 1:
            raise NotTranslated(f"parameter {name} has {found.size} elements, which is not translated")
        return float(found.flat[0])

    def needs(self, name: str, default: str, *known: str) -> str:
        """Return a choice that must be one of `known`."""
        found = self.text(name, default)
        if found not in known:
            raise NotTranslated(f"{name} = {found!r} is not translated")
        return found

    def only(self, **wanted: str) -> None:
        """Raise NotTranslated for a choice that is another than the wanted one, which is the default too."""
        for name, one in wanted.items():
            self.needs(name, one, one)

    def pick(self, name: str, default: str, choices: dict[str, Any]) -> Any:
        """Return what a choice stands for."""
        return choices[self.needs(name, default, *choices)]

    @property
    def width(self) -> int | None:
        """The width of the widest input: scalars are expanded to it."""
        widths = {one.width for one in self.inputs if one.width is not None}
        if len(widths) > 1:
            raise NotTranslated(f"its inputs have {' and '.join(map(str, sorted(widths)))} elements")
        return widths.pop() if widths else None

    def kind(self, *allowed: str) -> str:
        """Return the kind that all inputs have."""
        kinds = sorted({str(replace(one, width=None, shape=None)) for one in self.inputs})
        if len(kinds) != 1 or not set(kinds) <= set(allowed):
            raise NotTranslated(f"inputs of type {' and '.join(kinds)} are not translated")
        return kinds[0]


Item = LibraryBlock | Diagram


@dataclass
class Made:
    """The translation of a block: None where it only passes its inputs on, or is dropped."""

    item: Item | None
    outputs: list[Signal] = field(default_factory=list)
    """Those of a block are of its ports where nothing else is said."""

    def __post_init__(self) -> None:
        if not self.outputs and isinstance(self.item, LibraryBlock):
            self.outputs = [Signal(one.kind, one.width, one.shape) for one in self.item.outputs]


Rule = Callable[[Asked], Made]


def same(c: Asked, item: Item, kind: str = "real") -> Made:
    """Return a block with one output, as wide as its inputs."""
    return Made(item, [Signal(kind, c.width)])


def plain(value: Any, kind: Kind) -> Any:
    """Return a number as the parameter of a kind."""
    return bool(value) if kind == "bool" else float(value) if kind in FLOATS else int(value)


def widest(signals: Sequence[Signal]) -> Kind:
    """Return the kind that holds all signals: the one of several numbers that reaches highest, as Simulink takes it."""
    if all(replace(one, width=None).like(replace(signals[0], width=None)) for one in signals):
        return signals[0].kind
    rank = (*FLOATS, *sorted(INTEGERS, key=lambda kind: -BY_NAME[kind].high), "bool")
    return min((one.number for one in signals), key=rank.index)


def expanded(d: Diagram, source: str, signal: Signal, width: int | None, kind: Kind | None = None) -> str:
    """Return the source of a signal with this width and kind: a scalar is repeated, a number converted.

    Raises NotTranslated for another width.
    """
    if kind not in (None, signal.kind) and not isinstance(signal.kind, Bus):
        name, over = f"{source.replace('.', '_')}_{kind}", "wrap" if may_overflow(signal.number, str(kind)) else None
        source = d.add(name, Convert(signal.number, str(kind), width=signal.width, overflow=over), u=source)
        signal = replace(signal, kind=kind)
    if signal.width == width or width is None:
        return source
    if signal.width is not None:
        raise NotTranslated(f"an input of {signal.width} elements meets {width}")
    name = f"{source.replace('.', '_')}_expanded"
    if name not in d.parts and signal.kind == "real":
        d.add(name, MatrixGain([[1.0]] * width), u=source)
    elif name not in d.parts:
        d.add(name, Mux(width, signal.number), inputs=dict.fromkeys(port_series(width), source))
    return name


def each(rule: Rule, *parameters: str, wide: bool = False) -> Rule:
    """Return the rule of a block that takes the elements of its vectors one by one: of inputs and of `parameters`.

    With `wide` the rule takes vectors of inputs itself.
    """

    def of_all(c: Asked) -> Made:
        vectors = {name: c.value(name, "0").flatten(order="F") for name in parameters if name in c.values}
        sizes = {value.size for value in vectors.values() if value.size > 1}
        if not sizes and (wide or c.width is None):
            return rule(c)
        sizes |= set() if c.width is None else {c.width}
        if len(sizes) > 1:
            raise NotTranslated(f"its vectors have {' and '.join(map(str, sorted(sizes)))} elements")
        width = sizes.pop()
        alone = [replace(one, width=None, shape=None) for one in c.inputs]
        d, y = Diagram("each"), dict[str, str]()
        for k, one in enumerate(c.inputs):
            d.input(f"u{k}", one.kind, one.width)
            if one.width is not None:
                d.add(f"split{k}", Demux(width, one.kind), u=f"u{k}")
        for k, name in enumerate(port_series(width)):
            values = {key: repr(float(value[min(k, value.size - 1)])) for key, value in vectors.items()}
            made = rule(replace(c, inputs=list(alone), values={**c.values, **values}))
            one_of, output = made.item, made.outputs[0]
            if one_of is None or len(made.outputs) != 1 or len(names_of(one_of)) != len(alone):
                raise NotTranslated("its vector, or the number of its inputs, is not translated")
            sources = [f"u{j}" if one.width is None else f"split{j}.{name}" for j, one in enumerate(c.inputs)]
            d.add(f"of_{name}", one_of, inputs=dict(zip(names_of(one_of), sources, strict=True)))
            y[name] = f"of_{name}.{names_of(one_of, outputs=True)[0]}"
        d.add("y", Mux(width, output.number), inputs=y)
        d.output("y", "y")
        return Made(d, [replace(output, width=width)])

    return of_all


def row(block: Callable[..., LibraryBlock], *given: tuple[str, str]) -> Rule:
    """Return the rule of a library block whose arguments are numbers of the dialog, by name and default."""

    def rule(c: Asked) -> Made:
        if c.inputs:
            c.kind("real")
        return Made(block(*(c.scalar(*one) for one in given)))

    return each(rule, *(name for name, _ in given))


def names_of(item: Item, outputs: bool = False) -> list[str]:
    """Return the names of the inputs of a block or diagram, or of its outputs; a bus is one."""
    ports: Iterable[str | Port] = item.outputs if outputs else item.inputs
    return list(dict.fromkeys((port if isinstance(port, str) else port.name).partition(".")[0] for port in ports))


def signs(c: Asked, default: str) -> str:
    """Return the signs of the inputs of a Sum or Product, which says them or how many there are of the first kind."""
    said = c.text("Inputs", default).replace("|", "").replace(" ", "")
    return (
        said if not said.strip("+-" if default[0] == "+" else "*/") else default[0] * int(c.scalar("Inputs", default))
    )


def of_elements(c: Asked, rule: Rule) -> Made:
    """Return the block of a rule whose inputs are the elements of the one vector."""
    one, width = c.inputs[0], c.inputs[0].width or 1
    made = rule(replace(c, inputs=[replace(one, width=None)] * width))
    if made.item is None:
        raise NotTranslated("its vector is not translated")
    d = Diagram("elements")
    d.add("each", Demux(width, one.number), u=d.input("u", one.kind, one.width))
    elements = [f"each.{name}" for name in port_series(width)]
    d.add("y", made.item, inputs=dict(zip(names_of(made.item), elements, strict=True)))
    d.output("y", "y")
    return Made(d, made.outputs)


def passes(c: Asked) -> Made:
    """Return a block that passes its input on: within a step of an integrator too, where it is a number."""
    one = c.inputs[0]
    return Made(straight(one), [one])


def straight(one: Signal) -> LibraryBlock:
    """Return a block whose output is its input, of this type."""
    return Gain(1.0, one.width) if one.kind == "real" and one.shape is None else ZeroOrderHold(one.kind, one.width)


def holds(c: Asked) -> Made:
    """Return a block that holds its input until the next step."""
    one = c.inputs[0]
    return Made(ZeroOrderHold(one.kind, one.width), [one])


TYPES = {
    "double": "real",
    "single": "real",  # but see data_types.SINGLE
    "boolean": "bool",
    "logical": "bool",
    **{name: name for name in INTEGERS},
    **dict.fromkeys(("int64", "uint64"), "float64"),  # which holds whole numbers up to 2^53
}
"""Data types that have a kind here."""
