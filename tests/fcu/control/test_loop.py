"""The control loop: late steps, the stop from outside, grants, and beginning again."""

import time
from types import SimpleNamespace

import pytest

from tests.fcu.flights import ARM_AT, FLYING, OFF, Script, controller, fly
from tests.fcu.mavlink import desk as services_desk
from twodof.errors import ParameterError
from twodof.fcu.control.flight_code import ControlStep, FlightCode
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.fcu.control.loop import MOST_GRANTED, REMEDY, FlightController, TimeRestarted
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.flight.failsafe.state_machine import DISARMED
from twodof.rig.parameters import lab
from twodof.signals import TICK_NS
from twodof.sim.virtual_drone import VirtualRig

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
    made.bus.subscribe(TimeRestarted, lambda _: began.append(made.tick))
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
    with pytest.raises(ParameterError, match=r"lab.*: a real rig cannot be reset \(place it by hand\)"):
        made.reset()
    assert made.tick == 1


class Bench(services_desk.Bench):
    """Notes what is asked of the motors."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def stop(self) -> None:
        self.calls.append("stop")

    def release(self) -> None:
        self.calls.append("release")


class Code(services_desk.Code):
    """Arms as it is asked, and keeps what it was told of late steps; with a sandbox that keeps its clock."""

    def __init__(self) -> None:
        super().__init__()
        self.sandbox = SimpleNamespace(timed=None)
        self.late: list[bool] = []

    def step(self, tick: int, sample: SensorSample, asked: ControlInput, rings: bool, late: bool) -> ControlStep:
        self.late.append(late)
        return super().step(tick, sample, asked, rings, late)

    def take_over(self, other: FlightCode) -> None:
        self.took_over = other


class Arms(Script):
    """Arms, and asks for nothing."""

    def control_input(self, tick: int) -> ControlInput:
        return ControlInput(arm=ARM_AT <= tick < self.disarm_at)


def bare(lockstep: bool = True) -> tuple[FlightController, Bench, Code]:
    bench, code = Bench(), Code()
    return FlightController(bench, code, Arms(disarm_at=ARM_AT + 20), lockstep), bench, code


def test_a_stop_is_the_hardwares_at_once_and_released_when_it_is_disarmed() -> None:
    made, bench, code = bare()
    fly(made, ARM_AT + 5)
    assert bench.calls == []
    made.stop()
    assert bench.calls == ["stop"]
    fly(made, ARM_AT + 20)
    assert code.late == [False] * (ARM_AT + 5) + [True] * 15, "the failsafe is told until it is disarmed"
    assert bench.calls == ["stop"]
    fly(made, ARM_AT + 25)
    assert bench.calls == ["stop", "release"]
    assert code.late[-4:] == [False] * 4
    made.reset(1, 0.0, 1.0, rings=True)
    assert bench.calls == ["stop", "release", "release"]
    assert made.latest is None
    made.stop()
    made.reset(1, 0.0, 1.0, rings=True)
    made.step()
    assert not code.late[-1], "time that begins anew is not late"


def test_late_steps_on_the_ground_are_counted_and_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    made, _, _ = bare(lockstep=False)
    Clock(monkeypatch, tuple(range(ARM_AT - 10)))
    fly(made, ARM_AT - 5)
    assert (made.timing.overruns, made.remarks) == (ARM_AT - 10, [])
