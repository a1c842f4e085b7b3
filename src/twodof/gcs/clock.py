"""The drone's time: which control period it is in, how it passes, and how it is let pass in lockstep."""

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
# Real time for which the drone speaks and is silent over its own time, after which it stands still. Who waits for less
# of its time learns it sooner, but no sooner than a computer may pause.
STANDS_STILL_S, SOONEST_S = 3.0, 2.0
# A drone's clock that runs slower than this is none.
SLOWEST = 1.5
# Lockstep: real time that may go by, apart from and for each second of the drone's; its time that goes by in a slice.
SLICE_WALL_S = 5.0
SLOWEST_LOCKSTEP = 10.0
SLICE_TICKS = 125
SETPOINT_TICKS = 5
# What was overtaken on the way is up to a second old. What waited longer in some buffer comes between newer ones; so
# many stamps in a row that are older, in real time for so long, are no stragglers: ATTITUDE comes 100 times a second.
OLDEST_TICKS = 250
STAMPS_OF_A_RESTART = 5
RESTART_SEEN_S = 0.5
# Milliseconds and ticks are uint32 on the wire: stamps begin again after 49 days, ticks after 198. What seems to be
# further ahead than this is no wrap but another beginning.
_STAMPS, _TICKS = (1 << 32) // TICK_MS, 1 << 32
_MOST_AHEAD = 900_000
# After a reset of ours what was sent before it may still come.
RESET_SETTLES_S = 3.0


class DroneRestarted(NamedTuple):
    """An event: the drone's time has gone back although nobody here has asked for that."""


class SliceStarts(NamedTuple):
    """An event: in lockstep the ticks from `tick` to `until` (not included) are granted next."""

    tick: int
    until: int


class DroneClock:
    """The drone's ticks of 4 ms. `tick` is the newest that was told of; in lockstep the first that has not been run."""

    def __init__(self, session: DroneSession) -> None:
        self._session = session
        self.tick = 0
        self.granting = False  # time stands still, and is ours to grant
        self._older = 0  # stamps in a row, the first one at
        self._older_since = 0.0
        self._resets_until = 0.0
        self._start = 0  # which start of the drone's program it was; 0: it does not say
        self._numbers = count(1)
        session.on(self._stamped, *_STAMPED_MS)
        session.on(self._started, "TWODOF_RIG")
        session.on(self._ticked, *_TICKED)

    async def begin_granting(self, timeout: float) -> None:
        """From now on its time is ours to grant: learn how far it has come. Raises LinkLost, Timeout."""
        self.granting = True
        deadline = self._session.deadline(timeout, "asking how far its time has come")
        # A tick that ran long ago grants nothing; 0 could be one that has not run where ticks begin anew.
        self.tick = await self._ask(max(0, self.tick - _STAMPS), deadline, 0)

    def restart(self) -> None:
        """It began anew at tick 0."""
        self.tick = self._older = 0

    def meant(self, tick: int) -> int:
        """The tick that one from the wire stands for, which begins anew after 2^32."""
        return self._meant(tick, _TICKS)

    @contextmanager
    def resetting(self) -> Iterator[None]:
        """Meanwhile, and a moment longer, its time may begin anew."""
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
        """Let the drone's time pass up to `tick` (not run yet), or until `done()`, asked each 20 ms of its time.

        Raises LinkLost, and Rejected if it is not ours to grant. Raises Timeout if it stands still, after `patience`
        [s] of ours but not before SOONEST_S, or at the deadline of the call that lets it pass (`within`).
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
        self.tick = max(self.tick, until)  # another thread may have granted more meanwhile

    async def _ask(self, until: int, deadline: Deadline, least: int) -> int:
        """Grant time up to a tick; returns how far it has come then. Raises Rejected where that is not to `least`."""
        session, number = self._session, next(self._numbers)
        return await session.ask(
            lambda _: message("TWODOF_GRANT", until=until % _TICKS, number=number % _TICKS, **session.target),
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
                # By when it was heard: one that says nothing at all is lost.
                if session.heard_at - moved > still or session.heard_at > end:
                    raise Timeout(
                        f"the drone's time does not pass as ours does: it is at tick {self.tick}",
                        f"drone {session.system}",
                        "no message with its time comes: subscribe to ATTITUDE, or look at the link",
                    )
                if within is not None:
                    within.check()
                look = session.now + SETPOINT_TICKS * TICK_S
                await heard.next(look)
                stood = max(0.0, session.now - look)  # this program did, which is not the drone's fault
                moved, end = moved + stood, end + stood

    def _started(self, got: Any) -> None:
        """Another number than before: in the first second of a drone its stamps do not show that it has restarted."""
        before, self._start = self._start, got.start
        if before and got.start not in (0, before) and self._session.lost is None:
            self._session.emit(DroneRestarted())

    def _stamped(self, got: Any) -> None:
        self._to(self._meant(got.time_boot_ms // TICK_MS, _STAMPS))

    def _ticked(self, got: Any) -> None:
        self._to(self.meant(got.tick))

    def _meant(self, value: int, count: int) -> int:
        """The tick that a number which begins anew after `count` stands for: the nearest one, unless time went back."""
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
        come = self.meant(got.tick)
        if come < least:
            raise Rejected("it does not let its time run", deadline.where, "see who has the lease")
        return come
