"""Scripted drone: it answers a ground station's requests, and can fail at every message."""

import asyncio
import inspect
import itertools
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, Self

from tests.faults.virtual_time import run_virtual
from twodof.errors import LinkLost
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.connection import Connection, Received
from twodof.link.mavlink.ftp import FtpError, FtpOperation, packed, read_packet
from twodof.link.mavlink.messages import ExcitationReceiver, float_of_int, int_of_float, message
from twodof.link.mavlink.modes import MANUAL
from twodof.link.transport import open_transport
from twodof.link.transport.base import Transport

_names = itertools.count(1)
PARAMETERS = {"ATT_KP": 11.0, "RATE_KP": 0.0854, "THRUST_BAR": 0.4, "SYS_AUTOSTART": 4001}
# Ticks that it lets run for one grant: a real one bounds them too, and a test may have told the client any tick.
MOST_GRANTED = 2_500
DESCRIPTION = b'{"version": 1, "parameters": []}'


def speaking(text: bytes) -> Callable[[int, Any], list[Any] | None]:
    """Return a `spoil` that sends a line of text while a client connects."""
    waiting = [message("STATUSTEXT", severity=4, text=text)]

    def spoil(_: int, sent: Any) -> list[Any] | None:
        return [waiting.pop(), sent] if waiting and sent.get_type() == "TWODOF_RIG" else [sent]

    return spoil


class Peer:
    """Drone 1 at `url`. `spoil` returns the messages that are sent instead of each one; None ends the link."""

    def __init__(
        self,
        lockstep: bool = False,
        spoil: Callable[[int, Any], list[Any] | None] | None = None,
        wrap: Callable[[Transport], Transport] = lambda transport: transport,
    ) -> None:
        self.url = f"mem://peer-{next(_names)}"
        self.lockstep = lockstep
        self.wrap = wrap
        self.spoil = spoil or (lambda _, sent: [sent])
        self.armed = self.killed = False
        self.mode = MANUAL
        self.holder = (0, 0)
        self.tuning_withheld = 0
        self.start = 0
        self.tick = 0
        self.sent = 0
        self.heard: list[Any] = []
        self.refuse: dict[int, tuple[int, str]] = {}
        self.parameters: dict[str, float] = dict(PARAMETERS)
        self.log = bytes(range(256)) * 5
        self.files: dict[str, bytes] = {"/etc/extras/parameters.json": DESCRIPTION}
        self._file = ""
        self.beating = True
        self._done: dict[tuple[int, int], int] = {}
        self._pending: dict[int, dict[str, float]] = {}
        self._open = -1
        self._excitations = ExcitationReceiver()
        self._connection: Connection | None = None
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Self:
        transport = await open_transport(self.url.replace("mem:", "memin:"))
        self._connection = Connection(self.wrap(transport), system=1, component=1)
        loop = asyncio.get_running_loop()
        self._tasks = [loop.create_task(work) for work in (self._serve(), self._beat(), self._stream())]
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._connection is not None:
            await self._connection.close()

    def send(self, name: str, /, **fields: Any) -> None:
        """Send a message, as `spoil` lets it."""
        if self._connection is None or self._connection.transport.closed:
            return
        made = self.spoil(self.sent, message(name, **fields))
        self.sent += 1
        with suppress(LinkLost):
            if made is None:
                self._connection.transport._lose("it died")
                return
            for one in made:
                if isinstance(one, bytes):
                    self._connection.transport.send(one)
                else:
                    self._connection.send(one)

    def count(self, name: str) -> int:
        """How many messages of a kind were heard."""
        return sum(one.get_type() == name for one in self.heard)

    def heartbeat(self) -> None:
        """Say that it is there."""
        base = 1 | (128 if self.armed else 0)
        self.send(
            "HEARTBEAT",
            type=2,
            autopilot=12,
            base_mode=base,
            custom_mode=self.mode,
            system_status=8 if self.killed else 3,
        )

    async def _beat(self) -> None:
        while True:
            if self.beating:
                self.heartbeat()
            await asyncio.sleep(1.0)

    async def _stream(self) -> None:
        while not self.lockstep:
            await asyncio.sleep(0.02)
            self.tick += 5
            if self.beating:
                self.send("ATTITUDE", time_boot_ms=4 * self.tick, pitch=0.1, pitchspeed=0.01 * self.tick)

    async def _serve(self) -> None:
        assert self._connection is not None
        with suppress(LinkLost):
            while True:
                received = await self._connection.receive(60.0)
                if received is not None and self.beating:
                    self.heard.append(received.message)
                    self._answer(received)

    def _answer(self, received: Received) -> None:
        got = received.message
        answer = getattr(self, f"_{got.get_type().lower()}", None)
        if answer is not None:
            answer(got, received.frame)

    def _command_long(self, got: Any, _: Any) -> None:
        result, text = self.refuse.get(got.command, (0, ""))
        self.send("COMMAND_ACK", command=got.command, result=result)
        if text:  # as the flight controller says it: after its answer
            self.send("STATUSTEXT", severity=4, text=text)
        if result:
            return
        if got.command == 400:
            self.armed = got.param1 == 1.0
            self.killed |= got.param2 == 21196
            self.heartbeat()
        elif got.command == 185:
            self.killed = False
            self.heartbeat()
        elif got.command == 176:
            self.mode = int(got.param2) << 16 | int(got.param3) << 24
            self.heartbeat()
        elif got.command == 512 and got.param1 == 148:
            self.send("AUTOPILOT_VERSION", flight_sw_version=0x011001FF, flight_custom_version=b"twodof\0\0", uid=1)
        elif got.command == 512 and got.param1 == 54206:
            self.rig()
        elif got.command == 512 and got.param1 == 54209:
            self._lease()

    def rig(self) -> None:
        """Say what it stands on."""
        flags = 4 | (8 if self.lockstep else 0)
        self.send("TWODOF_RIG", tick=self.tick, tick_us=4000, flags=flags, name="paper", start=self.start)

    def _twodof_rig_reset(self, *_: Any) -> None:
        self.tick = 0
        self.rig()

    def _twodof_lease(self, got: Any, frame: Any) -> None:
        who = (frame.system, frame.component)
        if got.action == 1 and self.holder in ((0, 0), who):
            self.holder, self.tuning_withheld = who, got.tuning_withheld
        elif got.action == 2 and self.holder == who:
            self.holder, self.tuning_withheld = (0, 0), 0
        self._lease()

    def _lease(self) -> None:
        system, component = self.holder
        withheld = self.tuning_withheld
        self.send(
            "TWODOF_LEASE", holder_system=system, holder_component=component, duration_ms=3000, tuning_withheld=withheld
        )

    def _twodof_grant(self, got: Any, _: Any) -> None:
        until = min(got.until, self.tick + 25_000)  # as the flight controller bounds it
        while self.tick < until:
            if self.tick % 5 == 0:
                self.send("ATTITUDE", time_boot_ms=4 * self.tick, pitch=0.1, pitchspeed=0.01 * self.tick)
            self.tick += 1
        self.send("TWODOF_TICK", tick=self.tick, until=got.until, number=got.number)

    def _value(self, name: str) -> None:
        value, index = self.parameters[name], list(self.parameters).index(name)
        whole = isinstance(value, int)
        carried = float_of_int(value) if isinstance(value, int) else value
        kind = 6 if whole else 9
        total = len(self.parameters)
        self.send(
            "PARAM_VALUE", param_id=name, param_value=carried, param_type=kind, param_count=total, param_index=index
        )

    def _param_request_read(self, got: Any, _: Any) -> None:
        name = got.param_id if got.param_index < 0 else list(self.parameters)[got.param_index]
        if name in self.parameters:
            self._value(name)
        else:
            self.send("PARAM_ERROR", param_id=name, param_index=-1, error=1)

    def _param_request_list(self, *_: Any) -> None:
        self.send(
            "PARAM_VALUE", param_id="_HASH_CHECK", param_type=5, param_count=len(self.parameters), param_index=65535
        )
        for name in self.parameters:
            self._value(name)

    def _param_set(self, got: Any, _: Any) -> None:
        value = int_of_float(got.param_value) if got.param_type == 6 else got.param_value
        if self._open >= 0:
            self._pending.setdefault(self._open, {})[got.param_id] = value
            return
        self.parameters[got.param_id] = value
        self._value(got.param_id)

    def _twodof_param_transaction(self, got: Any, _: Any) -> None:
        self.send("TWODOF_PARAM_TRANSACTION", **self._transacted(got))

    def _transacted(self, got: Any) -> dict[str, Any]:
        answer = {"transaction": got.transaction, "action": got.action, "count": got.count}
        key = (got.action, got.transaction)
        if got.action == 0:
            if (1, got.transaction) not in self._done:
                self._open = got.transaction
            return answer
        if key in self._done:
            return {**answer, "result": self._done[key]}
        changes = self._pending.get(got.transaction, {})
        if len(changes) != got.count:
            return {**answer, "result": 8}  # it stays open: what was overtaken may still come
        self._open = -1
        self._done[key] = 2 if changes.get("ATT_KP") == 13.0 else 0
        if self._done[key]:
            return {**answer, "result": 2, "param_id": "ATT_KP"}
        self.parameters.update(changes)
        return answer

    def _twodof_excite(self, got: Any, _: Any) -> None:
        status = {"tick": self.tick, "transfer": got.transfer, "received": got.total}
        if got.action == 0:
            if self._excitations.take(got) is not None:
                self.send("TWODOF_EXCITE_STATUS", state=2, **status)
        elif got.action == 1:
            start = got.tick or self.tick
            self.send("TWODOF_EXCITE_STATUS", state=3, start_tick=start, end_tick=start + 100, **status)
            self.send("TWODOF_EXCITE_STATUS", state=4, start_tick=start, end_tick=start + 100, **status)

    def _log_request_list(self, *_: Any) -> None:
        self.send("LOG_ENTRY", id=0, num_logs=1, last_log_num=0, time_utc=1_700_000_000, size=len(self.log))

    def _log_request_data(self, got: Any, _: Any) -> None:
        for at in range(got.ofs, min(got.ofs + got.count, len(self.log)), 90):
            piece = self.log[at : at + 90]
            self.send("LOG_DATA", id=got.id, ofs=at, count=len(piece), data=piece)

    def _file_transfer_protocol(self, got: Any, frame: Any) -> None:
        asked, data = read_packet(bytes(got.payload)), b""
        if asked.op in (FtpOperation.CREATE, FtpOperation.OPEN_RO):
            self._file = asked.text
        content = self.files.get(self._file, b"")
        if asked.op == FtpOperation.CREATE:
            self.files[self._file] = b""
        elif asked.op == FtpOperation.OPEN_RO:
            data = len(content).to_bytes(4, "little")
        elif asked.op == FtpOperation.WRITE:
            self.files[self._file] = content[: asked.offset] + asked.data[: asked.size]
        elif asked.op == FtpOperation.READ:
            data = content[asked.offset :][: asked.size]
        elif asked.op == FtpOperation.LIST:
            names = [f"F{name}\t{len(self.files[name])}\0" for name in self.files][asked.offset :]
            if not names:
                answer = packed(asked.nak(FtpError.END), frame.system, frame.component)
                self.send("FILE_TRANSFER_PROTOCOL", payload=answer.payload)
                return
            data = names[0].encode()
        elif asked.op == FtpOperation.REMOVE:
            self.files.pop(asked.text, None)
        self.send("FILE_TRANSFER_PROTOCOL", payload=packed(asked.ack(data), frame.system, frame.component).payload)


def flight(make: Callable[..., Peer] = Peer, **options: Any) -> Callable[..., Callable[..., None]]:
    """Run an async test with a scripted drone and its client on virtual time.

    `make` may take parameters of the test by their names; `options` are for AsyncDrone.connect.
    """

    def decorate(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
        def run(**given: Any) -> None:
            async def work() -> None:
                wanted = {name: given[name] for name in inspect.signature(make).parameters if name in given}
                async with make(**wanted) as peer, await AsyncDrone.connect(peer.url, **options) as drone:
                    await test(peer, drone, **given)

            run_virtual(work())

        run.__name__, run.__doc__, run.__module__ = test.__name__, test.__doc__, test.__module__
        parameters = [*inspect.signature(test).parameters.values()][2:]
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.pytestmark = getattr(test, "pytestmark", [])  # type: ignore[attr-defined]
        return run

    return decorate
