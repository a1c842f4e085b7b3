"""A drone that asks for signatures: with the key everything works, without it nothing; and who is there at all."""

import asyncio
from pathlib import Path

import pytest

from tests.gcs.virtual import on_board
from twodof.errors import LinkError, LinkLost
from twodof.gcs import Drone, discover
from twodof.link.key import Key, write_key
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
