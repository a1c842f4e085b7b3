"""Player of an excitation on board: the exact numbers of its definition, one a tick, added to a set-point."""

import json
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.library.sources import MAX_LINES
from twodof.errors import ExperimentError
from twodof.excitation import MAX_DURATION_S, MAX_PARTS, Excitation, Multisine, from_dict
from twodof.signals import ATTITUDE, OPEN_LOOP, PERIOD, POSITION, RATE, VELOCITY

IDLE, RECEIVING, READY, PLAYING, DONE, STOPPED, REFUSED = range(7)
"""TWODOF_EXCITE_STATE."""

NEVER = 1 << 62
"""A tick that is never reached."""

_BEYOND = 1e9  # what no number of an excitation reaches


class ExcitationLoop(NamedTuple):
    """Place where an excitation enters: the loop (index into `signals.MODES`), its set-point, the excitation's unit."""

    loop: int
    name: str
    unit: str


LOOPS = (
    ExcitationLoop(OPEN_LOOP, "M_open", "-"),
    ExcitationLoop(RATE, "q0", "rad/s"),
    ExcitationLoop(ATTITUDE, "theta0", "rad"),
    ExcitationLoop(VELOCITY, "v0", "m/s"),
    ExcitationLoop(POSITION, "x0", "m"),
)
"""Loops that can be excited, in the order of TWODOF_LOOP."""


class SampledExcitation(NamedTuple):
    """Samples of an excitation: its value at the k-th tick after its start, (n,), and the unit."""

    unit: str
    values: NDArray[np.float64]


MOST_EFFORT = 1e8
"""Most cosines that a multisine may need on board: a second's work of one core."""


def prepare(definition: bytes) -> SampledExcitation:
    """Sample an excitation's JSON at 250 Hz.

    Raises ExperimentError for text that is not an excitation, and for a multisine with so many cosines that sampling it
    would take longer than a second.
    """
    try:
        values = json.loads(definition.decode())
    except (ValueError, RecursionError) as reason:
        raise ExperimentError("is not JSON", "excitation", "write it with to_json") from reason
    if not isinstance(values, dict):
        raise ExperimentError("is not a table of values", "excitation", "write it with to_json")
    effort = _effort(values) if values.get("kind") == Multisine.kind else 0.0
    if effort > MOST_EFFORT:
        remedy = f"give fewer or lower harmonics, or less time: at most {MOST_EFFORT:.2g} cosines"
        raise ExperimentError(f"{effort:.2g} cosines are too many to be computed on board", "multisine", remedy)
    try:
        return written_out(from_dict(values))
    except (ArithmeticError, LookupError, MemoryError, TypeError, ValueError) as reason:
        # Nothing that comes over a link may end the control loop.
        raise ExperimentError(f"cannot be sampled: {reason}", "excitation", "write it with to_json") from reason


def _effort(values: dict[str, Any]) -> float:
    """Return the number of cosines that a multisine needs; 0 if `from_dict` refuses it at once."""
    lines = values.get("harmonics")
    times = [values.get(name, 0) for name in ("lead", "settle", "period", "pause", "repeat")]
    if not isinstance(lines, list) or not 1 <= len(lines) <= MAX_LINES:
        return 0.0
    if not all(_plain(number) for number in (*lines, *times)):
        return 0.0
    lead, settle, period, pause, repeat = times
    duration = min(lead + settle + repeat * (period + pause), MAX_DURATION_S)
    return float(len(lines) * (64.0 * min(max(lines), MAX_PARTS) + duration / PERIOD))


def _plain(value: Any) -> bool:
    return isinstance(value, int | float) and abs(value) < _BEYOND


def written_out(excitation: Excitation) -> SampledExcitation:
    """Sample an excitation at 250 Hz, from its start to the end of the rest after it.

    The values are `excitation.at(arange(n) * PERIOD)`, bit for bit those that `experiment.experiments.script` flies.
    Raises ExperimentError if a value is not finite (a sweep over more octaves than a float has).
    """
    steps = int(np.ceil(excitation.duration / PERIOD - 1e-6))
    with np.errstate(all="ignore"):
        values = excitation.at(np.arange(steps) * PERIOD)
    if not np.isfinite(values).all():
        raise ExperimentError("a value is not finite", excitation.kind, "choose other frequencies")
    return SampledExcitation(excitation.unit, values)


class OnboardPlayer:
    """Player of one excitation: defined, waiting for its tick, playing, then done. A definition plays once.

    `start` is the tick of the excitation's time 0, `end` the first tick after it, `begins` the tick for which it waits.
    `reason` says why it was refused or stopped; `revision` counts the changes.
    """

    def __init__(self) -> None:
        self.state = IDLE
        self.transfer = 0
        self.reason = ""
        self.start = 0
        self.end = 0
        self.begins = NEVER
        self.revision = 0
        self.loop = LOOPS[0]
        self.thrust: float | None = None
        self._prepared: SampledExcitation | None = None

    @property
    def playing(self) -> bool:
        """Return whether the excitation acts on the set-points now."""
        return self.state == PLAYING

    @property
    def waiting(self) -> bool:
        """Return whether the excitation was started for a later tick."""
        return self.begins < NEVER

    @property
    def unit(self) -> str:
        """Return the unit of the definition, "" if there is none to play."""
        return self._prepared.unit if self._prepared is not None else ""

    def define(self, transfer: int, prepared: SampledExcitation) -> None:
        """Store the definition `transfer` without playing it."""
        self.transfer, self._prepared = transfer, prepared
        self.start = self.end = 0
        self._become(READY)

    def wait(self, tick: int, loop: ExcitationLoop, thrust: float | None) -> None:
        """Wait for `tick`, to play in `loop` with `thrust`."""
        self._become(READY)
        self.begins, self.loop, self.thrust = tick, loop, thrust
        self.start, self.end = tick, tick + (len(self._prepared.values) if self._prepared is not None else 0)

    def begin(self) -> None:
        """Begin to play."""
        self._become(PLAYING)

    def value(self, tick: int) -> float:
        """Return the value to add at `tick`; after the end return 0 and become done."""
        if self._prepared is None or not self.start <= tick < self.end:
            self._prepared = None
            self._become(DONE)
            return 0.0
        return float(self._prepared.values.item(tick - self.start))

    def finish(self, state: int, reason: str) -> None:
        """End the excitation as STOPPED, which forgets its definition, or as REFUSED."""
        if state == STOPPED:
            self._prepared = None
        self._become(state, reason)

    def _become(self, state: int, reason: str = "") -> None:
        self.state, self.reason, self.begins = state, reason, NEVER
        self.revision += 1
