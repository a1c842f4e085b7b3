"""The control loop: late steps, the stop from outside, grants, and beginning again."""

from __future__ import annotations

import time

import pytest

from tests.fcu.flights import FLYING, OFF, Script, controller, fly
from twodof.errors import ParameterError
from twodof.fcu.flight_code import FlightCode
from twodof.fcu.loop import MOST_GRANTED, REMEDY, FlightController
from twodof.flight.causes import BIT
from twodof.flight.failsafe_machine import DISARMED
from twodof.link.tick import TICK_NS
from twodof.rig.parameters import lab
from twodof.sim.rig_host import VirtualRig

AT = 300


class Clock:
    """Processor time that a step seems to take, by its tick."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, late: tuple[int, ...]) -> None:
        self.late, self.now, self.tick = late, 0, 0
        monkeypatch.setattr(time, "thread_time_ns", self.read)

    def read(self) -> int:
        """Now; each step reads it twice."""
        self.now += TICK_NS + 1 if self.tick // 2 in self.late else 10_000
        self.tick += 1
        return self.now


@pytest.mark.parametrize(("late", "off"), [((AT,), False), ((AT, AT + 1), True), ((AT, AT + 2), False)])
def test_two_late_steps_in_a_row_stop_the_motors_within_8_ms(
    late: tuple[int, ...], off: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = controller(FlightCode(), lockstep=False)
    clock = Clock(monkeypatch, late)
    steps = fly(made, AT + 20)
    assert clock.tick == 2 * (AT + 20)
    assert made.timing.overruns == len(late)
    assert steps[AT].fore > 0.0
    if off:
        # The second late step ends at tick AT + 2, the first tick after both: motors off there, 8 ms after the first.
        assert steps[AT + 1].fore > 0.0
        assert all((step.fore, step.aft) == (0.0, 0.0) for step in steps[AT + 2 :])
        assert steps[-1].state == OFF
        assert steps[-1].reason == BIT["step_late"]
        assert made.remarks == [
            (2, f"two control periods in a row took more than 4 ms (4.0 ms) of the processor: motors off. {REMEDY}")
        ]
    else:
        assert made.remarks == []
        assert steps[-1].state == FLYING


def test_in_lockstep_nothing_is_late(monkeypatch: pytest.MonkeyPatch) -> None:
    made = controller(FlightCode(), lockstep=True)
    clock = Clock(monkeypatch, tuple(range(1000)))
    assert fly(made, AT)[-1].state == FLYING
    assert clock.tick == 0
    assert made.timing.overruns == 0


def test_a_stop_from_outside_holds_until_disarmed_and_is_told() -> None:
    made = controller(FlightCode(), Script(disarm_at=AT + 100), lockstep=False)
    fly(made, AT)
    made.stop()
    rig = made.hardware
    assert isinstance(rig, VirtualRig)
    assert abs(rig.truth[0]) > 0.05, "it was about to follow a set-point"
    steps = fly(made, AT + 90)
    assert all((step.fore, step.aft) == (0.0, 0.0) for step in steps[AT + 1 :]), "the failsafe follows in two ticks"
    assert steps[-1].state == OFF
    assert steps[-1].reason == BIT["step_late"]
    assert made.remarks[0] == (2, f"the control loop hung: motors stopped. {REMEDY}")
    steps = fly(made, AT + 102)
    assert steps[-1].state == DISARMED
    before = rig.truth[0]
    for _ in range(25):
        rig.drive(0.9, 0.1)
    assert rig.truth[0] > before + 0.05, "commands count again"


def test_grants_are_taken_up_to_a_bound_and_never_back() -> None:
    made = controller(FlightCode())
    made.grant(10)
    made.grant(5)
    assert made.granted == 10
    made.grant(2**32 - 1)
    assert made.granted == MOST_GRANTED


def test_it_begins_again_with_the_same_bits_disarmed_only_and_on_a_virtual_rig_only() -> None:
    made = controller(FlightCode())
    made.reset(seed=5, x=0.1, noise=1.0, rings=False)
    began = []
    made.on_restart.append(lambda: began.append(made.tick))
    first = list(fly(made, 200))
    with pytest.raises(ParameterError, match="armed"):
        made.reset()
    assert made.tick == 200
    script = made.commander
    assert isinstance(script, Script)
    script.disarm_at = 200
    fly(made, 202)
    script.disarm_at = 10**9
    made.reset(seed=5, x=0.1, noise=1.0, rings=False)
    assert (made.tick, made.granted, began) == (0, 0, [0])
    assert fly(made, 200) == first


class Real(VirtualRig):
    """Says that it is not simulated."""

    virtual = False


def test_a_real_rig_cannot_begin_again() -> None:
    made = FlightController(Real(lab()), FlightCode(), Script())
    made.step()
    with pytest.raises(ParameterError, match="real"):
        made.reset()
    assert made.tick == 1
