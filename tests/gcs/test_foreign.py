"""Another's PX4, scripted: common verbs work, verbs that need our own messages are refused at once."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.gcs.peer import Peer, flight
from twodof.errors import LogError, Rejected
from twodof.excitation import Doublet
from twodof.flightlog import read_log
from twodof.gcs.async_drone import AsyncDrone


class Foreign(Peer):
    """Answers none of our own messages, as PX4 does."""

    def _answer(self, received: Any) -> None:
        got = received.message
        if got.get_type().startswith("TWODOF_"):
            return
        if got.get_type() == "COMMAND_LONG" and got.command in (511, 512) and got.param1 >= 54200:
            self.send("COMMAND_ACK", command=got.command, result=4)
            return
        super()._answer(received)


OURS: dict[str, tuple[str, Callable[[AsyncDrone], Any]]] = {
    "set_moment": ("TWODOF_OPENLOOP", lambda drone: drone.set_moment(0.1, thrust=0.4)),
    "excite": ("TWODOF_EXCITE", lambda drone: drone.excite(Doublet(0.1, 1.0, unit="rad"))),
    "stop_excitation": ("TWODOF_EXCITE", lambda drone: drone.stop_excitation()),
    "reset": ("TWODOF_RIG_RESET", lambda drone: drone.reset()),
    "stream": ("TWODOF_TOF", lambda drone: drone.stream("TWODOF_TOF", 10.0)),
    "batch": ("TWODOF_BATCH", lambda drone: drone.batch(["estimate.q"])),
    "truth": ("TWODOF_TRUTH", lambda drone: drone.truth()),
    "fly_controller": ("controllers", lambda drone: drone.fly_controller("attitude_control", b"{}")),
}


@pytest.mark.parametrize("verb", OURS)
@flight(Foreign)
async def test_a_verb_that_needs_our_messages_is_refused_at_once(peer: Foreign, drone: AsyncDrone, verb: str) -> None:
    missing, call = OURS[verb]
    assert not drone.ours
    heard, start = len(peer.heard), asyncio.get_running_loop().time()
    with pytest.raises(Rejected, match=f"not a twodof drone but px4, which has no .*{missing}"):
        await call(drone)
    assert asyncio.get_running_loop().time() == start
    await asyncio.sleep(0.5)
    assert {got.get_type() for got in peer.heard[heard:]} <= {"HEARTBEAT"}


@flight(Foreign)
async def test_a_foreign_drone_is_flown_and_tuned(peer: Foreign, drone: AsyncDrone) -> None:
    await drone.arm()
    await drone.set_pitch(0.1, thrust=0.4)
    assert peer.mode == 6 << 16
    await drone.parameters.update({"ATT_KP": 6.0, "RATE_KP": 0.05})
    assert peer.parameters["ATT_KP"] == 6.0


@flight(Foreign)
async def test_its_messages_are_recorded_as_they_come(peer: Foreign, drone: AsyncDrone, tmp_path: Path) -> None:
    """ATTITUDE 50 times a second, a battery now and then: each sample with the drone's own stamp."""
    async with drone.record(tmp_path / "px4.mcap") as recording:
        start = peer.tick
        peer.send("BATTERY_STATUS", voltages=[4000] * 3 + [0xFFFF] * 7, battery_remaining=50)
        await asyncio.sleep(2.01)
    with pytest.raises(LogError, match="only a twodof drone sends this topic"):
        async with drone.record(tmp_path / "none.mcap", ["tof.distance"]):
            pass
    log = read_log(tmp_path / "px4.mcap")
    assert recording.samples == sum(len(log[name]) for name in log)
    assert len(log["theta"]) == len(log["q"]) == 100
    np.testing.assert_allclose(np.diff(log["q"].time), 0.02, atol=1e-8)
    np.testing.assert_allclose(log["q"].value, 0.01 * (start + 5 * np.arange(1, 101)), rtol=1e-6)
    assert "lost" not in log.provenance
    assert log.provenance["drone"]["autopilot"] == "px4"


@flight(Foreign)
async def test_its_version_is_told_in_words(peer: Foreign, drone: AsyncDrone) -> None:
    assert str(await drone.version()) == "twodof 0.0.0 dev, speaks as px4 1.16.1 release"  # as the script says
    assert (await drone.version()).uid == 1
