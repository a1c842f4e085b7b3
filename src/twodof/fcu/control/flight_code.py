"""The compiled flight code, one tick at a time."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cache, cached_property
from operator import attrgetter
from types import MappingProxyType
from typing import Any, NamedTuple

from twodof.blocks import Diagram
from twodof.blocks.expressions.numbers import FLOATS
from twodof.blocks.schema.json_form import to_json
from twodof.compile import CompiledProgram, build
from twodof.compile.machine import CompiledMachine, Stepper
from twodof.errors import CompileError, ParameterError
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.fcu.control.sandbox import Sandbox
from twodof.fcu.parameters.table import UserParameters, user_parameters
from twodof.flight.core import core
from twodof.flight.declarations import FAILSAFE_INPUTS, USER_INPUTS
from twodof.flight.declarations import INPUTS as CORE_INPUTS
from twodof.flight.templates import MOTOR, TEMPLATES
from twodof.parameters import FLIGHT_PARAMETERS
from twodof.signals import PERIOD

MEASURED = tuple(name for name, _, _, _ in (*CORE_INPUTS, *FAILSAFE_INPUTS) if name in SensorSample._fields)
"""The fields of a sample that the flight code reads."""

INPUTS = (*MEASURED, *ControlInput._fields, "rings", "step_late", "user_late")
"""The inputs of the flight code, in the order of `FlightCode.step`."""

_COMMANDED = tuple(name for name, _, _, _ in USER_INPUTS)
"""Further inputs after those: the commands of a user's controllers in the sandbox."""

PATHS: Mapping[str, str] = MappingProxyType({row.name: row.path for row in FLIGHT_PARAMETERS})
"""Path in the flight code of each of `parameters.FLIGHT_PARAMETERS`, by its name on the wire."""

_CASCADE, _RESERVE = "cascade.", "stock."
_USER_PATHS = tuple(f"{'' if kind == MOTOR.name else _CASCADE}{kind}." for kind in TEMPLATES)
"""Paths of a user's controllers in the flight code."""
_LIMITS = MappingProxyType({name: f"failsafe.safe.{name}_limit" for name in ("x0", "v0", "theta0", "q0")})


@dataclass(slots=True)
class ControlStep:
    """One control period: measurements, requested input, and outputs of the flight code (`flight.core.OUTPUTS`)."""

    tick: int
    sample: SensorSample
    asked: ControlInput
    fore: float
    aft: float
    M: float
    T: float
    theta: float
    q: float
    x: float
    v: float
    x0: float
    v0: float
    theta0: float
    q0: float
    M_trim: float
    armed: bool
    action: int
    state: int
    reason: int
    causes: int


OUTPUTS = tuple(field.name for field in fields(ControlStep))[3:]
"""The outputs of the flight code: the fields of `ControlStep` after `asked`."""

_measured = attrgetter(*MEASURED)
_USED = slice(OUTPUTS.index("x0"), OUTPUTS.index("q0") + 1)


class ControllerIdentity(NamedTuple):
    """Identity of a controller: its name, 64 bits of its diagram's SHA-256, number of tuned parameters."""

    controller: str = "stock"
    diagram: int = 0
    changed: int = 0


class FlightCode:
    """The flight code with the failsafe, compiled for this machine, with its states and parameters.

    `controllers` are diagrams that fly in place of the stock ones of their templates. `trusted` ones are part of the
    native code. Others run in a sandbox of WebAssembly: its memory and its instructions per step are bounded, and its
    commands pass the same gate. In both cases the gate replaces them by the stock ones as docs/explanation/safety.md
    says. `fuel` is the most instructions of a step in the sandbox, None: by the size of the program.

    Raises DiagramError for a controller that fits no template, CompileError if the tool chain is missing.
    """

    def __init__(
        self,
        controllers: Iterable[Diagram] = (),
        trusted: bool = False,
        position_filter: str = "joint",
        precision: str = "float64",
        fuel: int | None = None,
    ) -> None:
        self.controllers = tuple(controllers)
        self.trusted = trusted
        self.position_filter = position_filter
        self.precision = precision
        inside = self.controllers if trusted else ()
        self.sandbox = (
            Sandbox(self.controllers, position_filter, precision, fuel) if self.controllers and not trusted else None
        )
        outside = self.sandbox is not None
        make = _program.__wrapped__ if inside else _program
        program = make(position_filter, precision, outside, inside)
        self.machine: CompiledMachine = program.machine()
        self._stepper = Stepper(
            self.machine, (*INPUTS, *(_COMMANDED if outside else ())), (*OUTPUTS, *(("user_flies",) if outside else ()))
        )
        self.user_parameters: tuple[UserParameters, ...] = user_parameters(self.controllers)
        self._user_values: dict[str, Any] = {}
        self._user_flies = False
        self._armed = False
        self._limits: dict[str, float] = {}
        self._read_limits()

    @cached_property
    def identity(self) -> ControllerIdentity:
        """Return the identity of the users' controllers."""
        if not self.controllers:
            return ControllerIdentity()
        names = "+".join(diagram.name for diagram in self.controllers)
        digest = hashlib.sha256("".join(to_json(diagram) for diagram in self.controllers).encode())
        return ControllerIdentity(names, int.from_bytes(digest.digest()[:8], "big"))

    @property
    def user_fault(self) -> str:
        """Return the fault that stopped a user's controllers in their sandbox, "" while they run."""
        return self.sandbox.fault if self.sandbox is not None else ""

    def step(
        self, tick: int, sample: SensorSample, asked: ControlInput, rings: bool = False, step_late: bool = False
    ) -> ControlStep:
        """Run one control period. `step_late`: the step before took too long."""
        measured = _measured(sample)
        if self.sandbox is None:
            outputs = self._stepper.step((*measured, *asked, rings, step_late, False))
        else:
            if self.sandbox.rests and not self._armed and self.sandbox.wakes():
                self.sandbox.resume(self._states())
            user = self.sandbox.step(sample, self._limited(asked), asked.in_reset or not self._user_flies)
            late, fore, aft, moment, thrust = user[:5]
            *flown, self._user_flies = self._stepper.step(
                (*measured, *asked, rings, step_late, late, True, fore, aft, moment, thrust)
            )
            if self._user_flies and not late:
                flown[_USED] = user[5:]  # the set-points in use are those of who flies
            outputs = tuple(flown)
        step = ControlStep(tick, sample, asked, *outputs)
        if self._armed and not step.armed and self._stopped:
            self._revive()
        self._armed = step.armed
        return step

    def reset(self, states: Mapping[str, Any] | None = None) -> None:
        """Set all states to their initial values with the present parameters, then those in `states` by path."""
        self.machine.reset()
        for path, value in (states or {}).items():
            self.machine.set_state(path, value)
        self._user_flies = self._armed = False
        self._revive()

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        """Set parameters by their names on the wire, or by paths such as "failsafe.battery.low".

        Those of a user's controllers have paths such as "attitude_control.k_q". A flag is true or false, or 1 or 0. All
        take effect at the next step, or none does: raises ParameterError for an unknown name and a value out of bounds.
        Stock controllers in reserve get the gains too.
        """
        known = self.machine.parameters
        paths = {_path(name): value for name, value in values.items()}
        paths = {path: _of_kind(known[path].kind, value) if path in known else value for path, value in paths.items()}
        outside = self.sandbox.machine.parameters if self.sandbox is not None else {}
        user = {path: value for path, value in paths.items() if path.startswith(_USER_PATHS) and path in outside}
        reserve = {
            f"{_RESERVE}{path.removeprefix(_CASCADE)}": value
            for path, value in paths.items()
            if path.startswith(_CASCADE)
        }
        replaced = set(PATHS.values()) - known.keys()  # gains of a loop that a user's controller replaces
        inside = {path: value for path, value in paths.items() if path not in replaced and path not in user}
        inside |= {path: value for path, value in reserve.items() if path in known}
        before = {path: self.machine.get(path) for path in inside if path in known}
        self.machine.set_many(inside)
        if self.sandbox is not None:
            try:
                self.sandbox.set_parameters(paths)
            except ParameterError:
                self.machine.set_many(before)
                raise
            self._user_values |= user
            if self._stopped and not self._armed:
                self._revive()
        self._read_limits()

    def parameter(self, name: str) -> Any:
        """Return the present value of a parameter, by either name. Raises ParameterError for an unknown one."""
        path = _path(name)
        if self.sandbox is not None and path.startswith(_USER_PATHS) and path in self.sandbox.machine.parameters:
            return self.sandbox.machine.get(path)
        if path not in self.machine.parameters and path.startswith(_CASCADE):
            path = f"{_RESERVE}{path.removeprefix(_CASCADE)}"
        return self.machine.get(path)

    def take_over(self, other: FlightCode) -> None:
        """Continue the flight of `other` with its parameters and the states of all parts that both have.

        A user's controllers keep their own defaults: parameters of another may have another meaning.
        """
        old = other.machine
        known = self.machine.parameters
        self.machine.set_many(
            {path: old.get(path) for path in old.parameters if path in known and not path.startswith(_USER_PATHS)}
        )
        for path in old.program.states:
            if path in self.machine.program.states:
                self.machine.set_state(path, old.state(path))
        self._read_limits()
        self._revive()

    @property
    def _stopped(self) -> bool:
        """Return whether a user's controllers need a fresh instance to go on."""
        return self.sandbox is not None and bool(self.sandbox.fault) and not self.sandbox.rests

    def _states(self) -> dict[str, Any]:
        return {path: self.machine.state(path) for path in self.machine.program.states}

    def _revive(self) -> None:
        """Restart the sandbox with its own parameters, and the parameters and states of the native code."""
        if self.sandbox is not None:
            machine = self.machine
            self.sandbox.restart(
                {path: machine.get(path) for path in machine.parameters} | self._user_values, self._states()
            )

    def _read_limits(self) -> None:
        limits = {name: float(self.machine.get(path)) for name, path in _LIMITS.items()}
        self._limits = limits | {"thrust": 1.0, "M_open": 1.0, "ax0": math.inf}

    def _limited(self, asked: ControlInput) -> ControlInput:
        """Return the set-points clipped as the failsafe clips them for native controllers."""
        values: dict[str, Any] = {name: _within(getattr(asked, name), limit) for name, limit in self._limits.items()}
        values["thrust"] = max(0.0, values["thrust"])
        return asked._replace(**values)


@cache
def _program(position_filter: str, precision: str, outside: bool, controllers: tuple[Diagram, ...]) -> CompiledProgram:
    """Build the flight code. Cached, as many virtual drones fly the same."""
    diagram = core(position_filter=position_filter, controllers=controllers, failsafe=True, outside=outside)
    program = build(diagram, PERIOD, precision)
    if not isinstance(program, CompiledProgram):  # raised here, so that it is tried again: one may be installed by then
        raise CompileError("no C compiler was found", diagram.name, "install gcc, or the wheel ziglang")
    return program


def _path(name: str) -> str:
    """Return the path of a parameter, by any of its names."""
    kind, _, _ = name.partition(".")
    return f"{_CASCADE}{name}" if kind in TEMPLATES and kind != MOTOR.name else PATHS.get(name, name)


def _within(value: float, limit: float) -> float:
    """Clip `value` to +-`limit`; return 0 for NaN and infinity."""
    return max(-limit, min(limit, value)) if math.isfinite(value) else 0.0


def _of_kind(kind: str, value: Any) -> Any:
    """Convert a whole number that came as a float to the type `kind` of its parameter."""
    if not isinstance(value, float) or not value.is_integer():
        return value
    return value == 1.0 if kind == "bool" and value in (0.0, 1.0) else value if kind in FLOATS else int(value)
