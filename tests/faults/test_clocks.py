"""Wall clocks that jump: the monotonic one rules, and stamps of signatures follow docs/reference/protocol.md."""

import asyncio
from contextlib import suppress
from pathlib import Path

import pytest

from tests.faults.virtual_time import on_virtual_time
from tests.faults.whole import DESCEND, LEVEL, Whole, acts, silent, stands, tell
from twodof.errors import LinkLost
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.connection import Connection
from twodof.link.signing import PER_SECOND, Key, Signing, SigningVerdict, Stamps

pytestmark = pytest.mark.slow

START = 300_000_000 * PER_SECOND  # in 2024
HOUR, DAY = 3600.0, 86400.0


class Clock:
    """A wall clock on the loop's time that somebody sets; read as time stamps are."""

    def __init__(self) -> None:
        self.offset = 0.0

    def __call__(self) -> int:
        """Now [10 us]."""
        return START + int((asyncio.get_running_loop().time() + self.offset) * PER_SECOND)


async def signed(whole: Whole, key: Key, clock: Clock, system: int = 250) -> AsyncDrone:
    """A client with a clock of its own."""
    real = Connection.__init__

    def made(self: Connection, transport: object, system: int, component: int, *_: object) -> None:
        real(self, transport, system, component, Signing(key, Stamps(None, clock)))

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("twodof.gcs.async_drone.Connection.__init__", made)
        return await AsyncDrone.over(await whole.open(), timeout=5.0, system=system)


@pytest.mark.long
@pytest.mark.parametrize(
    "jump",
    [
        300 * DAY,
        -40 * 365 * DAY,
        pytest.param(-2 * HOUR, marks=pytest.mark.soak),
        pytest.param(2 * HOUR, marks=pytest.mark.soak),
        pytest.param(-3 * DAY, marks=pytest.mark.soak),
    ],
)
@on_virtual_time
async def test_the_drones_clock_is_set_in_flight(jump: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No step is late, no set-point counts as lost, every command is heard, and the log's time goes on."""
    key = Key.fresh()
    theirs, ours = Clock(), Clock()
    signing = Signing(key, Stamps(tmp_path / "stamps.json", theirs))
    async with Whole(signing=signing, state=tmp_path / "drone") as whole:
        drone = await signed(whole, key, ours)
        await drone.run(0.5)
        await drone.arm()
        await drone.set_pitch(0.1, thrust=0.4)
        await drone.run(1.0)
        first = whole.tick
        theirs.offset = jump
        monkeypatch.setattr("time.time", lambda: 1.7e9 + jump)
        await drone.run(1.5)
        await drone.set_pitch(-0.1, thrust=0.4)
        await drone.run(1.0)
        assert silent(whole.since(first))
        assert whole.steps[-1].step.theta0 == pytest.approx(-0.1)
        assert (
            signing.counts[SigningVerdict.REPEATED],
            signing.counts[SigningVerdict.STALE],
            signing.counts[SigningVerdict.AHEAD],
        ) == (0, 0, 0)
        await drone.kill()
        assert stands(whole.steps[-1])
        await drone.disarm()
        await drone.close()
        other = await signed(whole, key, ours, 251)  # its clock may be behind; it follows what it hears
        await other.release()
        await other.close()


@on_virtual_time
async def test_a_clients_clock_that_jumps_by_less_than_a_year_is_not_noticed() -> None:
    key = Key.fresh()
    theirs, ours = Clock(), Clock()
    async with Whole(signing=Signing(key, Stamps(None, theirs))) as whole:
        drone = await signed(whole, key, ours)
        await drone.run(0.5)
        await drone.arm()
        await drone.set_pitch(0.1, thrust=0.4)
        await drone.run(1.0)
        first = whole.tick
        for ours.offset in (20 * HOUR, -20 * HOUR, 300 * DAY, -400 * DAY):
            await drone.run(0.6)  # longer than set-points may be missing
        assert silent(whole.since(first))
        await drone.close()
        assert stands(whole.steps[-1])


@pytest.mark.long
@on_virtual_time
async def test_a_client_with_a_clock_a_year_ahead_is_refused() -> None:
    """It signs times that cannot be: they are refused and counted; level within 1 s, then down as without a link."""
    key = Key.fresh()
    theirs, ours = Clock(), Clock()
    signing = Signing(key, Stamps(None, theirs))
    async with Whole(signing=signing) as whole:
        drone = await signed(whole, key, ours)
        await drone.run(0.5)
        await drone.arm()
        await drone.set_pitch(0.1, thrust=0.4)
        await drone.run(1.0)
        first = whole.tick
        ours.offset = 400 * DAY
        await whole.passes(5.0)
        tell("a client's clock ahead by over a year", "level", whole.ms(first, acts(LEVEL)), 1000)
        tell("a client's clock ahead by over a year", "down", whole.ms(first, acts(DESCEND)), 4000)
        tell("a client's clock ahead by over a year", "motors off", whole.ms(first, stands), 5000)
        assert signing.counts[SigningVerdict.AHEAD] > 10
        ours.offset = 0.0
        other = await signed(whole, key, ours, 251)  # another's stamps are a clock's
        await other.disarm()
        await other.close()
        await drone.close()


@pytest.mark.long
@on_virtual_time
async def test_a_drones_clock_that_jumps_ahead_by_more_than_a_year_is_not_believed_and_it_makes_itself_safe() -> None:
    """The client hears it no more: LinkLost after 3 s. It still hears the client, who stops; a kill still goes out."""
    key = Key.fresh()
    theirs, ours = Clock(), Clock()
    async with Whole(signing=Signing(key, Stamps(None, theirs))) as whole:
        drone = await signed(whole, key, ours)
        await drone.run(0.5)
        await drone.arm()
        await drone.set_pitch(0.1, thrust=0.4)
        await drone.run(1.0)
        first = whole.tick
        theirs.offset = 400 * DAY
        with pytest.raises(LinkLost):
            await drone.run(10.0)
        lost = whole.tick
        tell("the drone's clock ahead by over a year", "link lost for the client", 4.0 * (lost - first), 4500)
        await whole.passes(2.0)
        tell("the drone's clock ahead by over a year", "level", whole.ms(lost, acts(LEVEL)), 1000)
        with pytest.raises(LinkLost):
            await drone.kill()  # which goes out all the same
        await whole.passes(0.1)
        assert stands(whole.steps[-1])
        with suppress(LinkLost):
            await drone.close()
