"""Clock of a drone: wrapping numbers, restarts, pauses of this program, and time that stands still."""

import asyncio
from typing import Any

import pytest

from tests.faults.virtual_time import VirtualLoop, run_virtual
from tests.gcs.peer import Peer, flight
from twodof.errors import LinkLost, Timeout
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.clock import STANDS_STILL_S

STAMPS, TICKS = 1 << 30, 1 << 32


class OldPeer(Peer):
    """A drone that has run for weeks: what it says of its time is cut to 32 bits."""

    def send(self, name: str, /, **fields: Any) -> None:
        """As Peer's."""
        cut = {key: value & 0xFFFFFFFF for key, value in fields.items() if key in ("time_boot_ms", "tick", "until")}
        super().send(name, **{**fields, **cut})

    def _twodof_grant(self, got: Any, frame: Any) -> None:
        """Up to the tick nearest to now that the number stands for."""
        ahead = (got.until - self.tick) & 0xFFFFFFFF
        got.until = self.tick + (ahead if ahead < 1 << 31 else ahead - (1 << 32))
        super()._twodof_grant(got, frame)


@pytest.mark.parametrize("limit", [STAMPS, TICKS])
def test_a_drone_that_runs_for_weeks_is_flown_on(limit: int) -> None:
    """Milliseconds wrap after 49 days and ticks after 198, without a sign of a restart."""

    async def work() -> None:
        peer = OldPeer()
        peer.tick = limit - 500
        async with peer, await AsyncDrone.connect(peer.url) as drone:
            await drone.run(1.0)
            for _ in range(4):
                peer.rig()
                await drone.run(1.0)
            assert limit < drone.tick < limit + 1500
            assert drone.messages == []
            assert abs(drone.tick - peer.tick) < 10

    run_virtual(work())


def test_one_that_restarts_after_weeks_is_noticed() -> None:
    async def work() -> None:
        peer = OldPeer()
        peer.tick = STAMPS - 10_000_000
        async with peer, await AsyncDrone.connect(peer.url) as drone:
            await drone.run(1.0)
            peer.tick = 0
            await asyncio.sleep(1.5)
            with pytest.raises(LinkLost, match="has restarted"):
                await drone.arm()

    run_virtual(work())


def test_in_lockstep_numbers_wrap_for_set_points_and_grants() -> None:
    async def work() -> None:
        peer = OldPeer(lockstep=True)
        peer.tick = TICKS - 1000
        async with peer, await AsyncDrone.connect(peer.url) as drone:
            await drone.run(0.5)
            await drone.set_pitch(0.1)
            await drone.run(5.0)
            assert drone.tick > TICKS
            stamps = [got.time_boot_ms for got in peer.heard if got.get_type() == "SET_ATTITUDE_TARGET"]
            assert max(stamps) > 0xFFFFFFFF - 100
            assert min(stamps) < 100

    run_virtual(work())


@pytest.mark.parametrize(("after", "pause"), [(0.0, 0.0), (0.5, 1.6), (1.0, 1.7), (2.0, 2.0)])
@flight()
async def test_a_silent_drone_is_lost_despite_a_pause(
    peer: Peer, drone: AsyncDrone, after: float, pause: float
) -> None:
    """And not one whose time stands still: it is silent over all."""
    peer.beating = False
    asyncio.get_running_loop().call_later(after, stand_still, pause)
    with pytest.raises(LinkLost, match="nothing was heard"):
        await drone.run(20.0)


@pytest.mark.parametrize("pause", [1.0, 3.5, 10.0])
@flight()
async def test_time_passes_though_this_program_stood_still(peer: Peer, drone: AsyncDrone, pause: float) -> None:
    begun = drone.tick
    asyncio.get_running_loop().call_later(0.1, stand_still, pause)
    await drone.run(0.3)
    assert drone.tick >= begun + 75


def test_one_that_speaks_and_says_no_time_stands_still() -> None:
    async def work() -> None:
        silent = ("ATTITUDE",)
        async with Peer() as peer, await AsyncDrone.connect(peer.url) as drone:
            peer.spoil = lambda _, sent: [] if sent.get_type() in silent else [sent]
            begun = asyncio.get_running_loop().time()
            with pytest.raises(Timeout, match="time stands still"):
                await drone.run(20.0)
            assert asyncio.get_running_loop().time() - begun < STANDS_STILL_S + 1.1  # its heartbeat comes each second

    run_virtual(work())


def stand_still(seconds: float) -> None:
    """As a process does that is stopped."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.stand_still(seconds)


class Standing(Peer):
    """Its time stands still from a moment on, though it speaks."""

    stands = False

    def send(self, name: str, /, **fields: Any) -> None:
        """As Peer's, without what would tell the time."""
        if not (self.stands and name == "TWODOF_TICK"):
            super().send(name, **fields)

    async def _stream(self) -> None:
        while True:
            await asyncio.sleep(0.02)
            self.tick += 0 if self.stands else 5
            self.send("ATTITUDE", time_boot_ms=4 * self.tick, pitch=0.1, pitchspeed=0.0)


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize(("timeout", "most"), [(0.5, 2.3), (2.0, 2.3), (60.0, 5.3)])
def test_a_wait_where_the_drones_time_stands_still_ends_soon(lockstep: bool, timeout: float, most: float) -> None:
    """It speaks on, and its time does not pass: a wait of .5 s of it is not one of 10 s of ours."""

    async def work() -> None:
        peer = Standing(lockstep=lockstep)
        async with peer, await AsyncDrone.connect(peer.url) as drone:
            await drone.run(0.1)
            peer.stands = True
            loop = asyncio.get_running_loop()
            began = loop.time()
            with pytest.raises(Timeout):
                await drone.wait_until(lambda: False, timeout)
            assert loop.time() - began <= most
            peer.stands = False
            await drone.run(0.1)

    run_virtual(work())
