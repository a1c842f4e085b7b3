"""Kinds of experiments: the excitation to look for in a log, and the channels to take into a record."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, LogError, listed
from twodof.flightlog.contents import DetectedExcitation, excitations
from twodof.flightlog.events import modes
from twodof.flightlog.log import FlightLog
from twodof.identify.record import Record
from twodof.signals import BY_MAT, RAIL_CENTRE

Array = NDArray[np.float64]

# Beyond this the drone is at its end stop (0.87 rad) and no model of the free motion holds.
_NEAR_STOP_RAD = 0.84
# A free response is over when q has stayed below this share of its peak for this long; what follows in a log is
# somebody's hand. Half a swing lasts .9 s and more, so a passage through zero is not taken for the end.
_OVER_SHARE, _OVER_S = 0.005, 1.0
# Rotors are at rest so long after their last command: eight times their lag.
_AT_REST_S = 0.1
# A locked cart stands still; the range sensor's noise is 4 mm, and an experiment moves it by a decimetre and more.
_MOVED_M = 0.05
# A cart slower than this creeps. Rest of so long is left out, but for a while around the motion.
_CREEP, _REST_LEFT_S, _AROUND_S = 0.05, 2.0, 0.5
# Rest that is kept before the first edge: the simple method reads the trim and the noise from it.
_REST_S = 0.1


@dataclass(frozen=True)
class ExperimentKind:
    """Excitation to look for (modes and shapes of `flightlog.contents`), with inputs and outputs of the record.

    An output `x` is the range sensor's, x = dist - 0.50 m, and not the on-board estimate of that name. An input
    `gyro` is the measured q, which is an output too. Inputs named in `smooth` are measured and move on between their
    samples (`Record.from_channels`).
    """

    name: str
    text: str
    modes: tuple[str, ...]
    shapes: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    smooth: tuple[str, ...] = ()


_CLOSED = ("attitude", "velocity", "position")
_STEPPED = ("doublet", "doublets", "sweep", "steps")

_KINDS = (
    ExperimentKind("impulse", "free response to an impulse of M", ("open-loop",), ("impulse",), ("M",), ("q",)),
    ExperimentKind(
        "doublet",
        "doublet or another test signal of M, open loop",
        ("open-loop",),
        (*_STEPPED, "3-2-1-1"),
        ("M",),
        ("q",),
    ),
    ExperimentKind(
        "velocity",
        "motion along the rail: pitch to velocity",
        _CLOSED,
        _STEPPED,
        ("theta0", "theta", "q", "M", "T"),
        ("v", "x"),
        ("theta", "q"),
    ),
    ExperimentKind(
        "attitude",
        "pitch in closed loop, whatever moves its set-point",
        ("rate", *_CLOSED),
        (*_STEPPED, "impulse", "3-2-1-1"),
        ("M", "theta", "gyro"),
        ("q",),
        ("theta",),
    ),
)
KINDS: Mapping[str, ExperimentKind] = MappingProxyType({kind.name: kind for kind in _KINDS})


def cut(
    log: FlightLog, kind: str | ExperimentKind, window: tuple[float, float] | None = None, name: str | None = None
) -> Record:
    """Cut out the record of an experiment: its longest excitation in the log, or the `window` [s] given.

    `kind` is one of `KINDS` or its name. A doublet ends where the drone nears an end stop, a free response where it is
    over. Raises LogError where the log does not hold the excitation, and IdentificationError for a kind that is not
    there and as `Record.from_channels` does.
    """
    if isinstance(kind, str):
        if kind not in KINDS:
            raise IdentificationError(
                f"no kind of experiment called {kind!r:.80}", "cut", f"there are: {', '.join(KINDS)}"
            )
        kind = KINDS[kind]
    given = window is not None
    if window is None:
        what = f"holds no excitation for the experiment '{kind.name}' ({kind.text})"
        window = _after_start(log, _longest(log, excitations(log), [kind], what, "or name a window")[0])
    start, stop = window
    if "theta" in log and kind.name == "doublet":
        theta = log["theta"].slice(start, stop)
        beyond = np.flatnonzero(np.abs(theta.value) > _NEAR_STOP_RAD)
        stop = float(theta.time[beyond[0]]) if beyond.size else stop
    if kind.name == "impulse" and not given:
        stop = _end_of_motion(log, start, stop)
    channels = {one: _channel(log, one, one in kind.outputs) for one in (*kind.inputs, *kind.outputs)}
    title = log.source if name is None else name
    return Record.from_channels(
        channels, kind.inputs, kind.outputs, start=start, stop=stop, smooth=kind.smooth, name=title
    )


def kind_of(log: FlightLog) -> ExperimentKind:
    """Return the experiment that a log holds: the kind of its longest excitation.

    Steps and doublets of the pitch count as the velocity's experiment if the drone moved along the rail, and else as
    the pitch's in closed loop. Raises LogError for a log without an excitation of any of the `KINDS`.
    """
    moved = "dist" in log and float(np.ptp(log["dist"].value)) > _MOVED_M
    kinds = [kind for kind in KINDS.values() if moved or kind.name != "velocity"]
    found = excitations(log) if all(name in log for name in ("T", "q0", "theta0")) else []
    what = "holds none of the experiments from which something is identified"
    if not any(name in log for name in BY_MAT):
        remedy = "name what was applied and measured, and a model: --input NAME --output NAME --model arx:2,2,1"
        raise LogError(f"this is no flight of the 2DoF Drone: its columns are {listed(log)}", log.source, remedy)
    return _longest(log, found, kinds, what, f"name the experiment ({', '.join(KINDS)}) and a window")[1]


def around(log: FlightLog, record: Record, before: float = 1.0, after: float = 2.0) -> Record:
    """Return the channels of a `record` cut from `log`, over a stretch longer by `before` and `after` [s].

    It is for pictures: one sees what led to the excitation and what became of the flight.
    """
    names = (*record.inputs, *record.outputs)
    channels = {one: _channel(log, one, one in record.outputs) for one in names}
    first = max(float(channels[one][0][0]) for one in record.inputs) + record.dt
    start = min(max(first, record.start - before), record.start)
    stop = float(record.time[-1]) + after
    return Record.from_channels(
        channels, tuple(record.inputs), tuple(record.outputs), start=start, stop=stop, name=record.name
    )


def in_motion(record: Record) -> tuple[Record, ...]:
    """Return the stretches in which the cart moves, by the measured `v`; the record itself where it never rests.

    At rest and in a creep dry friction is as large as the drive, and no model tells which of the two wins: a flight of
    position steps, which creeps for 7 of 10 s, gave p_v .15 +- .05 as a whole, and .6 in motion, as other flights do.
    """
    time = record.output_time("v")
    moving = time[np.abs(record.outputs["v"].value) > _CREEP]
    rests = np.flatnonzero(np.diff(moving) > _REST_LEFT_S) + 1
    if not rests.size:
        return (record,)
    bounds = [(one[0] - _AROUND_S, one[-1] + _AROUND_S) for one in np.split(moving, rests)]
    end = float(record.time[-1])
    parts = [
        record.part(max(record.start, a), min(end, b), f"{record.name}, motion {k + 1}")
        for k, (a, b) in enumerate(bounds)
    ]
    return tuple(replace(part, flight=record.name) for part in parts)


def free_swing(record: Record) -> tuple[Record, dict[str, float]]:
    """Return the part of an impulse's record with the rotors at rest, and its first pitch and pitch rate.

    While the rotors turn, their lag and what they do to the bearing would pass for friction and stiffness. The pitch at
    the start is that which the swing takes back.
    """
    moment = record.inputs["M"]
    moved = np.flatnonzero(moment != moment[-1])
    start = record.start if not moved.size else float(record.time[moved[-1]]) + _AT_REST_S
    part = record.part(start, float(record.time[-1]))
    q = part.outputs["q"]
    theta = -float(np.trapezoid(q.value, record.dt * q.position))
    return part, {"theta_0": theta, "q_0": float(q.value[0])}


def only(record: Record, *outputs: str) -> Record:
    """Return the record with these of its outputs alone: a fit uses every output that it finds."""
    return replace(record, outputs={name: record.outputs[name] for name in outputs})


def _channel(log: FlightLog, name: str, measured: bool) -> tuple[Array, Array]:
    if name == "x" and measured:
        return log["dist"].time, log["dist"].value - RAIL_CENTRE
    if name == "gyro":
        name = "q"
    return log[name].time, log[name].value


def _end_of_motion(log: FlightLog, start: float, stop: float) -> float:
    q = log["q"].slice(start, stop)
    loud = q.time[np.abs(q.value) > _OVER_SHARE * np.abs(q.value).max()]
    quiet = np.flatnonzero(np.diff(loud, append=np.inf) > _OVER_S)
    # Before the impulse it is quiet too, but nothing has been loud yet.
    return min(stop, float(loud[quiet[0]]) + _OVER_S)


def _longest(
    log: FlightLog, found: Sequence[DetectedExcitation], kinds: Sequence[ExperimentKind], what: str, remedy: str
) -> tuple[DetectedExcitation, ExperimentKind]:
    """Return the longest excitation of those `found` that fits a kind, and the kind; else raise LogError `what`."""
    fitting = [(one, kind) for one in found for kind in kinds if one.mode in kind.modes and one.shape in kind.shapes]
    if not fitting:
        names = ", ".join(dict.fromkeys(one.name for one in found)) or "none"
        raise LogError(what, log.source, f"excitations found: {names}; {remedy}")
    return max(fitting, key=lambda pair: pair[0].edges[-1] - pair[0].edges[0])


def _after_start(log: FlightLog, one: DetectedExcitation) -> tuple[float, float]:
    """Return the excitation's window, without the time before its mode and the rotors' start."""
    start, stop = one.window
    for stretch in modes(log):
        if stretch.mode == one.mode and start < stretch.t0 < one.edges[0]:
            start = stretch.t0
    for armed, _ in log.armed() if "T" in log else []:
        if start <= armed < one.edges[0]:
            # Half of what lies between: the thrust has settled, and there is rest to read the trim from.
            start = min(0.5 * (armed + one.edges[0]), one.edges[0] - _REST_S)
    return start, stop
