"""Guards and actions as text, such as `v > 0.1 and after(25)` or `n = n + 1; y = 0.0`. Nothing of a text is executed.

A text has names, numbers, arithmetic, comparisons, and/or/not, `a if b else c`, and calls of the language's functions.
"""

import ast
import math
import operator
import warnings
from collections.abc import Callable, Mapping
from typing import Any

from twodof.blocks.elementary.functions import FUNCTIONS
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import Expr, as_expr, maximum, minimum, sqrt, to_int32, to_real, to_uint32, where
from twodof.blocks.namespaces import BusView
from twodof.errors import DiagramError, TwodofError, nearest, shown

MAX_TEXT = 1000  # characters of a guard or an action
MAX_DEPTH = 40  # of operations within one another
MAX_INTEGER = 2**64  # what a literal, and arithmetic of literals, may reach

CALLED: Mapping[str, Callable[..., Any]] = {
    **FUNCTIONS,
    **{f.__name__: f for f in (maximum, minimum, sqrt, to_int32, to_real, to_uint32, where)},
    "abs": abs,
    "max": maximum,
    "min": minimum,
}
"""The functions that a text may call, beside `after`."""
_CONSTANTS = {"true": True, "false": False}
_OPERATORS: Mapping[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_INSTEAD: Mapping[type[ast.AST], str] = {
    ast.Pow: "write x * x, or pow(x, y)",
    ast.BitAnd: "write `and`",
    ast.BitOr: "write `or`",
    ast.Invert: "write `not`",
    ast.Call: "call a function by its name, with values alone",
}
_FORM = "write names, numbers, + - * /, comparisons, and/or/not, and functions such as sin(x) or after(25)"
_AFTER = "write after(25) for ticks, or after(0.5, sec)"


class TextFault(DiagramError):
    """Mistake in a text; `where` is its column, from 1 on."""


class ActionText:
    """Guard or action that `text` is, called as the functions in its place: with u, x, p and t.

    The statements of an action are done one after the other. Raises TextFault, when called, for a mistake in the text.
    """

    def __init__(self, text: str, guard: bool) -> None:
        self.text = text
        self.guard = guard
        self._source = text.replace("\n", " ").strip() if guard else text.strip()
        self._body: list[ast.stmt] | None = None

    def __call__(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        if self._body is None:
            self._body = _parsed(self._source, self.guard)
        reading = _Reading(self._source, u, x, p, t)
        if self.guard:
            return reading.value(self._body[0].value) if self._body else True  # type: ignore[attr-defined]
        for statement in self._body:
            reading.assign(statement)
        return reading.given


def _parsed(text: str, guard: bool) -> list[ast.stmt]:
    if len(text) > MAX_TEXT:
        raise TextFault(
            f"a text of {len(text)} characters", "column 1", f"at most {MAX_TEXT}: use a block or variables"
        )
    if not text.isascii():
        column = next(k for k, c in enumerate(text) if not c.isascii())
        raise TextFault(f"the character {shown(text[column])}", f"column {column + 1}", "write ASCII characters")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as for `1or 2`
            body = ast.parse(text).body
    except SyntaxError as error:
        remedy = "compare with ==" if guard and "=" in text else _FORM
        raise TextFault(f"it cannot be read: {error.msg}", f"column {error.offset or 1}", remedy) from error
    except (ValueError, MemoryError, RecursionError) as error:
        raise TextFault("this is nested too deep, or has a character that is not seen", "column 1", _FORM) from error
    if guard and body and not (len(body) == 1 and isinstance(body[0], ast.Expr)):
        raise TextFault("a guard is one condition", _column(body[-1]), "compare with ==; assign in an action")
    return body


def _column(node: ast.AST) -> str:
    line, column = getattr(node, "lineno", 1), getattr(node, "col_offset", 0) + 1
    return f"column {column}" if line == 1 else f"line {line}, column {column}"


class _Reading:
    """One reading of a text; `given` are the values assigned so far."""

    def __init__(self, source: str, u: Any, x: Any, p: Any, t: Any) -> None:
        self.source = source
        self.clock = t
        own = {name: getattr(t, name) for name in ("elapsed", "elapsed_time")}
        self.names = [
            ("an input", vars(u)),
            ("a variable", dict(vars(x))),
            ("a parameter", vars(p)),
            ("a constant", _CONSTANTS),
            ("the time in the mode", own),
        ]
        self.given: dict[str, Any] = {}

    def assign(self, statement: ast.stmt) -> None:
        """Assign to a variable or an output."""
        match statement:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                found = self.value(value)
            case ast.AugAssign(target=ast.Name(id=name) as target, op=op, value=value) if type(op) in _OPERATORS:
                found = self.value(ast.copy_location(ast.BinOp(ast.Name(name), op, value), target))
            case _:
                raise TextFault("an action assigns values", _column(statement), "write such as y = 0.0; n = n + 1")
        self.given[name] = found
        variables = self.names[1][1]
        if name in variables:  # what follows reads the new value
            try:
                variables[name] = _as_kept(found, variables[name])
            except TwodofError as error:
                raise TextFault(f"{name!r}: {error.what}", _column(statement), error.remedy) from error

    def value(self, node: ast.expr, depth: int = 0) -> Any:
        """Compute an expression."""
        if depth > MAX_DEPTH:
            raise TextFault(f"more than {MAX_DEPTH} operations within one another", _column(node), "use a variable")
        try:
            found = self._value(node, depth + 1)
        except TextFault:
            raise
        except (TwodofError, ArithmeticError, TypeError, ValueError) as error:
            what, remedy = (error.what, error.remedy) if isinstance(error, TwodofError) else (str(error), _FORM)
            raise TextFault(what, _column(node), remedy) from error
        if (type(found) is float and not math.isfinite(found)) or (type(found) is int and abs(found) > MAX_INTEGER):
            raise TextFault("this number is too large", _column(node), "write a smaller one")
        return found

    def _value(self, node: ast.expr, depth: int) -> Any:
        match node:
            case ast.Constant(value=bool() | int() | float()):
                return node.value
            case ast.Name(id=name):
                return self._named(name, node)
            case ast.Attribute(value=inner, attr=name):
                bus = self.value(inner, depth)
                if not isinstance(bus, BusView):
                    raise TextFault(f"the field {name!r} of what is not a bus", _column(node), "give its name alone")
                return getattr(bus, name) if name in vars(bus) else _unknown(name, vars(bus), node)
            case ast.BinOp(left=a, op=op, right=b) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](self.value(a, depth), self.value(b, depth))
            case ast.UnaryOp(op=ast.USub(), operand=a):
                return -self.value(a, depth)
            case ast.UnaryOp(op=ast.UAdd(), operand=a):
                return +self.value(a, depth)
            case ast.UnaryOp(op=ast.Not(), operand=a):
                return _not(self.truth(a, depth))
            case ast.BoolOp(op=op, values=values):
                join = operator.and_ if isinstance(op, ast.And) else operator.or_
                found = self.truth(values[0], depth)
                for one in values[1:]:
                    found = join(found, self.truth(one, depth))
                return found
            case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _OPERATORS for op in ops):
                sides = [self.value(one, depth) for one in (left, *others)]
                pairs = zip(ops, sides, sides[1:], strict=False)
                first, *more = (_OPERATORS[type(op)](a, b) for op, a, b in pairs)
                for one in more:
                    first = first & one
                return first
            case ast.IfExp(test=test, body=a, orelse=b):
                return where(self.truth(test, depth), self.value(a, depth), self.value(b, depth))
            case ast.Call(func=ast.Name(id="after"), args=args, keywords=[]):
                return self._after(args, node, depth)
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
                if name not in CALLED:
                    there = nearest(name, [*CALLED, "after"])
                    raise TextFault(f"no function named {name!r}", _column(node), f"there are: {there}")
                return CALLED[name](*(self.value(one, depth) for one in args))
        operation: ast.AST = getattr(node, "op", node)
        instead = _INSTEAD.get(type(operation), _FORM)
        part = shown(ast.get_source_segment(self.source, node))
        raise TextFault(f"{part} cannot stand in a text", _column(node), instead)

    def _named(self, name: str, node: ast.expr) -> Any:
        found = [(what, values) for what, values in self.names if name in values]
        if len(found) > 1:
            what = f"{name!r} is {found[0][0]} and {found[1][0]}"
            raise TextFault(what, _column(node), "give one of them another name")
        if not found:
            _unknown(name, [known for _, values in self.names for known in values], node)
        return found[0][1][name]

    def truth(self, node: ast.expr, depth: int) -> Any:
        """Compute a condition."""
        found = self.value(node, depth)
        kind = found.kind if isinstance(found, Expr) else numbers.kind_of(found)
        if kind != "bool":
            raise TextFault(f"this is a {kind}, and not true or false", _column(node), "compare it, as in v > 0.0")
        return found

    def _after(self, args: list[ast.expr], node: ast.expr, depth: int) -> Any:
        """Return True from the n-th tick, or second, in the mode on."""
        match args:
            case [ticks] | [ticks, ast.Name(id="tick")]:
                count = self.value(ticks, depth)
                if isinstance(count, (bool, float)):
                    raise TextFault(f"{count} ticks", _column(node), _AFTER)
                return self.clock.elapsed >= count
            case [seconds, ast.Name(id="sec")]:
                return self.clock.elapsed_time >= self.value(seconds, depth)
        raise TextFault("after takes a number, and tick or sec", _column(node), _AFTER)


def _unknown(name: str, known: Any, node: ast.AST) -> Any:
    raise TextFault(f"unknown name {name!r}", _column(node), f"there are: {nearest(name, known)}")


def _not(value: Any) -> Any:
    return not value if isinstance(value, bool) else ~value


def _as_kept(value: Any, before: Any) -> Any:
    """Return `value` as the variable that was `before` keeps it; an array as it is."""
    return as_expr(value, before.kind) if isinstance(before, Expr) and before.width is None else value
