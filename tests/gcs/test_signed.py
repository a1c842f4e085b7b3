"""A drone that asks for signatures: with the key everything works, without it nothing; and who is there at all."""

import asyncio
import socket
from pathlib import Path

import pytest

from tests.gcs.virtual import on_board
from twodof.errors import LinkError, LinkLost
from twodof.gcs import Drone, discover
from twodof.link.connection import Connection
from twodof.link.key import Key, write_key
from twodof.link.messages import message
from twodof.link.opening import open_transport
from twodof.link.signing import Signing
from twodof.link.stamps import Stamps


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
        accepted = signing.counts.accepted
        with pytest.raises(LinkLost, match=r"no drone was heard.*: \d+ frames came, signed with another key"):
            Drone.connect(there.url, timeout=2.5, key=Key.fresh())
        assert signing.counts.forged > 0
        with pytest.raises(LinkLost, match=r"\d+ frames came signed.*key="):
            Drone.connect(there.url, timeout=1.5)
        assert signing.counts.unsigned > 0
        assert signing.counts.accepted == accepted
        assert there.drone.commander.lease.holder is None


def test_a_key_for_a_drone_without_one_is_said_to_be_none_of_its() -> None:
    with on_board() as there, pytest.raises(LinkLost, match=r"\d+ frames came, unsigned.*without key="):
        Drone.connect(there.url, timeout=2.5, key=Key.fresh())


def test_a_key_that_others_may_read_is_refused(tmp_path: Path) -> None:
    write_key(tmp_path / "drone.key", Key.fresh())
    (tmp_path / "drone.key").chmod(0o644)
    with pytest.raises(LinkError, match="others may read"):
        Drone.connect("mem://nowhere", timeout=0.1, key=tmp_path / "drone.key")


def test_a_host_that_is_unknown_is_an_error() -> None:
    with pytest.raises(LinkError, match=r"no-such-host.invalid.*no host"):
        asyncio.run(discover(0.1, hosts=["no-such-host.invalid"], places=[]))


def test_each_drone_is_found_where_only_it_is_heard() -> None:
    """A place at which both are heard comes first among those looked at; each has one of its own as well."""

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
        free = []
        for _ in range(3):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
                one.bind(("127.0.0.1", 0))
                free.append(one.getsockname()[1])
        both, first, second = (f"127.0.0.1:{port}" for port in free)
        beats = [
            asyncio.create_task(beat(f"udp://{place}", *systems))
            for place, systems in ((both, (1, 2)), (first, (1,)), (second, (2,)))
        ]
        found = await discover(0.6, places=[f"udpin://{place}" for place in (both, first, second)])
        for task in beats:
            task.cancel()
        await asyncio.gather(*beats, return_exceptions=True)
        assert [(one.system, one.url) for one in found] == [(1, f"udpin://{first}"), (2, f"udpin://{second}")]

    asyncio.run(look())


def test_drones_are_found_with_their_url_and_state() -> None:
    with on_board(index=4) as one, on_board(index=6, lockstep=True) as two:
        silent = "tcp://127.0.0.1:9"  # nobody listens at discard's port
        found = asyncio.run(discover(1.2, places=[silent, one.url, two.url]))
        assert [(each.system, each.url, each.mode, each.armed) for each in found] == [
            (5, one.url, "manual", False),
            (7, two.url, "manual", False),
        ]
        with Drone.connect(found[0].url) as drone:
            assert drone.state.rig.virtual
