"""Client of the command lease: taken once, renewed while the session lives, given up at its end.

Each renewal says whether other clients may change parameters.
"""

import asyncio
from contextlib import suppress
from typing import Any

from twodof.errors import LinkLost, RefusalReason, Rejected, Timeout
from twodof.gcs.commands import CommandSender
from twodof.gcs.session import Deadline, DroneSession
from twodof.link.mavlink.messages import message

DURATION_MS = 3000
RENEW_S = 0.5
"""More often than heartbeats: after a pause of 2 s the silence is still shorter than the failsafe's 3 s."""
LOOK_S = 0.25
GRACE_S = 1.3
"""Latest end of a lease that is not renewed, after its announced end: in lockstep whole seconds count."""
STATE, ASK, GIVE_UP = 0, 1, 2
_ANSWER = ("TWODOF_LEASE",)


class LeaseClient:
    """Lease of one vehicle: `holder` is (system, component) or None.

    `tuning_withheld` is True if only the holder may change parameters.
    """

    def __init__(self, session: DroneSession, commands: CommandSender) -> None:
        self._session, self._commands = session, commands
        self.holder: tuple[int, int] | None = None
        self.tuning_withheld = False
        self.wanted = False
        self._withholds = False  # sent with each renewal
        self._ends = 0.0  # by the loop's clock, unless the holder renews it
        self._renewing: asyncio.Task[None] | None = None
        session.on(self._told, "TWODOF_LEASE")

    @property
    def ours(self) -> bool:
        """True if this client is the holder."""
        connection = self._session.connection
        return self.holder == (connection.system, connection.component)

    async def take(self, timeout: float) -> float:
        """Take the lease and keep it; return the time [s] of waiting for another client's lease to end.

        A lease whose holder does not renew it, such as a killed script, ends within seconds: the call waits for that.
        Raises Rejected as soon as the holder renews it, or if it ends too late; LinkLost, Timeout.
        """
        deadline = self._session.deadline(timeout, "asking for the lease")
        began, before, ends = self._session.now, None, 0.0
        while not await self._session.ask(self._message(ASK), _ANSWER, self._granted, deadline):
            if self.holder != before:
                before, ends = self.holder, self._ends
            if self.holder is not None:
                await self._runs_out(ends, deadline)
        self.wanted = True
        if self._renewing is None:
            self._renewing = asyncio.get_running_loop().create_task(self._renew())
        return self._session.now - began

    async def _runs_out(self, ends: float, deadline: Deadline) -> None:
        """Wait until another client's lease has ended. Raises Rejected if it does not end, LinkLost, Timeout."""
        holder = self.holder
        while self.holder == holder:
            if ends > deadline.end:
                raise self._theirs(deadline, f"for {ends - self._session.now:.1f} s more")
            if self._ends > ends + GRACE_S or self._session.now > ends + GRACE_S:
                raise self._theirs(deadline, "and keeps it")
            over = self._session.now >= self._ends
            await asyncio.sleep(LOOK_S)
            if over:  # in lockstep it ends only when it is asked for
                return
            await self._session.ask(
                lambda attempt: self._commands.request_of("TWODOF_LEASE", attempt),
                _ANSWER,
                lambda got: got.action == STATE or None,
                deadline,
            )

    def _theirs(self, deadline: Deadline, how: str) -> Rejected:
        system, component = self.holder or (0, 0)
        return Rejected(
            f"{system}/{component} holds the lease, {how}",
            deadline.where,
            "wait until it is given up, or watch with take_lease=False",
            RefusalReason.LEASE,
        )

    async def withhold_tuning(self, withhold: bool, timeout: float) -> None:
        """Forbid other clients to change parameters while this one holds the lease, or allow it again.

        Raises Rejected if another client holds the lease, LinkLost, Timeout.
        """
        deadline = self._session.deadline(timeout, "withholding tuning")
        if not self.wanted:
            raise Rejected("this client does not hold the lease", deadline.where, "connect with take_lease=True")

        def answered(got: Any) -> bool | None:
            granted = self._granted(got)
            return None if granted and self.tuning_withheld != withhold else granted

        before, self._withholds = self._withholds, withhold  # at once: a renewal may be due before the answer
        ours = False
        try:
            ours = bool(await self._session.ask(self._message(ASK), _ANSWER, answered, deadline))
        finally:
            if not ours:
                self._withholds = before
        if not ours:
            raise self._theirs(deadline, "and only its holder withholds tuning")

    async def give_up(self, timeout: float) -> None:
        """Give the lease up, if this client holds it. Raises LinkLost, Timeout."""
        self.stop()
        if self.ours:
            deadline = self._session.deadline(timeout, "giving up the lease")
            await self._session.ask(self._message(GIVE_UP), _ANSWER, lambda _: not self.ours or None, deadline)

    def stop(self) -> None:
        """Stop renewing it; withheld tuning ends with the lease."""
        self.wanted = self._withholds = False
        if self._renewing is not None:
            self._renewing.cancel()
            self._renewing = None

    async def _renew(self) -> None:
        with suppress(LinkLost, Timeout):  # the next call raises it
            while True:
                await asyncio.sleep(RENEW_S)
                self._session.send(self._message(ASK))

    def _message(self, action: int) -> Any:
        duration = DURATION_MS if action == ASK else 0
        withheld = int(self._withholds and action == ASK)
        return message(
            "TWODOF_LEASE", action=action, duration_ms=duration, tuning_withheld=withheld, **self._session.target
        )

    def _told(self, got: Any) -> None:
        if got.action == STATE:
            self.holder = (got.holder_system, got.holder_component) if got.holder_system else None
            self.tuning_withheld = bool(got.tuning_withheld)
            self._ends = self._session.now + got.duration_ms / 1000

    def _granted(self, got: Any) -> bool | None:
        """Return True if this client holds the lease, False if another does; None until the answer comes."""
        return self.ours if got.action == STATE and self.holder is not None else None
