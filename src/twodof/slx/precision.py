"""Models that mix single and double: each number is rounded as its type says, whatever the precision of the build.

A signal of type single is a float32. A block whose numbers are all single computes in float32; any other one computes
in the build's precision, and a result of type single is rounded then.
Source: Simulink reference, data types of Sum, Product, Gain and others: the internal rule keeps single among singles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

from twodof.blocks import Diagram
from twodof.blocks.block import Block, Clock
from twodof.blocks.bus import grouped
from twodof.blocks.elementwise import elementwise
from twodof.blocks.expressions.expr import convert
from twodof.slx.composite_blocks import Formula
from twodof.slx.matlab.function_block import MatlabFunction
from twodof.slx.matrices import MATRIX_LINES
from twodof.slx.translation import Asked, Item, Made, NotTranslated, Signal, expanded, names_of

ROUTES = ("BusAssignment", "BusCreator", "BusSelector", "Concatenate", "Constant", "DataStoreMemory", "DataStoreRead",
          "DataStoreWrite", "Demux", "Ground", "Inport", "Memory", "Merge", "Mux", "RateTransition",
          "Selector", "SignalConversion", "SignalSpecification", "UnitDelay", "ZeroOrderHold")  # fmt: skip
"""Types that compute nothing: their rules take float32 as any other kind."""


class InSingle(Block):
    """A block that computes in float32: its inputs, outputs and states are, and its parameters become it when used."""

    def __init__(self, block: Block) -> None:
        self.block = block
        self.inputs, self.outputs, self.derived = (
            [replace(one, kind="float32") if one.kind == "real" else one for one in many]
            for many in (block.inputs, block.outputs, block.derived)
        )
        self.states = [replace(one, kind="float32") if one.kind == "real" else one for one in block.states]
        starts = [one.initial for one in block.states if one.kind == "real"]
        self.params = [replace(one, kind="float32") if one.name in starts else one for one in block.params]

    def prepare(self, p: Any, t: Clock) -> Any:
        """Compute the derived parameters in float64, and round them."""
        return _narrow(self.block.prepare(p, t))

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Compute the outputs."""
        return _narrow(self.block.output(u, x, _Narrow(p), cast(Clock, _Narrow(t))))

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Compute the next states."""
        return _narrow(self.block.update(u, x, _Narrow(p), cast(Clock, _Narrow(t))))


class _Narrow:
    """Parameters, or the clock, whose numbers are float32."""

    def __init__(self, values: Any) -> None:
        self._values = values

    def __getattr__(self, name: str) -> Any:
        return _narrow(getattr(self._values, name))

    def __getitem__(self, name: str) -> Any:
        return _narrow(self._values[name])


def _narrow(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _narrow(one) for name, one in value.items()}

    def one(v: Any) -> Any:
        kind = getattr(v, "kind", "real" if isinstance(v, float) else "")
        return convert(v, "float32") if kind == "real" else v

    return elementwise(one, value)


def precise(c: Asked, made: Made, inputs: Sequence[Signal]) -> Made:
    """Return the block with `inputs` of single and double where `made` has those of `c`, which are all real."""
    lines = isinstance(made.item, MatlabFunction) and c.block.kind in MATRIX_LINES
    if (c.block.type in ROUTES and not lines) or made.item is None:
        return made
    parts = {"Switch": [*inputs[:1], *inputs[2:]], "MultiPortSwitch": inputs[1:]}
    parts |= dict.fromkeys(("Delay", "DiscreteIntegrator"), inputs[:1])
    data = parts.get(c.block.type, inputs)
    floats = [one for one in data if one.kind in ("real", "float32")]
    said = c.text("OutDataTypeStr", "Inherit")
    alike = bool(floats) and all(one.kind == "float32" for one in floats)
    same = said.startswith("Inherit: Same as first") and bool(floats) and floats[0].kind == "float32"
    single = said == "single" or (said.startswith("Inherit") and (alike or same))
    outputs = [replace(one, kind="float32") if single and one.kind == "real" else one for one in made.outputs]
    if alike and all(one.kind != "real" for one in (*data, *outputs)):
        narrowed = InSingle(made.item) if lines and isinstance(made.item, Block) else _narrowed(made.item)
        if narrowed is not None:
            made = Made(narrowed, outputs)
            if all(one.kind != "real" for one in inputs):
                return made
            return Made(_converted(made, inputs, outputs, "float32"), outputs)
    if made.outputs == outputs and all(one.kind != "float32" for one in inputs):
        return made
    return Made(_converted(made, inputs, outputs), outputs)


def _narrowed(item: Item) -> Item | None:
    """Return a block, or a diagram of blocks, that computes in float32; None for one that cannot."""
    if isinstance(item, Block):
        unfit = isinstance(item, MatlabFunction) or any(one.continuous for one in item.states)
        return None if unfit else InSingle(item)
    d = Diagram(item.name)
    for port in item.inputs.values():
        d.declare(replace(port, kind="float32") if port.kind == "real" else port)
    for name, part in item.parts.items():
        inner = _narrowed(part.item)
        if inner is None or part.enable:
            return None
        d.add(name, inner, reset=part.reset)
    for (name, pin), source in item.connections.items():
        d.connect(source, f"{name}.{pin}")
    for given, output in item.outputs.items():
        d.output(given, str(output))
    return d


def _converted(made: Made, inputs: Sequence[Signal], outputs: Sequence[Signal], kind: str = "real") -> Diagram:
    """Return a diagram that computes in `kind` with converted inputs, and rounds the results that are single."""
    d, item = Diagram("precise"), made.item
    assert item is not None
    ports = grouped(item.inputs if isinstance(item, Block) else list(item.inputs.values()))
    sources = {}
    if len(ports) != len(inputs):
        raise NotTranslated(f"{len(inputs)} inputs of single and double among {len(ports)} are not translated")
    for port, (k, one) in zip(ports, enumerate(inputs, start=1), strict=True):
        source = d.input(f"u{k}", one.kind, one.width)
        if one.shape is not None:
            raise NotTranslated("a matrix of singles among doubles is not translated")
        if one.kind in ("real", "float32") and one.kind != kind:
            source = f"{d.add(f'as{k}', _conversion(one, kind), u1=source)}.y"
            one = replace(one, kind=kind)
        sources[port.name] = expanded(d, source, one, port.width if one.width is None else None)
    d.add("of", item, inputs=sources)
    for k, (name, before, after) in enumerate(
        zip(names_of(item, outputs=True), made.outputs, outputs, strict=True), start=1
    ):
        source = f"of.{name}"
        if after.kind != before.kind:
            source = f"{d.add(f'round{k}', _conversion(before, 'float32'), u1=source)}.y"
        d.output(f"y{k}", source)
    return d


def _conversion(one: Signal, kind: str) -> Formula:
    return Formula(lambda t, u: convert(u, kind), [one], Signal(kind, one.width))
