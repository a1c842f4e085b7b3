"""modelDescription.xml of an FMU, and the description of how its sources are compiled."""

import math
from collections.abc import Iterable, Sequence
from xml.etree import ElementTree as Xml

from twodof import __version__
from twodof.blocks.expressions.numbers import FLOATS
from twodof.compile.fmu.variables import FmuVariable
from twodof.compile.program.flat_program import FlatProgram

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
