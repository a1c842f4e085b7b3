"""Random diagrams in corners: parameters and states set from outside while the tick wraps around."""

import random
from typing import Any

import numpy as np
import pytest

from tests.compile.differential import same
from tests.compile.random_diagrams import Maker, random_inputs
from twodof.blocks import Block, Diagram, Port, State, array_of, minimum, sum
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import CompiledProgram, build

pytestmark = pytest.mark.slow

STEPS = 120


class OwnReader(Block):
    """`shown`, `long` and the next state read what `kept` gives, by way of a wire from this output to an input."""

    inputs = (Port("back", shape=(3, 3)), Port("real_in"))
    outputs = (Port("kept", shape=(3, 3)), Port("shown"), Port("long", width=12))
    states = (State("x", 0.5, shape=(3, 3)), State("n"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        total = sum(u.back @ u.back)
        return {"kept": x.x + 1.0, "shown": total * total, "long": array_of(12, lambda i: total + u.back[i // 4, 0])}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"x": minimum(5.0, u.back * u.real_in), "n": x.n + u.back[1, 1]}


def drawn(seed: int) -> tuple[Diagram, list[str]]:
    """A random diagram beside a block that reads its own output, and the signals to compare."""
    maker = Maker(seed, small=True)
    d = maker.diagram(f"corner{seed}")
    d.add("own", OwnReader(), real_in="real_in")
    d.connect("own.kept", "own.back")
    return d, [*maker.paths, "own.kept", "own.shown", "own.long"]


@pytest.mark.parametrize(
    ("seed", "precision", "integrator", "travelled"),
    [
        (1, "float64", "rk4", False),
        (2, "float32", "rk4", True),
        (3, "float32", "euler", False),
        *(pytest.param(n, "float64", "euler", n % 2 == 1, marks=pytest.mark.soak) for n in range(4, 40)),
    ],
)
def test_corners_have_the_bits_of_the_reference(seed: int, precision: str, integrator: str, travelled: bool) -> None:
    d, log = drawn(seed)
    d = from_json(to_json(d)) if travelled else d
    program = build(d, 0.01, precision, log, integrator, optimise="-O1")
    assert isinstance(program, CompiledProgram)
    ours, theirs = program.machine(), Reference(d, 0.01, precision, log, integrator).machine()
    ours.instance.structs["S"]["tick"][0] = theirs._tick = 2**32 - STEPS // 2
    rng = random.Random(seed)
    tuned = [path for path in ours.parameters if path.endswith((".p0", "shared"))]
    states = [path for path in program.states if isinstance(ours.state(path), float)]
    for k, row in enumerate(random_inputs(seed, STEPS)):
        if k % 20 == 7:
            values = dict.fromkeys(tuned, 0.5 + k / 500)
            path, value = rng.choice(states), rng.gauss(0, 1)
            for machine in (ours, theirs):
                machine.set_many(values)
                machine.set_state(path, value)
        want, found = theirs.step(row), ours.step(row)
        for path, value in want.items():
            assert same(np.atleast_1d(np.array(value)), np.atleast_1d(np.array(found[path]))).all(), (k, path)
        for path in program.states:
            assert same(*(np.atleast_1d(np.array(m.state(path))) for m in (theirs, ours))).all(), (k, path)
