"""AsyncDrone over a link that loses, delays, reorders and repeats frames, on virtual time."""

from pathlib import Path

import pytest

from tests.faults.transport import Faults, FaultyTransport
from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from twodof.errors import LinkLost
from twodof.excitation import Multisine
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.transport import open_transport

pytestmark = pytest.mark.slow

# The issue's: three packets in ten are lost, 200 ms of jitter, and what that reorders; one in ten comes twice.
BAD = Faults(loss=0.3, duplicate=0.1, reorder=0.1, jitter=0.2)
LONG = Multisine.schroeder(0.1, 10.0, range(1, 120), unit="rad")  # of 30 pieces


@pytest.mark.parametrize("seed", [0, 4, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2, 3, 5, 6, 7))])
def test_everything_is_done_over_a_bad_link(seed: int, tmp_path: Path) -> None:
    async def work() -> None:
        peer = Peer(wrap=lambda transport: FaultyTransport(transport, BAD, seed))
        async with peer:
            bad = FaultyTransport(await open_transport(peer.url), BAD, 1000 + seed)
            async with await AsyncDrone.over(bad, timeout=30.0) as drone:
                assert drone.ours
                await drone.parameters.update({"ATT_KP": 6.0, "RATE_KP": 0.05}, timeout=30.0)
                assert (peer.parameters["ATT_KP"], peer.parameters["RATE_KP"]) == (6.0, pytest.approx(0.05))
                await drone.run(0.5)  # until no second copy of a PARAM_SET is under way, which would act after the undo
                await drone.parameters.undo(timeout=30.0)
                assert peer.parameters["ATT_KP"] == 11.0
                assert len(await drone.parameters.all(30.0)) == len(peer.parameters)
                await drone.arm(timeout=30.0)
                assert peer.armed
                await drone.set_pitch(0.1, timeout=30.0)
                await drone.run(1.0)
                played = await drone.excite(LONG, timeout=60.0, wait=False)
                assert played.end_tick > played.start_tick
                entry = (await drone.logs.list(30.0))[0]
                assert (await drone.logs.download(entry, tmp_path / "log.ulg", 60.0)).read_bytes() == peer.log
                await drone.kill(timeout=30.0)
                assert not peer.armed
            assert peer.holder == (0, 0) or peer.count("TWODOF_LEASE") > 2

    run_virtual(work())


def test_a_cable_that_is_cut_and_mended() -> None:
    """Three seconds of silence are a lost link, for good; another connection flies on."""

    async def work() -> None:
        async with Peer() as peer:
            link = FaultyTransport(await open_transport(peer.url), Faults(), 1)
            drone = await AsyncDrone.over(link, timeout=5.0)
            await drone.arm()
            link.cut()
            with pytest.raises(LinkLost, match="nothing was heard"):
                await drone.run(10.0)
            link.mend()
            with pytest.raises(LinkLost):
                await drone.disarm()
            await drone.kill()  # which goes out although the link was lost
            assert not peer.armed
            await drone.close()
            peer.holder = (0, 0)  # which it would be 3 s later
            async with await AsyncDrone.connect(peer.url) as again:
                await again.arm()

    run_virtual(work())
