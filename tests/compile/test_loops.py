"""Loops within loops: what a loop does not change is computed once, so that cost grows as the arithmetic does."""

from typing import Any

import numpy as np
import pytest

from tests.compile.differential import same
from twodof.blocks import Block, Diagram, Port, State, array_of, fold, sin, to_int32, to_real
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import build
from twodof.compile.program.lower import lower
from twodof.compile.wasm.module import operations

pytestmark = pytest.mark.slow

DT = 0.01
N = 3


def product(a: Any, b: Any) -> Any:
    """The product of two N x N matrices, row after row, as loops."""

    def element(k: Any) -> Any:
        return fold(N, [0.0], lambda m, s: [s + a[k // N * N + m] * b[m * N + k % N]])[0]

    return array_of(N * N, element)


class Powers(Block):
    """y = a b^count."""

    inputs = (Port("a", width=N * N), Port("b", width=N * N))
    outputs = (Port("y", width=N * N),)

    def __init__(self, count: int) -> None:
        self.count = count

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        found = u.a
        for _ in range(self.count):
            found = product(found, u.b)
        return found


def powers(count: int) -> Diagram:
    d = Diagram("powers")
    d.input("a", width=N * N)
    d.input("b", width=N * N)
    d.add("c", Powers(count), a="a", b="b")
    d.output("y", "c")
    return d


def test_chained_products_cost_as_much_as_their_arithmetic() -> None:
    """Six of them took 2,300 us, and four were refused, when each turn of a loop computed the matrices before it."""
    costs = [operations(lower(powers(count), DT)) for count in (4, 8, 12)]
    lines = [build(powers(count), DT, optimise="-O0").source.count("\n") for count in (4, 8, 12)]
    turn = 20  # operations: a product, a sum, and the arithmetic of indices
    assert costs[2] - costs[1] == costs[1] - costs[0] < 4 * N * N * N * turn
    assert lines[2] - lines[1] == lines[1] - lines[0]


class Loops(Block):
    """Arrays, calls and loops in loops that change at every turn of the inner loop, of the outer one, or at none."""

    inputs = (Port("u"), Port("k", "int32"))
    outputs = (Port("y", width=4), Port("z"))
    states = (State("a", (0.5, -1.0, 0.25), width=3),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        def element(i: Any) -> Any:
            steady = array_of(3, lambda j: sin(x.a[j]) * u.u)  # the same at each turn of both loops
            turning = array_of(3, lambda j: steady[j] + to_real(i))  # another at each turn of the outer one
            both = fold(3, [u.u], lambda j, s: [s + turning[j] * array_of(2, lambda k: turning[k + i])[j - 1]])[0]
            counted = fold(3, [u.u], lambda j, s: [s - turning[(i * 2 - j + 7) // 2 % 3]])[0]
            wrapped = fold(3, [u.u], lambda j, s: [s - turning[(j - i) // 2] + steady[(i - 3) % 2]])[0]
            return both + sin(to_real(i) * u.u) + steady[u.k] + counted + wrapped

        def turn(i: Any, first: Any, second: Any) -> list[Any]:
            kept = array_of(3, lambda j: x.a[j] * 0.5)
            return [first + kept[i], second + kept[u.k] + array_of(3, lambda j: first + to_real(j))[u.k]]

        return {"y": array_of(4, element), "z": fold(4, [0.0, u.u], turn)[1]}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return array_of(3, lambda i: fold(2, [x.a[i]], lambda j, s: [0.5 * s + x.a[to_int32(u.u)] * 0.1])[0])


@pytest.mark.parametrize("target", ["native", "wasm"])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_what_a_loop_changes_is_computed_at_each_turn(target: str, precision: str) -> None:
    d = Diagram("loops")
    d.input("u")
    d.input("k", "int32")
    d.add("b", Loops(), u="u", k="k")
    d.output("y", "b.y")
    d.output("z", "b.z")
    ours = build(d, DT, precision, target=target, optimise="-O1").machine()
    judges = [Reference(one, DT, precision).machine() for one in (d, from_json(to_json(d)))]
    rng = np.random.default_rng(4)
    for _ in range(20):
        row = {"u": float(rng.normal()), "k": int(rng.integers(-1, 4))}
        found = ours.step(row)
        for judge in judges:
            wanted = judge.step(row)
            assert all(same(np.atleast_1d(wanted[n]), np.atleast_1d(found[n])).all() for n in ("y", "z"))
