"""Flash a controller: check, try and compile it, print its cost and changes, and let it fly from now on."""

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.blocks.difference import Difference, difference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import CompiledProgram, build
from twodof.compile.cortex_m7.report import measure
from twodof.compile.program.check import check as check_diagram
from twodof.compile.px4 import export
from twodof.compile.px4.tree import ERROR
from twodof.compile.px4.tree import check as check_module
from twodof.design import LoopMargins
from twodof.errors import CompileError, DiagramError, ExperimentError, LinkError, Rejected, shown
from twodof.flight.controller_store import STOCK, simulator_controllers
from twodof.flight.gains import DEFAULT
from twodof.flight.starters import load_diagram, starter
from twodof.flight.templates import ATTITUDE, MOTOR, POSITION, check_template
from twodof.gcs.async_drone import DEFAULT_URL
from twodof.gcs.drone import Drone
from twodof.rig.parameters import lab
from twodof.signals import HOVER, PERIOD
from twodof.sim.closed_loop import ClosedLoop, InitialState
from twodof.sim.linear import LOOPS, cascade_margins

Array = NDArray[np.float64]

_TRIAL_STEPS, _AT = 750, 50
"""Control steps of the flight (3 s), and of the step of the set-point (.2 s)."""

_PITCH, _PLACE = math.radians(3.0), 0.05
"""Steps of theta [rad] and x [m], small enough for a sound controller to stay far from its limits."""

_QUIET, _LASTS, _GROWS = 0.3, 0.7, 1.3
"""Swing of the pitch rate [rad/s] that is tolerated, and its ratio from third to third of the flight above which it
counts as persistent, and as growing."""

_SOON = 1.0
"""A linear motion that grows by the factor e within this time [s] is a fault even if the flight does not show it: its
mode may not have been flown. Slower growth is the drone's own, without control."""


@dataclass(frozen=True)
class _Plan:
    mode: str
    setpoint: str
    size: float
    rings: bool
    loops: tuple[str, ...]


_PLANS: Mapping[str, _Plan] = MappingProxyType(
    {
        ATTITUDE.name: _Plan("attitude", "theta0", _PITCH, True, ("motors", "rate", "attitude")),
        POSITION.name: _Plan("position", "x0", _PLACE, False, ("velocity", "position")),
        MOTOR.name: _Plan("position", "x0", _PLACE, False, tuple(LOOPS)),
    }
)


@dataclass(frozen=True)
class TrialFlight:
    """Result of a trial flight on the virtual rig `lab`. `fault` says why the controller must not fly, "" if it may.

    `margins` are those of the loops that the controller closes, by loop. If they cannot be computed they are empty, and
    `unknown` says why.
    """

    margins: Mapping[str, LoopMargins]
    unknown: str
    fault: str

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain data."""
        return {
            "margins": {name: m.to_json() for name, m in self.margins.items()},
            "margins_unknown": self.unknown or None,
            "fault": self.fault or None,
        }


def trial_flight(diagram: Diagram, template: str, target: str = "native") -> TrialFlight:
    """Fly `diagram` of the template `template` for 3 s without noise, with a step of 3 deg or of 5 cm.

    An attitude controller flies with the cart locked, any other with the cart free. The stock controllers close the
    other loops. A fault is a swing that does not die out, an end stop that is reached, or a loop with a fast growing
    linear mode. `target` is the compile target, as in `ClosedLoop`. Raises DiagramError for a diagram that does not
    compile.
    """
    plan = _PLANS[template]
    margins: dict[str, LoopMargins] = {}
    unknown = ""
    try:
        margins = cascade_margins(DEFAULT, [diagram], "lab", plan.loops)
    except DiagramError as reason:
        unknown = str(reason)
    rig = lab()
    loop = ClosedLoop(DEFAULT, rig, {"noise": 0.0, "rings": plan.rings}, controllers=[diagram], target=target)
    loop.start(InitialState(hover=True))
    stepped = np.where(np.arange(_TRIAL_STEPS) < _AT, 0.0, plan.size)
    out = loop.fly(_TRIAL_STEPS, {"mode": plan.mode, "thrust": HOVER, plan.setpoint: stepped})
    stops = float(rig["pitch_stop"]), float(rig["rail_stop"])
    return TrialFlight(margins, unknown, _fault(out, stops, margins))


def _fault(out: Mapping[str, Array], stops: tuple[float, float], margins: Mapping[str, LoopMargins]) -> str:
    swing = _fastest(margins)
    if swing is not None:
        return swing
    rate = np.asarray(out["true_q"], dtype=np.float64)
    for name, values, stop in (("pitch", out["true_theta"], stops[0]), ("cart", out["true_x"], stops[1])):
        beyond = np.flatnonzero(~(np.abs(values) < 0.98 * stop))
        if beyond.size:
            return f"the {name} is at its stop {PERIOD * max(0, int(beyond[0]) - _AT):.1f} s after the step"
    third = _TRIAL_STEPS // 3
    middle, late = (float(np.ptp(part)) for part in (rate[third : 2 * third], rate[2 * third :]))
    if late > _QUIET and late > _LASTS * middle:
        how = "growing" if late > _GROWS * middle else "and does not stop"
        return f"swings at {_frequency(rate[2 * third :]):.2g} rad/s, {how}"
    return ""


def _fastest(margins: Mapping[str, LoopMargins]) -> str | None:
    """Describe the motion of the fastest growing unstable loop; None if it grows slowly."""
    motions = [m.motion for m in margins.values() if not m.stable and m.motion is not None]
    worst = max(motions, key=lambda motion: motion.growth, default=None)
    return None if worst is None or worst.growth * _SOON < 1.0 else worst.text


def _frequency(values: Array) -> float:
    """Return the frequency of a swing [rad/s], from its crossings of the mean."""
    level = values - values.mean()
    passes = np.flatnonzero(np.sign(level[1:]) != np.sign(level[:-1]))
    if passes.size < 2:
        return math.pi / (PERIOD * len(values))
    return math.pi * (passes.size - 1) / (PERIOD * float(passes[-1] - passes[0]))


SYSTEM = 252
"""MAVLink system of `flash`. It differs from a script's, so that a script's lease refuses a flash."""

FLYING = "/etc/extras"
"""Folder on a drone, readable over FTP, with its active diagrams: `<template>.json`."""

SIM, FCU, PX4 = "sim", "fcu", "px4-dir"

FORCE = "--force-unstable"
"""Option of the command line that flashes an unstable controller."""

_STEPS = 250  # one second of flight on the emulated processor, to count instructions


@dataclass(frozen=True)
class ControllerCosts:
    """Costs of a controller: sizes of its structs [byte], equal on every target, and the figures of the Cortex-M7.

    `m7` is None without a cross compiler; `m7_missing` gives the reason.
    """

    parameters: int
    states: int
    inputs: int
    outputs: int
    m7: dict[str, Any] | None
    m7_missing: str

    def to_json(self) -> dict[str, Any]:
        """Return the figures as a JSON object."""
        return {
            "parameter_bytes": self.parameters,
            "state_bytes": self.states,
            "input_bytes": self.inputs,
            "output_bytes": self.outputs,
            "cortex_m7": self.m7,
            "cortex_m7_missing": self.m7_missing or None,
        }


@dataclass(frozen=True)
class FlashReport:
    """Result of a flash: `changes` to the diagram that `origin` names, remarks, warnings, and the `place` in words.

    `trial` has the margins and the trial flight on the virtual rig.
    """

    diagram: Diagram
    template: str
    costs: ControllerCosts
    origin: str
    changes: Difference
    remarks: tuple[str, ...]
    warnings: tuple[str, ...]
    place: str
    trial: TrialFlight


def controller_costs(diagram: Diagram, precision: str = "float32", target: str = "native") -> ControllerCosts:
    """Compile `diagram` for 250 Hz, for `target` and, with its tool chain, for the Cortex-M7; return the costs.

    Raises DiagramError and CompileError as `build` does, CompileError also without a C compiler.
    """
    program = build(diagram, PERIOD, precision, target=target)
    if not isinstance(program, CompiledProgram):
        raise CompileError("no C compiler was found", diagram.name, "install gcc, or the wheel ziglang")
    p, s, u, y = (program.dtypes[struct].itemsize for struct in "PSUY")
    try:
        on_m7 = build(diagram, PERIOD, precision, target="cortex-m7")
    except CompileError as reason:
        return ControllerCosts(p, s, u, y, None, str(reason))
    # Only the native target falls back to the interpreter.
    m7 = measure(on_m7, _STEPS).to_json() if isinstance(on_m7, CompiledProgram) else None
    return ControllerCosts(p, s, u, y, m7, "")


def flash(
    diagram: Diagram,
    to: str,
    out: Path | None = None,
    px4: Path | None = None,
    precision: str = "float32",
    key: Path | None = None,
    dry_run: bool = False,
    force: bool = False,
    say: Callable[[str, float], None] | None = None,
) -> FlashReport:
    """Put `diagram` on `to`: "sim", "px4-dir" (a module in the folder `out`), "fcu" or a drone's URL.

    A drone must be disarmed; it builds the controller for its sandbox and keeps it over restarts. A module is compared
    with the PX4 source in the folder `px4` first, if given. `dry_run` does everything but the flashing itself. `force`
    also flashes a diagram that is unstable on the virtual rig. `say` is called with the name of each step and the share
    of the work done (0 to 1).

    Raises LinkError for another `to`, and DiagramError for a diagram that fits no template. Raises ExperimentError for
    a diagram that is unstable on the virtual rig (`trial_flight`). Raises CompileError if it does not compile, and the
    errors of `open_target`.
    """
    check_target(to)
    kind, costs, trial, remarks = _examined(diagram, precision, "native", say or (lambda what, share: None))
    if trial.fault and not (force or dry_run):
        remedy = f"nothing was flashed; mend it with `twodof diagram margins`, or use {FORCE} (in Python force=True)"
        raise ExperimentError(f"unstable on the virtual rig: {trial.fault}", diagram.name, remedy)
    warnings = () if px4 is None else _checked(diagram, px4)
    with open_target(to, kind, out, key) as there:
        if not dry_run:
            there.put(diagram)
    changes = difference(there.before, diagram)
    return FlashReport(diagram, kind, costs, there.origin, changes, remarks, warnings, there.place, trial)


def _examined(
    diagram: Diagram, precision: str, target: str, say: Callable[[str, float], None]
) -> tuple[str, ControllerCosts, TrialFlight, tuple[str, ...]]:
    """Return template, costs, trial flight and remarks."""
    kind = check_template(diagram).name
    say("compiling", 0.0)
    costs = controller_costs(diagram, precision, target)
    say("flying on the virtual rig", 0.4)
    trial = trial_flight(diagram, kind, target)
    say("flashing" if target == "native" else "comparing", 0.9)
    remarks = tuple(f"{r.where}: {r.what} ({r.remedy})" for r in check_diagram(diagram, PERIOD).remarks)
    return kind, costs, trial, remarks


def _checked(diagram: Diagram, px4: Path) -> tuple[str, ...]:
    """Return the warnings of `twodof px4 check` for a temporary module. Raises CompileError if it does not fit."""
    with tempfile.TemporaryDirectory(prefix="twodof-") as name:
        folder = Path(name) / "module"
        export(diagram, folder)
        found = check_module(px4, folder)
    if not found.fits:
        errors = "; ".join(f"{row.where}: {row.what} ({row.remedy})" for row in found.rows if row.level == ERROR)
        what = f"the module {found.module} does not fit this PX4: {errors}"
        raise CompileError(what, str(px4), "mend these places and flash again; nothing was written")
    return tuple(f"{row.where}: {row.what} ({row.remedy})" for row in found.rows)


class Rehearsal(NamedTuple):
    """Result of a dry run of `flash`. The fields are those of `FlashReport`."""

    template: str
    costs: ControllerCosts
    trial: TrialFlight
    remarks: tuple[str, ...]
    changes: Difference

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain data."""
        return {
            "template": self.template,
            "costs": self.costs.to_json(),
            "trial": self.trial.to_json(),
            "remarks": list(self.remarks),
            "changes": self.changes.to_json(),
        }


def rehearse(
    diagram: Diagram, before: Diagram | None, say: Callable[[str, float], None], target: str = "wasm"
) -> Rehearsal:
    """Do every step of `flash` but the last, for an untrusted diagram, which runs in the sandbox alone.

    `before` is the active diagram, None the stock controller. Raises what `flash` raises, except for an unstable
    diagram: `trial` reports that.
    """
    kind, costs, trial, remarks = _examined(diagram, "float32", target, say)
    return Rehearsal(kind, costs, trial, remarks, difference(before or starter(STOCK[kind]), diagram))


class FlashTarget(NamedTuple):
    """Place for one controller of a template.

    `before` is the diagram there now, or the stock controller; `origin` says which. `place` names the place in words.
    `put` stores a new diagram there; if it fails, the old one stays.
    """

    before: Diagram
    origin: str
    place: str
    put: Callable[[Diagram], object]


def check_target(to: str) -> None:
    """Raise LinkError unless `to` names a place to flash or looks like a URL."""
    if to not in (SIM, FCU, PX4) and "/" not in to and ":" not in to:
        raise LinkError(
            f"{shown(to)} is not {SIM}, {PX4}, {FCU} or a URL", "--to", f"a drone's URL is such as {DEFAULT_URL}"
        )


@contextmanager
def open_target(to: str, kind: str, out: Path | None, key: Path | None) -> Iterator[FlashTarget]:
    """Open the place `to` for a controller of the template `kind`.

    `to` is `SIM`, `PX4` with the folder `out`, `FCU` or a drone's URL, reached with `key`. Raises LinkError for a
    malformed URL, LinkLost if no drone answers, Rejected if another client has its lease. `put` raises DiagramError,
    CompileError, LogError, and Rejected with the drone's reason.
    """
    if to == SIM:
        slot = simulator_controllers()
        yield FlashTarget(*slot.in_use(kind), str(slot.file(kind)), slot.flash)
    elif out is not None:
        yield FlashTarget(*_exported(out / "diagram.json", kind), str(out), lambda diagram: export(diagram, out))
    else:
        with Drone.connect(DEFAULT_URL if to == FCU else to, system=SYSTEM, key=key) as drone:
            place = f"drone {drone.there.session.system} at {drone.url}, /controllers/{kind}.json"
            yield FlashTarget(
                *_flying(drone, kind), place, lambda diagram: drone.fly_controller(kind, to_json(diagram))
            )


def _exported(file: Path, kind: str) -> tuple[Diagram, str]:
    if not file.exists():
        return _stock(kind)
    try:
        return load_diagram(file), str(file)
    except DiagramError as damage:
        return _stock(kind, f", as the diagram there is damaged: {damage}")


def _flying(drone: Drone, kind: str) -> tuple[Diagram, str]:
    try:
        diagram = from_json(drone.files.read(f"{FLYING}/{kind}.json"))
    except Rejected:  # no such file: the stock controller is active
        return _stock(kind)
    except DiagramError as damage:
        return _stock(kind, f", as the active diagram cannot be read: {damage}")
    return diagram, f"{diagram.name}, which flies on drone {drone.there.session.system}"


def _stock(kind: str, why: str = "") -> tuple[Diagram, str]:
    return starter(STOCK[kind]), f"the stock controller ({STOCK[kind]}){why}"
