"""Elementary functions, rounding and conversion, element by element."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from twodof.blocks.block import Block, Clock, library_block
from twodof.blocks.declarations import NAME, Param, Port
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
from twodof.blocks.enumeration import Kind, enumeration_of, plain_data, to_enumeration
from twodof.blocks.expressions.conversions import OVERFLOW, may_overflow, to_stored
from twodof.blocks.expressions.expr import convert, sqrt, where
from twodof.blocks.expressions.numbers import FLOATS, KINDS, NUMERIC, STORED, Integer, kind_of
from twodof.errors import DiagramError, shown

__all__ = [
    "Atan2",
    "Convert",
    "Elementary",
    "FunctionBlock",
    "Hypot",
    "Power",
    "Remainder",
    "Rounding",
    "Trigonometry",
    "function_block",
]

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
        self.function = one_of(function, list(self.functions), "function")
        self.ports("u", "real", width, unit, input_unit)

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
        self.ports("ab", "real", width, "rad", input_unit)

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
        self.ports("ab", "real", width, unit, "")

    def of(self, p: Any, a: Any, b: Any) -> Any:
        return pow(a, b)


@library_block("remainder")
class Remainder(Pointwise):
    """The remainder of a / b: a - b floor(a / b), with b's sign; for integers a % b, with a's sign (a % 0 = 0)."""

    def __init__(self, kind: str = "real", width: int | None = None, unit: str = "") -> None:
        self.kind = one_of(kind, NUMERIC, "kind")
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
        self.source = one_of(source, KINDS, "source")
        self.enumeration = enumeration_of(target)
        self.target = "int32" if self.enumeration else one_of(target, KINDS, "target")
        self.rounding = one_of(rounding, list(ROUNDING), "rounding")
        if overflow is not None:
            one_of(overflow, OVERFLOW, "overflow")
            one_of(self.target, STORED, "target with an overflow")
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


class FunctionBlock(Block):
    """A block without states whose outputs are what a function returns; made by `function_block`."""

    def __init__(
        self, function: Callable[..., Any], inputs: Sequence[Port], outputs: Sequence[Port], params: Sequence[Param]
    ) -> None:
        self.function = function
        self.inputs, self.outputs, self.params = list(inputs), list(outputs), list(params)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        result = self.function(*(u[i.name] for i in self.inputs), **{q.name: p[q.name] for q in self.params})
        if isinstance(result, tuple) and len(self.outputs) > 1:
            if len(result) != len(self.outputs):
                what = f"the function returns {len(result)} values for {len(self.outputs)} outputs"
                raise DiagramError(what, type(self).__name__, "return one value for each output")
            return {port.name: value for port, value in zip(self.outputs, result, strict=True)}
        return result

    def written(self, method: str) -> Callable[..., Any]:
        return self.function if method == "output" else super().written(method)


def function_block(
    function: Callable[..., Any],
    outputs: Sequence[Port | str] = ("y",),
    inputs: Sequence[Port] = (),
    params: Sequence[Param] = (),
) -> FunctionBlock:
    """Return a block that computes `function`, written with the functions of twodof.blocks (`where`, `sin`, ...).

    Its positional arguments are the inputs: scalar reals, unless `inputs` declares a port of that name. Its
    keyword-only arguments are parameters with the given defaults (or as `params` declares them). It returns a bare
    value for one output, a tuple in the order of `outputs`, or a dict by name. In JSON its traced expressions travel.

    Raises DiagramError for a function with *args or **kwargs, a parameter without a default or an input with one. It
    also does so for a declared name that the function does not take.
    """
    if not callable(function):
        raise DiagramError(f"{shown(function)} is not a function", "function_block", "give a Python function")
    label = getattr(function, "__name__", "")
    label = label if NAME.fullmatch(label) else "Function"
    ports, tunables = {p.name: p for p in inputs}, {p.name: p for p in params}
    found_inputs: list[Port] = []
    found_params: list[Param] = []
    for argument in inspect.signature(function).parameters.values():
        name = argument.name
        if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
            raise DiagramError(f"the function takes *{name}", label, "name each input and parameter")
        if argument.kind is argument.KEYWORD_ONLY:
            if name in tunables:
                found_params.append(tunables.pop(name))
            elif argument.default is argument.empty:
                raise DiagramError(f"parameter {name!r} has no default", label, f"write {name}=0.0")
            else:
                found_params.append(_param(name, argument.default))
        elif argument.default is not argument.empty:
            raise DiagramError(
                f"input {name!r} has a default", label, "parameters are keyword-only: put them after a *"
            )
        else:
            found_inputs.append(ports.pop(name, Port(name)))
    for name in [*ports, *tunables]:
        what = f"{name!r} is declared, but it is not an argument of the function"
        raise DiagramError(what, label, "add the argument, or delete the declaration")
    declared = [Port(port) if isinstance(port, str) else port for port in outputs]
    # The class is as much the user's as the function is.
    names = {"__doc__": function.__doc__, "__module__": getattr(function, "__module__", "__main__")}
    made: type[FunctionBlock] = type(label, (FunctionBlock,), names)
    return made(function, found_inputs, declared, found_params)


def _param(name: str, default: Any) -> Param:
    """Return a parameter of the type and width of its default; integers are given as int32(...) or uint32(...)."""
    default = plain_data(default, name)
    if isinstance(default, list) and default and isinstance(default[0], list) and default[0]:
        rows = [[_plain(v) for v in row] for row in default]
        return Param(name, rows, kind_of(default[0][0]), shape=(len(rows), len(rows[0])))
    many = isinstance(default, list)
    kind = kind_of(default[0] if many and default else default)
    plain = [_plain(v) for v in default] if many else _plain(default)
    return Param(name, plain, kind, len(default) if many else None)


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, Integer) else value
