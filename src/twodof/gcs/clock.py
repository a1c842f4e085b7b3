"""Clock of a drone: its control period, waiting for its time to pass, and granting time in lockstep."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from math import inf
from typing import Any, NamedTuple

from twodof.errors import Rejected, Timeout
from twodof.gcs.session import Deadline, DroneSession
from twodof.link.mavlink.messages import message
from twodof.signals import TICK_MS, TICK_S

_STAMPED_MS = ("ATTITUDE", "ATTITUDE_TARGET", "LOCAL_POSITION_NED", "ATTITUDE_QUATERNION")
_TICKED = ("TWODOF_SAFETY", "TWODOF_TIMING", "TWODOF_EXCITE_STATUS", "TWODOF_RIG", "TWODOF_TICK")
# Real time without a new tick, though messages come, after which the drone's time stands still. A shorter wait ends
# sooner, but no sooner than a computer may pause.
STANDS_STILL_S, SOONEST_S = 3.0, 2.0
# Slowest drone clock, in real time per second of the drone's.
SLOWEST = 1.5
# Lockstep: real time allowed for a slice, and for each second of the drone's besides; ticks of a slice.
SLICE_WALL_S = 5.0
SLOWEST_LOCKSTEP = 10.0
SLICE_TICKS = 125
SETPOINT_TICKS = 5
# A message that was overtaken on the way is up to a second old; an older one from some buffer comes between newer ones.
# This many older stamps in a row, for this long in real time, show a restart: ATTITUDE comes at 100 Hz.
OLDEST_TICKS = 250
STAMPS_OF_A_RESTART = 5
RESTART_SEEN_S = 0.5
# Milliseconds and ticks are uint32 on the wire: stamps wrap after 49 days, ticks after 198. A number further ahead than
# this is no wrap but a restart.
_STAMPS, _TICKS = (1 << 32) // TICK_MS, 1 << 32
_MOST_AHEAD = 900_000
# After a reset by this client, messages sent before it may still come.
RESET_SETTLES_S = 3.0


class DroneRestarted(NamedTuple):
    """Event: the drone's time has gone back without a reset by this client."""


class SliceStarts(NamedTuple):
    """Event: in lockstep the ticks from `tick` to `until` (not included) are granted next."""

    tick: int
    until: int


class DroneClock:
    """Clock of the drone in ticks of 4 ms; `tick` is the last one heard, in lockstep the next one to be run."""

    def __init__(self, session: DroneSession) -> None:
        self._session = session
        self.tick = 0
        self.granting = False  # lockstep: this client grants the time
        self._older = 0  # stamps in a row, the first one at
        self._older_since = 0.0
        self._resets_until = 0.0
        self._start = 0  # number of the start of the drone's program; 0: unknown
        self._numbers = count(1)
        session.on(self._stamped, *_STAMPED_MS)
        session.on(self._started, "TWODOF_RIG")
        session.on(self._ticked, *_TICKED)

    async def begin_granting(self, timeout: float) -> None:
        """Start granting time in lockstep, from the drone's present tick on. Raises LinkLost, Timeout."""
        self.granting = True
        deadline = self._session.deadline(timeout, "asking how far its time has come")
        # A tick long past grants nothing; 0 might be a tick to come, just before ticks wrap.
        self.tick = await self._ask(max(0, self.tick - _STAMPS), deadline, 0)

    def restart(self) -> None:
        """Go back to tick 0."""
        self.tick = self._older = 0

    async def one_tick(self, deadline: Deadline) -> None:
        """Grant one tick in lockstep; elsewhere do nothing. Raises LinkLost, Timeout, Rejected."""
        if self.granting:
            await self.run_until(self.tick + 1, within=deadline)

    def unwrap(self, tick: int) -> int:
        """Return the tick for its number on the wire, which wraps after 2^32."""
        return self._unwrap(tick, _TICKS)

    @contextmanager
    def resetting(self) -> Iterator[None]:
        """Allow the drone's time to go back during the block and a moment longer."""
        self._resets_until = inf
        try:
            yield
        finally:
            self._resets_until = self._session.now + RESET_SETTLES_S

    async def run_until(
        self,
        tick: int,
        done: Callable[[], bool] | None = None,
        within: Deadline | None = None,
        patience: float | None = None,
    ) -> None:
        """Let the drone's time pass up to `tick`, which is not run yet, or until `done()`, called each 20 ms of it.

        Raises LinkLost, and Rejected if another client grants the time. Raises Timeout if time stands still, after
        `patience` [s] of real time but not before SOONEST_S, or at the deadline `within` of the calling method.
        """
        most = inf if patience is None else max(SOONEST_S, patience)
        if not self.granting:
            await self._pass(tick, done, within, min(STANDS_STILL_S, most))
            return
        step = SETPOINT_TICKS if done is not None else SLICE_TICKS
        wall = SLICE_WALL_S + SLOWEST_LOCKSTEP * max(0, tick - self.tick) * TICK_S
        deadline = within or self._session.deadline(wall, f"granting time up to tick {tick}")
        for until in [*range(self.tick + step, tick, step), tick]:
            if self.tick >= tick or (done is not None and done()):
                return
            await self._grant(until, deadline, inf if patience is None else min(SLICE_WALL_S, most))

    async def _grant(self, until: int, deadline: Deadline, still: float) -> None:
        self._session.emit(SliceStarts(self.tick, until))
        slowest = still + SLOWEST_LOCKSTEP * (until - self.tick) * TICK_S
        if slowest < deadline.left:
            deadline = Deadline(slowest, f"granting time up to tick {until}", deadline.where)
        await self._ask(until, deadline, until)
        self.tick = max(self.tick, until)  # another call may have granted more meanwhile

    async def _ask(self, until: int, deadline: Deadline, least: int) -> int:
        """Grant time up to a tick and return the tick reached. Raises Rejected if that is below `least`."""
        session, number = self._session, next(self._numbers)
        return await session.ask(
            message("TWODOF_GRANT", until=until % _TICKS, number=number % _TICKS, **session.target),
            ("TWODOF_TICK",),
            lambda got: self._come(got, number % _TICKS, least, deadline),
            deadline,
        )

    async def _pass(self, tick: int, done: Callable[[], bool] | None, within: Deadline | None, still: float) -> None:
        session = self._session
        moved, seen = session.now, self.tick
        end = moved + still + SLOWEST * max(0, tick - seen) * TICK_S
        with session.listen(*_STAMPED_MS, *_TICKED) as heard:
            while self.tick < tick and not (done is not None and done()):
                if self.tick != seen:
                    moved, seen = session.now, self.tick
                # Measured when the drone is heard: a silent drone is lost instead.
                if session.heard_at - moved > still or session.heard_at > end:
                    what = f"the drone's time stands still or is too slow: it is at tick {self.tick}"
                    remedy = "no message with its time comes: subscribe to ATTITUDE, or look at the link"
                    raise Timeout(what, session.where, remedy)
                if within is not None:
                    within.check()
                look = session.now + SETPOINT_TICKS * TICK_S
                await heard.next(look)
                stood = max(0.0, session.now - look)  # a pause of this program, not of the drone
                moved, end = moved + stood, end + stood

    def _started(self, got: Any) -> None:
        """Detect a restart by the number of the start: in a drone's first second its stamps do not show it."""
        before, self._start = self._start, got.start
        if before and got.start not in (0, before) and self._session.lost is None:
            self._session.emit(DroneRestarted())

    def _stamped(self, got: Any) -> None:
        self._to(self._unwrap(got.time_boot_ms // TICK_MS, _STAMPS))

    def _ticked(self, got: Any) -> None:
        self._to(self.unwrap(got.tick))

    def _unwrap(self, value: int, count: int) -> int:
        """Return the nearest tick for a number that wraps after `count`, or the number itself if time went back."""
        near = value + count * round((self.tick - value) / count)
        return near if near >= 0 and -OLDEST_TICKS <= near - self.tick <= _MOST_AHEAD else value

    def _to(self, tick: int) -> None:
        expected = self._session.now < self._resets_until
        if tick >= self.tick - OLDEST_TICKS:
            self._older = 0
            if not self.granting:
                self.tick = max(self.tick, tick)
        elif not expected:
            now = self._session.now
            self._older_since = self._older_since if self._older else now
            self._older += 1
            long = self.granting or now - self._older_since >= RESTART_SEEN_S
            if self._older >= STAMPS_OF_A_RESTART and long and self._session.lost is None:
                self._session.emit(DroneRestarted())
        elif not self.granting:
            self.tick = tick

    def _come(self, got: Any, number: int, least: int, deadline: Deadline) -> int | None:
        if got.number != number:
            return None
        come = self.unwrap(got.tick)
        if come < least:
            raise Rejected("the drone does not let its time run", deadline.where, "see who has the lease")
        return come
