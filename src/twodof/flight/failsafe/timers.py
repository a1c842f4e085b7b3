"""Timers of the failsafe: bounded counters of ticks. One says that something is missing too long, one lets a flag last.

Each is two comparisons and one counter of an integer, so that tests can try everything that it can do.
"""

from typing import Any

from twodof.blocks import Block, Param, Port, State, int32, maximum, minimum, to_int32, where

MOST = 60.0
"""Longest time of a timer [s]: at 250 Hz a count of 15,000."""

_TIMEOUT = Param("timeout", 1.0, unit="s", low=0.004, high=MOST)
_TIME = Param("time", 0.5, unit="s", low=0.004, high=MOST)


def ticks(seconds: Any, dt: Any) -> Any:
    """`seconds` as a number of periods `dt`, to the nearest, one at least; int32."""
    return maximum(int32(1), to_int32(seconds / dt + 0.5))


class WatchdogTimer(Block):
    """Whether `alive` was false for `timeout` s, this tick included.

    With N = timeout / dt, `expired` comes in the Nth tick in a row without a sign of life (the first is tick 1). It
    goes in the tick of the next sign. The count saturates at N, where it starts, so that what was never alive is not
    waited for.
    """

    inputs = (Port("alive", "bool"),)
    outputs = (Port("expired", "bool"),)
    states = (State("count", "limit", "int32"),)
    derived = (Port("limit", "int32"),)

    def __init__(self, timeout: Param = _TIMEOUT) -> None:
        self.params = [timeout]

    def prepare(self, p: Any, t: Any) -> Any:
        return ticks(p.timeout, t.dt)

    def _count(self, u: Any, x: Any, p: Any) -> Any:
        # The comparison comes before the sum: a count that a fault has put anywhere cannot wrap around.
        return where(u.alive, int32(0), where(x.count < p.limit, maximum(x.count, int32(0)) + int32(1), p.limit))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self._count(u, x, p) >= p.limit  # the limit is 1 at least, and alive the count is 0

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self._count(u, x, p)


class OffDelay(Block):
    """`flag`, and for `time` s after it: what it starts lasts, so that nothing switches to and fro faster than that."""

    inputs = (Port("flag", "bool"),)
    outputs = (Port("lasting", "bool"),)
    states = (State("left", 0, "int32"),)
    derived = (Port("limit", "int32"),)

    def __init__(self, time: Param = _TIME) -> None:
        self.params = [time]

    def prepare(self, p: Any, t: Any) -> Any:
        return ticks(p.time, t.dt)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.flag | (x.left > int32(0))

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return where(u.flag, p.limit, maximum(int32(1), minimum(x.left, p.limit)) - int32(1))
