"""The lease: who may command. Asked for once, renewed while the session lives, given up at its end."""

import asyncio
from contextlib import suppress
from typing import Any

from twodof.errors import LinkLost, Rejected, Timeout
from twodof.gcs.deadline import Deadline
from twodof.gcs.session import Session
from twodof.link.messages import message

DURATION_MS = 3000
RENEW_S = 1.0
STATE, ASK, GIVE_UP = 0, 1, 2


class Lease:
    """Our hold on the vehicle, and who else has it: `holder` is (system, component), None for nobody."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.holder: tuple[int, int] | None = None
        self.wanted = False
        self._renewing: asyncio.Task[None] | None = None
        session.on(self._told, "TWODOF_LEASE")

    @property
    def ours(self) -> bool:
        """Whether we hold it."""
        connection = self._session.connection
        return self.holder == (connection.system, connection.component)

    async def take(self, timeout: float) -> None:
        """Ask for it and keep it. Raises Rejected if somebody else has it, LinkLost, Timeout."""
        deadline = Deadline(timeout, "asking for the lease", f"drone {self._session.system}")
        await self._session.ask(lambda _: self._message(ASK), ("TWODOF_LEASE",), self._granted, deadline)
        self.wanted = True
        if self._renewing is None:
            self._renewing = asyncio.get_running_loop().create_task(self._renew())

    async def give_up(self, timeout: float) -> None:
        """Let others command. Raises LinkLost, Timeout; without a lease it does nothing."""
        self.stop()
        if self.ours:
            deadline = Deadline(timeout, "giving up the lease", f"drone {self._session.system}")
            await self._session.ask(lambda _: self._message(GIVE_UP), ("TWODOF_LEASE",), self._gone, deadline)

    def stop(self) -> None:
        """Renew it no more."""
        self.wanted = False
        if self._renewing is not None:
            self._renewing.cancel()
            self._renewing = None

    def renew(self) -> None:
        """Renew it now."""
        if self.wanted:
            self._session.send(self._message(ASK))

    async def _renew(self) -> None:
        with suppress(LinkLost, Timeout):  # the next call says so
            while True:
                await asyncio.sleep(RENEW_S)
                self.renew()

    def _message(self, action: int) -> Any:
        place = {"target_system": self._session.system, "target_component": self._session.component}
        duration = DURATION_MS if action == ASK else 0
        return message("TWODOF_LEASE", action=action, duration_ms=duration, **place)

    def _told(self, got: Any) -> None:
        if got.action == STATE:
            self.holder = (got.holder_system, got.holder_component) if got.holder_system else None

    def _granted(self, got: Any) -> bool | None:
        self._told(got)
        if self.holder is not None and not self.ours:
            raise Rejected(
                f"{self.holder[0]}/{self.holder[1]} holds the lease",
                f"drone {self._session.system}",
                "wait until it is given up, or watch with take_lease=False",
            )
        return self.ours or None

    def _gone(self, got: Any) -> bool | None:
        self._told(got)
        return None if self.ours else True
