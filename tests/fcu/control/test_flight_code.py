"""The flight code a tick at a time: parameters, controllers inside and in the sandbox, and what replaces them."""

import math
import time
from typing import Any

import pytest

from tests.fcu.flights import ARM_AT, FLY_AT, FLYING, OFF, Script, controller, exhausting, failing, fly
from twodof.blocks import Diagram
from twodof.errors import ControllerFault, ParameterError
from twodof.fcu.control.flight_code import OUTPUTS, ControlStep, FlightCode
from twodof.fcu.control.hardware import ControlInput
from twodof.flight.failsafe.causes_and_actions import ACTIONS, BIT
from twodof.flight.starters import starter
from twodof.parameters import FLIGHT_PARAMETERS, PARAMETERS, PRESETS

pytestmark = pytest.mark.slow

NONE, LEVEL = ACTIONS.index("none"), ACTIONS.index("level")
UNTIL = 500
FAIL_AT = 300


def values(step: ControlStep) -> tuple[Any, ...]:
    return tuple(getattr(step, name) for name in OUTPUTS)


@pytest.mark.long
def test_a_controller_in_the_sandbox_flies_with_the_bits_of_the_same_one_inside() -> None:
    own = starter("lqr-attitude")
    inside = fly(controller(FlightCode([own], trusted=True)), UNTIL)
    outside = fly(controller(FlightCode([own])), UNTIL)
    # Before it flies the set-points that are shown are those of the stock cascade.
    assert [values(step) for step in outside[FLY_AT:]] == [values(step) for step in inside[FLY_AT:]]
    assert [(step.fore, step.aft, step.theta, step.state) for step in outside] == [
        (step.fore, step.aft, step.theta, step.state) for step in inside
    ]
    assert inside[-1].state == FLYING
    stock = fly(controller(FlightCode()), UNTIL)
    assert [step.M for step in stock] != [step.M for step in inside], "another controller flew"


@pytest.mark.parametrize("trusted", [False, True], ids=["sandbox", "inside"])
@pytest.mark.parametrize("wrong", [0.0, -1.0], ids=["nan", "-inf"])
def test_a_controller_that_gives_no_number_is_replaced_in_the_same_tick(trusted: bool, wrong: float) -> None:
    steps = fly(controller(FlightCode([failing(FAIL_AT, wrong)], trusted)), UNTIL)
    before, at, after = steps[FAIL_AT - 1], steps[FAIL_AT], steps[FAIL_AT + 1 :]
    assert (before.action, at.action) == (NONE, NONE)
    for step in (at, *after):
        assert math.isfinite(step.M)
        assert step.armed
        assert step.fore > 0.0
        assert step.aft > 0.0
    assert all(step.action == LEVEL and step.reason == BIT["user_failed"] for step in after)
    assert abs(after[-1].theta) < 0.03, "level by the stock controller"


def test_a_sandbox_that_runs_out_of_fuel_is_replaced_in_the_same_tick_and_begins_anew_once_disarmed() -> None:
    # Some ten times what the controller takes before it begins to toil, some tenth of what it takes then.
    made = controller(FlightCode([exhausting(FAIL_AT)], fuel=15_000), script := Script(disarm_at=400))
    steps = fly(made, 399)
    assert steps[FAIL_AT - 1].action == NONE
    assert (steps[FAIL_AT].action, steps[FAIL_AT].armed) == (NONE, True)
    assert math.isfinite(steps[FAIL_AT].M)
    assert all(step.action == LEVEL for step in steps[FAIL_AT + 1 :])
    assert "fuel" in made.code.user_fault
    assert any("fuel" in text for _, text in made.remarks)
    fly(made, 401)
    assert not script.steps[-1].armed
    assert made.code.user_fault == "", "a fresh instance"


def test_without_fuel_for_a_single_step_nothing_of_it_ever_flies() -> None:
    made = controller(FlightCode([exhausting(0)], fuel=15_000))
    steps = fly(made, 200)
    assert made.code.user_fault
    assert all(step.action == LEVEL for step in steps[ARM_AT + 1 :])
    assert steps[FLY_AT + 1].fore == 0.0, "and no action starts motors that stand"


def test_a_sandbox_that_cannot_even_begin_is_refused() -> None:
    with pytest.raises(ControllerFault, match="fuel"):
        FlightCode([starter("lqr-attitude")], fuel=10)


def test_in_real_time_a_sandbox_out_of_processor_time_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    made = controller(FlightCode([starter("lqr-attitude")]), lockstep=False)
    now = 0

    def clock() -> int:
        nonlocal now
        now += 2_500_000 if made.tick == FAIL_AT else 1_000
        return now

    monkeypatch.setattr(time, "thread_time_ns", clock)
    steps = fly(made, UNTIL)
    assert (steps[FAIL_AT].action, steps[FAIL_AT].armed) == (NONE, True)
    assert all(step.action == LEVEL and step.reason == BIT["user_failed"] for step in steps[FAIL_AT + 1 :])


def test_commands_of_the_last_resort_that_are_no_numbers_stop_the_motors_in_that_tick() -> None:
    made = controller(FlightCode())
    steps = fly(made, FAIL_AT)
    assert steps[-1].fore > 0.0
    made.code.machine.set_state("cascade.rate.sum", math.nan)
    steps = fly(made, FAIL_AT + 10)
    assert all((step.fore, step.aft) == (0.0, 0.0) for step in steps[FAIL_AT:])
    assert steps[-1].state == OFF
    assert steps[-1].reason & BIT["command_lost"]


def test_set_points_that_are_no_numbers_do_no_harm_to_a_controller_in_the_sandbox() -> None:
    def change(tick: int, asked: ControlInput) -> ControlInput:
        return asked._replace(theta0=math.nan, thrust=math.inf) if tick == FAIL_AT else asked

    made = controller(FlightCode([starter("lqr-attitude")]), Script(change=change))
    steps = fly(made, UNTIL)
    assert steps[FAIL_AT].reason == BIT["setpoint_invalid"]
    assert steps[-1].state == FLYING
    assert steps[-1].action == NONE


CODES: dict[str, Any] = {
    "stock": {},
    "inside": {"controllers": [starter("lqr-attitude")], "trusted": True},
    "sandbox": {"controllers": [starter("pid-position")]},
    "kalman": {"position_filter": "kalman"},
}


@pytest.mark.parametrize("which", CODES)
def test_every_parameter_is_set_by_its_name_and_read_back(which: str) -> None:
    code = FlightCode(**CODES[which])
    for row in FLIGHT_PARAMETERS:
        code.set_parameters({row.name: row.high})
        assert code.parameter(row.name) == row.high
        code.set_parameters({row.name: row.low})
        assert code.parameter(row.name) == row.low
    code.set_parameters(PRESETS["student"])
    for name, value in PRESETS["student"].items():
        assert code.parameter(name) == value


def test_parameters_are_set_all_or_none() -> None:
    code = FlightCode()
    before = {row.name: code.parameter(row.name) for row in PARAMETERS}
    for wrong in ({"ATT_KP": 1e9}, {"NOT_THERE": 1.0}, {"ATT_KP": math.nan}, {"failsafe.battery.low": -1.0}):
        with pytest.raises(ParameterError):
            code.set_parameters({"RATE_KP": 0.05} | wrong)
        assert {row.name: code.parameter(row.name) for row in PARAMETERS} == before


def test_gains_fly_in_the_stock_controllers_in_reserve_too() -> None:
    code = FlightCode([failing(FAIL_AT)], trusted=True)
    code.set_parameters({"ATT_KP": 5.0})
    assert code.machine.get("stock.attitude.kp") == 5.0


@pytest.mark.parametrize("other", [[], [starter("lqr-attitude")]], ids=["stock", "sandbox"])
def test_another_code_goes_on_where_the_one_before_stood(other: list[Diagram]) -> None:
    """Replaced while disarmed, the estimates go on with the same bits, and the parameters stay."""
    kept, changed = controller(FlightCode()), controller(FlightCode())
    changed.code.set_parameters({"THRUST_BAR": 0.45})
    fly(kept, ARM_AT - 20)
    fly(changed, ARM_AT - 20)
    changed.replace(FlightCode(other))
    one, two = fly(kept, ARM_AT + 10), fly(changed, ARM_AT + 10)
    assert [(s.theta, s.q, s.x, s.v) for s in two] == [(s.theta, s.q, s.x, s.v) for s in one]
    assert changed.code.parameter("THRUST_BAR") == 0.45
    with pytest.raises(ParameterError, match="armed"):
        changed.replace(FlightCode())
