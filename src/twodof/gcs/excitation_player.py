"""Player of excitations on board: sent in pieces, started at a tick, watched to the end."""

from dataclasses import dataclass
from itertools import count
from math import ceil, nan
from typing import Any

from twodof.errors import ExperimentError, Rejected, listed, shown
from twodof.excitation import Excitation
from twodof.gcs.clock import DroneClock
from twodof.gcs.session import Deadline, DroneSession
from twodof.link.mavlink.messages import excite, message
from twodof.signals import TICK_S

LOOPS = ("M", "q", "theta", "v", "x")
"""Loops that an excitation can enter, in the order of TWODOF_LOOP; the loops inside it are closed."""
UNITS = ("-", "rad/s", "rad", "m/s", "m")
_READY, _REFUSED = 2, 6
_STATES = {3: "playing", 4: "done", 5: "stopped", _REFUSED: "stopped"}
_START, _STOP = 1, 2
_STATUS = ("TWODOF_EXCITE_STATUS",)
_OVER = ("done", "stopped")
# Status comes at each change and at 1 Hz; the player waits this long for it after the planned end.
_LATE_TICKS = 500


@dataclass
class ExcitationPlayback:
    """Excitation on board from `start_tick` up to, not including, `end_tick`; `reason` says why it stopped."""

    transfer: int
    start_tick: int
    end_tick: int
    state: str = "waiting"
    reason: str = ""

    @property
    def done(self) -> bool:
        """True if it was played to its end."""
        return self.state == "done"


class ExcitationPlayer:
    """Player of excitations on one drone; `playback` is the one that this client started last."""

    def __init__(self, session: DroneSession, clock: DroneClock) -> None:
        self._session, self._clock = session, clock
        self._transfers = count(1)
        self.playback: ExcitationPlayback | None = None
        self._unconfirmed: ExcitationPlayback | None = None  # its start had no answer: it may play all the same
        session.on(self._told, *_STATUS)

    async def start(
        self, excitation: Excitation, loop: str | None, thrust: float | None, at: int | None, timeout: float
    ) -> ExcitationPlayback:
        """Send an excitation and start it at tick `at` (None: at once). Raises Rejected, LinkLost, Timeout."""
        number = loop_number(excitation, loop)
        transfer = next(self._transfers) & 0xFFFF
        deadline = self._session.deadline(timeout, "sending an excitation")
        while not await self._send(excitation, number, transfer, deadline):
            transfer = next(self._transfers) & 0xFFFF
        start = message(
            "TWODOF_EXCITE",
            action=_START,
            transfer=transfer,
            loop=number,
            tick=(at or 0) & 0xFFFFFFFF,
            thrust=nan if thrust is None else float(thrust),
            **self._session.target,
        )
        unwrap = self._clock.unwrap

        def begun(got: Any) -> tuple[int, int] | None:
            if not _is_about(got, transfer, "excitation"):
                return None
            waits = got.state == _READY and got.end_tick > got.start_tick and at in (None, 0, unwrap(got.start_tick))
            return (unwrap(got.start_tick), unwrap(got.end_tick)) if waits or got.state in _STATES else None

        # A short one may be over before this call goes on: `_told` keeps the status that comes meanwhile.
        before, playback = self.playback, ExcitationPlayback(transfer, 0, 0)
        self.playback, self._unconfirmed = playback, None
        try:
            first, end = await self._session.ask(start, _STATUS, begun, deadline)
        except BaseException:
            self.playback, self._unconfirmed = before, playback
            raise
        # A wrong end tick must not make this call wait for longer than the excitation lasts.
        longest = ceil(excitation.duration / TICK_S) + 1
        playback.start_tick, playback.end_tick = first, min(end, max(first, self._clock.tick) + longest)
        return playback

    async def finish(self, playback: ExcitationPlayback) -> ExcitationPlayback:
        """Let the drone's time pass until the excitation is done or stopped. Raises LinkLost."""
        await self._clock.run_until(playback.end_tick + 1, lambda: playback.state in _OVER)
        await self._clock.run_until(playback.end_tick + _LATE_TICKS, lambda: playback.state in _OVER)
        return playback

    async def stop(self, timeout: float) -> None:
        """Stop the excitation and wait until it is over; its base is held. Raises Rejected, LinkLost, Timeout.

        The order is repeated until the drone confirms it. For an excitation of another client it is sent once.
        """
        session, playback = self._session, self.playback
        deadline = session.deadline(timeout, "stopping the excitation")
        asked = message("TWODOF_EXCITE", action=_STOP, **session.target)
        if playback is None:
            session.send(asked)
            return

        def over(got: Any) -> bool | None:
            if got.state == _REFUSED and got.transfer != playback.transfer:
                raise _refusal(got, deadline.where)
            return True if playback.state in _OVER else None

        if playback.state not in _OVER:
            await session.ask(asked, _STATUS, over, deadline, meanwhile=lambda: self._clock.one_tick(deadline))

    async def _send(self, excitation: Excitation, loop: int, transfer: int, deadline: Deadline) -> bool:
        """Send the definition; return False if another session has played one under this number."""
        session = self._session

        def question(_: int) -> Any:
            *pieces, last = excite(excitation, loop, transfer, session.system, session.component)
            for piece in pieces:
                session.send(piece)
            return last

        def answer(got: Any) -> bool | None:
            if not _is_about(got, transfer, deadline.where):
                return None
            return True if got.state == _READY else False if _STATES.get(got.state) in _OVER else None

        return await session.ask(question, _STATUS, answer, deadline)

    def _told(self, got: Any) -> None:
        late = self._unconfirmed
        if late is not None and got.transfer == late.transfer and got.state in _STATES:
            late.start_tick, late.end_tick = self._clock.unwrap(got.start_tick), self._clock.unwrap(got.end_tick)
            self.playback, self._unconfirmed = late, None
        playback = self.playback
        if playback is not None and got.transfer == playback.transfer:
            playback.state = _STATES.get(got.state, playback.state)
            playback.reason = str(got.reason)


def loop_number(excitation: Excitation, loop: str | None) -> int:
    """Return the TWODOF_LOOP of `loop` in LOOPS, None: that of the excitation's unit. Raises ExperimentError."""
    if loop is None:
        return UNITS.index(excitation.unit)
    if loop not in LOOPS:
        raise ExperimentError(f"unknown loop {shown(loop)}", "excite", f"choose one of {listed(LOOPS)}")
    unit = UNITS[LOOPS.index(loop)]
    if excitation.unit != unit:
        raise ExperimentError(
            f"the excitation is in {excitation.unit}, the loop {loop} in {unit}", "excite", f'give unit="{unit}"'
        )
    return LOOPS.index(loop)


def _is_about(got: Any, transfer: int, where: str) -> bool:
    """Return True for the status of this transfer. Raises Rejected for its refusal."""
    if got.transfer == transfer and got.state == _REFUSED:
        raise _refusal(got, where)
    return bool(got.transfer == transfer)


def _refusal(got: Any, where: str) -> Rejected:
    return Rejected(str(got.reason) or "the drone does not play it", where, "remove this cause and try again")
