"""A recorded expression as a person would write it, for reports; long ones are cut."""

import re
from collections.abc import Mapping

from twodof.blocks.expressions.expr import Expr

MAX_TEXT = 72
_DEPTH = 4
_INFIX: Mapping[str, str] = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "quot": "//", "rem": "%", "shl": "<<", "shr": ">>",
    "and": "&", "or": "|", "xor": "^",
}  # fmt: skip
_COMPARES: Mapping[str, str] = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}
_TURNED: Mapping[str, str] = {"lt": ">", "le": ">="}
_PREFIX: Mapping[str, str] = {"neg": "-", "not": "~"}
_SECONDS = "to_real(x.elapsed) * t.dt"
_LEAVES: Mapping[str, str] = {"input": "u.", "state": "x.", "param": "p.", "tick": "t.", "dt": "t."}


def text_of(item: Expr) -> str:
    """`item` in the language's own words, such as `u.u < p.low`."""
    text = _text(item, _DEPTH)
    return text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 3] + "..."


def machine_text(item: Expr) -> str:
    """Return a guard or an action's value of a state machine in the words of its function."""
    text = text_of(item).replace(f"({_SECONDS})", "t.elapsed_time").replace(_SECONDS, "t.elapsed_time")
    return re.sub(r"\bx\.elapsed\b", "t.elapsed", text)


def limit_of(item: Expr) -> tuple[str, Expr, Expr] | None:
    """("min" or "max", a, b) if `item` is what minimum(a, b) or maximum(a, b) records."""
    if item.op != "where" or item.args[0].op != "lt":
        return None
    low, high = item.args[0].args
    if item.args[1] is low and item.args[2] is high:
        return "min", low, high
    if item.args[1] is high and item.args[2] is low:
        return "max", high, low
    return None


def _text(item: Expr, depth: int) -> str:
    if item.op in _LEAVES:
        return f"{_LEAVES[item.op]}{item.data}"
    if item.op == "const":
        return f"{item.data:g}" if isinstance(item.data, float) else str(item.data).lower()
    if item.op == "bound":
        return "i" if item.data[1] == 0 else f"s{item.data[1]}"
    if depth == 0 or not item.args:
        return "..."
    limit = limit_of(item)
    if limit is not None:
        return f"{limit[0]}({_text(limit[1], depth - 1)}, {_text(limit[2], depth - 1)})"
    args = [_text(a, depth - 1) for a in item.args[:4]]
    if item.op in _COMPARES:
        if item.args[0].op == "const" and item.op in _TURNED:
            return f"{args[1]} {_TURNED[item.op]} {args[0]}"  # u > 5 is recorded as 5 < u
        return f"{args[0]} {_COMPARES[item.op]} {args[1]}"
    if item.op in _INFIX:
        return " ".join((_inner(item.args[0], args[0]), _INFIX[item.op], _inner(item.args[1], args[1])))
    if item.op in _PREFIX:
        return _PREFIX[item.op] + _inner(item.args[0], args[0])
    if item.op == "select":
        return f"{args[0]}[{args[1]}]"
    name = {"call": item.data, "convert": f"to_{item.kind}"}.get(item.op, item.op)
    if item.op in ("build", "fold"):
        return f"{name}(...)"
    return f"{name}({', '.join(args)}{', ...' if len(item.args) > len(args) else ''})"


def _inner(item: Expr, text: str) -> str:
    """Return the text of an operand, in parentheses where it is an operation of two itself."""
    return f"({text})" if item.op in _INFIX or item.op in _COMPARES else text
