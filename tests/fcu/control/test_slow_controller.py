"""A controller in its sandbox that is too slow: out for the rest of the flight, and on the ground no burden either."""

import time
from dataclasses import dataclass, field
from typing import Any

import pytest

from tests.fcu.flights import ARM_AT, FLY_AT, FLYING, Script, controller, fly
from twodof.fcu.control import sandbox
from twodof.fcu.control.flight_code import FlightCode
from twodof.fcu.control.hardware import ControlInput
from twodof.fcu.control.loop import REMEDY, FlightController
from twodof.flight.failsafe.causes_and_actions import ACTIONS, BIT
from twodof.flight.starters import starter

pytestmark = pytest.mark.slow

NONE, LEVEL = ACTIONS.index("none"), ACTIONS.index("level")
SLOW_NS = 7_000_000
SLOW_AT = 300
LATER = 400


@dataclass
class Later(Script):
    """The same flight, `LATER` ticks later."""

    def control_input(self, tick: int) -> ControlInput:
        return super().control_input(tick - LATER)


@dataclass
class Slow:
    """Processor time of this thread; a step in the sandbox takes 7 ms of it in the ticks `during`."""

    during: range
    now: int = 0
    tick: int = 0
    stepped: list[int] = field(default_factory=list)

    def clock(self) -> int:
        self.now += 10_000
        return self.now


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> Slow:
    """Set `during` before it is flown."""
    made = Slow(range(0))

    class Stepper(sandbox.Stepper):
        def step(self, values: Any) -> tuple[Any, ...]:
            if made.tick in made.during:
                made.now += SLOW_NS
            made.stepped.append(made.tick)
            return super().step(values)

    monkeypatch.setattr(sandbox, "Stepper", Stepper)
    monkeypatch.setattr(time, "thread_time_ns", made.clock)
    return made


def flown(slow: Slow, until: int, script: Script | None = None) -> FlightController:
    """A flight of a controller in the sandbox, in real time, up to the tick `until`."""
    made = controller(FlightCode([starter("lqr-attitude")]), script, lockstep=False)
    went_on(slow, made, until)
    return made


def went_on(slow: Slow, made: FlightController, until: int) -> None:
    while made.tick < until:
        slow.tick = made.tick
        fly(made, made.tick + 1)


def steps(made: FlightController) -> list[Any]:
    assert isinstance(made.commander, Script)
    return made.commander.steps


def test_in_flight_it_is_disbelieved_once_and_the_stock_controller_levels(slow: Slow) -> None:
    slow.during = range(SLOW_AT, 10**9)
    made = flown(slow, SLOW_AT + 500)
    assert slow.stepped[-1] == SLOW_AT, f"it was stepped {slow.stepped[-1] - SLOW_AT} times more"
    after = steps(made)[SLOW_AT + 1 :]
    assert all(step.armed and step.action == LEVEL and step.reason == BIT["user_failed"] for step in after)
    assert abs(after[-1].theta) < 0.03
    said = [text for _, text in made.remarks]
    what = "controller stopped, the stock one levels the drone: a step of lqr_attitude took 7.0 ms"
    assert said == [f"{what}, more than the allowed 2 ms. {sandbox.REMEDY}"]
    assert made.timing.overruns == 1
    assert REMEDY not in said[0]


def test_when_it_becomes_slow_in_the_tick_in_which_it_is_armed(slow: Slow) -> None:
    slow.during = range(ARM_AT, 10**9)
    made = flown(slow, ARM_AT + 500)
    assert slow.stepped[-1] == ARM_AT
    assert all(step.armed for step in steps(made)[ARM_AT + 1 :])
    assert all(step.action == LEVEL for step in steps(made)[FLY_AT + 2 :])
    assert made.timing.overruns == 1


def test_on_the_ground_it_costs_the_loop_no_ticks(slow: Slow) -> None:
    """40 s of it, on a loop that has 4 ms for each step: each step of the sandbox that is slow costs it two."""
    slow.during = range(10**9)
    made = flown(slow, 10_000, Script(change=lambda _tick, _asked: ControlInput()))
    assert made.timing.overruns <= 6, f"{made.timing.overruns} steps of 10000 took too long"
    assert made.timing.overruns == len(slow.stepped)
    ((severity, text),) = made.remarks  # said once, however often it is tried
    assert (severity, text.partition(":")[0]) == (4, "controller paused on the ground, it is tried again by itself")
    assert "lqr_attitude took 7.0 ms" in text


@pytest.mark.parametrize("at", [3, 50])
def test_one_that_was_slow_once_on_the_ground_is_tried_again_and_flies(slow: Slow, at: int) -> None:
    slow.during = range(at, at + 1)
    made = flown(slow, at + 100, Later())
    assert made.code.user_fault
    went_on(slow, made, LATER)
    assert made.code.user_fault == ""
    went_on(slow, made, LATER + SLOW_AT)
    assert steps(made)[-1].state == FLYING
    assert slow.stepped[-1] == LATER + SLOW_AT - 1
    other = controller(FlightCode([starter("lqr-attitude")]), Later(), lockstep=False)
    expected = fly(other, LATER + SLOW_AT)
    assert [step.M for step in steps(made)[-100:]] == pytest.approx([step.M for step in expected[-100:]], abs=1e-9)


def test_after_a_flight_it_is_tried_again_a_second_later(slow: Slow) -> None:
    slow.during = range(SLOW_AT, SLOW_AT + 200)
    made = flown(slow, SLOW_AT + 150, Script(disarm_at=SLOW_AT + 100))
    assert slow.stepped[-1] == SLOW_AT
    went_on(slow, made, SLOW_AT + 400)
    assert made.code.user_fault == ""
    assert slow.stepped[-1] == SLOW_AT + 399


def test_a_change_of_its_parameters_does_not_step_it_at_once(slow: Slow) -> None:
    """Otherwise each move of a slider would make the loop late."""
    slow.during = range(10**9)
    made = flown(slow, 10, Script(change=lambda _tick, _asked: ControlInput()))
    for number in range(200):
        made.code.set_parameters({"attitude_control.k_q": 0.1 + 0.0001 * number})
        went_on(slow, made, made.tick + 1)
    assert len(slow.stepped) <= 2
    slow.during = range(0)
    went_on(slow, made, made.tick + 600)
    assert made.code.user_fault == ""
    assert made.code.parameter("attitude_control.k_q") == 0.1 + 0.0001 * 199
