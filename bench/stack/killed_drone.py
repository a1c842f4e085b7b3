"""A virtual drone in real time that says when it was killed and arms again: `python -m bench.stack.killed_drone [KEY]`.

It prints a line of JSON with its URLs, TCP and UDP. For each line on standard input it lets a kill go and
arms in the name of the system there. It prints when it is armed, and when the motors have stopped.
"""

import asyncio
import sys
import time
from pathlib import Path

from bench.stack.drone_process import say
from twodof.fcu.control.flight_code import ControlStep
from twodof.link.mavlink.dialect import GROUND_STATION
from twodof.link.signing import Signing, Stamps, read_key
from twodof.sim.virtual_drone import VirtualDrone

ALIVE_TICKS = 12
"""Armed for so long it may be killed again."""


class Kills:
    """A listener of the control loop, called once the motors have their commands."""

    def __init__(self, drone: VirtualDrone) -> None:
        self.pilot = 0
        self._drone = drone
        self._armed = 0

    def __call__(self, step: ControlStep) -> None:
        """Says that a kill has stopped the motors, lets it go and arms again."""
        commander, pilot = self._drone.commander, (self.pilot, GROUND_STATION)
        if step.armed:
            self._armed += 1
            if self._armed == ALIVE_TICKS:
                say({"armed": time.monotonic_ns()})
        elif self._armed:
            if self._armed >= ALIVE_TICKS:
                self.pilot = 0
                say({"killed": time.monotonic_ns()})
            self._armed = 0
        if self.pilot and not step.armed:
            holder = commander.lease.holder
            if holder not in (None, pilot):
                commander.lease.give_up(holder)
            commander.arming.release(pilot)
            commander.arming.arm(pilot)


async def serve(key: str) -> None:
    """Until standard input ends."""
    signing = Signing(read_key(Path(key)), Stamps(None)) if key else None
    drone = VirtualDrone("paper", {"rings": True}, signing=signing)
    kills = Kills(drone)
    drone.controller.bus.subscribe(ControlStep, kills)
    async with drone:
        say({"urls": [await drone.listen(f"{kind}://127.0.0.1:0") for kind in ("tcpin", "udpin")]})
        while line := await asyncio.to_thread(sys.stdin.readline):
            kills.pilot = int(line)
        say({"missed": drone.controller.timing.missed})


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1] if len(sys.argv) > 1 else ""))
