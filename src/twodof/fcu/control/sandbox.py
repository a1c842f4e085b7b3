"""Sandbox for a user's untrusted controllers: a flight core with them in WebAssembly, with bounded time and memory."""

import time
from collections.abc import Iterable, Mapping
from operator import attrgetter
from typing import Any

from twodof.blocks import Diagram
from twodof.compile import CompiledProgram, build
from twodof.compile.machine import Stepper
from twodof.compile.wasm.target import INSTALL, Wasm
from twodof.errors import CompileError, ControllerFault
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.flight.core import core
from twodof.flight.declarations import INPUTS as CORE_INPUTS
from twodof.signals import PERIOD

BUDGET_NS = 2_000_000
"""Processor time [ns] that a step in the sandbox may take in real time: half of the control period."""

PAUSE, LONGEST_PAUSE = 250, 4000
"""Ticks on the ground until a controller that was too slow is tried again; doubled each time, up to the second."""
REMEDY = "If it comes once, the computer was busy: end other programs. If it comes again, simplify the diagram"
GOOD = 1000
"""Steps in time, in a row, after which the pause starts at `PAUSE` again."""

MEASURED, ASKED = (
    tuple(name for name, _, _, _ in CORE_INPUTS if name in given._fields) for given in (SensorSample, ControlInput)
)
"""The inputs that are measured, and those that are requested."""
OUTPUTS = ("fore", "aft", "M", "T", "x0", "v0", "theta0", "q0")


SandboxOutput = tuple[Any, ...]
"""A flag, True if the controllers have stopped or were late, so that the rest must not fly; then `OUTPUTS`."""

_measured, _asked = attrgetter(*MEASURED), attrgetter(*ASKED)
_NOTHING: SandboxOutput = (True, *(0.0,) * len(OUTPUTS))


class Sandbox:
    """The flight core with `controllers`, without failsafe, in WebAssembly; its commands go through the native gate.

    `fault` says what stopped the sandbox, "" while it runs. A stopped sandbox is late in every step until `restart`.

    In real time (`timed`) a step that takes more than `BUDGET_NS` of the processor stops it too, so that it makes no
    second control period late. On the ground it may be tried again after a pause (`wakes`, `resume`).

    Raises DiagramError for a controller that fits no template, CompileError if the compiler for WebAssembly or wasmtime
    is missing.
    """

    def __init__(
        self,
        controllers: Iterable[Diagram],
        position_filter: str = "joint",
        precision: str = "float64",
        fuel: int | None = None,
    ) -> None:
        controllers = tuple(controllers)
        self.name = " and ".join(one.name for one in controllers)
        diagram = core(position_filter=position_filter, controllers=controllers)
        program = build(diagram, PERIOD, precision, target=Wasm(fuel=fuel))
        if not isinstance(program, CompiledProgram):
            raise CompileError("WebAssembly cannot be run here", diagram.name, INSTALL)
        self.program = program
        self.timed = False
        self._renew()

    def _renew(self) -> None:
        self.fault = ""
        self._spent = self._pause = self._rest = self._good = 0
        self._tries = False
        self.machine = self.program.machine()
        self._stepper = Stepper(self.machine, (*MEASURED, *ASKED), OUTPUTS)

    def _known(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return those of `values` whose parameters the sandbox has."""
        return {path: value for path, value in values.items() if path in self.machine.parameters}

    def restart(self, parameters: Mapping[str, Any], states: Mapping[str, Any]) -> None:
        """Restart as a fresh instance with these parameters and states by path; set `fault` if that fails."""
        try:
            self._renew()
            self.machine.set_many(self._known(parameters))
            self._begin(states)
        except ControllerFault as fault:
            self.fault = str(fault)

    @property
    def rests(self) -> bool:
        """Return whether the sandbox was too slow and will be tried again; any other fault is final."""
        return self._rest > 0

    def wakes(self) -> bool:
        """Count a tick of the pause on the ground. Return whether `resume` may try the sandbox again now."""
        self._spent = 0
        self._rest -= 1
        return self._rest == 0

    def resume(self, states: Mapping[str, Any]) -> None:
        """Resume with these states, by path; `fault` stays until a step was in time."""
        try:
            self._begin(states)
        except ControllerFault as fault:
            self.fault = str(fault)
        else:
            self._tries = True

    def _begin(self, states: Mapping[str, Any]) -> None:
        self.machine.reset()  # a state may begin at a parameter
        for path, value in states.items():
            if path in self.program.states:
                self.machine.set_state(path, value)

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        """Set the known ones of `values`, all or none; the time that this takes counts for the next step.

        Raises ParameterError for an invalid value. If derived parameters cannot be computed, the sandbox stops with a
        `fault`.
        """
        began = time.thread_time_ns() if self.timed else 0
        try:
            self.machine.set_many(self._known(values))
        except ControllerFault as fault:
            self.fault = self.fault or str(fault)
        self._spent += time.thread_time_ns() - began if self.timed else 0

    def step(self, sample: SensorSample, asked: ControlInput, in_reset: bool) -> SandboxOutput:
        """Run one control period, with finite set-points within their limits."""
        if self.fault and not self._tries:
            return _NOTHING
        tries, self._tries = self._tries, False
        began = time.thread_time_ns() if self.timed else 0
        try:
            given = asked._replace(in_reset=in_reset)
            commands = self._stepper.step((*_measured(sample), *_asked(given)))
        except ControllerFault as fault:
            self.fault = str(fault)
            return _NOTHING
        used = time.thread_time_ns() - began + self._spent if self.timed else 0
        self._spent = 0
        if used > BUDGET_NS:
            self._overran(used)
            return True, *commands
        if tries:
            self.fault = ""
        self._good += 1
        if self._good >= GOOD:
            self._pause = 0
        return False, *commands

    def _overran(self, used: int) -> None:
        took = f"a step of {self.name} took {used * 1e-6:.1f} ms, more than the allowed {BUDGET_NS * 1e-6:g} ms"
        self.fault = self.fault or f"{took}. {REMEDY}"
        self._good = 0
        self._pause = self._rest = min(max(PAUSE, 2 * self._pause), LONGEST_PAUSE)
