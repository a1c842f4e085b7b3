"""A commander before a flight code that arms when nothing speaks against it: ticks without anything that flies."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from twodof.fcu.command.command_lease import CommandResult, Source
from twodof.fcu.command.commander import Commander
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.flight.failsafe.causes_and_actions import ACTIONS, BIT
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, DISARMED, FLYING, LEVEL, MAY_TURN, OFF, REFUSED
from twodof.link.mavlink import modes
from twodof.link.mavlink.setpoints import SetPoint
from twodof.signals import ATTITUDE

ME: Source = (250, 190)
OTHER: Source = (245, 190)
COMPANION: Source = (1, 191)
LEVEL_FLIGHT = SetPoint(ATTITUDE, theta0=0.0, thrust=0.4)

_SAMPLE = SensorSample(0.0, 0.0, -9.81, 0.0, 0.0, 0.0, True, 0.5, False, 0.0, 12.3, 0.8)
_NUMBERS = (
    *("fore", "aft", "M", "T", "theta", "q", "x", "v", "x0", "v0", "theta0", "q0", "M_trim"),
    *("action", "state", "reason", "causes"),
)


@dataclass
class Rig:
    """Rings and safety switch."""

    rings: bool = False
    safety_off: bool = True


class Failsafe:
    """The failsafe's state machine as docs/explanation/safety.md has it, told its causes by the test."""

    def __init__(self) -> None:
        self.state = DISARMED
        self.causes = 0
        self.acts: int | None = None  # LEVEL, OFF, ...: what it does while armed

    def step(self, tick: int, asked: ControlInput) -> ControlStep:
        """One tick."""
        causes = self.causes
        if not asked.arm:
            self.state = DISARMED
        elif self.state == DISARMED:
            idle = asked.mode == 0 or (asked.mode == 1 and not asked.thrust and not asked.M_open)
            causes |= 0 if idle else BIT["not_idle"]
            self.state = REFUSED if causes else FLYING
        elif self.state in MAY_TURN:
            self.state = FLYING if self.acts is None else self.acts
        armed = self.state in MAY_TURN
        rest: dict[str, float] = dict.fromkeys(_NUMBERS, 0.0)
        return ControlStep(
            tick=tick,
            sample=_SAMPLE,
            asked=asked,
            armed=armed,
            **rest
            | {
                "action": self.state - FLYING if armed else ACTIONS.index("off"),
                "state": self.state,
                "reason": causes if self.state in (REFUSED, LEVEL, BRAKE, DESCEND, OFF) else 0,
                "causes": causes,
            },
        )


@dataclass
class Cockpit:
    """A commander and its ticks; `steps` are all so far. `talking` are heard before each of them."""

    rig: Rig = field(default_factory=Rig)
    lockstep: bool = False
    talking: Iterable[Source] = (ME,)
    failsafe: Failsafe = field(default_factory=Failsafe)
    steps: list[ControlStep] = field(default_factory=list)
    tick: int = 0

    def __post_init__(self) -> None:
        self.commander = Commander(self.rig, lambda: 0.375, self.lockstep)

    def run(self, ticks: int = 1) -> ControlInput:
        """Time passes; what was asked in the last tick."""
        for _ in range(ticks):
            for source in self.talking:
                self.commander.lease.note_frame(source, True)
            step = self.failsafe.step(self.tick, self.commander.control_input(self.tick))
            self.commander.after_step(step)
            self.steps.append(step)
            self.tick += 1
        return self.steps[-1].asked

    def arm(self, source: Source = ME) -> CommandResult:
        """Arms, and waits for the answer."""
        verdict = self.commander.arming.arm(source)
        for _ in range(30):
            if verdict.result != 5:
                break
            self.run()
            verdict = self.commander.arming.answer
        return verdict


def armed(rig: Rig | None = None, lockstep: bool = False, talking: Iterable[Source] = (ME,)) -> Cockpit:
    """One that is armed, some ticks after its start."""
    cockpit = Cockpit(rig or Rig(), lockstep, talking)
    cockpit.run(3)
    assert cockpit.arm().accepted
    return cockpit


def offboard(setpoint: SetPoint = LEVEL_FLIGHT, **options: object) -> Cockpit:
    """Armed, and flying a set-point."""
    cockpit = armed(**options)
    assert cockpit.commander.setpoint(ME, setpoint).accepted
    assert cockpit.commander.set_mode(ME, modes.OFFBOARD).accepted
    cockpit.run()
    return cockpit
