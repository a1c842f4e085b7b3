"""Coming back: a drone that restarts under a client, a client that was killed and starts again."""

import asyncio
from typing import Any

import pytest

from tests.faults.virtual_time import VirtualLoop, run_virtual
from tests.faults.whole import Whole, run
from tests.gcs.peer import Peer, flight
from twodof.errors import LinkLost, Rejected
from twodof.excitation import Impulse
from twodof.gcs.async_drone import AsyncDrone

pytestmark = pytest.mark.slow


async def killed(drone: AsyncDrone) -> None:
    """End a client as kill -9 does, without a message."""
    drone.lease.stop()
    drone.setpoints.stop()
    await drone.session.close()


@pytest.mark.parametrize("armed", [False, True])
def test_a_restarted_script_waits_for_its_old_lease(armed: bool) -> None:
    """Disarmed it ends 3 s after it was asked for the last time, in flight 3 s after the last word; then it is ours."""

    async def work() -> None:
        async with Whole() as whole:
            first = await whole.airborne(0.0) if armed else await whole.client(system=250)
            await killed(first)
            start = asyncio.get_running_loop().time()
            again = await whole.client(system=251)
            assert asyncio.get_running_loop().time() - start < 3.5
            assert again.lease.ours
            assert any("waited" in line.text and "lease" in line.text for line in again.messages)
            assert again.state.armed == armed
            await again.disarm()
            await again.close()

    run(work())


class Standing(Peer):
    """Drone in lockstep, whose lease of a dead pilot counts down in whole seconds."""

    def __init__(self) -> None:
        super().__init__(lockstep=True)
        self.holder = (222, 190)
        self.died = asyncio.get_running_loop().time()

    @property
    def left_ms(self) -> int:
        """Announced time to the lease's end."""
        return max(0, min(2500, 3000 - 1000 * int(asyncio.get_running_loop().time() - self.died)))

    def _twodof_lease(self, got: Any, frame: Any) -> None:
        if self.left_ms == 0 and self.holder == (222, 190):
            self.holder = (0, 0)
        super()._twodof_lease(got, frame)

    def _lease(self) -> None:
        left = self.left_ms if self.holder == (222, 190) else 3000
        self.send("TWODOF_LEASE", holder_system=self.holder[0], holder_component=self.holder[1], duration_ms=left)


def test_a_dead_pilot_in_lockstep_has_a_successor() -> None:
    async def work() -> None:
        async with Standing() as peer:
            start = asyncio.get_running_loop().time()
            async with await AsyncDrone.connect(peer.url) as drone:
                assert drone.lease.ours
                assert 2.5 < asyncio.get_running_loop().time() - start < 4.5

    run_virtual(work())


def test_a_renewed_lease_is_refused_soon() -> None:
    """Its holder renews it all the time, so two and a half seconds are enough to know; the deadline would be thirty."""

    async def work() -> None:
        async with Whole() as whole:
            first = await whole.client(system=250)
            start = asyncio.get_running_loop().time()
            with pytest.raises(Rejected, match="250/190 holds the lease, and keeps it"):
                await whole.client(system=251)
            assert asyncio.get_running_loop().time() - start < 3.5
            await first.close()

    run(work())


def test_a_lease_that_ends_too_late_is_refused_at_once() -> None:
    async def work() -> None:
        async with Whole() as whole:
            await killed(await whole.client(system=250))
            start = asyncio.get_running_loop().time()
            with pytest.raises(Rejected, match=r"250/190 holds the lease, for [123]\.\d s more"):
                await whole.client(system=251, timeout=2.5)
            assert asyncio.get_running_loop().time() - start < 1.2  # a second until its heartbeat is heard

    run(work())


@pytest.mark.parametrize("watching", [False, True])
@pytest.mark.parametrize("after", [0.1, 0.9])
def test_a_drone_that_restarts_in_its_first_second_is_noticed(after: float, watching: bool) -> None:
    """Its stamps go back by so little that they might have been overtaken; it says which start it was."""

    async def work() -> None:
        peer = Peer()
        peer.start = 7
        async with peer, await AsyncDrone.connect(peer.url, take_lease=not watching) as drone:
            await asyncio.sleep(after)
            peer.rig()
            await asyncio.sleep(0.05)
            assert drone.session.lost is None
            peer.tick, peer.start, peer.holder = 0, 8, (0, 0)
            peer.rig()
            await asyncio.sleep(0.05)
            assert any("has restarted" in line.text for line in drone.messages)
            if watching:
                await drone.run(0.1)
                assert drone.tick < 100
            else:
                with pytest.raises(LinkLost, match="has restarted"):
                    await drone.arm()

    run_virtual(work())


@pytest.mark.parametrize("pause", [2.0, 30.0])
@pytest.mark.parametrize(("watching", "armed"), [(False, False), (True, False), (True, True), (False, True)])
def test_a_pause_ends_the_session_in_flight_only(watching: bool, armed: bool, pause: float) -> None:
    """A notebook's slow cell, a laptop that slept: the drone was not silent. But for 3 s nobody flew it."""

    async def work() -> None:
        loop = asyncio.get_running_loop()
        async with Peer() as peer, await AsyncDrone.connect(peer.url, take_lease=not watching) as drone:
            if watching:
                peer.armed = armed
                await drone.run(1.5)
            elif armed:
                await drone.arm()
                await drone.set_pitch(0.1)
            assert isinstance(loop, VirtualLoop)
            loop.stand_still(pause)
            if armed and not watching and pause > 3.0:
                sent = drone.setpoints.sent
                with pytest.raises(LinkLost, match=r"stood still for 3\d\.\d s, and the drone was without its pilot"):
                    await drone.set_pitch(0.2)
                assert drone.setpoints.sent == sent
            else:
                await drone.run(1.0)
                said = any("computer is too slow" in line.text for line in drone.messages)
                assert said == (pause > 3.0 or (armed and not watching)), "a short pause hurts who sends set-points"
                await drone.telemetry("theta").next()
                assert drone.telemetry("theta").value
            # That it was silent indeed is still noticed.
            peer.beating = False
            await asyncio.sleep(4.5)  # 3 s, and a look each second
            with pytest.raises(LinkLost):
                _ = drone.telemetry("theta").value
            peer.beating = True

    run_virtual(work())


@pytest.mark.parametrize("after", [0.1, 0.3, 0.45, 0.6, 0.8, 0.95])
@flight()
async def test_a_pilot_that_stood_still_for_a_moment_flies_on(peer: Peer, drone: AsyncDrone, after: float) -> None:
    """Whenever it does: the drone hears of it twice a second, so for less than 3 s it was without its pilot."""
    await drone.arm()
    await drone.level_hold()
    await drone.run(1.0 + after)
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.stand_still(2.4)
    await drone.run(2.0)
    assert drone.state.armed
    assert drone.messages == []


def test_a_quick_restart_of_the_program_is_noticed() -> None:
    """The program itself: another start of it says another number, a reset the same."""

    async def start(whole: Whole) -> tuple[int, int]:
        seen: list[Any] = []
        drone = await whole.client(system=250, take_lease=True)
        drone.session.on(seen.append, "TWODOF_RIG")
        await drone.reset()
        await drone.run(1.5)
        await drone.close()
        assert len({got.start for got in seen}) == 1
        return seen[0].start, len(seen)

    async def work() -> None:
        numbers = set()
        for _ in range(2):
            async with Whole() as whole:
                number, told = await start(whole)
                assert number
                assert told >= 2
                numbers.add(number)
        assert len(numbers) == 2

    run(work())


def test_the_same_excitation_in_another_session_is_played_again() -> None:
    """In real time nothing is reset between: the second must not be taken for a repetition of the first."""

    async def work() -> None:
        async with Whole() as whole:
            for _ in range(2):
                async with await whole.client(system=250) as drone:
                    await drone.run(0.3)
                    await drone.arm()
                    before = drone.tick
                    played = await drone.excite(Impulse(0.1, 0.05, unit="-"), thrust=0.0)
                    assert played.done
                    assert played.start_tick >= before
                    flown = [step.M for step in whole.since(played.start_tick) if step.tick < played.end_tick]
                    assert flown == [0.1] * len(flown)
                    assert len(flown) > 10

    run(work())
