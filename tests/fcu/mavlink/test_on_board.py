"""The services in front of the real commander, store and flight code, in lockstep on the virtual rig, over mem://."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from tests.patience import PATIENCE_S
from twodof.link.connection import Connection
from twodof.link.mavlink.messages import message
from twodof.link.transport import open_transport
from twodof.sim.virtual_drone import VirtualDrone

US = {"target_system": 1, "target_component": 1}


class Client:
    """A client that holds what came until it is asked for."""

    def __init__(self, link: Connection) -> None:
        self.link = link
        self.came: list[Any] = []

    def say(self, name: str, **fields: Any) -> None:
        self.link.send(message(name, **US, **fields))

    async def wait(self, name: str, wanted: Callable[[Any], bool] = lambda _: True) -> Any:
        """The next message of that name; all before it are in `came`."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                received = await self.link.receive(1.0)
                if received is None:
                    continue
                self.came.append(received.message)
                if received.message.get_type() == name and wanted(received.message):
                    return received.message

    async def command(self, number: int, *params: float) -> int:
        self.say("COMMAND_LONG", command=number, **{f"param{n}": value for n, value in enumerate(params, start=1)})
        return (await self.wait("COMMAND_ACK", lambda ack: ack.command == number)).result

    async def run(self, until: int) -> None:
        """Lets time run; `came` is what it brought."""
        self.came.clear()
        self.say("TWODOF_GRANT", until=until, number=until & 0xFFFF)
        await self.wait("TWODOF_TICK", lambda tick: tick.number == until & 0xFFFF and tick.tick == until)


@asynccontextmanager
async def on_board(name: str) -> AsyncIterator[tuple[VirtualDrone, Client]]:
    async with VirtualDrone(lockstep=True, conditions={"rings": True}) as drone:
        await drone.listen(f"memin://{name}")
        async with Connection(await open_transport(f"mem://{name}"), 250, 1) as link:
            yield drone, Client(link)


def flown(name: str, what: Callable[[VirtualDrone, Client], Awaitable[None]]) -> None:
    async def session() -> None:
        async with on_board(name) as (drone, client):
            await what(drone, client)

    asyncio.run(session())


def test_streams_tell_what_flies() -> None:
    async def what(drone: VirtualDrone, client: Client) -> None:
        client.say("TWODOF_LEASE", action=1, duration_ms=30_000)
        await client.wait("TWODOF_LEASE", lambda lease: lease.holder_system == 250)
        await client.run(250)
        assert await client.command(511, 54205, 4000.0) == 0
        await client.run(750)
        count = Counter(one.get_type() for one in client.came)
        assert (count["ATTITUDE"], count["HIGHRES_IMU"], count["TWODOF_TRUTH"]) == (200, 100, 500)
        assert 36 <= count["TWODOF_TOF"] <= 37  # 18.35 Hz
        # At rest on the rig: level within what the sensors' noise leaves of the estimate, one g.
        attitude = [one.pitch for one in client.came if one.get_type() == "ATTITUDE"]
        truth = [one.theta for one in client.came if one.get_type() == "TWODOF_TRUTH"]
        assert max(abs(pitch - truth[0]) for pitch in attitude) < 0.02
        imu = [one.zacc for one in client.came if one.get_type() == "HIGHRES_IMU"]
        assert abs(sum(imu) / len(imu) + 9.81) < 0.05

    flown("streams", what)


def test_a_kill_outlasts_resets_and_disarmings_and_is_shown_until_it_is_released() -> None:
    async def what(drone: VirtualDrone, client: Client) -> None:
        client.say("TWODOF_LEASE", action=1, duration_ms=30_000)
        await client.run(50)
        assert await client.command(185, 1.0) == 0
        client.say("TWODOF_RIG_RESET", seed=1, x=0.0, noise=1.0, rings=1)
        await client.wait("TWODOF_RIG")
        await client.run(50)
        assert await client.command(400, 1.0) == 1
        assert await client.command(400, 0.0) == 0
        assert await client.command(400, 1.0) == 1
        await client.run(350)  # a second and more: the state is told once in it
        shown = next(one for one in client.came if one.get_type() == "TWODOF_SAFETY")
        assert (shown.killed, shown.killed_system, shown.killed_component) == (1, 250, 1)
        assert await client.command(246, 1.0) == 0, "switched on anew it is not killed"
        await client.run(50)
        assert await client.command(185, 1.0) == 0
        assert await client.command(400, 1.0) == 1
        assert await client.command(185, 0.0) == 0
        assert await client.command(400, 1.0) == 5
        client.say("TWODOF_GRANT", until=52, number=1)
        assert (await client.wait("COMMAND_ACK")).result == 0

    flown("kill", what)
