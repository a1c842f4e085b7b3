"""Replay: the compiled flight code gets a log's inputs, and its outputs are compared with the log's.

This checks that the compiled code is what flew. The compiled cascade is run in several modes, so that each loop gets
its own logged set-point and measurement. An integral that the log does not tell is computed from the first samples.
Gains that were changed in flight are changed in the replay. A user's controllers run from one reset of the flight code
to the next.
"""

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.compile import build
from twodof.errors import ParameterError
from twodof.flight.cascade import ArmingReset, cascade
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.templates import ATTITUDE as ATTITUDE_CONTROL
from twodof.flight.templates import MOTOR, POSITION
from twodof.flightlog.log import FlightLog
from twodof.signals import ATTITUDE, PERIOD, RATE, VELOCITY
from twodof.sim.flight_segment import FlownParameters
from twodof.sim.time_alignment import AlignedLog, Flags, Floats, align_log, runs

CHANNELS = ("M", "q0", "theta0", "T")

_SETTLE = 5  # samples left out where a loop starts: on board the reset ends two to four samples beyond the edge
_FORGET = 45  # samples after which the derivative has forgotten a lost error: .714^45 = 3e-7
# Samples that seed a loop: one alone would leave the rounding of a logged float32 in its integral for the whole flight.
# With two unknowns, integral and derivative, twelve tell the integral as well as six tell it alone.
_SEED = 12
UNSURE_S = 0.1
"""Largest time [s] between a change in a recording and the same change on the drone, as a message takes time."""
_LONE_RESET = 5  # length of a reset that does not end the stretch
_FLOAT32 = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Replay:
    """Result of a replay. Only channels whose loop was active are in `nrms` and `coverage`.

    `nrms[channel]` is the RMS of (replayed - logged) over the RMS of the logged signal, `coverage[channel]` the share
    of the active samples that was compared; `windows` are the stretches [s] in which any channel was compared.
    `replayed[channel]` (n,) are the outputs at the stamps `time` (n,) [s], `compared[channel]` (n,) the compared ones.
    """

    nrms: Mapping[str, float]
    coverage: Mapping[str, float]
    windows: tuple[tuple[float, float], ...]
    precision: str
    time: Floats
    replayed: Mapping[str, Floats]
    compared: Mapping[str, Flags]

    def to_json(self) -> dict[str, Any]:
        """Return `{"nrms": {channel: number}, "coverage": {channel: number}, "windows_s": [[t0, t1], ...]}`."""
        return {
            "nrms": dict(self.nrms),
            "coverage": dict(self.coverage),
            "windows_s": [list(window) for window in self.windows],
        }


def replay(log: FlightLog, gains: Gains | None = None, precision: str = "float64") -> Replay:
    """Run the cascade, compiled in `precision`, on the logged inputs, and compare M, q0, theta0, T with the log.

    By default the gains are those of the log with each change in flight, else the defaults, and user's controllers
    whose diagrams are in the log run in place of the stock loops, in the sandbox. With `gains` the stock cascade runs
    with these gains throughout.

    Without a compiler the reference interpreter runs the stock loops, with a warning. Raises LogError if the log lacks
    a channel, DiagramError for an unknown precision, and CompileError if the sandbox for user's controllers is missing.

    Not compared are five samples after a loop starts, samples whose input is missing from the log, and the twelve after
    each of these. From the twelve the loop's integral is computed, and for M the derivative's state. The log does not
    hold the reset of the integrals: it is found where M equals the law's value with the integral in reset. Samples are
    not compared where a missing one could hide a reset, or within `UNSURE_S` of a change, whose exact step is unknown.
    """
    flown = FlownParameters.of(log.provenance) if gains is None else FlownParameters(gains)
    paired = align_log(log)
    unsure = np.zeros(len(paired.time), dtype=np.bool_)
    for at, _, _ in flown.changes:
        unsure |= np.abs(paired.time - at) <= UNSURE_S
    if flown.controllers and not flown.unknown:
        return _result(paired, precision, *replay_user(log, paired, flown, precision, unsure))
    start = flown.gains or DEFAULT
    program = build(cascade(start), dt=PERIOD, precision=precision, log=tuple(_TERMS))
    changes = flown.gains_in_flight(start)
    stage = _Stages(program, paired, {int(np.searchsorted(paired.time, at, "right")): g for at, g in changes})
    replayed: dict[str, Floats] = {}
    compared: dict[str, Flags] = {}
    in_reset, doubt = stage.find_reset()
    lost, doubt = paired.lost, doubt | unsure
    if paired.active["M"].any():
        seeds, compared["M"] = _plan(paired.active["M"], lost["M"] | lost["q"] | lost["q0"] | doubt, in_reset)
        replayed["M"] = stage.run(RATE, in_reset | ~paired.active["M"], seeds, stage.seed_rate)["M"]
    if paired.active["q0"].any():
        replayed["q0"] = stage.run(ATTITUDE, in_reset)["q0"]
        compared["q0"] = paired.active["q0"] & ~(lost["q0"] | lost["theta0"] | lost["theta"] | unsure)
    if paired.active["theta0"].any():
        missing = lost["M"] | lost["theta0"] | lost["v0"] | lost["v"] | doubt
        seeds, known = _plan(paired.active["theta0"], missing, in_reset)
        out = stage.run(VELOCITY, in_reset | ~paired.active["theta0"], seeds, stage.seed_velocity)
        replayed |= {"theta0": out["theta0"], "T": out["T"]}
        compared |= {"theta0": known, "T": known & ~lost["T"]}
    return _result(paired, precision, replayed, compared)


def _result(paired: AlignedLog, precision: str, replayed: dict[str, Floats], compared: dict[str, Flags]) -> Replay:
    nrms, coverage = {}, {}
    for name in CHANNELS:
        if name in compared:
            used = compared[name]
            coverage[name] = float(used.sum() / paired.active[name].sum())
            if used.any():
                logged = paired.value[name][used]
                nrms[name] = float(np.sqrt(np.mean((replayed[name][used] - logged) ** 2) / np.mean(logged**2)))
    anything = np.any([*compared.values(), np.zeros(len(paired.time), dtype=np.bool_)], axis=0)
    windows = tuple((float(paired.time[a]), float(paired.time[b - 1])) for a, b in runs(anything))
    return Replay(nrms, coverage, windows, precision, paired.time, replayed, compared)


_TERMS = ("rate.proportional", "rate.derivative", "rate.increment", "velocity.force")


def _plan(active: Flags, lost: Flags, in_reset: Flags) -> tuple[list[int], Flags]:
    """Return the first samples of each seed of a loop, and flags (n,) of what may be compared."""
    seeds: list[int] = []
    compared = np.zeros(len(active), dtype=np.bool_)
    onsets = np.flatnonzero(np.diff(in_reset.astype(np.int8)) == 1) + 1
    for first, end in runs(active):
        start = first + _SETTLE
        for loss in [*(np.flatnonzero(lost[first:end]) + first).tolist(), end]:
            # What an integral lacks before a reset says nothing of it afterwards.
            start = max([start, *(int(k) for k in onsets if start < k < start + _SEED)])
            if loss - start > _SEED:
                seeds.append(start)
                compared[start + _SEED : loss] = True
            start = max(start, loss + 1)
    return seeds, compared


class _Stages:
    """The compiled cascade, run over the log in one mode after the other."""

    def __init__(self, program: Any, paired: AlignedLog, gains: Mapping[int, Gains]) -> None:
        self.program = program
        self.gains = gains
        self.paired = paired
        self.n = len(paired.time)
        value = paired.value
        self.inputs = {name: value[name] for name in ("q0", "theta0", "v0", "q", "theta", "v")}

    def find_reset(self) -> tuple[Flags, Flags]:
        """Where the integrals were held in reset while the drone was armed, (n,), and where that cannot be known.

        There M is P + D + Ki Ts e, to the rounding of a logged float32: at the end of a stretch, or for five samples.
        """
        out = self.run(RATE)
        terms = [np.asarray(out[name], dtype=np.float64) for name in _TERMS[:3]]
        size = np.abs(self.paired.value["M"]) + sum(np.abs(term) for term in terms)
        fits = np.abs(self.paired.value["M"] - sum(terms)) <= 4.0 * _FLOAT32 * size
        found = np.zeros(self.n, dtype=np.bool_)
        for first, end in runs(self.paired.active["M"]):
            for a, b in runs(fits[first:end]):
                if b - a >= _LONE_RESET or (b == end - first and b - a >= 2):
                    found[first + a : first + b] = True
        return self._with_doubt(found, fits)

    def _with_doubt(self, found: Flags, fits: Flags) -> tuple[Flags, Flags]:
        """Return the resets, and where they are unknown: beside one, or after a missing sample that ends a stretch.

        Until the derivative has forgotten a missing error, M does not tell the reset. It lasted if it is there before
        and afterwards.
        """
        lost = self.paired.lost["M"] | self.paired.lost["q"] | self.paired.lost["q0"]
        unknown = np.convolve(lost, np.ones(_FORGET + 1))[: self.n] > 0.5
        in_reset, doubt = found.copy(), np.zeros(self.n, dtype=np.bool_)
        for first, end in runs(self.paired.active["M"]):
            for a, b in runs(unknown[first:end] & ~found[first:end]):
                before = a > 0 and bool(found[first + a - 1])
                after = b < end - first and bool(found[first + b])
                if before and after:
                    in_reset[first + a : first + b] = True
                elif before or after or b == end - first:
                    while a > 0 and fits[first + a - 1] and not found[first + a - 1]:
                        a -= 1  # too short to be called a reset, but it may have begun here
                    doubt[first + a : first + b] = True
        return in_reset, doubt

    def run(
        self,
        mode: int,
        in_reset: Flags | None = None,
        seeds: Sequence[int] = (),
        seed: Callable[[Any, Mapping[str, Any], int, int], None] | None = None,
    ) -> dict[str, Floats]:
        """Return the cascade's outputs (n,) in `mode`; `seed` sets the machine right after each of the `seeds`."""
        machine = self.program.machine()
        inputs = self.inputs | ({} if in_reset is None else {"in_reset": in_reset})
        changes = [at for at in self.gains if at < self.n]
        cuts = sorted({0, self.n, *changes, *seeds, *(s + _SEED for s in seeds)})
        pieces = []
        for a, b in itertools.pairwise(cuts):
            if a in self.gains:
                machine.set_many(self.gains[a].parameters())
            out = machine.run(b - a, {name: column[a:b] for name, column in inputs.items()} | {"mode": mode})
            pieces.append(out)
            if seed and a in seeds:
                seed(machine, out, a, b)
        return {name: np.concatenate([np.asarray(p[name], dtype=np.float64) for p in pieces]) for name in pieces[0]}

    def seed_rate(self, machine: Any, out: Mapping[str, Any], a: int, b: int) -> None:
        """Give integral and derivative the part that M lacks from a to b: a constant, and one that decays."""
        missing = self.paired.value["M"][a:b] - np.asarray(out["M"], dtype=np.float64)
        lag = 1.0 / machine.get("rate.N")
        decay = (lag / (lag + PERIOD)) ** np.arange(b - a)
        (lasting, decaying), *_ = np.linalg.lstsq(np.column_stack([np.ones(b - a), decay]), missing)
        _add_to_integral(machine, "rate", float(lasting))
        kd = machine.get("rate.kd")
        if kd > 0.0:
            machine.set_state("rate.slope", machine.state("rate.slope") + float(decaying * decay[-1] / kd))

    def seed_velocity(self, machine: Any, out: Mapping[str, Any], a: int, b: int) -> None:
        """Give the integral the part that the force lacks from a to b; the logged force is the inverse projection."""
        full = machine.get("projection.T_bar") * machine.get("projection.eta_T")
        logged = -np.tan(self.paired.value["theta0"][a:b]) * full
        missing = logged - np.asarray(out["velocity.force"], dtype=np.float64)
        _add_to_integral(machine, "velocity", float(np.mean(missing)))


def _add_to_integral(machine: Any, loop: str, offset: float) -> None:
    """Shifts the compensated sum of `loop`: its value is sum - carry."""
    value = float(machine.state(f"{loop}.sum")) - float(machine.state(f"{loop}.carry")) + offset
    machine.set_state(f"{loop}.sum", value)
    machine.set_state(f"{loop}.carry", float(machine.state(f"{loop}.sum")) - value)


_ELEMENT = re.compile(r"(.+)\[(\d{1,6})\]")


def replay_user(
    log: FlightLog, paired: AlignedLog, flown: FlownParameters, precision: str, unsure: Flags
) -> tuple[dict[str, Floats], dict[str, Flags]]:
    """Run the cascade with the user's controllers over the whole log, at its modes and set-points.

    Returns the outputs (n,) by channel at the steps of the log, and flags (n,) of those that may be compared. A user's
    controller has known states when it is reset: without thrust, and just after. So it is compared from there up to
    the first missing sample, except at the steps flagged in `unsure` (n,). M is not compared if a user's motor
    controller flew. Without the channel `mode` nothing is compared.

    The diagrams in a log are not trusted, so they run in the sandbox, as on board. Raises LogError if the log lacks
    another channel, CompileError if the sandbox is missing, and ControllerFault if a step uses up its fuel.
    """
    if "mode" not in log.channels:
        return {}, {}
    inputs, lost = _inputs(log, paired)
    machine = build(_diagram(flown), dt=PERIOD, precision=precision, target="wasm").machine()
    machine.set_state("arming.count", machine.get("arming.samples"))  # a log may begin in flight, without a reset
    _tune(machine, flown.tuning)
    n = len(paired.time)
    places = [int(place) for place in np.searchsorted(paired.time, [row[0] for row in flown.changes], "right")]
    pieces, gains = [], flown.gains or DEFAULT
    for a, b in itertools.pairwise(sorted({0, n, *(place for place in places if place < n)})):
        changes = [row for place, row in zip(places, flown.changes, strict=True) if place == a]
        for _, name, value in changes:
            gains = gains.changed(name, value)
            _tune(machine, {**gains.parameters(), name: value})
        pieces.append(machine.run(b - a, {name: column[a:b] for name, column in inputs.items()}))
    out = {name: np.concatenate([np.asarray(piece[name]) for piece in pieces]) for name in pieces[0]}
    known = _known(out["reset"].astype(np.bool_), lost) & ~unsure
    names = ["q0", "theta0", "T"] if MOTOR.name in flown.controllers else ["M", "q0", "theta0", "T"]
    active = {name: paired.active[name] for name in names if paired.active[name].any()}
    replayed = {name: np.asarray(out[name], dtype=np.float64) for name in active}
    return replayed, {name: flags & known for name, flags in active.items()}


def _diagram(flown: FlownParameters) -> Diagram:
    """Return the cascade with the user's controllers, and the reset that comes before it on board."""
    item = cascade(
        flown.gains or DEFAULT, flown.controllers.get(ATTITUDE_CONTROL.name), flown.controllers.get(POSITION.name)
    )
    d = Diagram("flown")
    for port in item.inputs.values():
        d.input(port.name, port.kind, unit=port.unit)
    d.add("arming", ArmingReset(), mode="mode", thrust="thrust", in_reset="in_reset")
    d.add("cascade", item, inputs={name: name for name in item.inputs} | {"in_reset": "arming"})
    for name in ("M", "q0", "theta0", "T"):
        d.output(name, f"cascade.{name}")
    d.output("reset", "arming")
    return d


def _inputs(log: FlightLog, paired: AlignedLog) -> tuple[dict[str, Any], Flags]:
    """Return the cascade's inputs at each step, (n,), and where one of them is missing."""
    n = len(paired.time)
    at = {"mode": log["mode"].index(paired.time, "next"), "x0": log["x0"].index(paired.time, "next")}
    at["x"] = log["x"].index(paired.time, "hold")
    lost = np.any([*paired.lost.values(), *(places < 0 for places in at.values())], axis=0)
    read = {name: log[name].value[np.maximum(places, 0)] for name, places in at.items()}
    mode = read.pop("mode").astype(np.int32)
    # In the modes without a velocity loop the thrust is given; in open loop nothing else is.
    given = {"thrust": paired.value["T"], "M_open": paired.value["M"], "mode": mode, "in_reset": np.zeros(n, np.bool_)}
    return given | read | {name: paired.value[name] for name in ("q0", "theta0", "v0", "q", "theta", "v")}, lost


def _tune(machine: Any, values: Mapping[str, Any]) -> None:
    """Set parameters of the cascade by path, an array's element by its index.

    Anybody may have written them: unknown paths, and values that the parameter refuses, are left out.
    """
    for path, value in values.items():
        element = _ELEMENT.fullmatch(path)
        full = f"cascade.{element[1] if element else path}"
        if full not in machine.parameters:
            continue
        given = value
        if element:
            before, place = machine.get(full), int(element[2])
            if not isinstance(before, list) or place >= len(before):
                continue
            given = [*before[:place], value, *before[place + 1 :]]
        with suppress(ParameterError, OverflowError):  # a whole number may be larger than any float
            machine.set(full, given)


def _known(reset: Flags, lost: Flags) -> Flags:
    """Where the controllers' states are known, (n,): since the last reset nothing was lost."""
    step = np.arange(len(reset))
    since_reset = np.maximum.accumulate(np.where(reset, step, -1))
    since_loss = np.maximum.accumulate(np.where(lost, step, -1))
    return (since_reset >= 0) & (since_loss < since_reset)
