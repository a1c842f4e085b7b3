"""The module in V8, the engine of browsers, through node: loaded by its interface alone, with nothing to import."""

from __future__ import annotations

import base64
import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.blocks.library.samples import random_inputs
from tests.compile import examples
from tests.compile.differential import same
from tests.patience import PATIENCE_S
from tests.toolchains import need
from twodof.blocks import Diagram
from twodof.compile import CompiledProgram, build
from twodof.flight.core import core
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

HOST = Path(__file__).with_name("host.mjs")
STEPS = 3000


def encoded(column: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(column).tobytes()).decode()


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(
    ("make", "dt", "parameter"),
    [(examples.loop, 0.01, "k"), (core, PERIOD, "cascade.rate.ki")],
    ids=["loop", "flight core"],
)
def test_v8_gives_the_bits_of_native_code(
    make: Callable[[], Diagram], dt: float, parameter: str, precision: str, tmp_path: Path
) -> None:
    """Two runs, a parameter changed between them; more steps than the module has rows, where one is long."""
    need("node")
    program, native = build(make(), dt, precision, target="wasm"), build(make(), dt, precision).machine()
    assert isinstance(program, CompiledProgram)
    about, runs, expected = program.backend.interface(), [], []
    for seed, strange in ((1, False), (2, True)):
        values = {} if seed == 1 else {parameter: 1.25 * native.get(parameter)}
        with np.errstate(over="ignore"):
            inputs = {
                n: v.astype(precision) if v.dtype.kind == "f" else v
                for n, v in random_inputs(make(), STEPS, seed, strange).items()
            }
        sent = {i["path"]: encoded(inputs[i["path"]].astype(i["type"])) for i in about["inputs"]}
        runs.append({"parameters": values, "steps": STEPS, "inputs": sent})
        native.set_many(values)
        expected.append(native.run(STEPS, inputs))
    (tmp_path / "m.wasm").write_bytes(program.backend.module.data)
    (tmp_path / "m.json").write_text(json.dumps(about, allow_nan=False), encoding="utf-8")
    done = subprocess.run(
        ["node", str(HOST), str(tmp_path / "m.wasm"), str(tmp_path / "m.json")],
        input=json.dumps(runs),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for wanted, found in zip(expected, json.loads(done.stdout), strict=True):
        assert wanted.keys() == found.keys()
        for name, column in wanted.items():
            bits = np.frombuffer(base64.b64decode(found[name]), column.dtype).reshape(column.shape)
            assert same(column, bits).all(), name


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
