"""A Simulink model as it stands in its file: systems of blocks and lines, masks, charts, callbacks and solver.

`read_model(path)` reads .slx and .mdl of all releases. Values are the file's MATLAB text: nothing is computed here.
Paths are compared with each run of white space as one space, as a name may hold a line break.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twodof.errors import DiagramError, LogError
from twodof.flightlog import fence
from twodof.slx.reader import plain_model


@dataclass(frozen=True)
class Pin:
    """One end of a line: the identifier of a block, `out`, `in`, `enable` or another kind of port, and its number."""

    sid: str
    kind: str
    number: int

    @classmethod
    def parse(cls, text: str) -> "Pin":
        """Read `12:5#out:1` or `12#enable`."""
        sid, _, port = text.rpartition("#")
        kind, _, number = port.partition(":")
        return cls(sid, kind.lower(), int(number) if number.isdigit() else 1)


@dataclass
class Wire:
    """A line or a branch of one: its way as offsets (dx, dy), and where it ends or parts."""

    points: list[tuple[float, float]]
    sink: Pin | None
    branches: list["Wire"]

    def sinks(self) -> Iterator[Pin]:
        """Yield the pins that are driven."""
        stack = [self]
        while stack:
            at = stack.pop()
            if at.sink is not None:
                yield at.sink
            stack += at.branches


@dataclass
class Line:
    """A signal: its name, the pin that drives it (None where it hangs in the air) and its wire."""

    name: str
    source: Pin | None
    wire: Wire


@dataclass
class Mask:
    """A mask: its parameters by name, each with its kind (`edit`, `popup`, `checkbox`) and text, and its code."""

    kind: str
    parameters: dict[str, tuple[str, str]]
    initialization: str

    @property
    def computed(self) -> dict[str, str]:
        """The parameters whose text is an expression."""
        return {name: text for name, (kind, text) in self.parameters.items() if kind in COMPUTED}


COMPUTED = ("edit", "promote")
"""Kinds of a mask's parameters that are expressions: one that is promoted from inside may be a choice too."""


@dataclass
class SimulinkBlock:
    """A block: its type, name, identifier (SID), the parameters that the file gives, its mask and what is inside."""

    type: str
    name: str
    sid: str
    values: dict[str, str]
    instance: dict[str, str] = field(default_factory=dict)
    """What a link to a library gives its block."""
    ports: tuple[int, int] | None = None
    """Numbers of inputs and outputs; None where the file leaves the type's own."""
    signals: dict[int, str] = field(default_factory=dict)
    """Names of the signals by the output's number."""
    mask: Mask | None = None
    system: "System | None" = None

    @property
    def kind(self) -> str:
        """The block's kind for a reader: its type, the library block of a link, or MATLAB Function and Chart."""
        if self.type == "Reference":
            return collapsed(self.values.get("SourceBlock", "")).rpartition("/")[2] or "Reference"
        special = self.values.get("SFBlockType", "NONE")
        return special if special not in ("NONE", "") else self.type

    @property
    def commented(self) -> bool:
        """True if it is commented out, or through."""
        return self.values.get("Commented", "off") != "off"

    @property
    def place(self) -> tuple[float, float, float, float] | None:
        """Left, top, right and bottom on its sheet; None where the file does not say."""
        numbers = [float(one) for one in re.findall(r"-?\d+(?:\.\d+)?", self.values.get("Position", ""))]
        if len(numbers) != 4 or max(map(abs, numbers)) >= 1e6:
            return None
        a, b, c, d = numbers
        return min(a, c), min(b, d), max(a, c), max(b, d)


@dataclass
class System:
    """A sheet: its blocks by identifier, and its lines."""

    blocks: dict[str, SimulinkBlock]
    lines: list[Line]

    def ports(self, kind: str) -> list[str]:
        """Return the names of the Inports or Outports by their number."""
        found = [one for one in self.blocks.values() if one.type == kind]
        return [collapsed(one.name) for one in sorted(found, key=port_number)]

    def walk(self, path: str = "") -> Iterator[tuple[str, "System"]]:
        """Yield this system and all below it with their paths, `Controller/PID`, in the order of the file."""
        yield path, self
        for block in self.blocks.values():
            if block.system is not None:
                yield from block.system.walk(below(path, block))


CODED = ("MATLAB Function", "Chart")
"""Kinds of blocks that are translated from their code."""


@dataclass
class SimulinkChart:
    """A MATLAB Function or a Stateflow chart: its path, and the code or labels in it."""

    path: str
    function: bool
    text: str
    form: Mapping[str, Any] | None = None
    """Its states and transitions as the reader gives them; None where they are not read."""


@dataclass
class Model:
    """A model, library or subsystem file."""

    name: str
    kind: str
    release: str
    version: str
    solver: dict[str, str]
    callbacks: dict[str, str]
    dictionary: str
    """Name of the data dictionary's file; "" without one."""
    defaults: dict[str, dict[str, str]]
    """Parameters that the file gives to all blocks of a type."""
    root: System
    charts: list[SimulinkChart]

    def blocks(self) -> Iterator[tuple[str, SimulinkBlock]]:
        """Yield each block with its path from the model's top."""
        for path, system in self.root.walk():
            for block in system.blocks.values():
                yield below(path, block), block

    def texts(self) -> Iterator[str]:
        """Yield what may name a member of an enumeration: values of blocks, and code."""
        for _, block in self.blocks():
            yield from (*block.values.values(), *block.instance.values())
        yield from (one.text for one in self.charts)

    def place(self, path: str) -> str:
        """Return a system's path as the file has it, where `path` may leave out space around names; "" is the top.

        Raises DiagramError if there is no such system.
        """
        wanted = one_spaced(path).strip("/")
        found = [at for at, _ in self.root.walk()]
        alike = [at for at in found if _trimmed(at) == _trimmed(wanted)]
        if wanted in found or len(alike) == 1:
            return wanted if wanted in found else alike[0]
        for at, block in self.blocks():
            source = block.values.get("ReferencedSubsystem") or one_spaced(block.values.get("SourceBlock", ""))
            if source and f"{wanted}/".startswith(f"{at}/"):
                what = f"has no subsystem {path}: {at} is a link to {source}"
                raise DiagramError(what, self.name, "give that file, and the subsystem's path in it")
        known = ", ".join(map(repr, alike)) or ", ".join(found[1:9]) or "none"
        raise DiagramError(f"has no subsystem {path}", self.name, f"its first ones are: {known}")

    def system(self, path: str) -> System:
        """Return the system at a path, as `place` reads it."""
        return dict(self.root.walk())[self.place(path)]


def port_number(block: SimulinkBlock) -> int:
    """Return the number of an Inport or Outport."""
    said = block.values.get("Port", "1")
    return int(said) if said.isdigit() else 1


def source_file(block: SimulinkBlock) -> str:
    """Return the name of the file that a block's inside is in: a library, a subsystem or a model; "" without one."""
    if block.type == "ModelReference":
        return re.sub(r"\.(slx|mdl|slxp)$", "", block.values.get("ModelNameDialog", block.values.get("ModelName", "")))
    if block.type == "Reference":
        return collapsed(block.values.get("SourceBlock", "")).partition("/")[0]
    return block.values.get("ReferencedSubsystem", "")


def collapsed(text: str) -> str:
    """Return a text with each run of white space as one space, and none around it."""
    return " ".join(text.split())


def one_spaced(path: str) -> str:
    """Return a path with each run of white space as one space: two names may differ in a space at the end."""
    return re.sub(r"\s+", " ", path)


def split_path(path: str) -> list[str]:
    """Return the names in a path, in which a slash of a name is doubled."""
    return re.split(r"(?<!/)/(?!/)", path)


def _trimmed(path: str) -> list[str]:
    return [name.strip() for name in split_path(path)]


def below(path: str, block: SimulinkBlock) -> str:
    """Return the path of a block in the system at `path`, "" for the top."""
    return f"{path}/{escaped(block.name)}".lstrip("/")


def escaped(name: str) -> str:
    """Return a name as it stands in a path: Simulink doubles a slash."""
    return one_spaced(name).replace("/", "//")


def read_model(path: str | Path) -> Model:
    """Read a model, library or subsystem file: .slx, or .mdl of both kinds.

    Raises DiagramError, with the remedy, for what is not one, is damaged, or takes more than the fence's limits.
    """
    try:
        plain, _ = fence.read(plain_model, path)
    except LogError as reason:
        remedy = "give a .slx or .mdl file; open a damaged one in Simulink and save it again"
        raise DiagramError(reason.what, reason.where, remedy) from reason
    charts = [SimulinkChart(one_spaced(path), *one) for path, *one in plain.pop("charts")]
    model = Model(name=Path(path).stem, root=_system(plain.pop("root")), charts=charts, **plain)
    for _, block in model.blocks():  # a link of a library into itself
        source = block.values.get("SourceBlock", "")
        if source.startswith("$bdroot/"):
            block.values["SourceBlock"] = source.replace("$bdroot", model.name, 1)
    return model


def _system(plain: Mapping[str, Any]) -> System:
    blocks = {one["sid"]: _block(one) for one in plain["blocks"]}
    lines = [Line(name, Pin.parse(source) if source else None, _wire(wire)) for name, source, wire in plain["lines"]]
    return System(blocks, lines)


def _block(plain: dict[str, Any]) -> SimulinkBlock:
    mask, system, ports = plain.pop("mask", None), plain.pop("system", None), plain.pop("ports", None)
    return SimulinkBlock(
        **{**plain, "signals": {int(k): v for k, v in plain.get("signals", {}).items()}},
        mask=None if mask is None else Mask(mask[0], {k: (v[0], v[1]) for k, v in mask[1].items()}, mask[2]),
        system=None if system is None else _system(system),
        ports=None if ports is None else (ports[0], ports[1]),
    )


def _wire(plain: list[Any]) -> Wire:
    points, sink, branches = plain
    numbers = [float(one) for one in re.findall(r"-?\d+(?:\.\d+)?", points)]
    pairs = list(zip(numbers[::2], numbers[1::2], strict=False))
    return Wire(pairs, Pin.parse(sink) if sink else None, [_wire(one) for one in branches])
