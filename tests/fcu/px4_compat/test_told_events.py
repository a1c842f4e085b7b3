"""A flight in which things go wrong, as a client of PX4 reads it: EVENTs in words, reports of checks, and STATUSTEXT.

The reader is libevents' own parser; the descriptions are fetched over the link, as QGroundControl does it.
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.fcu.px4_compat.event_reader import Reader
from twodof.errors import Rejected
from twodof.fcu.mavlink.files.file_tree import EXTRAS
from twodof.flight.failsafe.causes_and_actions import CAUSES
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.mavlink.modes import MODES, POSITION
from twodof.sim.virtual_drone import VirtualDrone

TAB = "\t"
TEXTS = {cause.name: cause.text for cause in CAUSES}


class Watcher:
    """What a person at a client that shows events sees, and what one at a client without them does."""

    def __init__(self, drone: AsyncDrone, reader: Reader) -> None:
        self._drone, self._reader = drone, reader
        self._heard: list[Any] = []
        drone.session.on(self._heard.append, "EVENT", "STATUSTEXT")

    async def look(self, seconds: float = 0.2) -> tuple[list[str], list[str]]:
        """Lines of events, and of STATUSTEXT, since the last look and in the next `seconds`."""
        await self._drone.run(seconds)
        heard, self._heard[:] = [*self._heard], []
        lines: list[str] = []
        for one in heard:
            if one.get_type() == "STATUSTEXT":
                lines[len(lines) - bool(one.chunk_seq) :] = [(lines[-1] if one.chunk_seq else "") + one.text]
        return self._reader.shown([one for one in heard if one.get_type() == "EVENT"]), lines


async def _flight() -> None:
    async with VirtualDrone("paper", {"rings": True}, lockstep=True) as virtual:
        await virtual.listen("memin://told")
        async with await AsyncDrone.connect("mem://told") as drone:
            reader = Reader(await drone.files.read(f"{EXTRAS}/events.json"))
            watcher = Watcher(drone, reader)
            await drone.run(0.5)  # at first no sensor was heard yet
            await drone.command("RUN_PREARM_CHECKS")
            await watcher.look()
            able = {group.name: group.can_arm for group in reader.checks._mode_groups}
            assert able == {mode.name: mode.custom_mode != POSITION for mode in MODES}  # the rings lock the cart

            await drone.arm()
            us = drone.session.connection.system
            assert await watcher.look() == ([f"Armed by system {us}, component 190"], [])

            await drone.set_pitch(0.05, thrust=0.4)
            virtual.rig.distort = lambda sample: sample._replace(imu_new=False)
            shown, lines = await watcher.look()
            reason = "; ".join(TEXTS[name] for name in lines[0].rstrip(TAB).split("(")[1].rstrip(")").split(", "))
            assert shown == [f"Failsafe: motors off ({reason})", "Disarmed by the failsafe"]
            assert lines[0].startswith("failsafe: motors off (")
            assert lines[0].endswith(TAB)  # who shows events leaves this line out: nothing is said twice

            with pytest.raises(Rejected) as refused:
                await drone.arm()
            assert TAB not in refused.value.what
            (denied,), (said,) = await watcher.look()
            assert said.startswith("not armed: ")
            assert said.endswith(TAB)
            assert "the failsafe has stopped the motors, disarm first" in denied
            assert not any(group.can_arm for group in reader.checks._mode_groups)
            assert set(reader.failing().values()) >= {"accel", "system"}

            virtual.rig.distort = None
            await drone.kill()
            shown, lines = await watcher.look()
            assert shown == [f"Killed by system {us}, component 190"]
            assert lines == [f"killed by system {us}, component 190{TAB}"]
            with pytest.raises(Rejected):
                await drone.arm()
            (denied,), _ = await watcher.look()
            assert denied == "Arming denied: it was killed, release it first"

            await drone.disarm()
            await drone.release()
            shown, lines = await watcher.look(2.1)
            assert shown == [f"Released by system {us}, component 190"]
            assert lines == [f"released by system {us}, component 190{TAB}"]
            assert reader.failing() == {"The mode moves the cart, which is locked": "position_controller"}
            await drone.arm()  # as the report has it
            shown, _ = await watcher.look()
            assert shown == [f"Armed by system {us}, component 190"]


def test_what_happens_is_told_in_words_to_who_shows_events_and_to_who_does_not() -> None:
    asyncio.run(_flight())
