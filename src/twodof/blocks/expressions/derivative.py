"""Exact derivatives of recorded expressions: forward-mode differentiation of the graph at a point.

Each value carries its slope, the vector of its derivatives by the seeds. Source: Griewank, Walther, Evaluating
Derivatives (2nd ed., 2008), chapter 3. At a tie, a point at which a branch changes, that branch is taken into which a
given direction leads. Source: Griewank, On stable piecewise linearization, Optimization Methods and Software 28-6,
2013.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.elementary.functions import FUNCTIONS
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import Expr, convert
from twodof.blocks.expressions.graph import OPERATIONS, followed
from twodof.blocks.expressions.numbers import FLOATS, Int32, Integer, Vector
from twodof.errors import DiagramError

Slope = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Dual:
    """A number of the language and its slope; None means 0, as always for an integer or bool."""

    value: Any
    slope: Slope | None = None


Value = Dual | tuple[Dual, ...]


@dataclass(frozen=True)
class Tie:
    """A branch that changes exactly at the point: the block `where`, a description `what`, and the deciding slope.

    With `single`, the branch of the point itself is taken at that point only, as for `==`.
    """

    where: str
    what: str
    slope: Slope
    single: bool = False


def constant(value: Any) -> Value:
    """Return a number or Vector as a value without a slope."""
    return tuple(Dual(v) for v in value) if isinstance(value, tuple) else Dual(value)


def plain(value: Value) -> Any:
    """Return the number, or the Vector of numbers, of a value without its slope."""
    return Vector(d.value for d in value) if isinstance(value, tuple) else value.value


_PARTIAL: dict[str, Callable[..., tuple[float, ...]]] = {
    "add": lambda a, b, y: (1.0, 1.0),
    "sub": lambda a, b, y: (1.0, -1.0),
    "mul": lambda a, b, y: (b, a),
    "div": lambda a, b, y: (1.0 / b, -y / b),
    "neg": lambda x, y: (-1.0,),
    "sqrt": lambda x, y: (0.5 / y,),
    "sin": lambda x, y: (math.cos(x),),
    "cos": lambda x, y: (-math.sin(x),),
    "sin_octant": lambda x, y: (math.cos(x),),
    "cos_octant": lambda x, y: (-math.sin(x),),
    "tan": lambda x, y: (1.0 + y * y,),
    "atan": lambda x, y: (1.0 / (1.0 + x * x),),
    "atan2": lambda a, b, y: (b / (a * a + b * b), -a / (a * a + b * b)),
    "asin": lambda x, y: (1.0 / math.sqrt(1.0 - x * x),),
    "acos": lambda x, y: (-1.0 / math.sqrt(1.0 - x * x),),
    "exp": lambda x, y: (y,),
    "log": lambda x, y: (1.0 / x,),
    "pow": lambda x, n, y: (n * math.pow(x, n - 1.0), y * math.log(x) if x > 0.0 else math.nan),
    "tanh": lambda x, y: (1.0 - y * y,),
    "hypot": lambda a, b, y: (a / y, b / y),
}
"""Derivatives of operations and elementary functions by each argument, as functions of arguments and result."""

_HALF = dict.fromkeys(("round_half_even", "round_half_away"), lambda x: math.floor(x + 0.5))
_STEPS: dict[str, Callable[[float], float]] = {"floor": math.floor, "ceil": math.ceil, "trunc": math.trunc, **_HALF}
_NEVER = math.nan
_WITHIN = 1e-12  # the sine of an angle by which a direction may leave a border and be within it


class Tangent:
    """Evaluation of expressions with their slopes, in float64; to be used under `numbers.precision("float64")`.

    At a tie the branch is that into which `direction`, a motion of the seeds, leads; by default it is that of the point
    itself. `ties` collects the ties that were met, `rounded` the blocks in which a slope ends at a rounding; `block` is
    the path of the block that is evaluated.
    """

    def __init__(self, direction: Slope | None = None) -> None:
        self.direction = direction
        self.ties: list[Tie] = []
        self.rounded: set[str] = set()
        self.block = ""

    def evaluate(
        self, roots: Sequence[Expr], leaf: Callable[[Expr], Value], memo: dict[Any, Value] | None = None
    ) -> list[Value]:
        """Return the values of `roots`, given those of their leaves; `memo` keeps values by the node's id.

        Raises DiagramError for bit patterns, which have no derivative.
        """

        def compute(item: Expr, args: list[Value]) -> Value:
            if item.op == "const":
                return Dual(numbers.cast(item.data, item.kind))
            return self._compute(item, args) if args else leaf(item)

        return followed(roots, compute, _build, _fold, {} if memo is None else memo)

    def _compute(self, item: Expr, args: list[Value]) -> Value:
        op = item.op
        if op == "vector":
            return tuple(_scalar(a) for a in args)
        if op in ("select", "store"):
            return _element(op, args)
        duals = [_scalar(a) for a in args]
        if all(d.slope is None for d in duals):
            return Dual(self._number(item, [d.value for d in duals]))
        if op == "convert" and item.args[0].kind in FLOATS and item.kind in FLOATS:  # as if it did not round
            return Dual(self._number(item, [duals[0].value]), duals[0].slope)
        if item.kind not in FLOATS or op in ("convert", "bits") or (op == "call" and item.data in _STEPS):
            return Dual(self._stepwise(item, duals))
        return self._smooth(item, duals)

    def _number(self, item: Expr, args: list[Any]) -> Any:
        if item.op == "convert":
            return convert(args[0], item.kind)
        if item.op == "call":
            return FUNCTIONS[item.data](*args)
        if item.op in ("bits", "from_bits"):
            raise DiagramError("bit patterns have no derivative", self.block, "use the functions of twodof.blocks")
        return OPERATIONS[item.op](*args)

    def _smooth(self, item: Expr, d: list[Dual]) -> Dual:
        op = item.op
        if op == "where":
            return d[1] if d[0].value else d[2]
        values = [a.value for a in d]
        value = self._number(item, values)
        if op == "abs":
            return Dual(value, _scaled(d[0].slope, self._sign(d[0])))
        name = item.data if op == "call" else op
        if name not in _PARTIAL:
            raise DiagramError(f"{name} has no derivative", self.block, "use the functions of twodof.blocks")
        try:
            # By operators numpy's numbers may become infinite; where a function has no slope, Python's raise.
            partial = _PARTIAL[name](*(map(float if op == "call" else np.float64, values)), np.float64(value))
        except (ValueError, ZeroDivisionError, OverflowError):
            partial = (_NEVER,) * len(d)
        return Dual(value, _sum(d[0].slope, partial[0], d[1].slope if len(d) > 1 else None, partial[-1]))

    def _sign(self, d: Dual) -> float:
        if d.value != 0.0 or d.slope is None:
            return float(np.sign(d.value))
        return self._side("the argument of abs is 0", d.slope) or 1.0

    def _side(self, what: str, slope: Slope, single: bool = False) -> float:
        """-1, 1 or 0: to which side of a tie the direction leads; 0 where it stays on it."""
        if not slope.any():
            return 0.0
        self.ties.append(Tie(self.block, what, slope, single))
        if self.direction is None:
            return 0.0
        along = slope @ self.direction
        stays = abs(along) <= _WITHIN * np.linalg.norm(slope) * np.linalg.norm(self.direction)
        return 0.0 if stays else float(np.sign(along))

    def _stepwise(self, item: Expr, d: list[Dual]) -> Any:
        """Evaluate an operation that has no slope and may jump: comparison, rounding, conversion to an integer."""
        values = [a.value for a in d]
        found = self._number(item, values)
        if item.op in ("lt", "le", "eq", "ne") and item.args[0] is not item.args[1]:
            if values[0] != values[1]:
                return found
            difference = _sum(d[0].slope, 1.0, d[1].slope, -1.0)
            what = "both sides of a comparison are equal"
            side = 0.0 if difference is None else self._side(what, difference, item.op in ("eq", "ne"))
            if side == 0.0:
                return found
            return np.bool_(side < 0.0 if item.op in ("lt", "le") else item.op == "ne")
        x, slope = float(values[0]), d[0].slope
        name = {"call": item.data, "convert": "trunc"}.get(item.op, "")
        if name in _STEPS:
            self.rounded.add(self.block)
        edge = x + 0.5 if name in _HALF else x
        if name not in _STEPS or slope is None or not math.isfinite(x) or edge != math.floor(edge):
            return found
        side = self._side("a number that is rounded is whole", slope)
        beside = _STEPS[name](x + 0.25 * side) if abs(x) < 2.0**50 else x
        return convert(numbers.cast(float(beside), "real"), item.kind)


def _build(length: int, element: Callable[[Dual], Value]) -> Value:
    made = (element(Dual(Int32(i))) for i in range(length))
    return tuple(v for one in made for v in (one if isinstance(one, tuple) else (one,)))


def _fold(length: int, initial: list[Value], step: Callable[..., list[Value]]) -> tuple[Dual, ...]:
    carried = initial
    for i in range(length):
        carried = step(Dual(Int32(i)), *carried)
    return tuple(map(_scalar, carried))


def _scalar(value: Value) -> Dual:
    if isinstance(value, tuple):
        raise TypeError("an array stands where a scalar is expected")
    return value


def _element(op: str, args: list[Value]) -> Value:
    array, index = args[0], _scalar(args[1]).value
    if not isinstance(array, tuple) or not isinstance(index, Integer):
        raise TypeError("an element of no array")
    place = numbers.clamp_index(index, len(array))
    if op == "select":
        return array[place]
    return (*array[:place], _scalar(args[2]), *array[place + 1 :])


def _scaled(slope: Slope | None, factor: float) -> Slope | None:
    return None if slope is None else slope * factor


def _sum(a: Slope | None, by_a: float, b: Slope | None, by_b: float) -> Slope | None:
    """Return a * by_a + b * by_b, where None is zero."""
    if a is None or b is None:
        return _scaled(a, by_a) if b is None else _scaled(b, by_b)
    return a * by_a + b * by_b
