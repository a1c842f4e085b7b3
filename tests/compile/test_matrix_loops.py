"""What matrices cost in C: what is read once is computed where it is read, and an index is clamped once."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from twodof.blocks import Block, Diagram, Port, State, array_of, minimum, outer, sum
from twodof.blocks.reference import Reference
from twodof.compile import build
from twodof.compile.builder import emit_program

ROWS, COLUMNS = 5, 4


class Formula(Block):
    """y is a formula of the matrices m, n and s, the vectors v and w, and the indices i and j."""

    def __init__(self, formula: Callable[[Any], Any], **output: Any) -> None:
        self.formula = formula
        shapes = {"m": (ROWS, COLUMNS), "n": (ROWS, COLUMNS), "s": (COLUMNS, COLUMNS)}
        self.inputs = [
            *(Port(name, shape=shape) for name, shape in shapes.items()),
            *(Port("v", width=ROWS), Port("w", width=COLUMNS), Port("i", "int32"), Port("j", "int32")),
        ]
        self.outputs = [Port("y", **output)]

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self.formula(u)


def diagram(formula: Callable[[Any], Any], **output: Any) -> Diagram:
    d, block = Diagram("formula"), Formula(formula, **output)
    for port in block.inputs:
        d.input(port.name, port.kind, port.width if port.shape is None else None, shape=port.shape)
    d.add("block", block, inputs={port.name: port.name for port in block.inputs})
    d.output("y", "block.y")
    return d


WHOLE: dict[str, tuple[Callable[[Any], Any], dict[str, Any], Callable[..., Any]]] = {
    "transpose in a product": (
        lambda u: u.s @ u.m.T,
        {"shape": (COLUMNS, ROWS)},
        lambda u: u["s"] @ u["m"].T,
    ),
    "outer product taken away": (
        lambda u: u.m - outer(u.v, u.w),
        {"shape": (ROWS, COLUMNS)},
        lambda u: u["m"] - np.outer(u["v"], u["w"]),
    ),
    "transposes of transposes": (
        lambda u: (u.m.T.T + outer(u.w, u.v).T) * u.n,
        {"shape": (ROWS, COLUMNS)},
        lambda u: (u["m"] + np.outer(u["w"], u["v"]).T) * u["n"],
    ),
    "elements of a computed column": (
        lambda u: array_of(ROWS, lambda i: u.m[i, u.j] + u.m[u.i, 1]),
        {"width": ROWS},
        lambda u: u["m"][:, np.clip(u["j"], 0, COLUMNS - 1)] + u["m"][np.clip(u["i"], 0, ROWS - 1), 1],
    ),
}


@pytest.mark.parametrize("name", WHOLE)
def test_what_is_read_once_needs_no_array_and_no_second_clamp(name: str) -> None:
    formula, output, _ = WHOLE[name]
    source = emit_program(diagram(formula, **output), 0.1).source
    step = source[source.index("void formula_advance(const formula_P *restrict") :]
    arrays = re.findall(r"^ +real (\w+)\[", step, re.MULTILINE)
    assert [a for a in arrays if a != "block_y"] == (["block_array"] if "of transposes" in name else [])
    assert "clamp_index" not in source


@pytest.mark.parametrize("name", WHOLE)
def test_it_is_what_numpy_computes_with_the_references_bits(name: str) -> None:
    formula, output, by_numpy = WHOLE[name]
    d = diagram(formula, **output)
    reference, native = Reference(d, 0.1).machine(), build(d, 0.1, optimise="-O1").machine()
    rng = np.random.default_rng(7)
    for i, j in ((0, 0), (4, 3), (-7, 2**31 - 1), (2**31 - 1, -(2**31)), (3, 1)):
        given = {n: rng.normal(size=p.shape or p.width) for n, p in d.inputs.items() if p.kind == "real"}
        found = np.asarray(reference.step({**given, "i": i, "j": j})["y"])
        assert np.array_equal(found, np.asarray(native.step({**given, "i": i, "j": j})["y"]))
        np.testing.assert_allclose(found, by_numpy({**given, "i": i, "j": j}), rtol=1e-13, atol=1e-14)


class OwnReader(Block):
    """`shown`, `long` and the next state read what `kept` gives, by way of a wire from this output to an input."""

    inputs = (Port("back", shape=(3, 3)), Port("z"))
    outputs = (Port("kept", shape=(3, 3)), Port("shown"), Port("long", width=12))
    states = (State("x", 0.5, shape=(3, 3)), State("n"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        total = sum(u.back @ u.back)
        return {"kept": x.x + 1.0, "shown": total * total, "long": array_of(12, lambda i: total + u.back[i // 4, 0])}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"x": minimum(5.0, u.back * u.z), "n": x.n + u.back[1, 1]}


def test_a_block_that_reads_its_own_output_computes_that_first() -> None:
    d = Diagram("own")
    d.input("z")
    d.add("block", OwnReader(), z="z")
    d.connect("block.kept", "block.back")
    for name in ("kept", "shown", "long"):
        d.output(name, f"block.{name}")
    reference, native = Reference(d, 0.1).machine(), build(d, 0.1, optimise="-O1").machine()
    for k in range(4):
        expected, found = reference.step({"z": 0.3 * k}), native.step({"z": 0.3 * k})
        for name in expected:
            assert np.array_equal(np.asarray(expected[name]), np.asarray(found[name]))
    assert native.state("block.n") == reference.state("block.n")
