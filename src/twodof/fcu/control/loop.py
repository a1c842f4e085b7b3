"""The flight controller: one control period after the other, in real time or in lockstep."""

import secrets
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeVar, cast

from twodof.errors import ParameterError
from twodof.fcu.control.flight_code import ControlStep, FlightCode
from twodof.fcu.control.hardware import ControlInput, Hardware, VirtualHardware
from twodof.link.mavlink.dialect import MavSeverity
from twodof.signals import TICK_NS

Event = TypeVar("Event")


class OnboardEventBus:
    """Event bus that calls the listeners of an event's class, in the order of subscription, within `publish`."""

    def __init__(self) -> None:
        self._listeners: defaultdict[type[Any], list[Callable[[Any], object]]] = defaultdict(list)

    def subscribe(self, kind: type[Event], listener: Callable[[Event], object]) -> None:
        """Call `listener` with each event of the class `kind`, not of its subclasses."""
        self._listeners[kind].append(listener)

    def publish(self, event: object) -> None:
        """Call the listeners of this event's class; an exception of a listener is raised here."""
        for listener in self._listeners.get(type(event), ()):
            listener(event)


REMEDY = "End other programs on the flight controller's computer, or fly a virtual drone in lockstep"
"""Remedy for a processor that is too slow (`step_late`)."""

MOST_GRANTED = 25_000
"""Most ticks that may be granted beyond those that have run: 100 s."""


WINDOW = 250
"""Number of steps over which the figures are taken: a second."""


@dataclass(slots=True)
class LoopTiming:
    """Counts since the start, and figures [us] of the last whole second.

    `overruns` counts steps whose processor time was beyond the period, `missed` periods that were left out because the
    loop was too late to make up for them. `step_mean` and `step_worst` are the processor time of a step, `late_worst`
    is the longest delay of a step after its due time. In lockstep nothing is late and nothing is measured.
    """

    overruns: int = 0
    missed: int = 0
    step_mean: float = 0.0
    step_worst: float = 0.0
    late_worst: float = 0.0
    _steps: int = 0
    _used: int = 0
    _worst: int = 0
    _late: int = 0

    def stepped(self, used: int, budget: int) -> bool:
        """Note the processor time [ns] of a step; return whether it is beyond its budget."""
        self._steps += 1
        self._used += used
        self._worst = max(self._worst, used)
        over = used > budget
        self.overruns += over
        if self._steps == WINDOW:
            self.step_mean, self.step_worst = self._used * 1e-3 / WINDOW, self._worst * 1e-3
            self.late_worst = self._late * 1e-3
            self._steps = self._used = self._worst = self._late = 0
        return over

    def began(self, late: int) -> None:
        """Note the delay [ns] with which a step began."""
        self._late = max(self._late, late)


class ControlInputSource(Protocol):
    """Source of the flight code's input, which sees each step and restarts at 0: the commander."""

    def control_input(self, tick: int) -> ControlInput: ...
    def after_step(self, step: ControlStep) -> None: ...
    def restart(self) -> None: ...


class TimeRestarted(NamedTuple):
    """Restart of time at tick 0."""


class FlightController:
    """Control loop: one step a control period, and the tick that counts them.

    `commander` gives the input, `code` computes the commands, `hardware` measures and drives. Each ControlStep is
    published on `bus` (None: a new one), and TimeRestarted when time begins again.

    In `lockstep` time stands still until ticks are granted, and nothing is late. In real time the processor time of a
    step is compared with the control period. `remarks` are (MAV_SEVERITY, text) pairs for the clients. All methods
    except `stop` are for one thread.
    """

    def __init__(
        self,
        hardware: Hardware,
        code: FlightCode,
        commander: ControlInputSource,
        lockstep: bool = False,
        bus: OnboardEventBus | None = None,
    ) -> None:
        self.hardware = hardware
        self.code = code
        self.commander = commander
        self.lockstep = lockstep
        self.bus = bus or OnboardEventBus()
        self.timing = LoopTiming()
        self.started_as = 1 + secrets.randbelow(0xFFFFFFFF)  # how clients tell a restart from a pause
        self.tick = 0
        self.granted = 0
        self.latest: ControlStep | None = None
        self.remarks: list[tuple[int, str]] = []
        self._late = False
        self._stopped = False
        self._fault = ""
        if code.sandbox is not None:
            code.sandbox.timed = not lockstep

    def step(self) -> ControlStep:
        """Run one control period."""
        began = 0 if self.lockstep else time.thread_time_ns()
        hardware = self.hardware
        sample = hardware.read()
        asked = self.commander.control_input(self.tick)
        step = self.code.step(self.tick, sample, asked, hardware.rings, self._late or self._stopped)
        if began:
            self._note_time(time.thread_time_ns() - began, step.armed)
        hardware.drive(step.fore, step.aft)
        self.tick += 1
        self.latest = step
        if self._stopped and not step.armed:
            self._stopped = False
            hardware.release()
        if self.code.user_fault != self._fault:
            self._fault = self.code.user_fault
            if self._fault and step.armed:
                what = "controller stopped, the stock one levels the drone"
                self.remarks.append((MavSeverity.CRITICAL, f"{what}: {self._fault}"))
            elif self._fault:
                pauses = self.code.sandbox is not None and self.code.sandbox.rests
                what = (
                    "controller paused on the ground, it is tried again by itself" if pauses else "controller stopped"
                )
                self.remarks.append((MavSeverity.WARNING, f"{what}: {self._fault}"))
        self.commander.after_step(step)
        self.bus.publish(step)
        return step

    def _note_time(self, used: int, armed: bool) -> None:
        """Note the processor time [ns] of a step; two late ones in a row stop the motors with a remark."""
        late = self.timing.stepped(used, TICK_NS)
        if late and self._late and armed:
            took = f"two control periods in a row took more than {TICK_NS // 10**6} ms ({used * 1e-6:.1f} ms)"
            self.remarks.append((MavSeverity.CRITICAL, f"{took} of the processor: motors off. {REMEDY}"))
        self._late = late

    def stop(self) -> None:
        """Stop the motors at once, from any thread (the watchdog's); the failsafe gives `step_late` as the reason."""
        self.hardware.stop()
        self._stopped = True
        self.remarks.append((MavSeverity.CRITICAL, f"the control loop hung: motors stopped. {REMEDY}"))

    def grant(self, until: int) -> None:
        """Let time run up to the tick `until`, which is not run itself; an earlier tick has no effect."""
        self.granted = max(self.granted, min(until, self.tick + MOST_GRANTED))

    def reset(
        self, seed: int | None = None, x: float = 0.0, noise: float | None = None, rings: bool | None = None
    ) -> None:
        """Restart at tick 0, the virtual rig at rest at `x` [m]; None leaves a value as it was.

        Raises ParameterError, and changes nothing, on a real rig, while armed, and as `VirtualHardware.reset`.
        """
        if not self.hardware.virtual:
            raise ParameterError("a real rig cannot be reset", self.hardware.name, "place it by hand")
        if self.latest is not None and self.latest.armed:
            raise ParameterError("the drone is armed", "reset", "disarm first")
        states = cast(VirtualHardware, self.hardware).reset(seed, x, noise, rings)
        self.code.reset(states)
        self.tick = self.granted = 0
        self.latest = None
        self._late = self._stopped = False
        self.hardware.release()
        self.commander.restart()
        self.bus.publish(TimeRestarted())

    def replace(self, code: FlightCode) -> None:
        """Let another flight code fly from the next tick on, from the present states.

        Raises ParameterError while armed.
        """
        if self.latest is not None and self.latest.armed:
            raise ParameterError("the drone is armed", "controller", "disarm first")
        code.take_over(self.code)
        if code.sandbox is not None:
            code.sandbox.timed = not self.lockstep
        self.code = code
