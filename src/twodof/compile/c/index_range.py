"""Between which bounds an integer lies that is made of constants and loop counters, or clamped: it needs no clamp."""

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
    if item.op == "where":
        return _chosen(item, limits, depth + 4)
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


def _chosen(item: Expr, limits: Mapping[tuple[int, int], int], depth: int) -> Span:
    """Of `where`: that of the smaller or the larger of two, as a clamp has them, or of either."""
    test, a, b = item.args
    low, high = zip(*(index_range(e, limits, depth) or (_LOW, _HIGH) for e in (a, b)), strict=True)
    compared = [id(e) for e in test.args] if test.op == "lt" else []
    if compared == [id(a), id(b)]:
        return min(low), min(high)
    return (max(low) if compared == [id(b), id(a)] else min(low)), max(high)
