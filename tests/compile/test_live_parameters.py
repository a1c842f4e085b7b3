"""Parameters that change while a program runs: the same rules and bits on every target."""

from typing import Any

import numpy as np
import pytest

from tests.compile import examples
from tests.compile.differential import same
from tests.toolchains import need
from twodof.blocks.reference.interpreter import Reference
from twodof.compile import CompiledMachine, build
from twodof.errors import ParameterError

pytestmark = pytest.mark.slow

STEPS = 60
LOG = ("pendulum.q", "gain.y")


@pytest.fixture(params=["native", "wasm", "cortex-m7"])
def machine(request: pytest.FixtureRequest) -> CompiledMachine:
    if request.param == "cortex-m7":
        need("qemu-system-arm")
    made: Any = build(examples.loop(), 0.01, "float32", LOG, target=request.param).machine()
    return made


def derived(machine: CompiledMachine) -> tuple[float, float]:
    return float(machine.instance.structs["P"]["pendulum_stiffness"][0]), float(
        machine.instance.structs["P"]["pendulum_damping"][0]
    )


def test_a_change_between_two_steps_counts_from_the_next_one(machine: CompiledMachine) -> None:
    judge = Reference(examples.loop(), 0.01, "float32", LOG).machine()
    changes = ({}, {"k": 3.0}, {"pendulum.omega": 3.5, "pendulum.zeta": 0.2, "k": 0.5}, {"sum.limit": 0.01})
    for values in changes:
        for each in (machine, judge):
            each.set_many(values)
        got, want = (each.run(STEPS, {"r": 0.4}) for each in (machine, judge))
        for name, column in want.items():
            assert same(np.asarray(column, np.float32), got[name]).all(), (values, name)
        one, other = machine.step({"r": 0.3}), judge.step({"r": 0.3})
        assert one == other


def test_all_change_in_one_step_or_none_does(machine: CompiledMachine) -> None:
    machine.run(STEPS, {"r": 0.4})
    machine.set_many({"pendulum.omega": 3.0, "pendulum.zeta": 0.25})
    assert derived(machine) == (9.0, 1.5)
    before = machine.instance.structs["P"].tobytes()
    refused: tuple[tuple[dict[str, Any], str], ...] = (
        ({"pendulum.omega": 4.0, "k": 10.5}, r"k: 10.5 is outside 0 to 10"),
        ({"pendulum.omega": 4.0, "sum.limit": -1e-9}, r"sum.limit: -1e-09 is outside 0 to inf rad"),
        ({"pendulum.omega": 4.0, "k": float("nan")}, r"k: nan is outside 0 to 10"),
        ({"pendulum.omega": 4.0, "pendulum.stiffness": 1.0}, "no parameter named 'pendulum.stiffness'"),
        ({"pendulum.omega": 4.0, "k": "2"}, "k: "),
        ({"pendulum.omega": 4.0, "k": [1.0, 2.0]}, "k: "),
    )
    for values, said in refused:
        with pytest.raises(ParameterError, match=said):
            machine.set_many(values)
        assert machine.instance.structs["P"].tobytes() == before
    twin = machine.program.machine()
    twin.run(STEPS, {"r": 0.4})
    twin.set_many({"pendulum.omega": 3.0, "pendulum.zeta": 0.25})
    assert machine.run(STEPS)["theta"].tobytes() == twin.run(STEPS)["theta"].tobytes()


def test_what_float32_does_not_hold_becomes_infinite_without_a_warning(machine: CompiledMachine) -> None:
    """A warning that a caller has made an error stopped half way: some parameters new, the derived ones old."""
    judge = Reference(examples.loop(), 0.01, "float32", LOG).machine()
    for each in (machine, judge):
        each.set_many({"pendulum.omega": 3.0, "sum.limit": 1e39})
    assert machine.get("sum.limit") == float("inf")
    assert derived(machine)[0] == 9.0
    assert machine.step({"r": 0.3}) == judge.step({"r": 0.3})


def test_reset_starts_from_the_present_parameters(machine: CompiledMachine) -> None:
    machine.run(STEPS, {"r": 0.4})
    machine.set("pendulum.theta0", 0.25)
    machine.reset()
    assert (machine.tick, machine.state("pendulum.theta")) == (0, 0.25)
    assert machine.step()["theta"] == 0.25
