"""A virtual drone: the rig as the hardware of a flight controller, and the flight controller's whole program on it."""

import asyncio
import functools
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from operator import itemgetter
from pathlib import Path
from typing import Any, Self

from twodof.blocks import Diagram
from twodof.compile import CompiledProgram, build
from twodof.compile.machine import Stepper
from twodof.errors import CompileError, ExperimentError, ParameterError
from twodof.fcu.assembly import Assembly
from twodof.fcu.control.controllers import Controllers
from twodof.fcu.control.flight_code import MEASURED, ControllerIdentity, FlightCode
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.link.mavlink.dialect import PROFILES
from twodof.link.signing import Signing
from twodof.parameters import ParameterSet
from twodof.rig.parameters import NAMES, lab, load_rig
from twodof.rig.rig import BASE_DT, MEASUREMENTS, SAMPLE, TRUTH, rig
from twodof.sim.closed_loop import SETTLE_STEPS, InitialState, covariances, mounting

TICKS = SAMPLE[0]
"""Base ticks in a control period."""

Values = tuple[tuple[str, Any], ...]
"""Values of parameters by path, as pairs."""

_OUTPUTS = (*MEASUREMENTS, "voltage", "charge", *TRUTH)
# The rig does not roll or yaw, and its IMU gives a sample at each tick.
_LACKING = len(_OUTPUTS), len(_OUTPUTS) + 1
_sampled = itemgetter(*(_OUTPUTS.index(n) if n in _OUTPUTS else _LACKING[n == "imu_new"] for n in SensorSample._fields))


@functools.cache
def _program(precision: str) -> CompiledProgram:
    program = build(rig(), BASE_DT, precision)
    if not isinstance(program, CompiledProgram):  # raised here, so that it is tried again: one may be installed by then
        raise CompileError("no C compiler was found", "rig", "install gcc, or the wheel ziglang")
    return program


@functools.lru_cache(16)  # what was run once need not be run again in this process
def _at_rest(precision: str, position_filter: str, of_rig: Values, of_estimator: Values) -> Mapping[str, Any]:
    """Return the covariances to which an estimator settles in 100 s on a rig with the motors off.

    The rig's sensors do not depend on the flight code then: the rig runs first.
    """
    machine = _program(precision).machine()
    machine.set_many(dict(of_rig))
    machine.reset()
    seen = machine.run(SETTLE_STEPS * TICKS, {"fore": 0.0, "aft": 0.0})
    given: dict[str, Any] = {name: seen[name][::TICKS] for name in MEASURED if name in _OUTPUTS}
    given |= {"imu_new": True, "rings": False, "step_late": False, "user_late": False}
    # The estimator is the same with all controllers.
    code = FlightCode(position_filter=position_filter, precision=precision).machine
    code.set_many(dict(of_estimator))
    code.reset()
    code.run(SETTLE_STEPS, given | ControlInput()._asdict())
    return {path: code.state(path) for path in covariances(code.program.states)}


class VirtualRig:
    """A rig from `twodof.rig.parameters` (None: `lab`) as a `VirtualHardware`, with the bits of `ClosedLoop`.

    `conditions` are further parameters of the rig (`trim`, `noise`, `seed`, `rings`, ...). `safety_off` is true if the
    safety switch was pressed. `distort`, a function, changes each sensor sample, to test faults. `seed` is that of the
    noise, and `rings` says that the rings lock the cart. Raises ParameterError for parameters that are unknown or out
    of bounds, CompileError without a C compiler.
    """

    virtual = True

    def __init__(
        self,
        parameters: ParameterSet | None = None,
        conditions: Mapping[str, Any] | None = None,
        precision: str = "float64",
        name: str = "lab",
        safety_off: bool = True,
    ) -> None:
        program = _program(precision)
        self.name = name
        self.safety_off = safety_off
        self.distort: Callable[[SensorSample], SensorSample] | None = None
        self.machine = program.machine()
        self.machine.set_many(dict((lab() if parameters is None else parameters).snapshot()) | dict(conditions or {}))
        self._stepper = Stepper(self.machine, ("fore", "aft"), _OUTPUTS)
        self._flight_states: frozenset[str] = frozenset()
        self._settled: Mapping[str, Any] = {}
        self._stopped = False
        self._take_conditions()
        self.machine.reset()
        self._look()

    @property
    def truth(self) -> tuple[float, float, float, float]:
        """Pitch [rad], pitch rate [rad/s], position [m] and velocity [m/s] at this tick."""
        return self._outputs[-len(TRUTH) :]

    def settle(self, code: FlightCode) -> None:
        """Reset this rig and `code` to rest, with the covariances to which the estimator of `code` settles on this rig.

        Later calls of `reset` use these covariances too.
        """
        own = code.machine
        self._flight_states = frozenset(own.program.states)
        of_rig = tuple((path, self.machine.get(path)) for path in self.machine.parameters)
        of_estimator = tuple((path, own.get(path)) for path in own.parameters if path.startswith("estimator."))
        self._settled = _at_rest(code.precision, code.position_filter, of_rig, of_estimator)
        code.reset(self._begin(InitialState()))

    def reset(
        self, seed: int | None = None, x: float = 0.0, noise: float | None = None, rings: bool | None = None
    ) -> dict[str, Any]:
        """Reset to rest at `x` [m]; None keeps a value as it is. Return the states for the flight code, by path.

        Raises ParameterError, and changes nothing, for a position beyond the rail, or a seed or noise out of bounds.
        """
        asked = {"seed": seed, "noise": noise, "rings": rings}
        values = {name: value for name, value in asked.items() if value is not None}
        start = InitialState(x=float(x))
        try:
            start.check(float(self.machine.get("pitch_stop")), float(self.machine.get("rail_stop")))
        except ExperimentError as error:
            raise ParameterError(error.what, error.where, error.remedy) from error
        # The rings hold the cart where it starts.
        self.machine.set_many(values | {"ring_place": float(x)} | start.rig_parameters())
        self._take_conditions()
        return self._begin(start)

    def read(self) -> SensorSample:
        """Return the sensor sample of this tick."""
        sample = SensorSample._make(_sampled((*self._outputs, 0.0, True)))
        return sample if self.distort is None else self.distort(sample)

    def drive(self, fore: float, aft: float) -> None:
        """Command the rotor pairs, 0 to 1 each, and run the rig for one control period."""
        if self._stopped:
            fore = aft = 0.0
        self._stepper.run(TICKS, (fore, aft))
        self._look()

    def stop(self) -> None:
        """Stop both rotor pairs until `release`, overriding `drive`. May be called from any thread."""
        self._stopped = True

    def release(self) -> None:
        """Let the commands of `drive` act again after `stop`."""
        self._stopped = False

    def _look(self) -> None:
        # What the sensors say of a tick depends on the rig's state only, and is needed before that tick's commands.
        self._outputs = self._stepper.peek()

    def _begin(self, start: InitialState) -> dict[str, Any]:
        machine = self.machine
        machine.set_many(start.rig_parameters())
        machine.reset()
        for path, value in start.rig_states(float(machine.get("delay")), float(machine.get("lag"))).items():
            machine.set_state(path, value)
        self._look()
        if not self._flight_states:
            return {}
        return start.flight_states(self._flight_states) | dict(self._settled)

    def _take_conditions(self) -> None:
        self.seed, self.rings = int(self.machine.get("seed")), bool(self.machine.get("rings"))
        self.noise = float(self.machine.get("noise"))


class VirtualDrone:
    """Drone number `index` (system `index` + 1) on a virtual rig, in real time or in `lockstep`.

    `rig` is "paper", "lab", a file or a set of parameters; `conditions` are further parameters of the rig (`seed`,
    `noise`, `rings`, ...). `controllers` are diagrams, their JSON files, or names of starter diagrams, which fly in a
    sandbox unless `trusted`. `precision` is that of rig and flight code. `state` is the folder in which parameters,
    controllers and logs are kept, None to keep nothing; `fresh` deletes its content except the logs. `rate` names the
    streams that every client gets, "onboard" or "ground".

    Use it as an asynchronous context manager, within which it runs; `listen` opens links. Raises ParameterError for a
    rig, condition or rate, DiagramError and CompileError for a controller, and LinkError for a link.

    `controller` is the flight controller with its loop, `commander` decides about arming, mode and set-points, and
    `server` has the links and the MAVLink services.
    """

    def __init__(
        self,
        rig: str | Path | ParameterSet = "lab",
        conditions: Mapping[str, Any] | None = None,
        controllers: Iterable[str | Path | Diagram] = (),
        trusted: bool = False,
        precision: str = "float64",
        lockstep: bool = False,
        index: int = 0,
        safety_off: bool = True,
        state: Path | None = None,
        signing: Signing | None = None,
        position_filter: str = "joint",
        fuel: int | None = None,
        rate: str = "onboard",
        fresh: bool = False,
    ) -> None:
        parameters = rig if isinstance(rig, ParameterSet) else load_rig(rig)
        name = "own" if isinstance(rig, ParameterSet) else Path(rig).stem
        if name in NAMES and str(rig) != name:
            name = "own"  # a file must not pass for the ready-made rig of its name
        self.rig = VirtualRig(parameters, conditions, precision, name, safety_off)
        uploads, kept = (None, None) if state is None else (state / "controllers", state / "flying")
        chosen = Controllers(controllers, trusted, uploads, kept, position_filter, precision, fuel)
        if rate not in PROFILES:
            raise ParameterError(f"no rates are named {rate!r:.40}", "rate", f"use one of {', '.join(PROFILES)}")
        own = mounting({**parameters, **(conditions or {})})
        self.assembly = Assembly(self.rig, chosen, index + 1, lockstep, signing, state, PROFILES[rate], fresh, own)
        self.controller, self.commander = self.assembly.controller, self.assembly.commander
        self.server = self.assembly.server
        self.rig.settle(self.controller.code)
        self.urls: list[str] = []
        self._running: asyncio.Task[None] | None = None

    @property
    def flown(self) -> ControllerIdentity:
        """Identity of the controller that flies, and the number of parameters that differ from their defaults."""
        return self.assembly.flown

    async def __aenter__(self) -> Self:
        self._running = asyncio.create_task(self.server.run(), name=f"drone {self.server.system}")
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def listen(self, url: str) -> str:
        """Open a link and return its URL, with the port that the system chose for port 0. Raises LinkError."""
        self.urls.append(await self.server.listen(url))
        return self.urls[-1]

    async def wait(self) -> None:
        """Wait until the drone ends, which only an error causes. Raises that error."""
        if self._running is not None:
            await self._running

    async def close(self) -> None:
        """Stop the motors, close links and log; a second call does nothing. Raises the error that ended the drone."""
        running, self._running = self._running, None
        try:
            if running is not None:
                running.cancel()
                with suppress(asyncio.CancelledError):
                    await running
        finally:
            await self.server.close()
            self.assembly.close()
