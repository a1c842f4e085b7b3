"""Arithmetic of whole numbers as Simulink defines it: types of results, rounding, overflow; comparisons, logic, bits.

A result is computed without a bound, then rounded and brought into its type: saturated, or wrapped around.
Source: Simulink reference, blocks Sum, Product, Gain, Data Type Conversion, Shift Arithmetic, Bitwise Operator.
"""

import dataclasses
import math
import operator
from collections.abc import Callable, Mapping
from functools import partial, reduce
from typing import Any

from twodof.blocks.elementary.functions import ceil, floor, round_half_away, round_half_even, trunc
from twodof.blocks.elementary.functions import pow as power
from twodof.blocks.elementwise import clamp
from twodof.blocks.enumeration import Kind
from twodof.blocks.expressions.conversions import to_stored
from twodof.blocks.expressions.expr import convert, where
from twodof.blocks.expressions.numbers import BY_NAME, FLOATS, INTEGERS, STORED, WORDS
from twodof.blocks.library import Abs, Bias, Compare, CompareToConstant, Gain, Maximum, Minimum, Saturation
from twodof.blocks.library.logic import COMPARISONS
from twodof.slx.composite_blocks import formula
from twodof.slx.data_types import kind_of
from twodof.slx.model import System
from twodof.slx.translation import Asked, Made, NotTranslated, Rule, each, of_elements, passes, same

ROUNDING: Mapping[str, Callable[[Any], Any]] = {
    "Floor": floor,
    "Zero": trunc,
    "Ceiling": ceil,
    "Convergent": round_half_even,
    "Nearest": lambda v: floor(v + 0.5),
    "Round": round_half_away,
    "Simplest": trunc,
}
COMPARED = {"==": "==", "~=": "!=", "<": "<", "<=": "<=", ">": ">", ">=": ">="}
_TESTS = {"isNaN": lambda u: u != u, "isInf": lambda u: abs(u) == math.inf, "isFinite": lambda u: abs(u) < math.inf}


def exact(c: Asked) -> Callable[[Any], Any]:
    """Return the conversion of a block's numbers: to float64, which holds whole numbers, or to real beside a real."""
    return partial(convert, kind="real" if any(one.kind == "real" for one in c.inputs) else "float64")


def _kind(c: Asked, said: str) -> Kind:
    """Return the kind of a type; of single real, which is rounded where single and double are mixed."""
    found = kind_of(said, c.names)
    return "real" if found == "float32" else found


def fitted(value: Any, kind: str, saturate: bool, rounding: str) -> Any:
    """Return a float as a number of `kind`; NaN gives 0."""
    if kind == "real":
        return convert(value, "real")
    if kind == "bool":
        return value != 0.0
    whole = ROUNDING[rounding](value)
    if kind == "float64":
        return convert(whole, kind)
    if not saturate:
        span = float(BY_NAME[kind].high - BY_NAME[kind].low + 1)
        whole = whole - floor(whole / span) * span
        whole = where(whole > float(BY_NAME[kind].high), whole - span, whole)
    return to_stored(whole, kind, "saturate") if kind in STORED else convert(whole, kind)


def whole(c: Asked, of: Callable[..., Any], default: str = "Inherit: Same as first input") -> Made | None:
    """Return the block of an operation on whole numbers, of `of` of exact numbers; None where all is real."""
    said = c.text("OutDataTypeStr", default)
    kinds = {one.number for one in c.inputs}
    if said.startswith("Inherit: Same as"):
        kind = c.inputs[0].number
    elif said.startswith("Inherit"):
        kind = "real" if "real" in kinds else min(kinds - {"bool"} or {"int32"})
        if kind != "real" and len(kinds - {"bool"}) > 1:
            raise NotTranslated(f"OutDataTypeStr = {said!r} of {' and '.join(sorted(kinds))} is not translated")
    else:
        kind = str(_kind(c, said))
    if kinds == {"real"} and kind == "real":
        return None
    if kind not in ("real", "float64", *INTEGERS):
        raise NotTranslated(f"a result of the type {kind} is not translated")
    if kind in INTEGERS and said.startswith("Inherit: Inherit via internal rule"):
        c.notes.append(f"the internal rule for whole numbers: the type {kind} of the inputs is kept")
    saturate, rounding = _saturates(c), c.needs("RndMeth", "Floor", *ROUNDING)
    return formula(c, lambda t, *v: fitted(of(*map(exact(c), v)), kind, saturate, rounding), kind)


def _saturates(c: Asked) -> bool:
    return c.text("SaturateOnIntegerOverflow", c.text("DoSatur", "on")) == "on"


def whole_sum(c: Asked, signs: str) -> Made | None:
    """Return a sum of whole numbers; None where all is real."""
    accumulator = c.text("AccumDataTypeStr", "Inherit: Inherit via internal rule")
    many = len(signs) > 2 and _saturates(c) and {one.number for one in c.inputs} != {"real"}
    if many and not accumulator.startswith("Inherit: Inherit via internal rule"):
        raise NotTranslated(f"AccumDataTypeStr = {accumulator!r} of more than two numbers is not translated")
    return whole(c, partial(signed_sum, signs))


def signed_sum(signs: str, *terms: Any) -> Any:
    """Return the sum of terms with their signs, which begins with the first of those that are added."""
    first = max(signs.find("+"), 0)
    total = terms[first] if signs[first] == "+" else -terms[first]
    for k, (sign, term) in enumerate(zip(signs, terms, strict=True)):
        if k != first:
            total = total + term if sign == "+" else total - term
    return total


def whole_product(c: Asked, signs: str) -> Made | None:
    """Return a product of whole numbers; None where all is real."""
    kinds, said = {one.number for one in c.inputs}, c.text("OutDataTypeStr", "Inherit: Same as first input")
    wanted = min(kinds) if said.startswith("Inherit") else _kind(c, said)
    if kinds == {"real"} and wanted == "real":
        return None
    c.values.setdefault("RndMeth", "Zero")
    if "real" not in kinds and kinds != {"bool"} and (len(signs) > 2 or signs not in ("**", "*/", "*")):
        raise NotTranslated(f"Inputs = {signs!r} of {' and '.join(sorted(kinds))} is not translated")
    if signs == "*/" and "real" not in kinds:  # as MathWorks' C has it, also by 0
        low, high = float(BY_NAME[str(wanted)].low), float(BY_NAME[str(wanted)].high)
        return whole(c, lambda a, b: where(b == 0.0, where(a < 0.0, b + low, b + high), a / b))
    if not _saturates(c) and kinds == {wanted} and kinds <= set(WORDS):  # the low bits of a product of 64 bits
        return formula(c, lambda t, *v: reduce(operator.mul, v), kinds.pop())

    def product(a: Any, *others: Any) -> Any:
        made = 1.0 / a if signs[0] == "/" else a
        for sign, one in zip(signs[1:], others, strict=True):
            made = made * one if sign == "*" else made / one
        return made

    return whole(c, product)


def whole_gain(c: Asked, gain: float) -> Made | None:
    """Return a gain on an integer signal; None where all is real.

    A fraction raises NotTranslated, unless the gain's type or the output's is single or double.
    """
    real = c.text("ParamDataTypeStr", "") in ("double", "single") or c.inputs[0].number in FLOATS
    kind, said = BY_NAME[c.inputs[0].number], c.text("OutDataTypeStr", "")
    if kind.name == "bool" and said.startswith("Inherit: Inherit via internal"):
        c.values["OutDataTypeStr"], real = "double", True
        c.notes.append("the internal rule for a boolean and a number: double")
    real |= kind.name == "bool" and said in ("single", "double")
    if not real and (gain > 0.0 or (gain < 0.0 and kind.low < 0)) and said in ("single", "double"):
        # The gain is a whole number of as many bits, scaled by the smallest power of two that it fits.
        most = kind.high + 0.5 if gain > 0.0 else kind.low - 0.5
        scale, result = 2.0 ** math.floor(math.log2(most / gain)), kind_of(said, c.names)
        gain = math.floor(gain * scale + 0.5) / scale
        return formula(c, lambda t, u: gain * convert(u, str(result)), str(result))
    if not real and not gain.is_integer():
        raise NotTranslated(f"Gain = {gain:g} of {c.inputs[0]} is not translated: its scaling is not known")
    return whole(c, lambda u: u * gain)


def _stepped(by: float) -> Rule:
    """Return the rule of a block that adds a number, around the ends of a type of whole numbers."""

    def rule(c: Asked) -> Made:
        c.values |= {"OutDataTypeStr": "Inherit: Same as first input", "SaturateOnIntegerOverflow": "off"}
        return whole(c, lambda u: u + by) or formula(c, lambda t, u: u + by)

    return rule


def _absolute(c: Asked) -> Made:
    return whole(c, abs) or same(c, Abs(c.kind("real"), c.width))


def _bias(c: Asked) -> Made:
    bias = c.scalar("Bias", "0.0")
    if c.inputs[0].number != "real" and not bias.is_integer():
        raise NotTranslated(f"Bias = {bias:g} of {c.inputs[0]} is not translated")
    return whole(c, lambda u: u + bias) or same(c, Bias(bias, c.width))


def _saturate(c: Asked) -> Made:
    low, high = c.scalar("LowerLimit", "-0.5"), c.scalar("UpperLimit", "0.5")
    if c.inputs[0].number != "real" and not all(v.is_integer() or math.isinf(v) for v in (low, high)):
        raise NotTranslated(f"limits {low:g} and {high:g} of {c.inputs[0]} are not translated")
    return whole(c, lambda u: clamp(low, high, u)) or same(c, Saturation(low, high, "real", c.width))


def _min_max(c: Asked) -> Made:
    name = c.needs("Function", "min", "min", "max")
    if len(c.inputs) == 1:
        return of_elements(c, _min_max) if c.width is not None else passes(c)
    lower = lambda a, b: where(a < b, a, b) if name == "min" else where(b < a, a, b)  # noqa: E731
    made = whole(c, lambda *v: reduce(lower, v), "Inherit: Inherit via internal rule")
    return made or same(c, {"min": Minimum, "max": Maximum}[name](len(c.inputs), "real", c.width))


def _convert(c: Asked) -> Made:
    said = c.text("OutDataTypeStr", "Inherit: Inherit via back propagation")
    if said.startswith("Inherit"):
        c.notes.append("the type is inherited from behind: that of the input is kept")
        return passes(c)
    kind, rounding = _kind(c, said), c.needs("RndMeth", "Zero", *ROUNDING)
    if kind == c.inputs[0].kind:
        return passes(c)
    if not isinstance(kind, str) or not isinstance(c.inputs[0].kind, str):
        raise NotTranslated(f"a conversion of {c.inputs[0]} to {said} is not translated")
    if said.startswith("Enum"):
        c.notes.append("a number that is no member stays itself, where Simulink takes the default one")
    saturate = _saturates(c)
    return formula(c, lambda t, u: fitted(exact(c)(u), str(kind), saturate, rounding), kind)


# --- truth


def _truth(c: Asked, of: Callable[..., Any], block: Any = None) -> Made:
    """Return the block of a condition: bool, or the 0 and 1 of another type."""
    said = c.text("OutDataTypeStr", "boolean")
    kind = "bool" if said.startswith("Inherit") else str(_kind(c, said))
    if kind == "bool" and block is not None:
        return Made(block())
    return formula(c, lambda t, *v: convert(of(*map(exact(c), v)), kind), kind)


def _relational(c: Asked) -> Made:
    name = c.text("Operator", c.text("Function", ">="))
    if name in _TESTS:
        return _truth(c, _TESTS[name])
    if name not in COMPARED:
        raise NotTranslated(f"Operator = {name!r} is not translated")
    kinds = {one.number for one in c.inputs}
    plain = len(kinds) == 1 and kinds <= {"real", *WORDS}
    block = (lambda: Compare(COMPARED[name], c.inputs[0].kind, c.width)) if plain else None
    return _truth(c, COMPARISONS[COMPARED[name]], block)


def _compare_to(c: Asked, wanted: float) -> Made:
    kind, operation = c.inputs[0].number, c.pick("relop", "<=", dict(COMPARED))
    if kind != "real" and not wanted.is_integer():
        raise NotTranslated(f"a comparison of {c.inputs[0]} with {wanted:g} is not translated")
    library = kind in ("real", *WORDS)
    block = (lambda: CompareToConstant(operation, wanted, kind, c.width)) if library else None
    return _truth(c, lambda u: COMPARISONS[operation](u, wanted), block)


# --- bits


def _bits(c: Asked) -> Made:
    """Combine the bits of whole numbers with one another, or with a mask."""
    kind, name = c.kind("bool", *INTEGERS), c.needs("logicop", "AND", "AND", "OR", "NAND", "NOR", "XOR", "NOT")
    mask = [int(c.scalar("BitMask", "0"))] if c.text("UseBitMask", "on") == "on" and name != "NOT" else []
    if c.width is not None and len(c.inputs) == 1 and name != "NOT" and not mask:
        return of_elements(c, _bits)
    combine = {"A": operator.and_, "O": operator.or_, "X": operator.xor}[name.removeprefix("N")[0]]
    word = "uint32" if kind == "uint32" else "int32"

    def of(t: Any, *values: Any) -> Any:
        found = reduce(combine, [*(convert(v, word) for v in values), *mask])
        found = ~found if name[0] == "N" else found
        return (found & 1) != 0 if kind == "bool" else convert(found, kind)

    return formula(c, of, kind)


def _shift(c: Asked) -> Made:
    """Shift the bits of a whole number: to the left they get lost, to the right the sign stays."""
    kind = c.inputs[0].number
    direction = c.needs("BitShiftDirection", "Bidirectional", "Left", "Right", "Bidirectional")
    if c.needs("BitShiftNumberSource", "Dialog", "Dialog", "Input port") == "Input port":
        if {one.kind for one in c.inputs} != {"real"} or direction == "Left" or c.scalar("BinPtShiftNumber", "0"):
            raise NotTranslated(f"a shift of {c.inputs[0]} by an input is not translated")
        return formula(c, lambda t, u, count: u * power(2.0, floor(0.0 - count)))
    count = int(c.scalar("BitShiftNumber", "0")) * (-1 if direction == "Left" else 1)
    if kind == "real" and not c.scalar("BinPtShiftNumber", "0"):
        return same(c, Gain(2.0**-count, c.width))
    if kind not in INTEGERS or c.scalar("BinPtShiftNumber", "0") or abs(count) > 31:
        raise NotTranslated(f"a shift of {c.inputs[0]} by {count} is not translated")
    word = "uint32" if kind == "uint32" else "int32"
    shift = operator.rshift if count > 0 else operator.lshift
    return formula(c, lambda t, u: convert(shift(convert(u, word), abs(count)), kind), kind)


def _field(c: Asked) -> Made:
    """Return some bits of a whole number, shifted bits, or the bits of several ones side by side, the first highest.

    Simulink's type has as many bits as there are (`ufix3`): here it is the smallest kind that holds them.
    """
    kinds, name, shift = {one.number for one in c.inputs}, c.block.kind, 0
    if not kinds <= set(INTEGERS) or any(one.width is not None for one in c.inputs):
        raise NotTranslated(f"bits of {' and '.join(map(str, c.inputs))} are not translated")
    sizes = [one.bits or len(f"{BY_NAME[one.number].high - BY_NAME[one.number].low:b}") for one in c.inputs]
    total = sum(sizes)
    if name == "Bit Shift":
        shift = int(c.scalar("N", "1")) * c.pick("mode", _LOGICAL[0], dict(zip(_LOGICAL, (-1, 1), strict=True)))
    elif name != "Bit Concat":
        last, shift = (int(c.scalar(end, "0")) for end in ("lidx", "ridx"))
        if name == "Extract Bits":
            c.needs("bitsToExtract", "Upper half", "Range of bits")
            c.needs("outScalingMode", "Preserve fixed-point scaling", "Treat bit field as an integer")
            shift, last = (int(c.value("bitIdxRange", "[0 7]").flat[k]) for k in (0, -1))
        if not 0 <= shift <= last < total:
            raise NotTranslated(f"bits {shift} to {last} of {c.inputs[0]} are not translated")
        total = last - shift + 1
    kind = next((kind for kind in ("uint8", "uint16", "uint32") if BY_NAME[kind].high >= 2**total - 1), "")
    if not kind or abs(shift) > 31:
        raise NotTranslated(f"{total} bits, or a shift by {shift}, are not translated")

    def joined(t: Any, *u: Any) -> Any:
        found: Any = None
        for one, size in zip(u, sizes, strict=True):
            bits = convert(one, "uint32") & 2**size - 1
            found = bits if found is None else found << size | bits
        return convert((found << -shift if shift < 0 else found >> shift) & 2**total - 1, kind)

    made = formula(c, joined, kind)
    return Made(made.item, [dataclasses.replace(made.outputs[0], bits=total)])


_LENGTHS = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048, "mi": 1609.344, "mile": 1609.344}
_ANGLES = {"rad": 1.0, "deg": math.pi / 180.0, "rev": 2.0 * math.pi}
_TIMES = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0, "hr": 3600.0}


def _speeds(sizes: Mapping[str, float]) -> dict[str, float]:
    return {f"{name}/{time}": size / of for name, size in sizes.items() for time, of in _TIMES.items()}


_SIZES: Mapping[str, Mapping[str, float]] = {
    "m": _LENGTHS,
    "m/s": {**_speeds(_LENGTHS), "mph": 0.44704},
    "rad": _ANGLES,
    "rad/s": {**_speeds(_ANGLES), "rpm": math.pi / 30.0},
    "s": _TIMES,
    "kg": {"kg": 1.0, "g": 1e-3, "lbm": 0.45359237},
    "N": {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605},
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5},
    **{name: {name: 1.0, f"k{name}": 1e3, f"m{name}": 1e-3} for name in ("W", "V", "A", "Hz")},
}
UNITS = {name: (unit, size) for unit, sizes in _SIZES.items() for name, size in sizes.items()}
"""Units by the names that Simulink gives them: the unit of the SI, and what they are of it (BIPM; NIST SP 811)."""


def with_units(system: System) -> System:
    """Return a system whose UnitConversions have the units `From` and `To` of the ports and specifications beside."""
    said = {sid: unit for sid, one in system.blocks.items() if (unit := one.values.get("Unit", "inherit")) != "inherit"}
    blocks = dict(system.blocks)
    for source, sink in ((line.source, sink) for line in system.lines if line.source for sink in line.wire.sinks()):
        for sid, end, beside in ((sink.sid, "From", source.sid), (source.sid, "To", sink.sid)):
            if beside in said and sid in blocks and blocks[sid].type == "UnitConversion":
                blocks[sid] = dataclasses.replace(blocks[sid], values={**blocks[sid].values, end: said[beside]})
    return System(blocks, system.lines)


def _unit_conversion(c: Asked) -> Made:
    before, after = c.text("From", ""), c.text("To", "")
    if not before or not after:
        raise NotTranslated("its units are translated where a port or a Signal Specification right beside says them")
    for unit in (before, after):
        if unit not in UNITS:
            raise NotTranslated(f"the unit {unit[:40]} is not translated")
    (quantity, size), (other, wanted) = UNITS[before], UNITS[after]
    if quantity != other:
        raise NotTranslated(f"{before} cannot be converted to {after}")
    c.kind("real")
    c.notes.append("MathWorks' factor may differ in its last bit")
    return same(c, Gain(size / wanted, c.width))


_LOGICAL = ("Shift Left Logical", "Shift Right Logical")


_TO_CONSTANT = each(lambda c: _compare_to(c, c.scalar("const", "3.0")), "const", wide=True)
ARITHMETIC_RULES: dict[str, Rule] = {
    "Abs": _absolute,
    "ArithShift": _shift,
    "Bias": _bias,
    "Bitwise Operator": _bits,
    **dict.fromkeys(("Bit Concat", "Bit Shift", "Bit Slice", "Extract Bits"), _field),
    **dict.fromkeys(("CompareToConstant", "Compare To Constant"), _TO_CONSTANT),
    **dict.fromkeys(("CompareToZero", "Compare To Zero"), lambda c: _compare_to(c, 0.0)),
    "DataTypeConversion": _convert,
    "Decrement Real World": _stepped(-1.0),
    "Increment Real World": _stepped(1.0),
    "MinMax": _min_max,
    "RelationalOperator": _relational,
    "Saturate": each(_saturate, "LowerLimit", "UpperLimit", wide=True),
    "UnitConversion": _unit_conversion,
}
"""Rules of the blocks whose types decide what they compute."""
