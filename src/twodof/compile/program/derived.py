"""Derived parameters in doubles: what `prepare` computes in float64 and rounds once, in builds of float32 too."""

from collections.abc import Mapping

from twodof.blocks.expressions.expr import Expr, node
from twodof.blocks.expressions.graph import walk

EXACT = "float64"


def in_doubles(exprs: Mapping[str, Expr]) -> dict[str, Expr]:
    """What `prepare` gives, with each real in it a float64, except the parameters and the results themselves.

    In a build of float64 that is the same arithmetic.
    """
    wide: dict[int, Expr] = {}
    for item in walk(exprs.values()):
        wide[id(item)] = _widened(item, wide)
    return {name: _rounded(wide[id(e)]) if e.kind == "real" else wide[id(e)] for name, e in exprs.items()}


def _widened(item: Expr, wide: Mapping[int, Expr]) -> Expr:
    """A node with float64 in the place of real; parameters are kept as they are and converted where they are read."""
    args = [wide[id(a)] for a in item.args]
    if item.op == "param":
        return _converted(item, EXACT) if item.kind == "real" else item
    if item.op == "select" and item.args[0].op == "param" and item.kind == "real":
        return node("convert", EXACT, (node("select", "real", (item.args[0], args[1])),))
    kind = EXACT if item.kind == "real" else item.kind
    if item.op == "convert" and args[0].kind == kind:
        return args[0]
    return node(item.op, kind, tuple(args), item.data, item.width)


def _rounded(item: Expr) -> Expr:
    """A float64, or an array of them, as real."""
    if item.op == "vector":
        return node("vector", "real", tuple(_converted(a, "real") for a in item.args), None, item.width)
    return _converted(item, "real")


def _converted(item: Expr, kind: str) -> Expr:
    """A number as another float kind; of an array each element, in a loop."""
    if item.width is None:
        return node("convert", kind, (item,))
    # The array does not read the loop's counter, so it is made before the loop, whatever loops are around.
    element = node("select", item.kind, (item, node("bound", "int32", (), (0, 0))))
    return node("build", kind, (node("convert", kind, (element,)),), (item.width, 0), item.width)
