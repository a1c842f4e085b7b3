"""Elementary functions, rounding and conversion, element by element."""

from collections.abc import Callable, Mapping
from typing import Any

from twodof.blocks.block import library_block
from twodof.blocks.declarations import Port
from twodof.blocks.elementary.functions import (
    FUNCTIONS,
    atan2,
    ceil,
    exp,
    floor,
    hypot,
    log,
    pow,
    round_half_away,
    round_half_even,
    trunc,
)
from twodof.blocks.elementwise import Pointwise, one_of
from twodof.blocks.enumeration import Kind, enumeration_of, to_enumeration
from twodof.blocks.expressions.conversions import OVERFLOW, may_overflow, to_stored
from twodof.blocks.expressions.expr import convert, sqrt, where
from twodof.blocks.expressions.kinds import FLOATS, KINDS, NUMERIC, STORED
from twodof.errors import DiagramError

__all__ = ["Atan2", "Convert", "Elementary", "Hypot", "Power", "Remainder", "Rounding", "Trigonometry"]

Function = Callable[[Any], Any]

TRIGONOMETRIC: Mapping[str, Function] = {
    name: FUNCTIONS[name] for name in ("sin", "cos", "tan", "asin", "acos", "atan", "tanh")
}
ELEMENTARY: Mapping[str, Function] = {
    "exp": exp,
    "log": log,
    "sqrt": sqrt,
    "square": lambda v: v * v,
    "reciprocal": lambda v: 1.0 / v,
}
ROUNDING: Mapping[str, Function] = {
    "floor": floor,
    "ceil": ceil,
    "trunc": trunc,
    "half_even": round_half_even,
    "half_away": round_half_away,
    "nearest": lambda v: where(v < 0.0, -floor(0.5 - v), floor(v + 0.5)),
}


class _Function(Pointwise):
    """y = f(u), f chosen by name."""

    functions: Mapping[str, Function]

    def _declare(self, function: str, width: int | None, input_unit: str, unit: str) -> None:
        self.function = one_of(function, list(self.functions), type(self).__name__, "function")
        self.inputs = [Port("u", width=width, unit=input_unit)]
        self.outputs = [Port("y", width=width, unit=unit)]

    def of(self, p: Any, u: Any) -> Any:
        return self.functions[self.function](u)


@library_block("trigonometry")
class Trigonometry(_Function):
    """y = sin, cos, tan, asin, acos, atan or tanh of u, by `function`; angles in rad."""

    functions = TRIGONOMETRIC

    def __init__(self, function: str = "sin", width: int | None = None, input_unit: str = "", unit: str = "") -> None:
        self._declare(function, width, input_unit, unit)


@library_block("elementary")
class Elementary(_Function):
    """y = exp(u), log(u) (natural), sqrt(u), square u^2 or reciprocal 1/u, by `function`; IEEE where undefined."""

    functions = ELEMENTARY

    def __init__(self, function: str = "exp", width: int | None = None, input_unit: str = "", unit: str = "") -> None:
        self._declare(function, width, input_unit, unit)


@library_block("rounding")
class Rounding(_Function):
    """y = u rounded by `function`: floor, ceil, trunc (towards 0), nearest (halves away from 0); a real still."""

    functions = ROUNDING

    def __init__(self, function: str = "floor", width: int | None = None, input_unit: str = "", unit: str = "") -> None:
        self._declare(function, width, input_unit, unit)


@library_block("atan2")
class Atan2(Pointwise):
    """y = atan2(a, b) [rad]: the angle of the point (b, a), within -pi .. pi; C99's signs of zero and infinities."""

    def __init__(self, width: int | None = None, input_unit: str = "") -> None:
        self.inputs = [Port("a", width=width, unit=input_unit), Port("b", width=width, unit=input_unit)]
        self.outputs = [Port("y", width=width, unit="rad")]

    def of(self, p: Any, a: Any, b: Any) -> Any:
        return atan2(a, b)


@library_block("hypot")
class Hypot(Pointwise):
    """y = sqrt(a^2 + b^2) without overflow or underflow on the way."""

    def __init__(self, width: int | None = None, unit: str = "") -> None:
        self.ports("ab", "real", width, unit)

    def of(self, p: Any, a: Any, b: Any) -> Any:
        return hypot(a, b)


@library_block("power")
class Power(Pointwise):
    """y = a^b as C99's pow."""

    def __init__(self, width: int | None = None, unit: str = "") -> None:
        self.inputs = [Port("a", width=width), Port("b", width=width)]
        self.outputs = [Port("y", width=width, unit=unit)]

    def of(self, p: Any, a: Any, b: Any) -> Any:
        return pow(a, b)


@library_block("remainder")
class Remainder(Pointwise):
    """The remainder of a / b: a - b floor(a / b), with b's sign; for integers a % b, with a's sign (a % 0 = 0)."""

    def __init__(self, kind: str = "real", width: int | None = None, unit: str = "") -> None:
        self.kind = one_of(kind, NUMERIC, "Remainder", "kind")
        self.ports("ab", kind, width, unit)

    def of(self, p: Any, a: Any, b: Any) -> Any:
        return a - b * floor(a / b) if self.kind in FLOATS else a % b


@library_block("convert")
class Convert(Pointwise):
    """y = u as another type. Float to integer: rounded by `rounding`, then saturated, NaN gives 0. To bool: u != 0.

    int32 to uint32 and back keep the bits; bool gives 0 or 1. `overflow` says what happens to what does not fit an
    integer of 8 or 16 bits: "saturate", or "wrap", which keeps the low bits of the int32. The roundings "half_even"
    and "half_away" go to the nearest integer. The rounding "nearest" is floor(|u| + 0.5) with u's sign. An
    enumeration as `target` takes the int32; what is none of its members becomes 0.
    """

    def __init__(
        self,
        source: str = "real",
        target: Kind = "int32",
        rounding: str = "trunc",
        width: int | None = None,
        unit: str = "",
        overflow: str | None = None,
    ) -> None:
        self.source = one_of(source, KINDS, "Convert", "source")
        self.enumeration = enumeration_of(target, "Convert")
        self.target = "int32" if self.enumeration else one_of(target, KINDS, "Convert", "target")
        self.rounding = one_of(rounding, list(ROUNDING), "Convert", "rounding")
        if overflow is not None:
            one_of(overflow, OVERFLOW, "Convert", "overflow")
            one_of(self.target, STORED, "Convert", "target with an overflow")
        elif may_overflow(self.source, self.target):
            rule = f"overflow={' or '.join(map(repr, OVERFLOW))}"
            raise DiagramError(f"a {source} may not fit {self.target}", "Convert", f"say what happens then: {rule}")
        self.overflow = overflow
        self.inputs = [Port("u", source, width, unit)]
        self.outputs = [Port("y", target, width, unit)]

    def of(self, p: Any, u: Any) -> Any:
        if self.enumeration is not None:
            return to_enumeration(self.enumeration, self._converted(u))
        return self._converted(u)

    def _converted(self, u: Any) -> Any:
        if self.source == self.target:
            return u
        if self.target == "bool":
            return u != 0
        if self.source in FLOATS and self.target not in FLOATS and self.rounding != "trunc":
            u = ROUNDING[self.rounding](u)
        return to_stored(u, self.target, self.overflow) if self.target in STORED else convert(u, self.target)
