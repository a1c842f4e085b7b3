"""Variables of an FMU as FMI names, types and orders them, and the modelDescription.xml that lists them."""

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from xml.etree import ElementTree as Xml

import numpy as np

from twodof import __version__
from twodof.blocks.declarations import Param, limits
from twodof.blocks.expressions.numbers import BY_NAME, FLOATS, INTEGERS, dtype_of
from twodof.compile.program.flat_program import FlatProgram, FlatSignal
from twodof.compile.target import EmittedProgram
from twodof.errors import DiagramError

MOST_SCALARS = 10_000


@dataclass(frozen=True)
class FmuVariable:
    """A variable of an FMU; its value reference is its place in the list.

    `causality` is "independent", "input", "output" or "parameter"; `kind` is a type of the language, but never "real".
    `place` is a member of the C struct `Memory`, in which element `first` of a vector or matrix begins the variable.
    `shape` is () for a scalar. `start` has the elements row after row, and is empty for an output. `low` and `high` are
    bounds in the variable's own type, and `members` are those of an enumeration.
    """

    name: str
    causality: str
    kind: str
    place: str
    shape: tuple[int, ...] = ()
    first: int = 0
    unit: str = ""
    text: str = ""
    start: tuple[float, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    tunable: bool = True
    members: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def row(self) -> str:
        """Initializer of the variable's `Variable` in C."""
        causality = "f" if self.causality == "parameter" and not self.tunable else self.causality[0]
        rows = self.shape[0] if len(self.shape) == 2 else 1
        offset = f"offsetof(Memory, {self.place}) + {self.first * np.dtype(BY_NAME[self.kind].dtype).itemsize}u"
        of = f"'{causality}', '{BY_NAME[self.kind].letter}', {self.size}u, {rows}u, {offset}"
        members = f"(const int32_t[]){{{', '.join(map(str, self.members))}}}" if self.members else "NULL"
        return f'{{"{self.name}", {of}, {_hex(self.low)}, {_hex(self.high)}, {len(self.members)}u, {members}}},'


def fmu_variables(emitted: EmittedProgram, version: str) -> list[FmuVariable]:
    """Return the variables of the FMU of a program, in the order of their value references.

    FMI 3.0 has vectors and matrices, and the time. In FMI 2.0 they are scalars, `v[1]` and `m[1,2]`, counted from 1.
    An output with the name of an input is called `name_out`. Raises DiagramError in FMI 2.0 for a uint32, and for more
    than MOST_SCALARS elements.
    """
    found: dict[str, FmuVariable] = {}
    time = FmuVariable("time", "independent", "float64", "time", unit="s")
    for v in (*_variables(emitted), *([time] if version == "3.0" else [])):
        name = v.name
        while name in found:
            name += _SUFFIXES[v.causality]
        found[name] = replace(v, name=name)
    if version == "3.0":
        return list(found.values())
    _check_scalars(found.values())
    return [scalar for v in found.values() for scalar in _scalars(v)]


_SUFFIXES = {"output": "_out", "parameter": "_parameter", "independent": "_"}


def _variables(emitted: EmittedProgram) -> Iterator[FmuVariable]:
    flat, layout = emitted.flat, emitted.layout
    for name, signal in flat.inputs.items():
        made = _variable(emitted, name, "input", f"u.{layout.inputs[signal].name}", signal)
        if made.kind in INTEGERS:
            made = replace(made, low=BY_NAME[made.kind].low, high=BY_NAME[made.kind].high)
        yield replace(made, start=(0,) * made.size)
    for path, signal in flat.outputs.items():
        yield _variable(emitted, path, "output", f"y.{layout.outputs[path].name}", signal)
    for path, parameter in flat.parameters.items():
        d = parameter.declared
        made = _variable(emitted, path, "parameter", f"p.{layout.parameters[parameter].name}", d)
        dtype = np.dtype(BY_NAME[made.kind].dtype)
        start = np.broadcast_to(np.asarray(d.value, dtype), made.shape).ravel().tolist()
        with np.errstate(over="ignore"):  # a bound that float32 does not hold is infinite
            low, high = (float(dtype.type(b)) if made.kind == "float32" else b for b in limits(d))
        if made.kind in INTEGERS:
            low, high = math.ceil(low), math.floor(high)
        text = "; ".join(filter(None, (d.text, made.text)))
        yield replace(made, start=tuple(start), low=low, high=high, text=text, tunable=d.tunable)


def _variable(
    emitted: EmittedProgram, name: str, causality: str, place: str, declared: FlatSignal | Param
) -> FmuVariable:
    kind = dtype_of(declared.kind, emitted.precision).name
    shape = declared.shape or (() if declared.width is None else (declared.width,))
    members = {} if declared.enum is None else declared.enum.members
    # An integer has no unit in FMI.
    unit, told = (declared.unit, "") if kind in FLOATS else ("", f"[{declared.unit}]" if declared.unit else "")
    text = " ".join(filter(None, (told, ", ".join(f"{value}: {name}" for name, value in members.items()))))
    made = FmuVariable(name, causality, kind, place, shape, unit=unit, text=text)
    return replace(made, members=tuple(members.values()))


def _check_scalars(found: Collection[FmuVariable]) -> None:
    remedy = "export it for FMI 3.0 (--fmi 3.0)"
    for v in found:
        if v.kind == "uint32":
            raise DiagramError("FMI 2.0 has no uint32", v.name, remedy)
    if sum(v.size for v in found) > MOST_SCALARS:
        longest = max(found, key=lambda v: v.size)
        what = f"FMI 2.0 has no arrays, and their elements are more than {MOST_SCALARS} scalars"
        raise DiagramError(what, longest.name, remedy)


def _scalars(v: FmuVariable) -> Iterator[FmuVariable]:
    """Yield the elements of a vector or matrix, row after row, as variables of their own."""
    for k, index in enumerate(product(*map(range, v.shape))):
        name = f"{v.name}[{','.join(str(i + 1) for i in index)}]" if index else v.name
        first = index[1] * v.shape[0] + index[0] if len(index) == 2 else k
        yield replace(v, name=name, shape=(), first=first, start=v.start[k : k + 1])


def _hex(bound: float) -> str:
    return float(bound).hex() if math.isfinite(bound) else f"{'-' if bound < 0 else ''}__builtin_inf()"


Attributes = dict[str, str]


def model_description(
    program: FlatProgram, variables: Sequence[FmuVariable], version: str, token: str, source: str
) -> bytes:
    """Return modelDescription.xml of the FMU of `program`, for FMI `version`, "2.0" or "3.0".

    `token` is the instantiation token (in FMI 2.0 the GUID), and `source` the name of the C file.
    """
    newer = version == "3.0"
    about = {
        "fmiVersion": version,
        "modelName": program.name,
        "instantiationToken" if newer else "guid": token,
        "description": _printable(program.text),
        "generationTool": f"twodof {__version__}",
        "variableNamingConvention": "structured",
    }
    root = Xml.Element("fmiModelDescription", about)
    period = repr(program.dt)
    abilities = {"modelIdentifier": program.name, "canHandleVariableCommunicationStepSize": "true"}
    state = "FMUState" if newer else "FMUstate"
    abilities |= {f"canGetAndSet{state}": "true", f"canSerialize{state}": "true"}
    simulation = _add(root, "CoSimulation", abilities | ({"fixedInternalStepSize": period} if newer else {}))
    if not newer:
        _add(_add(simulation, "SourceFiles"), "File", {"name": source})
    units = sorted({_printable(v.unit) for v in variables if _printable(v.unit)})
    if units:
        listed = _add(root, "UnitDefinitions")
        for unit in units:
            _add(listed, "Unit", {"name": unit})
    _add(_add(root, "LogCategories"), "Category", {"name": "logStatusError"})
    _add(root, "DefaultExperiment", {"startTime": "0", "stepSize": period})
    listed = _add(root, "ModelVariables")
    for reference, v in enumerate(variables):
        (_add_variable if newer else _add_scalar)(listed, v, reference)
    structure = _add(root, "ModelStructure")
    outputs = [k for k, v in enumerate(variables) if v.causality == "output"]
    # After a step no output depends on an input that is set then; before the first one an output may.
    independent = {"dependencies": "", "dependenciesKind": ""}
    for name, known in (("Output", independent), ("InitialUnknown", {})) if outputs else ():
        listed = structure if newer else _add(structure, f"{name}s")
        for k in outputs:
            place = {"valueReference": str(k)} if newer else {"index": str(k + 1)}
            _add(listed, name if newer else "Unknown", place | known)
    return _bytes(root)


def build_description(name: str, source: str, options: Iterable[str]) -> bytes:
    """Return buildDescription.xml of FMI 3.0: the C file `source`, and the options that keep its bits."""
    root = Xml.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    build = _add(root, "BuildConfiguration", {"modelIdentifier": name})
    files = _add(build, "SourceFileSet", {"language": "C99", "compilerOptions": " ".join(options)})
    _add(files, "SourceFile", {"name": source})
    return _bytes(root)


def _add(parent: Xml.Element, name: str, attributes: Attributes | None = None) -> Xml.Element:
    return Xml.SubElement(parent, name, attributes or {})


def _add_variable(parent: Xml.Element, v: FmuVariable, reference: int) -> None:
    """Add a variable as FMI 3.0 writes it, of any size."""
    kind = "Boolean" if v.kind == "bool" else v.kind.capitalize().replace("Uint", "UInt")
    made = _add(parent, kind, _named(v, reference) | _values(v))
    for size in v.shape:
        _add(made, "Dimension", {"start": str(size)})


def _add_scalar(parent: Xml.Element, v: FmuVariable, reference: int) -> None:
    """Add a scalar as FMI 2.0 writes it."""
    kind = "Real" if v.kind in FLOATS else "Boolean" if v.kind == "bool" else "Integer"
    _add(_add(parent, "ScalarVariable", _named(v, reference)), kind, _values(v))


def _named(v: FmuVariable, reference: int) -> Attributes:
    changes = {"independent": "continuous", "parameter": "tunable" if v.tunable else "fixed"}
    initial = {"parameter": "exact", "output": "calculated"}.get(v.causality)
    named = {"name": v.name, "valueReference": str(reference), "causality": v.causality}
    named |= {"variability": changes.get(v.causality, "discrete")} | ({"initial": initial} if initial else {})
    text = _printable(v.text)
    return named | ({"description": text} if text else {})


def _values(v: FmuVariable) -> Attributes:
    """Return unit, bounds and start of a variable."""
    values = {"unit": _printable(v.unit)} if _printable(v.unit) else {}
    if v.kind != "bool":
        bounds = {"min": v.low, "max": v.high}
        values |= {name: _number(bound, v.kind) for name, bound in bounds.items() if math.isfinite(bound)}
    return values | ({"start": " ".join(_number(n, v.kind) for n in v.start)} if v.start else {})


def _number(value: float, kind: str) -> str:
    if kind == "bool":
        return "true" if value else "false"
    if kind not in FLOATS:
        return str(int(value))
    return (
        repr(float(value)) if math.isfinite(value) else "NaN" if math.isnan(value) else "INF" if value > 0 else "-INF"
    )


def _printable(text: str) -> str:
    """Return a user's text without the characters that XML cannot hold."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _bytes(root: Xml.Element) -> bytes:
    Xml.indent(root)
    made: bytes = Xml.tostring(root, encoding="UTF-8", xml_declaration=True)
    return made + b"\n"
