"""The shell: links in and out, time as it is granted, what happens to peers, links and faults."""

import asyncio
import time
from collections.abc import Callable, Coroutine, Hashable
from typing import Any

import pytest

from tests.fcu.flights import FLY_AT, Script, controller, fly
from tests.patience import PATIENCE_S
from twodof.fcu.control.flight_code import ControlStep, FlightCode
from twodof.fcu.control.loop import MOST_GRANTED
from twodof.fcu.mavlink.service import Service
from twodof.fcu.server import Peer, Server
from twodof.link.connection import Connection, Received
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, Stamps
from twodof.link.transport import open_transport, udp

pytestmark = pytest.mark.slow

CLIENT = 250


class Grants(Service):
    """Lockstep without a lease: TWODOF_GRANT grants, PARAM_SET asks for a pitch, PING is answered by a TWODOF_TICK."""

    def __init__(self, server: Server, script: Script) -> None:
        self.server, self.script = server, script
        self.theta0 = 0.0
        self.heard: list[tuple[str, int]] = []
        self.left: list[Hashable] = []
        self.idled = 0
        script.change = lambda tick, asked: asked._replace(theta0=self.theta0)

    def handle(self, received: Received) -> bool:
        """Notes the message and the tick, and does what it says."""
        got, name = received.message, received.message.get_type()
        self.heard.append((name, self.server.controller.tick))
        if name == "TWODOF_GRANT":
            self.server.controller.grant(got.until)
        elif name == "PARAM_SET":
            self.theta0 = got.param_value
        elif name == "STATUSTEXT":
            raise ZeroDivisionError("a fault of a service")
        elif name == "MISSION_COUNT":
            return False
        return True

    def after(self, step: ControlStep) -> None:
        """Tells everybody of every tenth tick."""
        if step.tick % 10 == 9:
            self.server.send(message("TWODOF_TICK", tick=step.tick + 1, until=0, number=0))

    def gone(self, peer: Hashable) -> None:
        """Notes who left."""
        self.left.append(peer)

    def idle(self) -> None:
        """Counts."""
        self.idled += 1


def grant(until: int) -> Any:
    return message("TWODOF_GRANT", until=until, number=1)


def pitch(value: float) -> Any:
    return message("PARAM_SET", target_system=1, target_component=1, param_id="X", param_value=value, param_type=9)


class World:
    """A server in lockstep at mem://NAME, and its script and service."""

    def __init__(self, signing: Signing | None = None, lockstep: bool = True) -> None:
        self.script = Script()
        self.server = Server(controller(FlightCode(), self.script, lockstep), 1, signing)
        self.grants = Grants(self.server, self.script)
        self.server.services.append(self.grants)

    async def client(self, url: str, signing: Signing | None = None) -> Connection:
        """A client of it."""
        return Connection(await open_transport(url), CLIENT, 1, signing)


def run(work: Callable[[World], Coroutine[Any, Any, None]], **options: Any) -> World:
    """Runs `work` beside the server, with a deadline."""

    async def all_of_it() -> World:
        world = World(**options)
        async with asyncio.timeout(PATIENCE_S), world.server as server:
            running = asyncio.create_task(server.run())
            working = asyncio.create_task(work(world))
            await asyncio.wait((running, working), return_when=asyncio.FIRST_COMPLETED)
            if running.done():
                working.cancel()
                running.result()
            running.cancel()
            await working
        return world

    return asyncio.run(all_of_it())


async def ticked(client: Connection, tick: int) -> None:
    """Waits for the TWODOF_TICK of `tick`."""
    while True:
        received = await client.receive(PATIENCE_S)
        assert received is not None
        if received.message.get_type() == "TWODOF_TICK" and received.message.tick == tick:
            return


def test_what_comes_before_and_between_grants_acts_at_the_first_tick_of_the_next_one() -> None:
    async def work(world: World) -> None:
        await world.server.listen("memin://order")
        client = await world.client("mem://order")
        # All at once: nothing waits for an answer.
        for sent in (pitch(0.1), grant(150), pitch(0.2), pitch(0.3), grant(160), grant(170), pitch(0.4), grant(180)):
            client.send(sent)
        await ticked(client, 180)
        await client.close()

    world = run(work)
    asked = [step.asked.theta0 for step in world.script.steps]
    assert asked == pytest.approx([0.1] * 150 + [0.3] * 20 + [0.4] * 10)  # float32 on the wire
    assert [tick for name, tick in world.grants.heard if name == "TWODOF_GRANT"] == [0, 150, 160, 170]


def test_another_client_is_heard_while_a_long_grant_runs() -> None:
    async def work(world: World) -> None:
        url = await world.server.listen("tcpin://127.0.0.1:0")
        await world.server.listen("memin://long")
        first, second = await world.client("mem://long"), await world.client(url.replace("tcpin", "tcp"))
        first.send(grant(MOST_GRANTED))
        await asyncio.sleep(0)
        second.send(pitch(0.2))
        while "PARAM_SET" not in dict(world.grants.heard):
            await asyncio.sleep(0)
        await first.close()
        await second.close()

    world = run(work)
    heard = dict(world.grants.heard)
    assert 0 < heard["PARAM_SET"] < MOST_GRANTED


def test_a_fault_in_a_service_ends_it_with_the_motors_off() -> None:
    worlds = []

    async def work(world: World) -> None:
        worlds.append(world)
        await world.server.listen("memin://fault")
        client = await world.client("mem://fault")
        client.send(message("STATUSTEXT", severity=1, text="x"))
        await asyncio.sleep(PATIENCE_S)

    with pytest.raises(ZeroDivisionError, match="a fault of a service"):
        run(work)
    rig: Any = worlds[0].server.controller.hardware
    for _ in range(25):
        rig.drive(0.9, 0.1)  # without the stop it would tilt by half a radian
    assert rig.truth[0] == pytest.approx(0.0, abs=0.01)


def test_services_hear_of_peers_that_leave_and_messages_to_them_are_nothing() -> None:
    async def work(world: World) -> None:
        server = world.server
        url = await server.listen("tcpin://127.0.0.1:0")
        clients = [await world.client(url.replace("tcpin", "tcp")) for _ in range(2)]
        for client in clients:
            client.send(pitch(0.1))
        while len(world.grants.heard) < 2:
            await asyncio.sleep(0.001)
        await clients[0].close()
        while not world.grants.left:
            clients[1].send(grant(server.controller.tick + 25))
            await asyncio.sleep(0.001)
        (peer,) = world.grants.left
        assert isinstance(peer, Peer)
        before = server.lost
        server.send(message("TWODOF_TICK", tick=0, until=0, number=0), peer)
        assert server.lost == before + 1
        server.send(message("TWODOF_TICK", tick=2**40, until=0, number=0))
        assert server.lost == before + 2, "what fits no field is dropped"
        with pytest.raises(AssertionError, match="no peer of a server"):
            server.send(message("TWODOF_TICK", tick=0, until=0, number=0), "nobody")
        await clients[1].close()

    left = run(work).grants.left
    assert left.count(left[0]) == 1, "once"


def test_a_link_that_was_cut_is_opened_again() -> None:
    async def work(world: World) -> None:
        for first in (True, False):
            # The flight controller goes to the other side here, as it does to a serial line.
            other = Connection(await open_transport("memin://cut"), CLIENT, 1)
            if first:
                await world.server.listen("mem://cut")
            while not other.transport.peers:
                await asyncio.sleep(0.01)
            tick = world.server.controller.tick
            other.send(grant(tick + 10))
            await ticked(other, tick + 10)
            await other.close()

    assert run(work).server.controller.tick == 20


def test_with_a_key_only_what_is_signed_by_it_is_heard_and_what_it_says_is_signed() -> None:
    key = Key.fresh()

    async def work(world: World) -> None:
        await world.server.listen("memin://signed")
        strangers = [
            await world.client("mem://signed"),
            await world.client("mem://signed", Signing(Key.fresh(), Stamps(None))),
        ]
        for stranger in strangers:
            stranger.send(grant(100))
        friend = await world.client("mem://signed", Signing(key, Stamps(None)))
        friend.send(grant(10))
        await ticked(friend, 10)
        for connection in (*strangers, friend):
            await connection.close()

    world = run(work, signing=Signing(key, Stamps(None)))
    assert world.grants.heard == [("TWODOF_GRANT", 0)]
    assert world.server.controller.tick == 10


def test_a_flooded_link_leaves_the_control_loop_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each message of a flood costs a millisecond; the motors are driven during it, not after it."""
    flood = 400

    async def work(world: World) -> None:
        spent = world.grants.handle

        def slowly(received: Received) -> bool:
            end = time.monotonic() + 0.001
            while time.monotonic() < end:
                pass
            return spent(received)

        monkeypatch.setattr(world.grants, "handle", slowly)
        await world.server.listen("memin://flood")
        client = await world.client("mem://flood")
        while world.server.controller.tick < 10:
            await asyncio.sleep(0.004)
        for _ in range(flood):
            client.send(message("MISSION_ACK", target_system=1))
        while len(world.grants.heard) < flood:
            await asyncio.sleep(0.004)

    world = run(work, lockstep=False)
    ticks = [tick for _, tick in world.grants.heard]
    # 100 control periods are due within it at least; after each stall 25 of them are made up for at once.
    assert len(set(ticks)) >= 15


def test_strangers_beyond_the_places_of_a_link_are_no_clients_but_stop_motors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp, "MOST_PEERS", 2)

    async def work(world: World) -> None:
        url = (await world.server.listen("udpin://:0")).replace("udpin", "udp")
        clients = [await world.client(url) for _ in range(4)]
        for number, client in enumerate(clients):
            client.send(message("PARAM_SET", param_value=float(number)))
            client.send(message("COMMAND_LONG", command=400, param1=1.0, target_system=1))
            client.send(message("COMMAND_LONG", command=400, target_system=1))
            while len(world.grants.heard) < (3 * (number + 1) if number < 2 else 4 + number + 1):
                await asyncio.sleep(0.001)
            await asyncio.sleep(0.02)  # in which all that was sent is read
        # Of two all; of the others what stops motors, which goes before what came before it.
        assert sorted(name for name, _ in world.grants.heard) == ["COMMAND_LONG"] * 6 + ["PARAM_SET"] * 2
        for client in clients:
            await client.close()

    run(work)


@pytest.mark.parametrize("virtual", [True, False])
def test_a_real_drone_whose_program_stood_still_stops_its_motors(
    virtual: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after SIGSTOP: the watchdog saw nothing either. A virtual rig's time stood still too, and it flies on."""
    monkeypatch.setattr("twodof.fcu.server.Watchdog", Blind)

    async def work(world: World) -> None:
        made, steps = world.server.controller, world.script.steps
        monkeypatch.setattr(made.hardware, "virtual", virtual)
        in_flight(world)
        begun_at = made.tick
        while made.tick == begun_at:
            await asyncio.sleep(0.004)
        time.sleep(0.5)
        missed_at = len(steps)
        while len(steps) < missed_at + 50:
            await asyncio.sleep(0.004)
        assert made.timing.missed > 0
        assert steps[-1].armed == virtual
        assert bool(steps[-1].fore) == virtual

    run(work, lockstep=False)


def in_flight(world: World) -> None:
    """At once: where the program stood still while it arms it would stay on the ground."""
    fly(world.server.controller, FLY_AT + 10)
    assert world.script.steps[-1].fore > 0.0


class Blind:
    """A watchdog that stood still with the program."""

    def __init__(self, stop: Callable[[], None], patient: bool) -> None:
        self.stop = stop

    def beat(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


def test_a_hanging_loop_stops_the_motors_in_real_time() -> None:
    """Block the event loop in flight: the watchdog's thread stops the motors, and the failsafe gives the reason."""

    async def work(world: World) -> None:
        made, steps = world.server.controller, world.script.steps
        in_flight(world)
        while not any("hung" in text for _, text in made.remarks):  # where others crowd, the thread may be late too
            time.sleep(0.3)
            await asyncio.sleep(0.1)
        while steps[-1].armed:
            await asyncio.sleep(0.004)
        assert (steps[-1].fore, steps[-1].aft) == (0.0, 0.0)

    run(work, lockstep=False)
