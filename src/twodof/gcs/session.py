"""Session with one vehicle: one task receives and dispatches messages; silence ends every waiting call.

The vehicle is lost after SILENT_S without a message. It stays lost until a new session, since lease, subscriptions and
set-points are gone with it. In lockstep nothing comes between calls, so silence counts from the question on. The client
has a MAVLink system id of its own (`Identity`), and time stamps of that id for signing.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import sys
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Hashable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from twodof.errors import LinkError, LinkLost, Timeout, TwodofError
from twodof.link.connection import Connection, Received
from twodof.link.mavlink.dialect import AUTOPILOT, NO_AUTOPILOT
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, SigningVerdict, Stamps, read_key

OWN_SYSTEMS = (*range(200, 241), 242, 243, 244)
"""Ids to draw from, without discovery's (241), MAVSDK's (245), `twodof flash`'s (252) and QGroundControl's (255)."""

_MOST_TRIES = 8


_claims: dict[int, socket.socket] = {}


def drawn(besides: Collection[int] = ()) -> int:
    """Draw a system id that is not in `besides`; no other client on this computer gets it until `give_back`.

    If all are taken, and on systems other than Linux, another client may have the same id.
    """
    order: list[int] = [system for system in OWN_SYSTEMS if system not in besides]
    secrets.SystemRandom().shuffle(order)
    return next((system for system in order if _claim(system)), order[0])


def give_back(system: int) -> None:
    """Let other clients draw this id; an id that was not drawn here is left alone."""
    claim = _claims.pop(system, None)
    if claim is not None:
        claim.close()


def _claim(system: int) -> bool:
    """Claim an id on this computer; return False if it is taken. Linux frees the name when the process ends."""
    if not sys.platform.startswith("linux"):
        return False
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0twodof-client-{system}")
    except OSError:
        claim.close()
        return False
    _claims[system] = claim
    return True


def identity(system: int | None, on_board: bool, key: Key | str | Path | None) -> tuple[int, Signing | None]:
    """Return a client's system id and its signing; id 0 stands for the drone's own, which is not known yet.

    With a key's file, an id is preferred that has time stamps beside it and is free. Raises LinkError.
    """
    if system is not None or on_board or key is None or isinstance(key, Key):
        number = (0 if on_board else drawn()) if system is None else system
        return number, _signing(key, number)
    read = read_key(key)
    order = sorted(OWN_SYSTEMS, key=lambda number: (not _stamps(key, number).exists(), secrets.randbits(32)))
    for number in order[:_MOST_TRIES]:
        try:
            return number, Signing(read, Stamps(_stamps(key, number)))
        except LinkError as error:  # another process has it
            last = error
    raise last


def _signing(key: Key | str | Path | None, system: int) -> Signing | None:
    """Return the signing with a key; time stamps are beside the key's file, one file for each system id."""
    if key is None:
        return None
    if isinstance(key, Key):
        return Signing(key, Stamps(None))
    return Signing(read_key(key), Stamps(_stamps(key, system)))


def _stamps(key: str | Path, system: int) -> Path:
    return Path(f"{key}.{system}.stamps")


class Deadline:
    """Deadline `seconds` from now on the running loop's clock; `doing` and `where` are for the error's text."""

    def __init__(self, seconds: float, doing: str, where: str = "") -> None:
        if not 0.0 <= seconds < 1e7:
            raise ValueError(f"a timeout of {seconds!r} s is out of range: give 0 to 1e7 s")
        self.seconds, self.doing, self.where = seconds, doing, where
        self._loop = asyncio.get_running_loop()
        self.end = self._loop.time() + seconds

    @property
    def left(self) -> float:
        """Remaining time [s], never negative."""
        return max(0.0, self.end - self._loop.time())

    def error(self, remedy: str = "check the link, then try again, or allow more time") -> Timeout:
        """Return the error to raise after the deadline."""
        return Timeout(f"{self.doing}: no answer within {self.seconds:.3g} s", self.where, remedy)

    @asynccontextmanager
    async def turn(self, lock: asyncio.Lock, remedy: str) -> AsyncIterator[None]:
        """Hold `lock` during the block. Raises Timeout with the `remedy` if it does not become free in time."""
        try:
            async with asyncio.timeout(self.left):
                await lock.acquire()
        except TimeoutError:
            raise self.error(remedy) from None
        try:
            yield
        finally:
            lock.release()

    def check(self) -> None:
        """Raise Timeout after the deadline."""
        if self.left <= 0.0:
            raise self.error()


SILENT_S = 3.0
HEARTBEAT_S = 1.0
SLACK_S = 0.5
"""Delay of this client's heartbeat on a loaded machine; a longer one is a pause of this program."""
RETRY_S = 0.5
# Messages dispatched before other tasks get a turn, and answers that may wait for one call.
BURST = 64
MOST_WAITING = 20_000
_GROUND, _ON_BOARD = 6, 18

Handler = Callable[[Any], None]
T = TypeVar("T")


class ProgramPaused(NamedTuple):
    """Event: this program stood still for `seconds`, longer than a drone goes on without set-points."""

    seconds: float


class MessageListener:
    """Bounded queue of messages of some kinds for one call; `lost` counts the oldest ones dropped."""

    def __init__(self, session: DroneSession, names: tuple[str, ...] = (), size: int = MOST_WAITING) -> None:
        self._session = session
        self.names = names
        self.lost = 0
        self._messages: deque[Any] = deque(maxlen=size)
        self._waiter: asyncio.Future[None] | None = None
        self.since = session.now

    def take(self, got: Any) -> None:
        """Add a message."""
        self.lost += len(self._messages) == self._messages.maxlen
        self._messages.append(got)
        self.wake()

    def wake(self) -> None:
        """Wake the waiting call."""
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)

    async def next(self, until: float, though_lost: bool = False) -> Any | None:
        """Return the next message, or None after `until` (the loop's clock). Raises LinkLost, unless `though_lost`."""
        while not self._messages:
            if not though_lost:
                self._session.check(self.since)
            left = until - self._session.now
            if left <= 0.0:
                return None
            waiter = self._waiter = asyncio.get_running_loop().create_future()
            handle = asyncio.get_running_loop().call_later(min(left, HEARTBEAT_S), self.wake)
            try:
                await waiter
            finally:
                handle.cancel()
                self._waiter = None
        return self._messages.popleft()


class DroneSession:
    """Session with the vehicle `system` over `connection`, which it owns; begun by `find`, ended by `close`.

    `on_board` is True for a companion's program, False for a ground station.
    """

    def __init__(self, connection: Connection, on_board: bool = False) -> None:
        self.connection = connection
        self.on_board = on_board
        self.system = 0
        self.component = AUTOPILOT
        self.lockstep = False
        self.ours = False  # a drone of this package, not another's PX4
        self.taken = 0  # messages of the vehicle
        self.signed_frames = 0  # of the vehicle; before it is found, of all senders
        self._kind = _ON_BOARD if on_board else _GROUND
        self._loop = asyncio.get_running_loop()
        self._peer: Hashable | None = None
        self._sought: int | None = None
        self.heard_at = self._last_heard = self._awake = self._loop.time()
        """Time of the vehicle's last message, by the loop's clock [s]."""
        self.closed = False
        self.lost: LinkLost | None = None
        """Reason of a lost vehicle, None before."""
        self._handlers: dict[str | type, list[Handler]] = {}
        self._listeners: list[MessageListener] = []
        self._tasks = [self._loop.create_task(work) for work in (self._receive(), self._beat())]

    @property
    def now(self) -> float:
        """The loop's clock [s]."""
        return self._loop.time()

    @property
    def url(self) -> str:
        """URL of the link."""
        return self.connection.transport.url

    @property
    def where(self) -> str:
        """Name of the vehicle in errors."""
        return f"drone {self.system}"

    @property
    def target(self) -> dict[str, int]:
        """Fields with a message's receiver."""
        return {"target_system": self.system, "target_component": self.component}

    def deadline(self, seconds: float, doing: str) -> Deadline:
        """Return a deadline for a request to the vehicle."""
        return Deadline(seconds, doing, self.where)

    async def find(self, system: int | None, timeout: float) -> None:
        """Wait for the heartbeat of the vehicle `system` (None: any) and stay with that vehicle.

        Raises LinkLost if none comes within `timeout` [s].
        """
        deadline = Deadline(timeout, "looking for a drone", self.url)
        self._sought = system
        with self.listen("HEARTBEAT") as heard:
            while not self.system and await heard.next(deadline.end) is not None:
                pass
        if self.system:
            return
        which = "no drone" if system is None else f"no drone {system}"
        refused, remedy = self._refused()
        raise LinkLost(f"{which} was heard within {timeout:.3g} s{refused}", self.url, remedy)

    def _refused(self) -> tuple[str, str]:
        """Return a text about frames with a wrong signature, and a remedy."""
        signing = self.connection.signing
        if signing is not None:
            counts, old = signing.counts, self.connection.framing["mavlink1_refused"]
            if forged := counts[SigningVerdict.FORGED]:
                return f": {forged} frames came, signed with another key", "connect with the drone's own key"
            if unsigned := counts[SigningVerdict.UNSIGNED] + old:
                words = f": {unsigned} frames came, unsigned, and key= lets in none such"
                return words, "give it the key (twodof fcu --key), or connect without key="
            for verdict in (SigningVerdict.REPEATED, SigningVerdict.STALE, SigningVerdict.AHEAD):
                if counts[verdict]:
                    return f": {counts[verdict]} frames came, of the first {verdict.value}", "set both clocks"
        return "", "start it, correct the address or the key, or look with Drone.discover()"

    def on(self, handler: Handler, *kinds: str | type) -> None:
        """Call `handler` with each message of these names from the vehicle, and each event of these types.

        The handler must be quick. It gets no message before `find`.
        """
        for kind in kinds:
            self._handlers.setdefault(kind, []).append(handler)

    @contextmanager
    def handling(self, handler: Handler, kind: str | type) -> Iterator[None]:
        """As `on`, until the end of the block."""
        self.on(handler, kind)
        try:
            yield
        finally:
            self._handlers[kind].remove(handler)

    def emit(self, event: object) -> None:
        """Hand an event to the handlers of its type."""
        for handler in [*self._handlers.get(type(event), ())]:
            handler(event)

    @contextmanager
    def listen(self, *names: str) -> Iterator[MessageListener]:
        """Listen to the messages of these names from the vehicle; before it is found, from every sender."""
        heard = MessageListener(self, names)
        self._listeners.append(heard)
        try:
            yield heard
        finally:
            self._listeners.remove(heard)

    def send(self, sent: Any) -> None:
        """Send to the vehicle. Raises LinkLost once it is lost."""
        self.check(self.now)
        self.send_anyway(sent)

    def send_anyway(self, sent: Any) -> None:
        """Send to a vehicle that may be lost, to stop motors. Raises LinkLost if the link itself is gone."""
        self._woke()
        self._awake = self.now
        self.connection.send(sent, self._peer)

    async def ask(
        self,
        question: Any,
        answers: tuple[str, ...],
        accept: Callable[[Any], T | None],
        deadline: Deadline,
        retry_s: float = RETRY_S,
        prolonged: bool = False,
        meanwhile: Callable[[], Awaitable[None]] | None = None,
    ) -> T:
        """Send a question every `retry_s` [s] until `accept` returns a value for an answer; return that value.

        `question` is the message, or a function of the number of the attempt that returns it; None is not sent.
        `answers` are the names of messages that may answer. If `prolonged`, every
        answer postpones the next question, for questions with many answers. `meanwhile` is awaited after each question
        and answer, to let the drone's time pass. Raises LinkLost, Timeout at the deadline, and exceptions of `accept`.
        """
        with self.listen(*answers) as heard:
            for attempt in count():
                if (sent := question(attempt) if callable(question) else question) is not None:
                    self.send(sent)
                if meanwhile is not None:
                    await meanwhile()
                until = min(deadline.end, self.now + retry_s)
                while (got := await heard.next(until)) is not None:
                    found = accept(got)
                    if found is not None:
                        return found
                    if meanwhile is not None:
                        await meanwhile()
                    deadline.check()  # a peer may send other messages without end
                    if prolonged:
                        until = min(deadline.end, self.now + retry_s)
                if (late := self.now - until) > SLACK_S:  # this program stood still, and has not taken what has come
                    deadline.end += late
                deadline.check()
        raise deadline.error()

    def check(self, since: float) -> None:
        """Raise LinkLost if the vehicle is lost; `since` is the time at which the caller began to wait."""
        self._woke()
        if self.lost is None and self.system:
            heard = max(self._last_heard, since) if self.lockstep else self._last_heard
            if self.now - heard > SILENT_S:
                self.end(
                    LinkLost(f"nothing was heard of drone {self.system} for {SILENT_S:g} s", self.url, "connect again")
                )
        self.check_lost()

    def check_lost(self) -> None:
        """Raise LinkLost if the vehicle is known to be lost; safe to call from any thread."""
        lost = self.lost
        if lost is not None:
            raise LinkLost(lost.what, lost.where, lost.remedy)

    def _woke(self) -> None:
        """Detect a pause of this program (a slow cell, a sleeping laptop), in which the drone was not silent.

        The pause is counted from this client's last message: for that long the drone has heard nothing of it.
        """
        paused = self.now - self._awake
        if paused > HEARTBEAT_S + SLACK_S and self.lost is None:
            self._last_heard = min(self.now, self._last_heard + paused - HEARTBEAT_S)
            self._awake = self.now
            if paused > SILENT_S:
                self.emit(ProgramPaused(paused))

    async def close(self) -> None:
        """End the session and close the link; a second time does nothing."""
        self.closed = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self.end(LinkLost("the session was closed", self.url, "connect again"))
        await self.connection.close()
        give_back(self.connection.system)

    def beat(self) -> None:
        """Send this client's heartbeat."""
        if not self.connection.system:
            return  # a program on board has the drone's own system, which is not known yet
        with suppress(LinkLost):  # `check` raises it in waiting calls
            self.connection.send(message("HEARTBEAT", type=self._kind, autopilot=NO_AUTOPILOT, system_status=4))

    async def _beat(self) -> None:
        while True:
            self._woke()
            self._awake = self.now
            self.beat()
            if not self.lockstep:
                with suppress(LinkLost):
                    self.check(self.now)
            await asyncio.sleep(HEARTBEAT_S)

    async def _receive(self) -> None:
        try:
            while True:
                received = await self.connection.receive(HEARTBEAT_S)
                for _ in range(BURST):
                    if received is None:
                        break
                    self._take(received)
                    received = self.connection.receive_now()
                if received is not None:
                    self._take(received)
                    await asyncio.sleep(0)
        except LinkLost as gone:
            self.end(gone)

    def _take(self, received: Received) -> None:
        got, frame = received.message, received.frame
        name = got.get_type()
        flies = name == "HEARTBEAT" and frame.component == AUTOPILOT and got.autopilot != NO_AUTOPILOT
        if not self.system and flies and self._sought in (None, frame.system):
            # At once: the next message, perhaps in the same packet, may be of another vehicle.
            self.system = frame.system
        if self.system:
            if (frame.system, frame.component) != (self.system, self.component):
                return
            self.taken += 1
            self.heard_at = self._last_heard = self.now
            self._peer = received.peer
        self.signed_frames += frame.signed
        for handler in self._handlers.get(name, ()) if self.system else ():
            try:
                handler(got)
            except (ArithmeticError, LookupError, TypeError, ValueError, TwodofError) as fault:
                # A peer may put anything into a field: its message is dropped, and the session goes on.
                self._loop.call_exception_handler({"message": f"a {name} was not taken", "exception": fault})
        for heard in self._listeners:
            if name in heard.names:
                heard.take(got)

    def end(self, reason: LinkLost) -> None:
        """Mark the vehicle as lost: waiting and later calls raise the first `reason`."""
        if self.lost is None:
            self.lost = reason
        for heard in self._listeners:
            heard.wake()
