"""One program commands, another tunes: beside each other at one drone, on the port that every program looks at."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest
from typer.testing import CliRunner

from tests.fcu.command.cockpit import ME, Cockpit
from tests.fleet.drone_numbers import free_numbers
from tests.gcs.peer import Peer, flight
from tests.gcs.virtual import on_board
from twodof.cli.app import app
from twodof.companion.companion import Companion
from twodof.companion.links import px4_links
from twodof.errors import Rejected
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone import Drone
from twodof.gcs.loop_thread import LoopThread
from twodof.link.transport.url import Ports

pytestmark = pytest.mark.slow


@contextmanager
def directly(index: int) -> Iterator[None]:
    """A drone that sends to the onboard port, and listens as PX4 does."""
    place = f"udp://127.0.0.1:{Ports.ONBOARD + index}?bind=127.0.0.1:{Ports.COMPANION_ONBOARD + index}"
    with on_board(place, conditions={"rings": True}):
        yield


@contextmanager
def through_the_companion(index: int) -> Iterator[None]:
    """A drone behind its companion, which has the usual ports."""
    thread = LoopThread("companion")
    with on_board(conditions={"rings": True}) as there:

        async def start() -> Companion:
            return await Companion(there.url, px4_links(index)).__aenter__()

        companion = thread.run(start())
        try:
            yield
        finally:
            thread.run(companion.close())
            thread.close()


@pytest.mark.parametrize("served", [directly, through_the_companion])
def test_the_commander_may_withhold_tuning(served: Callable[[int], AbstractContextManager[None]]) -> None:
    with free_numbers(1) as index, served(index):
        url = f"udpin://127.0.0.1:{Ports.ONBOARD + index}"
        with Drone.connect(url, take_lease=False) as tuner:
            with Drone.connect(url) as commander:
                commander.arm()
                commander.set_pitch(0.0, thrust=0.3)
                tuner.parameters["RATE_KP"] = 0.06
                commander.withhold_tuning()
                with pytest.raises(Rejected, match="holds the lease and withholds tuning"):
                    tuner.parameters["RATE_KP"] = 0.08
                with pytest.raises(Rejected, match="holds the lease and withholds tuning"):
                    tuner.parameters.change({"RATE_KP": 0.08, "ATT_KP": 9.0})
                with pytest.raises(Rejected, match="this client does not hold the lease"):
                    tuner.withhold_tuning()
                assert tuner.parameters["RATE_KP"] == pytest.approx(0.06)
                commander.withhold_tuning(False)
                tuner.parameters["RATE_KP"] = 0.07
                commander.withhold_tuning()
                assert commander.state.armed
            tuner.parameters["RATE_KP"] = 0.08  # the lease was given up, and with it what it withheld


def test_the_shell_tunes_another_programs_drone() -> None:
    with free_numbers(1) as index, directly(index):
        url = f"udpin://127.0.0.1:{Ports.ONBOARD + index}"
        with Drone.connect(url):
            done = CliRunner().invoke(app, ["parameters", "RATE_KP=0.06", "--url", url])
            assert done.exit_code == 0
            assert " 0.06 " in done.output


@flight()
async def test_what_is_withheld_is_allowed_again_with_the_next_lease(peer: Peer, drone: AsyncDrone) -> None:
    await drone.withhold_tuning()
    await drone.run(1.0)  # over a renewal
    assert peer.tuning_withheld
    await drone.lease.give_up(5.0)
    await drone.lease.take(5.0)
    await drone.run(1.0)
    assert not peer.tuning_withheld


@flight()
async def test_without_the_lease_tuning_cannot_be_withheld(peer: Peer, drone: AsyncDrone) -> None:
    peer.holder = (7, 190)
    with pytest.raises(Rejected, match="7/190 holds the lease"):
        await drone.withhold_tuning()
    peer.holder = (0, 0)
    await drone.run(1.0)  # a renewal takes it
    assert drone.lease.ours
    assert not peer.tuning_withheld


@pytest.mark.parametrize(("M", "T", "why"), [(5.0, 0.0, "M = 5 is outside -1 to 1"), (0.0, 1.5, "T = 1.5 is outside")])
def test_an_open_loop_message_beyond_its_bounds_is_refused(M: float, T: float, why: str) -> None:
    commander = Cockpit().commander
    assert why in commander.open_loop(ME, M, T, True, True, True).text
    assert commander.open_loop(ME, M, T, True, False, False).accepted  # it is not flown


def test_open_loop_ends_whatever_moment_the_message_has() -> None:
    assert Cockpit().commander.open_loop(ME, 5.0, 0.0, False, True, False).accepted
