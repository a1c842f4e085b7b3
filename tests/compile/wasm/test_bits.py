"""WebAssembly in steps and runs of any length, and its interface; `test_targets.py` compares its bits."""

import itertools
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blocks.library.samples import random_inputs
from tests.compile import examples
from tests.compile.differential import same
from twodof.blocks import Diagram
from twodof.compile import CompiledProgram, build

pytestmark = pytest.mark.slow

EXAMPLES = (examples.loop, examples.switched, examples.edge, examples.delay)


def differing(first: dict[str, NDArray[Any]], second: dict[str, NDArray[Any]]) -> list[str]:
    assert first.keys() == second.keys()
    return [name for name, a in first.items() if a.shape != second[name].shape or not same(a, second[name]).all()]


@pytest.mark.parametrize("make", EXAMPLES, ids=[m.__name__ for m in EXAMPLES])
def test_single_steps_and_runs_of_any_length_are_the_same(make: Callable[[], Diagram]) -> None:
    """Longer than the rows that stand in the memory; inputs as columns and as one value."""
    program = build(make(), 0.01, target="wasm")
    assert isinstance(program, CompiledProgram)
    rows = program.backend.module.places[program.flat.name].rows
    steps = 2 * rows + 3
    inputs = random_inputs(make(), steps, 3, False)
    whole = program.machine().run(steps, inputs)
    stepped, pieces = program.machine(), program.machine()
    first = [stepped.step({n: v[k].item() for n, v in inputs.items()}) for k in range(50)]
    cuts = (0, 1, 7, rows + 9, steps)
    parts = [pieces.run(b - a, {n: v[a:b] for n, v in inputs.items()}) for a, b in itertools.pairwise(cuts)]
    for name, column in whole.items():
        assert np.array([row[name] for row in first], column.dtype).tobytes() == column[:50].tobytes()
        assert np.concatenate([p[name] for p in parts]).tobytes() == column.tobytes()
    held = {n: v[0].item() for n, v in inputs.items()}
    native = build(make(), 0.01).machine()
    ours = program.machine()
    assert differing(native.run(steps, held), ours.run(steps, held)) == []
    assert differing(native.run(1, {}), ours.run(1, {})) == []


def test_the_interface_says_where_everything_stands() -> None:
    program = build(examples.loop(), 0.01, "float32", target="wasm")
    about: dict[str, Any] = program.backend.interface()
    assert about == json.loads(json.dumps(about, allow_nan=False))
    machine = program.machine()
    machine.set_many({"k": 3.0, "pendulum.omega": 2.5})
    machine.run(30, {"r": 0.5})
    memory = bytes(machine.instance._memory)

    def at(entry: dict[str, Any]) -> Any:
        values = np.frombuffer(memory, entry["type"], entry["count"], entry["address"]).tolist()
        return values if entry["array"] else values[0]

    parameters = {p["path"]: p for p in about["parameters"]}
    assert list(parameters) == list(machine.parameters)
    for path, entry in parameters.items():
        assert at(entry) == machine.get(path)
    assert (parameters["k"]["low"], parameters["k"]["high"], parameters["pendulum.omega"]["high"]) == (0.0, 10.0, None)
    for entry in about["states"]:
        assert at(entry) == machine.state(entry["path"])
    assert [(i["path"], i["unit"], at(i)) for i in about["inputs"]] == [("r", "rad/s", 0.5)]
    assert [o["path"] for o in about["outputs"]] == ["y", "theta"]
    assert about["dt"] == 0.01
