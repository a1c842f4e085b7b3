"""Flights of a flight code on the virtual rig without any wire, and controllers that fail in flight."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from twodof.blocks import Block, Diagram, Port, State, where
from twodof.blocks.elementary.functions import sin
from twodof.blocks.library import Sum
from twodof.fcu.control.flight_code import ControlStep, FlightCode
from twodof.fcu.control.hardware import ControlInput
from twodof.fcu.control.loop import FlightController
from twodof.flight.templates import ATTITUDE
from twodof.rig.parameters import lab
from twodof.signals import MODES
from twodof.sim.virtual_drone import VirtualRig

ARM_AT, FLY_AT = 100, 120
ATTITUDE_MODE = MODES.index("attitude")
FLYING, OFF = 2, 6


@dataclass
class Script:
    """A commander that arms at `ARM_AT`, flies level in attitude mode from `FLY_AT` on, and disarms at `disarm_at`."""

    disarm_at: int = 10**9
    change: Callable[[int, ControlInput], ControlInput] = lambda tick, asked: asked
    steps: list[ControlStep] = field(default_factory=list)

    def control_input(self, tick: int) -> ControlInput:
        """Return the input at `tick`."""
        flies = FLY_AT <= tick < self.disarm_at
        return self.change(
            tick,
            ControlInput(
                mode=ATTITUDE_MODE if flies else 0,
                thrust=0.4 if flies else 0.0,
                theta0=0.1 if tick % 200 < 100 else 0.0,
                arm=ARM_AT <= tick < self.disarm_at,
                setpoint_new=True,
                link_new=True,
            ),
        )

    def after_step(self, step: ControlStep) -> None:
        """Keeps it."""
        self.steps.append(step)

    def restart(self) -> None:
        """Forgets what was seen."""
        self.steps.clear()


def controller(code: FlightCode, script: Script | None = None, lockstep: bool = True) -> FlightController:
    """`code` in front of the settled `lab` rig in its rings."""
    rig = VirtualRig(lab(), {"rings": True, "seed": 3}, code.precision)
    rig.settle(code)
    return FlightController(rig, code, script or Script(), lockstep)


def fly(made: FlightController, until: int) -> list[ControlStep]:
    """Runs up to the tick `until`; all steps so far."""
    while made.tick < until:
        made.step()
    script = made.commander
    assert isinstance(script, Script)
    return script.steps


class Law(Block):
    """P on pitch and rate; from its step `at` on the moment is `wrong` times infinity (0: NaN), or for None right."""

    inputs = tuple(Port(p.name, p.kind, unit=p.unit) for p in ATTITUDE.inputs)
    outputs = (Port("M"), Port("failed", "bool"))
    states = (State("count", 0, "int32"),)

    def __init__(self, at: int, wrong: float | None) -> None:
        self.at, self.wrong = at, wrong

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        right = 0.0854 * (where(u.FLAG_ATTITUDE_ENABLED, 11.0 * (u.theta_0 - u.theta), u.q_0) - u.q)
        failed = x.count >= self.at
        moment = right if self.wrong is None else where(failed, self.wrong * float("inf"), right)
        return {"M": moment, "failed": failed}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.count + 1


class Toil(Block):
    """0, found by hundreds of sines."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        y = u.u
        for _ in range(300):
            y = sin(y)
        return 0.0 * y


def failing(at: int, wrong: float = 0.0) -> Diagram:
    """An attitude controller whose moment is NaN or infinite from its step `at` on."""
    d = _controller("failing", Law(at, wrong))
    d.output("M", "law.M")
    return d


def exhausting(at: int) -> Diagram:
    """An attitude controller that computes many times as much from its step `at` on."""
    d = _controller("exhausting", Law(at, None))
    toil = Diagram("toil")
    toil.input("u")
    toil.add("toil", Toil(), u="u")
    toil.output("y", "toil")
    d.add("toil", toil, enable="law.failed", u="law.M")
    d.add("both", Sum("++"), a="law.M", b="toil.y")
    d.output("M", "both")
    return d


def _controller(name: str, law: Block) -> Diagram:
    d = Diagram(name)
    for port in ATTITUDE.inputs:
        d.input(port.name, port.kind, unit=port.unit)
    d.add("law", law, inputs={port.name: port.name for port in ATTITUDE.inputs})
    return d
