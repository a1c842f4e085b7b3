"""The operations of the language as C99, one row each; `where` is C's conditional (ternary) operator."""

from collections.abc import Iterator
from dataclasses import dataclass

from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.numbers import CONVERSIONS, FLOATS, INTEGERS, TAKES, WORDS

C_TYPES = {"real": "real", "float32": "float", "float64": "double", "bool": "bool"}
C_TYPES |= {kind: f"{kind}_t" for kind in INTEGERS}
# How tightly an expression's text binds.
ATOM, PRODUCT, SUM, SIGNED, COMPARISON, LOOSE = range(6)
COMPARISONS = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}
PLAIN = {op: f"plain_{op}" for op in ("add", "sub", "mul", "quot", "rem")}
"""Names of the rows for int32 arithmetic whose result cannot wrap around, by operation."""
BITWISE = {"and": "&", "or": "|", "xor": "^"}


@dataclass(frozen=True)
class Operator:
    """C of an operation: `text` with `{0}`, `{1}` for its operands, which may call the function `helper`.

    `operands` are the loosest bindings at which each operand needs no brackets, `binding` is that of the whole text.
    `{f}` is the suffix of C's functions for the build's precision: "f" for float32.
    """

    text: str
    operands: tuple[int, ...] = (LOOSE, LOOSE, LOOSE)
    binding: int = ATOM
    helper: str = ""


def called(name: str, operands: int, helper: str = "") -> Operator:
    """Return the operator that calls the C function `name` with `operands` arguments."""
    return Operator(f"{name}({', '.join(f'{{{i}}}' for i in range(operands))})", helper=helper)


def row(item: Expr, operand: str) -> str:
    """Return the name of the row in OPERATORS for an operation whose first operand is of the type `operand`."""
    if item.op == "where":
        return f"where_{item.kind}"
    if item.op in COMPARISONS:
        return f"{item.op}_{operand}"
    if item.op == "convert":
        return f"{operand}_to_{item.kind}"
    if item.op == "bits":
        return f"{operand}_word_{1 if item.data else 0}"
    if item.op == "from_bits":
        return f"{item.kind}_from_{'bits' if len(item.args) == 2 else 'word'}"
    return f"{item.op}_{item.kind}"


def _rows() -> Iterator[tuple[str, Operator]]:
    for kind in C_TYPES:
        yield f"where_{kind}", Operator("{0} ? {1} : {2}", (COMPARISON, SIGNED, SIGNED), LOOSE)
        for op, sign in COMPARISONS.items():
            if kind in TAKES[op]:
                yield f"{op}_{kind}", Operator(f"{{0}} {sign} {{1}}", (SUM, SUM), COMPARISON)
    for origin, target in CONVERSIONS:
        name = f"{origin}_to_{target}"
        cast = origin not in FLOATS or target in FLOATS
        yield name, Operator(f"({C_TYPES[target]}){{0}}", (ATOM,), SIGNED) if cast else called(name, 1, name)
    for kind in (*FLOATS, "uint32"):
        yield f"add_{kind}", Operator("{0} + {1}", (SUM, PRODUCT), SUM)
        yield f"sub_{kind}", Operator("{0} - {1}", (SUM, PRODUCT), SUM)
        yield f"mul_{kind}", Operator("{0} * {1}", (PRODUCT, ATOM), PRODUCT)
    for kind, f in zip(FLOATS, ("{f}", "f", ""), strict=True):
        yield f"div_{kind}", Operator("{0} / {1}", (PRODUCT, ATOM), PRODUCT)
        yield f"neg_{kind}", Operator("-{0}", (ATOM,), SIGNED)
        yield f"abs_{kind}", called(f"__builtin_fabs{f}", 1)
        yield f"sqrt_{kind}", called(f"__builtin_sqrt{f}", 1)
        for name, operands in (("word_0", 1), ("word_1", 1), ("from_bits", 2), ("from_word", 1)):
            yield f"{kind}_{name}", called(f"{kind}_{name}", operands, f"{kind}_{name}")
    yield "not_bool", Operator("!{0}", (ATOM,), SIGNED)
    for op, sign in (("and", "&&"), ("or", "||"), ("xor", "!=")):
        yield f"{op}_bool", Operator(f"{{0}} {sign} {{1}}", (ATOM, ATOM), LOOSE)
    for kind in WORDS:
        yield f"not_{kind}", Operator("~{0}", (ATOM,), SIGNED)
        for op, sign in BITWISE.items():
            yield f"{op}_{kind}", Operator(f"{{0}} {sign} {{1}}", (ATOM, ATOM), LOOSE)
        for op in ("quot", "rem"):
            yield f"{op}_{kind}", called(f"{kind}_{op}", 2, f"{kind}_{op}")
    for op in ("add", "sub", "mul", "shl", "shr"):
        yield f"{op}_int32", called(f"int32_{op}", 2, f"int32_{op}")
    for op in ("neg", "abs"):
        yield f"{op}_int32", called(f"int32_{op}", 1, f"int32_{op}")
    for op, sign in (("add", "+"), ("sub", "-")):
        yield PLAIN[op], Operator(f"{{0}} {sign} {{1}}", (SUM, PRODUCT), SUM)
    for op, sign in (("mul", "*"), ("quot", "/"), ("rem", "%")):
        yield PLAIN[op], Operator(f"{{0}} {sign} {{1}}", (PRODUCT, ATOM), PRODUCT)
    yield "shl_uint32", Operator("{0} << ({1} & 31u)", (ATOM, ATOM), LOOSE)
    yield "shr_uint32", Operator("{0} >> ({1} & 31u)", (ATOM, ATOM), LOOSE)
    yield "neg_uint32", Operator("0u - {0}", (PRODUCT,), SUM)
    yield "abs_uint32", Operator("{0}", (LOOSE,), LOOSE)
    yield "mulhi_uint32", Operator("(uint32_t)(((uint64_t){0} * {1}) >> 32)", (ATOM, ATOM), SIGNED)


OPERATORS = dict(_rows())
"""The operators, by the name that `row` returns."""
