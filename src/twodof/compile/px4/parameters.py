"""Parameters of a module in PX4: rows from a diagram's parameters, and module.yaml."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from twodof.blocks.declarations import limits
from twodof.blocks.expressions.numbers import FLOATS, STORED
from twodof.compile.program.flat_program import FlatProgram
from twodof.compile.px4.names import ModuleNames, harmless, parameter_names
from twodof.errors import DiagramError

WIDEST = 32  # an array of more elements keeps its defaults
MOST = 200
LARGEST_INT, SMALLEST_INT = 2**31 - 1, -(2**31)
LARGEST_FLOAT = float(np.finfo(np.float32).max)
LIVE, TORQUE = "LIVE", "TORQUE"
_LIVE_TEXT = "1: changes act at the next step; 0: they wait, and act together in one step when this is 1 again"
_TORQUE_TEXT = (
    "Torque set-point of M = 1. The allocator moves each motor of a symmetric X by .7071 of it, so that sqrt(2) gives "
    "fore = T + M and aft = T - M"
)

# Units that every PX4 from v1.14 knows, by how the block language writes them; others go into the description.
UNITS: Mapping[str, str] = MappingProxyType(
    {u: u for u in ("%", "Hz", "1/s", "rad", "rad/s", "deg", "deg/s", "m", "m/s", "s", "ms", "us", "N", "kg", "V", "A")}
    | {"rad/s2": "rad/s^2", "m/s2": "m/s^2", "m/s3": "m/s^3", "m2": "m^2", "N*m": "Nm", "kg*m2": "kg m^2"}
)


@dataclass(frozen=True)
class ExportedParameter:
    """A parameter in PX4.

    `kind` is "real", "int32", "uint32" or "bool" as in the diagram; "real" stands for float32 too and "int32" for the
    integers of 8 and 16 bits. `index` is an element of an array. The module enforces `low` and `high`, in float32 for
    a real. `fixed`: read when the module starts. The module's own parameters have no `path`.
    """

    name: str
    kind: str
    default: float
    low: float
    high: float
    unit: str
    text: str
    fixed: bool = False
    path: str = ""
    index: int | None = None

    @property
    def place(self) -> str:
        """Path of the diagram's parameter, with the element's index; "" for the module's own."""
        return f"{self.path}{'' if self.index is None else f'[{self.index}]'}"

    @property
    def bounds(self) -> str:
        """Text of the bounds."""
        if self.kind == "bool":
            return "true or false"
        low, high = (number(bound, self.kind) for bound in (self.low, self.high))
        below, above = self.low in (-LARGEST_FLOAT, SMALLEST_INT), self.high in (LARGEST_FLOAT, LARGEST_INT)
        if below and above:
            return "any finite number" if self.kind == "real" else "any integer"
        return f"at most {high}" if below else f"at least {low}" if above else f"{low} to {high}"

    @property
    def px4_type(self) -> str:
        """Type in module.yaml."""
        return {"real": "float", "bool": "boolean"}.get(self.kind, "int32")


@dataclass(frozen=True)
class KeptParameter:
    """Parameter that is not in PX4 and keeps its default, with the reason."""

    path: str
    reason: str


def exported(
    program: FlatProgram, names: ModuleNames, torque: bool
) -> tuple[list[ExportedParameter], list[KeptParameter]]:
    """Return the rows of the diagram's parameters and of the module's own, and the parameters that are not in PX4.

    A parameter that is not tunable is read when the module starts; see `diagram_rows` for those not in PX4. `torque`
    adds the scale of the torque set-point. Raises DiagramError for more than MOST parameters.
    """
    own = [ExportedParameter(f"{names.prefix}_{LIVE}", "bool", 1.0, 0.0, 1.0, "", _LIVE_TEXT)]
    if torque:
        scale = float32(math.sqrt(2.0))
        own.append(ExportedParameter(f"{names.prefix}_{TORQUE}", "real", scale, 0.0, 10.0, "", _TORQUE_TEXT))
    wanted, _ = _wanted(program)
    if len(wanted) > MOST:
        what = f"it has {len(wanted)} parameters for PX4, too many"
        raise DiagramError(what, program.name, f"use at most {MOST}: bind or remove some")
    rows, kept = diagram_rows(program, names.prefix)
    return [*rows, *own], kept


def diagram_rows(
    program: FlatProgram, prefix: str, elsewhere: Iterable[str] = (), part: str = ""
) -> tuple[list[ExportedParameter], list[KeptParameter]]:
    """Return the rows of the diagram's parameters, at most MOST, and the parameters that are not in PX4.

    Not in PX4 are an array of more than WIDEST elements, a float64, and a parameter whose default PX4 cannot hold (not
    finite, an integer above 2^31 - 1). The names are those in PX4's module, unless `elsewhere` has one of them already
    (`parameter_names`). Raises DiagramError for two equal names.
    """
    wanted, kept = _wanted(program)
    beyond = dict.fromkeys(path for path, _ in wanted[MOST:])
    kept += [KeptParameter(path, f"beyond the first {MOST} numbers") for path in beyond]
    # An array is shown whole or not at all.
    shown = [(path, index) for path, index in wanted[:MOST] if path not in beyond]
    # Both are kept free even where a module has no torque, so that a name does not depend on what it is part of.
    module = [f"{prefix}_{LIVE}", f"{prefix}_{TORQUE}"]
    made = parameter_names(prefix, shown, module, elsewhere, part)
    return [_row(program, name, path, index) for name, (path, index) in zip(made, shown, strict=True)], kept


def _wanted(program: FlatProgram) -> tuple[list[tuple[str, int | None]], list[KeptParameter]]:
    """Return path and index of the numbers that PX4 can hold, and the parameters that stay at their defaults."""
    wanted: list[tuple[str, int | None]] = []
    kept: list[KeptParameter] = []
    for path, parameter in program.parameters.items():
        d = parameter.declared
        values = [float(v) for v in np.ravel(np.asarray(d.value), order="F")]
        if d.width is not None and d.width > WIDEST:
            kept.append(KeptParameter(path, f"an array of {d.width} elements; up to {WIDEST} are shown"))
        elif d.kind == "float64":
            kept.append(KeptParameter(path, "a float64; PX4's parameters are float32 and int32"))
        elif d.kind in FLOATS and not all(math.isfinite(float32(v)) for v in values):
            kept.append(KeptParameter(path, "its default is not finite in float32"))
        elif d.kind == "uint32" and max(values) > LARGEST_INT:
            kept.append(KeptParameter(path, "its default is above 2147483647, the largest integer of PX4"))
        else:
            wanted += [(path, None)] if d.width is None else [(path, i) for i in range(d.width)]
    return wanted, kept


def float32(value: float) -> float:
    """Return `value` rounded to float32."""
    with np.errstate(over="ignore"):
        return float(np.float32(value))


def _row(program: FlatProgram, name: str, path: str, index: int | None) -> ExportedParameter:
    d = program.parameters[path].declared
    value = np.ravel(np.asarray(d.value), order="F")
    default = float(value[0 if index is None or len(value) == 1 else index])
    kind = "real" if d.kind in FLOATS else "int32" if d.kind in STORED else d.kind
    if kind == "real":
        low, high = max(float32(d.low), -LARGEST_FLOAT), min(float32(d.high), LARGEST_FLOAT)
        default = float32(default)
    elif d.kind == "bool":
        low, high = 0.0, 1.0
    else:
        least, most = limits(d)
        low, high = max(_whole(least, math.ceil), SMALLEST_INT), min(_whole(most, math.floor), LARGEST_INT)
    if not low <= default <= high:
        raise DiagramError(f"its default {default:g} is outside [{low:g}, {high:g}]", path, "change one of them")
    return ExportedParameter(name, kind, default, low, high, d.unit, d.text, not d.tunable, path, index)


def _whole(bound: float, rounded: Callable[[float], int]) -> float:
    return float(rounded(bound)) if math.isfinite(bound) else bound


def module_yaml(names: ModuleNames, rows: Sequence[ExportedParameter]) -> str:
    """Return the text of module.yaml: one group with `rows`."""
    lines = [
        f"module_name: {names.module}",
        "",
        "parameters:",
        f"    - group: Twodof {names.stem}",
        "      definitions:",
    ]
    for row in rows:
        lines += [f"        {row.name}:", "            description:", f"                short: {_short(row)}"]
        lines += [f"                long: {_quoted(_long(row), 600)}", f"            type: {row.px4_type}"]
        if row.kind == "real":
            lines += [f"            decimal: {decimals(row.default)}"]
        if row.kind != "bool":
            if row.low not in (-LARGEST_FLOAT, SMALLEST_INT):
                lines += [f"            min: {number(row.low, row.kind)}"]
            if row.high not in (LARGEST_FLOAT, LARGEST_INT):
                lines += [f"            max: {number(row.high, row.kind)}"]
        if row.unit in UNITS and row.kind != "bool":
            lines += [f"            unit: {_quoted(UNITS[row.unit], 20)}"]
        if row.fixed:
            lines += ["            reboot_required: true"]
        lines += [f"            default: {number(row.default, row.kind)}"]
    return "\n".join(lines) + "\n"


def _short(row: ExportedParameter) -> str:
    unit = harmless(f" [{row.unit}]", 20) if row.unit and row.unit not in UNITS else ""
    text = ": ".join(filter(None, (row.place, row.text)))
    return _quoted(harmless(text, 70 - len(unit) - 1) + f" {unit}".rstrip(), 70)


def _long(row: ExportedParameter) -> str:
    text = ": ".join(filter(None, (row.place, row.text)))
    when = "Read when the module starts." if row.fixed else "A change acts at the next step."
    bounds = row.bounds[0].upper() + row.bounds[1:]
    return f"{text}. {bounds}; another value is put back to the one that flies. {when}"


def _quoted(text: str, longest: int) -> str:
    # `harmless` leaves neither quotes nor backslashes; ${ and @ would mean something to PX4's generators.
    return f'"{harmless(text, longest)}"'


def decimals(default: float) -> int:
    """Return the decimal places that show four significant digits of a default, 3 to 8."""
    return min(max(3 - math.floor(math.log10(abs(default))), 3), 8) if default else 3


def number(value: float, kind: str) -> str:
    """Return a number for YAML and PX4's generators: the shortest text of this float32, with a decimal point."""
    if kind == "bool":
        return "true" if value else "false"
    if kind != "real":
        return str(int(value))
    text = str(np.float32(value))
    mantissa, e, exponent = text.partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + e + exponent
