"""A user's controllers that are not trusted: a whole flight core of theirs in WebAssembly, bounded, watched."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from twodof.blocks import Diagram
from twodof.compile import Program, build
from twodof.compile.stepper import Stepper
from twodof.compile.wasm.target import Wasm
from twodof.errors import CompileError, ControllerFault
from twodof.fcu.asked import Asked
from twodof.fcu.hardware import Sample
from twodof.flight.core import INPUTS as CORE_INPUTS
from twodof.flight.core import PERIOD, core

BUDGET_NS = 2_000_000
"""Processor time [ns] that a step in the sandbox may take in real time: half of the control period."""

INPUTS = tuple(name for name, _, _, _ in CORE_INPUTS)
OUTPUTS = ("fore", "aft", "M", "T", "x0", "v0", "theta0", "q0")


class Commands(NamedTuple):
    """What the controllers asked for, and the set-points that they used.

    `late` says that they were stopped or out of time, and that the rest is not to fly.
    """

    late: bool
    fore: float
    aft: float
    M: float
    T: float
    x0: float
    v0: float
    theta0: float
    q0: float


_NOTHING = Commands(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Sandbox:
    """The flight core with `controllers`, without failsafe, in WebAssembly; its commands go through the native gate.

    `fault` says what stopped it, "" while it runs; then every step is late until `restart`. A step in real time
    (`timed`) that takes more than `BUDGET_NS` of the processor is late. Raises DiagramError for a controller that fits
    no template, CompileError where the compiler for WebAssembly or wasmtime is not there.
    """

    def __init__(
        self,
        controllers: Iterable[Diagram],
        position_filter: str = "joint",
        precision: str = "float64",
        fuel: int | None = None,
    ) -> None:
        diagram = core(position_filter=position_filter, controllers=controllers)
        program = build(diagram, PERIOD, precision, target=Wasm(fuel=fuel))
        if not isinstance(program, Program):
            raise CompileError("there is no WebAssembly", diagram.name, "install the wheels ziglang and wasmtime")
        self.program = program
        self.timed = False
        self.late_steps = 0
        self.fault = ""
        self._spent = 0
        self.machine = program.machine()
        self._stepper = Stepper(self.machine, INPUTS, OUTPUTS)

    def restart(self, parameters: Mapping[str, Any], states: Mapping[str, Any]) -> None:
        """A fresh instance with these parameters and states by path, as far as it has them; `fault` if it cannot be."""
        self.fault = ""
        self._spent = 0
        try:
            self.machine = self.program.machine()
            self._stepper = Stepper(self.machine, INPUTS, OUTPUTS)
            known = self.machine.parameters
            self.machine.set_many({path: value for path, value in parameters.items() if path in known})
            self.machine.reset()  # a state may begin at a parameter
        except ControllerFault as fault:
            self.fault = str(fault)
            return
        for path, value in states.items():
            if path in self.program.states:
                self.machine.set_state(path, value)

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        """Sets those of `values` that it has, all or none; the time that this takes is part of the next step's.

        Raises ParameterError for a value that cannot be. Where derived parameters cannot be computed it has stopped:
        `fault` says so.
        """
        known = self.machine.parameters
        began = time.thread_time_ns() if self.timed else 0
        try:
            self.machine.set_many({path: value for path, value in values.items() if path in known})
        except ControllerFault as fault:
            self.fault = self.fault or str(fault)
        self._spent += time.thread_time_ns() - began if self.timed else 0

    def step(self, sample: Sample, asked: Asked, in_reset: bool) -> Commands:
        """One control period, with set-points that are numbers within their limits."""
        if self.fault:
            return _NOTHING
        began = time.thread_time_ns() if self.timed else 0
        try:
            asked_for = self._stepper.step(
                (
                    *(sample.acc_x, sample.acc_z, sample.gyro_y, sample.dist, sample.dist_new, sample.dist_age),
                    *(asked.mode, in_reset, asked.x0, asked.v0, asked.ax0, asked.theta0, asked.q0),
                    *(asked.thrust, asked.M_open, asked.use_trim),
                )
            )
        except ControllerFault as fault:
            self.fault = str(fault)
            return _NOTHING
        late = self.timed and time.thread_time_ns() - began + self._spent > BUDGET_NS
        self._spent = 0
        self.late_steps += late
        return Commands(late, *asked_for)
