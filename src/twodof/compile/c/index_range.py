"""Between which bounds an integer made of constants and loop counters lies: then it needs no clamp and cannot wrap."""

from collections.abc import Mapping

from twodof.blocks.expressions.expr import Expr

DEEPEST = 20  # operations within one another that are looked at
_LOW, _HIGH = -(2**31), 2**31 - 1

Span = tuple[int, int]


def index_range(item: Expr, limits: Mapping[tuple[int, int], int], depth: int = 0) -> Span | None:
    """The least and the largest value of an int32, or None where that is not known or it may wrap around.

    `limits` has one more than the largest value of each loop counter, by its depth and 0.
    """
    if item.kind != "int32" or item.width is not None or depth > DEEPEST:
        return None
    if item.op == "const":
        return item.data, item.data
    if item.op == "bound":
        return (0, limits[item.data] - 1) if item.data in limits else None
    if item.op not in ("add", "sub", "mul", "quot", "rem"):
        return None
    a, b = (index_range(each, limits, depth + 1) for each in item.args)
    if a is None or b is None:
        return None
    if item.op in ("quot", "rem"):
        if a[0] < 0 or b[0] != b[1] or b[0] <= 0:
            return None
        return (a[0] // b[0], a[1] // b[0]) if item.op == "quot" else (0, min(a[1], b[0] - 1))
    if item.op == "sub":
        b = (-b[1], -b[0])
    ends = [x * y if item.op == "mul" else x + y for x in a for y in b]
    return (min(ends), max(ends)) if min(ends) >= _LOW and max(ends) <= _HIGH else None
