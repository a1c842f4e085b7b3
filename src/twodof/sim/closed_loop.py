"""The closed loop: the rig and the flight code as one diagram, compiled as one step, and started in any state."""

import functools
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.blocks.declarations import Param, unknown_parameter
from twodof.blocks.library.delays import ZeroOrderHold
from twodof.blocks.reference.interpreter import Reference
from twodof.compile import CompiledProgram, build
from twodof.errors import ExperimentError
from twodof.flight.core import OUTPUTS, core
from twodof.flight.declarations import FAILSAFE_INPUTS, INPUTS
from twodof.flight.failsafe.diagram import OUTPUTS as FAILSAFE_OUTPUTS
from twodof.flight.failsafe.state_machine import FLYING
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.templates import TEMPLATES
from twodof.parameters import TUNABLES, ParameterSet, float32_decimal
from twodof.rig.parameters import lab
from twodof.rig.rig import BASE_DT, MEASUREMENTS, SAMPLE, TRUTH, rig
from twodof.rig.rotors import RING
from twodof.signals import HOVER, MODES, PERIOD
from twodof.sim.drone_estimator import HISTORY, drone_estimator, settled

SETTLE_STEPS = 25_000
"""Control steps at rest after which the estimator's covariances are constant, as the gyro's bias needs some 10 s."""

_COVARIANCE = re.compile(r"\.(P_\w+|\w*variance)$").search
_ARMED = 1000  # more than any count of samples that the flight code waits for after arming


@dataclass(frozen=True)
class InitialState:
    """Start of a simulated flight: the rig's state [rad, rad/s, m, m/s], the estimates, and the commands before it.

    `estimates` ("theta", "x", "v") are by default the true values. `commands` are (M, T) of the control steps before
    the start, the latest last, which fill the rotors and the delay line. Without any the rotors are at rest, or with
    `hover` they run at T = .4 and no integral is in reset. `wake` and `polarised` are the rig's `wake_start` and
    `polarised_start`, by default 1 with running rotors. `states` overwrites single states by path, such as
    "flight.cascade.rate.sum".
    """

    theta: float = 0.0
    q: float = 0.0
    x: float = 0.0
    v: float = 0.0
    estimates: Mapping[str, float] = field(default_factory=dict)
    commands: tuple[tuple[float, float], ...] = ()
    hover: bool = False
    wake: float | None = None
    polarised: float | None = None
    states: Mapping[str, Any] = field(default_factory=dict)

    @property
    def running(self) -> bool:
        """Return True if the rotors run at the start."""
        return self.hover or (bool(self.commands) and self.commands[-1][1] > 0.0)

    def check(self, pitch_stop: float, rail_stop: float) -> None:
        """Raise ExperimentError unless the start is within the stops [rad, m]."""
        for name, bound in (("theta", pitch_stop), ("x", rail_stop)):
            if not abs(getattr(self, name)) <= bound:
                what = f"{name} = {getattr(self, name):g} is beyond the stop at {bound:g}"
                raise ExperimentError(what, "start", "start between the stops")

    def rig_parameters(self) -> dict[str, float]:
        """Return the parameters of the rig to set before its reset, by name."""
        running = float(self.running)
        return {
            "theta_start": self.theta,
            "q_start": self.q,
            "x_start": self.x,
            "v_start": self.v,
            "wake_start": running if self.wake is None else self.wake,
            "polarised_start": running if self.polarised is None else self.polarised,
        }

    def rig_states(self, delay: float, lag: float) -> dict[str, Any]:
        """Return the states of the rig to set after its reset, by path.

        They are those of rotors with `delay` [s] and `lag` [s] that have received `commands`.
        """
        states: dict[str, Any] = {"battery.load": float(self.running)}
        commands = self.commands or (((0.0, HOVER),) if self.hover else ())
        if not commands:
            return states
        held = np.repeat(np.asarray(commands, dtype=np.float64), SAMPLE[0], axis=0)
        back = max(1, round(delay / BASE_DT))
        decay = float(np.exp(-BASE_DT / lag)) if lag > 0.0 else 0.0
        for name, sign in (("fore", 1.0), ("aft", -1.0)):
            command = np.clip(held[:, 1] + sign * held[:, 0], 0.0, 1.0)
            speed = command[0]
            for arrived in command[: max(0, len(command) - back)]:
                speed = arrived + decay * (speed - arrived)
            ring = np.full(RING, command[0])
            recent = command[-RING:]
            ring[RING - len(recent) :] = recent  # place 0 is written next, so the latest stands last
            states |= {f"rotors.{name}": float(speed), f"rotors.{name}_ring": ring.tolist()}
        return states

    def flight_states(self, known: Iterable[str]) -> dict[str, Any]:
        """Return values for the flight code's states, to set after its reset, by path.

        `known` are the paths of all states that this flight code has.
        """
        known = frozenset(known)
        estimate = {"theta": self.theta, "x": self.x, "v": self.v} | dict(self.estimates)
        joint = "estimator.filter.theta" in known
        pitch, position = ("estimator.filter",) * 2 if joint else ("estimator.pitch", "estimator.position")
        states: dict[str, Any] = {
            "previous.theta": estimate["theta"],
            f"{pitch}.theta": estimate["theta"],
            f"{position}.x": estimate["x"],
            f"{position}.v": estimate["v"],
            "estimator.publisher.x": estimate["x"],
            "estimator.publisher.v": estimate["v"],
        }
        states |= {path: True for path in (f"{pitch}.started", f"{position}.started") if path in known}
        if f"{position}.turning" in known:  # the real drone's estimator
            ago = PERIOD * np.arange(-HISTORY, 0)
            level = np.full(HISTORY, estimate["theta"])
            own = settled(level, estimate["x"] + estimate["v"] * ago, np.full(HISTORY, estimate["v"]))
            states |= {f"{position}.{name}": value for name, value in own.states.items()}
        if f"{position}.x_filter" in known:
            states[f"{position}.x_filter"] = estimate["x"]
        if self.running:
            states["arming.count"] = _ARMED
        if self.running and "failsafe.machine.state" in known:
            thrust = self.commands[-1][1] if self.commands else HOVER
            states |= {"failsafe.machine.state": FLYING, "failsafe.safe.thrust": thrust}
            # What flew before had sensors and a link: an axis whose first sample is 0 has not stood still.
            alive = ("imu", "axis", "range", "range_stuck", "link")
            states |= dict.fromkeys((f"failsafe.{name}.count" for name in alive), 0)
        return states


def covariances(known: Iterable[str]) -> list[str]:
    """Return those of the flight code's state paths `known` that are covariances of the estimator.

    A flight starts with the values to which they settle at rest, as its pitch is well known.
    """
    return [path for path in sorted(known) if path.startswith("estimator.") and _COVARIANCE(path)]


TICKS = SAMPLE[0]
"""Base ticks in a step of the flight code."""

SETPOINTS = tuple(name for name, _, _, _ in INPUTS if name not in MEASUREMENTS)
"""Inputs of the closed loop: mode, set-points and flags of the flight code."""

SAFETY = tuple(name for name, _, _, _ in FAILSAFE_INPUTS if name != "voltage")
"""Inputs of the closed loop with the failsafe, besides `SETPOINTS`."""

READ = frozenset(name for name, _, _, _ in INPUTS)
"""Names of the flight code's inputs, which include the measurements that it reads."""

ARMING = 25
"""Steps from a start with the motors off until `fly` arms; by then the range sensor has given a sample."""

FLIGHT, CASCADE = "flight.", "flight.cascade."
"""Prefixes of the paths of the flight code, and of its cascade, in the closed loop."""

_OWN = tuple(f"{prefix}{name}." for name in TEMPLATES for prefix in (FLIGHT, CASCADE))
_IMU = MappingProxyType({name: f"failsafe.force.{name}" for name in ("imu_below", "imu_ahead")})
_SETTLE_TICKS = SETTLE_STEPS * TICKS
_SETTLE_TICKS_INTERPRETED = 2_000


def mounting(rig: Mapping[str, Any]) -> dict[str, float]:
    """Return the flight code's parameters that say where the IMU of `rig` is, by path, as MAVLink carries them."""
    return {path: float32_decimal(rig[name]) for name, path in _IMU.items() if name in rig}


def loop_values(rig: Mapping[str, Any]) -> dict[str, Any]:
    """Return a rig's values as parameters of the closed loop with the failsafe, by path."""
    return {f"rig.{name}": value for name, value in rig.items()} | {
        f"{FLIGHT}{path}": value for path, value in mounting(rig).items()
    }


def closed_loop(
    gains: Gains = DEFAULT, position_filter: str = "joint", controllers: Iterable[Diagram] = (), failsafe: bool = False
) -> Diagram:
    """Return the diagram of the rig with the flight code, for a base tick of 1 ms.

    Inputs: those of the flight code that are not measured (`SETPOINTS`). Outputs: those of the flight code; the
    measurements; the true states `true_theta`, `true_q`, `true_x`, `true_v`; `load`, `voltage`, `charge`. Parameters:
    `rig.<name>` and `flight.<path>`. `controllers` fly in place of the stock ones, see `flight.core`.
    The `position_filter` "drone" is the real drone's estimator (`sim.drone_estimator`). The others are those of
    `flight.estimator`. With `failsafe` the flight code includes the failsafe, with the further inputs `SAFETY` and
    outputs `flight.failsafe.diagram.OUTPUTS`; it reads the rig's voltage. Raises ParameterError for an unknown position
    filter, DiagramError for a diagram that fits no template.
    """
    d = Diagram("closed_loop", "the virtual rig and the code that flies it")
    given = (*SETPOINTS, *(SAFETY if failsafe else ()))
    for name, kind, unit, _ in (*INPUTS, *FAILSAFE_INPUTS):
        if name in given:
            d.input(name, kind, unit=unit)
            d.add(f"{name}_held", ZeroOrderHold(kind=kind, unit=unit), rate=SAMPLE, u=name)
    d.add("rig", rig())
    d.add("flight", _flight_code(gains, position_filter, controllers, failsafe), rate=SAMPLE)
    for name in given:
        d.connect(f"{name}_held", f"flight.{name}")
    for name in MEASUREMENTS:
        if name in READ:
            d.connect(f"rig.{name}", f"flight.{name}")
    for name in ("fore", "aft"):
        d.connect(f"flight.{name}", f"rig.{name}")
    if failsafe:
        d.add("voltage_held", ZeroOrderHold(unit="V"), rate=SAMPLE, u="rig.voltage")
        d.connect("voltage_held", "flight.voltage")
    for name, _, _ in (*OUTPUTS, *(FAILSAFE_OUTPUTS if failsafe else ())):
        d.output(name, f"flight.{name}")
    for name in MEASUREMENTS:
        d.output(name, f"rig.{name}")
    for name in TRUTH:
        d.output(f"true_{name}", f"rig.{name}")
    for name in ("load", "voltage", "charge"):
        d.output(name, f"rig.{name}")
    return d


def _flight_code(gains: Gains, position_filter: str, controllers: Iterable[Diagram], failsafe: bool) -> Diagram:
    """Return the flight core; the filter "drone" puts the real drone's estimator in it."""
    if position_filter != "drone":
        return core(gains, position_filter, controllers, failsafe)
    code = core(gains, controllers=controllers, failsafe=failsafe)
    code.parts["estimator"].item = drone_estimator()
    return code


def _built(
    position_filter: str,
    controllers: tuple[Diagram, ...],
    failsafe: bool,
    precision: str,
    log: tuple[str, ...],
    target: str = "native",
) -> CompiledProgram | Reference:
    diagram = closed_loop(position_filter=position_filter, controllers=controllers, failsafe=failsafe)
    return build(diagram, BASE_DT, precision, log=log, target=target)


_stock = functools.lru_cache(8)(_built)  # user diagrams may be changed between two loops


class ClosedLoop:
    """A compiled closed loop with one rig and one set of gains, for any number of flights.

    `rig` is a set from `twodof.rig.parameters` (None: `lab`). `conditions` are further parameters of the rig, such as
    `noise` and `seed`. `tuning` sets parameters of the flight code that are not gains, by path. `log` names further
    signals to return. `controllers` are diagrams that fly in place of the stock loops and mixer (`flight.templates`);
    `gains` are those of the remaining stock loops. `precision`, "float64" or "float32", holds for the rig too. Without
    a C compiler the reference interpreter runs the loop, with a warning. With `failsafe` the inputs `SAFETY` are those
    of a flight without faults, armed after `ARMING` steps (at once in hover), unless `fly` is given others. `target` is
    "native", or "wasm", the sandbox, for diagrams from untrusted sources.

    If a controller's moment or thrust is not finite, the motors stop. The flight goes on to its end, and its `M` and
    `T` have these values. Raises DiagramError for a diagram that fits no template or two that fit the same.
    """

    def __init__(
        self,
        gains: Gains = DEFAULT,
        rig: ParameterSet | None = None,
        conditions: Mapping[str, Any] | None = None,
        position_filter: str = "joint",
        tuning: Mapping[str, Any] | None = None,
        log: tuple[str, ...] = (),
        controllers: Iterable[Diagram] = (),
        precision: str = "float64",
        failsafe: bool = False,
        target: str = "native",
    ) -> None:
        # Gains are parameters: one program, compiled once, flies them all.
        flown = tuple(controllers)
        make = _built if flown else _stock
        self.program = make(position_filter, flown, failsafe, precision, tuple(log), target)
        if isinstance(self.program, Reference):  # not kept: a compiler may be installed before the next one
            _stock.cache_clear()
        self.machine = self.program.machine()
        self.controllers = {
            name.removeprefix(CASCADE).removeprefix(FLIGHT): name
            for name in self.machine.parameters
            if name.startswith(_OWN)
        }
        stock = {path: row for path, row in TUNABLES.items() if f"{FLIGHT}{path}" in self.machine.parameters}
        self.flight_parameters = {
            name: f"{FLIGHT}{path}" for path, row in stock.items() for name in {path, row.name or path}
        }
        """Path in the closed loop of each stock parameter, by its path in the flight code and its name on the wire."""
        self.rig = dict((lab() if rig is None else rig).snapshot())
        self.conditions = dict(conditions or {})
        self.configure(self.rig | self.conditions)
        self.tune(gains)
        self.machine.set_many({f"flight.{path}": value for path, value in (tuning or {}).items()})
        self.states = frozenset(self.machine.states)
        self._flight_states = {path.removeprefix(FLIGHT) for path in self.states if path.startswith(FLIGHT)}
        self.inputs = (*SETPOINTS, *(SAFETY if failsafe else ()))
        self.failsafe = failsafe
        self._settled = self._settle()

    def configure(self, values: Mapping[str, Any]) -> None:
        """Set parameters of the rig by name, and tell the failsafe where the IMU is.

        Raises ParameterError for an unknown or impossible one.
        """
        known = self.machine.parameters
        self.machine.set_many(
            {path: value for path, value in loop_values(values).items() if path.startswith("rig.") or path in known}
        )

    def tune(self, gains: Gains) -> None:
        """Set the gains of those stock loops that this closed loop has."""
        values = {f"{CASCADE}{path}": value for path, value in gains.parameters().items()}
        self.machine.set_many({path: value for path, value in values.items() if path in self.machine.parameters})

    def tune_controllers(self, values: Mapping[str, Any]) -> None:
        """Set parameters of the user's controllers and of the stock flight code, all or none.

        `values` are by paths such as "attitude_control.k_theta" and "cascade.attitude.limit", or by names on the wire
        such as "RATE_KP". Raises ParameterError for an unknown path or a value out of its bounds.
        """
        known = self.flight_parameters | self.controllers
        for path in values:
            if path not in known:
                raise unknown_parameter(path, known)
        self.machine.set_many({known[path]: value for path, value in values.items()})

    def controller_parameters(self) -> dict[str, tuple[Param, Any]]:
        """Return declaration and present value of each tunable parameter of the user's controllers, by path."""
        return {
            path: (self.machine.parameters[full], self.machine.get(full)) for path, full in self.controllers.items()
        }

    def start(self, at: InitialState) -> None:
        """Reset the loop to the start `at`. Raises ExperimentError for a start beyond a stop."""
        parameters, states = self.start_values(at)
        self.configure(parameters)
        self.machine.reset()
        for path, value in states.items():
            self.machine.set_state(path, value)

    def start_values(self, at: InitialState) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the rig's parameters to set before a reset, by name, and the states to set after it, by path.

        Raises ExperimentError for a start beyond a stop.
        """
        get, known = self.machine.get, self._flight_states
        at.check(float(get("rig.pitch_stop")), float(get("rig.rail_stop")))
        rig = at.rig_states(float(get("rig.delay")), float(get("rig.lag")))
        states = {f"rig.{path}": value for path, value in rig.items()}
        states |= {f"{FLIGHT}{path}": value for path, value in at.flight_states(known).items()}
        return at.rig_parameters(), states | self._settled | dict(at.states)

    def _settle(self) -> dict[str, Any]:
        """Return the covariances to which the estimator settles at rest: a flight starts with a certain pitch."""
        paths = [f"{FLIGHT}{path}" for path in covariances(self._flight_states)]
        self.machine.reset()
        compiled = isinstance(self.program, CompiledProgram)
        self.machine.run(_SETTLE_TICKS if compiled else _SETTLE_TICKS_INTERPRETED)
        return {path: self.machine.state(path) for path in paths}

    def fly(self, steps: int, setpoints: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        """Fly `steps` control steps of 4 ms; return each signal at these steps, (steps,) by name.

        A set-point is one value or an array of `steps` values, by default 0 (or false). `mode` is a name or an index
        into `signals.MODES`. Raises ExperimentError for an unknown set-point or mode.
        """
        inputs: dict[str, Any] = dict.fromkeys(SETPOINTS, 0.0) | {"mode": 0, "in_reset": False, "use_trim": False}
        if self.failsafe:
            inputs |= self._nothing_fails(steps)
        for name, value in setpoints.items():
            if name not in self.inputs:
                raise ExperimentError(f"no set-point named {name!r:.80}", "fly", f"use one of {', '.join(self.inputs)}")
            if name == "mode" and isinstance(value, str):
                if value not in MODES:
                    raise ExperimentError(f"unknown mode {value!r:.80}", "fly", f"use one of {', '.join(MODES)}")
                value = MODES.index(value)
            array = np.asarray(value)
            inputs[name] = np.repeat(array, TICKS) if array.ndim else array[()].item()
        out = self.machine.run(steps * TICKS, inputs)
        return {name: np.asarray(values[::TICKS]) for name, values in out.items()}

    def _nothing_fails(self, steps: int) -> dict[str, Any]:
        """Return the inputs `SAFETY` of a flight on which nothing fails."""
        flying = int(self.machine.state("flight.failsafe.machine.state")) == FLYING
        arm = np.arange(steps) >= (0 if flying else ARMING)
        healthy = dict.fromkeys(("setpoint_new", "link_new", "imu_new"), True)
        late = dict.fromkeys(("step_late", "user_late"), False)
        return {**healthy, **late, "arm": np.repeat(arm, TICKS), "rings": bool(self.machine.get("rig.rings"))}
