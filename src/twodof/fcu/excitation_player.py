"""Playing an excitation on board: the very numbers of its definition, one a tick, added to a set-point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twodof.errors import ExperimentError
from twodof.excitation import Excitation, from_json
from twodof.fcu.setpoints import ATTITUDE, OPEN_LOOP, POSITION, RATE, VELOCITY
from twodof.flight.core import PERIOD

STATES = IDLE, RECEIVING, READY, PLAYING, DONE, STOPPED, REFUSED = range(7)
"""TWODOF_EXCITE_STATE."""


class Loop(NamedTuple):
    """Where an excitation enters: the loop (index into `signals.MODES`), its set-point, the excitation's unit."""

    loop: int
    name: str
    unit: str


LOOPS = (
    Loop(OPEN_LOOP, "M_open", "-"),
    Loop(RATE, "q0", "rad/s"),
    Loop(ATTITUDE, "theta0", "rad"),
    Loop(VELOCITY, "v0", "m/s"),
    Loop(POSITION, "x0", "m"),
)
"""By TWODOF_LOOP."""

_NEVER = 1 << 62


class Prepared(NamedTuple):
    """An excitation written out: value at the k-th tick after its start, (n,), and the unit."""

    unit: str
    values: NDArray[np.float64]


def prepare(definition: bytes | str) -> Prepared:
    """An excitation's JSON written out at 250 Hz. Raises ExperimentError for one that is none.

    The values are `excitation.at(arange(n) * PERIOD)`, as `experiment.script` computes them.
    """
    try:
        text = definition if isinstance(definition, str) else definition.decode()
    except UnicodeDecodeError as reason:
        raise ExperimentError("is no UTF-8", "excitation", "write it with to_json") from reason
    return written_out(from_json(text))


def written_out(excitation: Excitation) -> Prepared:
    """An excitation at 250 Hz, from its start to the end of the rest after it."""
    steps = int(np.ceil(excitation.duration / PERIOD - 1e-6))
    return Prepared(excitation.unit, excitation.at(np.arange(steps) * PERIOD))


class Player:
    """One excitation at a time: received, ready, waiting for its tick, playing, and then its base held.

    `start` and `end` are the tick of its time 0 and the first one after its end; `revision` counts changes of `state`.
    """

    def __init__(self) -> None:
        self.state = IDLE
        self.transfer = 0
        self.reason = ""
        self.start = 0
        self.end = 0
        self.revision = 0
        self.begins = _NEVER
        self.loop = LOOPS[0]
        self.thrust: float | None = None
        self.prepared: Prepared | None = None

    @property
    def playing(self) -> bool:
        """Whether it gives the set-points now."""
        return self.state == PLAYING

    @property
    def waiting(self) -> bool:
        """Whether it was started for a tick that has not come."""
        return self.begins < _NEVER

    def define(self, transfer: int, prepared: Prepared) -> None:
        """Takes a definition; nothing is played yet."""
        self.transfer, self.prepared = transfer, prepared
        self.begins = _NEVER
        self._become(READY)

    def wait(self, tick: int, loop: Loop, thrust: float | None) -> None:
        """Plays from `tick` on, once `begin` is called there."""
        self.begins, self.loop, self.thrust = tick, loop, thrust
        self.start, self.end = tick, tick + (len(self.prepared.values) if self.prepared is not None else 0)
        self.revision += 1

    def begin(self) -> None:
        """Its tick has come."""
        self.begins = _NEVER
        self._become(PLAYING)

    def value(self, tick: int) -> float | None:
        """What is added at `tick`; None once it has ended."""
        if self.prepared is None or not self.start <= tick < self.end:
            self._become(DONE)
            return None
        return float(self.prepared.values.item(tick - self.start))

    def finish(self, state: int, reason: str) -> None:
        """It ends here: STOPPED or REFUSED, and why."""
        self.begins = _NEVER
        self.reason = reason
        self._become(state)

    def forget(self) -> None:
        """No definition, nothing played."""
        self.prepared, self.transfer, self.begins = None, 0, _NEVER
        self._become(IDLE)

    def _become(self, state: int) -> None:
        self.state = state
        self.revision += 1
        if state not in (STOPPED, REFUSED):
            self.reason = ""
