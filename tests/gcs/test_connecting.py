"""Connecting: signing keys, system ids, taken ports, and the discovery of drones."""

import asyncio
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.virtual_time import run_virtual
from tests.faults.whole import paced_by_the_loop
from tests.fleet.drone_numbers import free_numbers
from tests.gcs.virtual import on_board
from tests.patience import PATIENCE_S
from twodof.errors import LinkError, LinkLost
from twodof.gcs import Drone, discover, session
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.connection import Connection
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, SigningVerdict, Stamps, write_key
from twodof.link.transport import open_transport
from twodof.link.transport.url import Ports
from twodof.sim.virtual_drone import VirtualDrone

pytestmark = pytest.mark.slow


def test_a_signed_drone_is_flown_with_its_key_only(tmp_path: Path) -> None:
    key = Key.fresh()
    write_key(tmp_path / "drone.key", key)
    signing = Signing(key, Stamps(None))
    with on_board(lockstep=True, signing=signing) as there:
        for _ in range(2):  # the second one's time stamps go on where the first one's ended
            with Drone.connect(there.url, key=tmp_path / "drone.key") as drone:
                drone.run(0.3)
                drone.arm()
            assert not there.drone.commander.armed


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_signed_drone_without_its_key_is_lost_with_a_reason(lockstep: bool) -> None:
    signing = Signing(Key.fresh(), Stamps(None))

    async def work() -> None:
        with paced_by_the_loop():
            async with VirtualDrone(lockstep=lockstep, signing=signing) as drone:
                await drone.listen("memin://signed")
                with pytest.raises(LinkLost, match=r"no drone was heard.*: \d+ frames came, signed with another key"):
                    await AsyncDrone.connect("mem://signed", timeout=2.5, key=Key.fresh())
                assert signing.counts[SigningVerdict.FORGED] > 0
                with pytest.raises(LinkLost, match=r"\d+ frames are signed.*key="):
                    await AsyncDrone.connect("mem://signed", timeout=2.5)
                assert signing.counts[SigningVerdict.UNSIGNED] > 0
                assert signing.counts[SigningVerdict.ACCEPTED] == 0
                assert drone.commander.lease.holder is None

    run_virtual(work())


def test_a_key_for_an_unsigned_drone_is_lost_with_a_reason() -> None:
    async def work() -> None:
        with paced_by_the_loop():
            async with VirtualDrone() as drone:
                await drone.listen("memin://unsigned")
                with pytest.raises(LinkLost, match=r"\d+ frames came, unsigned.*without key="):
                    await AsyncDrone.connect("mem://unsigned", timeout=2.5, key=Key.fresh())

    run_virtual(work())


def test_a_key_that_others_may_read_is_refused(tmp_path: Path) -> None:
    write_key(tmp_path / "drone.key", Key.fresh())
    (tmp_path / "drone.key").chmod(0o644)
    with pytest.raises(LinkError, match="others may read"):
        Drone.connect("mem://nowhere", timeout=0.1, key=tmp_path / "drone.key")


def test_a_host_that_is_unknown_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)  # nobody's name server is waited for
    with pytest.raises(LinkError, match=r"no-such-host.invalid.*is not a host"):
        asyncio.run(discover(0.1, hosts=["no-such-host.invalid"], places=[]))


def test_each_drone_is_found_at_its_own_place() -> None:

    async def beat(url: str, *systems: int) -> None:
        connections = [Connection(await open_transport(url), system, 1) for system in systems]
        try:
            while True:
                for connection in connections:
                    connection.send(message("HEARTBEAT", type=2, autopilot=12))
                await asyncio.sleep(0.05)
        finally:
            for connection in connections:
                await connection.close()

    async def look() -> None:
        places = {"memin://both": (1, 2), "memin://first": (1,), "memin://second": (2,)}
        beats = [asyncio.create_task(beat(url.replace("in:", ":"), *systems)) for url, systems in places.items()]
        found = await discover(0.6, places=places)
        for task in beats:
            task.cancel()
        await asyncio.gather(*beats, return_exceptions=True)
        assert [(one.system, one.url) for one in found] == [(1, "memin://first"), (2, "memin://second")]

    run_virtual(look())


def test_drones_are_found_with_url_and_state() -> None:
    async def work() -> None:
        with paced_by_the_loop():
            async with VirtualDrone(index=4) as one, VirtualDrone(index=6, lockstep=True) as two:
                await one.listen("memin://one")
                await two.listen("memin://two")
                found = await discover(1.2, places=["mem://nobody", "mem://one", "mem://two"])
                assert [(each.system, each.url, each.mode, each.armed) for each in found] == [
                    (5, "mem://one", "manual", False),
                    (7, "mem://two", "manual", False),
                ]
                async with await AsyncDrone.connect(found[0].url) as drone:
                    assert drone.state.rig.virtual

    run_virtual(work())


def test_a_drone_is_found_over_a_network() -> None:
    with on_board(index=4) as there:

        async def work() -> None:
            while not (found := await discover(1.0, places=["tcp://127.0.0.1:9", there.url])):  # discard's port
                pass
            assert [(each.system, each.url) for each in found] == [(5, there.url)]

        asyncio.run(asyncio.wait_for(work(), PATIENCE_S))


TWO = (1001, 1002)  # ids that no drone of another test has
ANOTHER = f"""
import sys
from twodof.gcs import session
session.OWN_SYSTEMS = {TWO}
print(session.drawn(), flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="numbers are kept apart on Linux only")
def test_a_clients_id_is_its_own_until_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "OWN_SYSTEMS", TWO)
    other = subprocess.Popen([sys.executable, "-c", ANOTHER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with other:
        assert other.stdout is not None
        theirs = int(other.stdout.readline())
        for _ in range(8):
            ours = session.drawn()
            assert ours != theirs
            session.give_back(ours)
        other.kill()
    both = {session.drawn(), session.drawn()}
    for number in both:
        session.give_back(number)
    assert both == set(TWO)


def test_a_taken_port_is_named_if_no_drone_answers() -> None:
    with free_numbers(1) as number, socket.socket(type=socket.SOCK_DGRAM) as other:
        port = Ports.ONBOARD + number
        other.bind(("127.0.0.1", port))
        with pytest.raises(LinkLost, match="in use") as caught:
            asyncio.run(AsyncDrone.connect(f"udpin://127.0.0.1:{port}", timeout=0.3))
    assert str(port) in caught.value.where
    assert str(Ports.COMPANION_ONBOARD + number) in caught.value.what
    assert "end the program that has it" in caught.value.remedy
