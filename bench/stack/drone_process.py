"""A virtual drone in real time, in a process that notes when its motors change: `python -m bench.stack.drone_process`.

It prints a line of JSON with its URL; for each line on standard input it prints one with what it has noted since.
"""

import asyncio
import json
import subprocess
import sys
import time
from types import TracebackType
from typing import Any, Self

from twodof.fcu.control.flight_code import ControlStep
from twodof.sim.virtual_drone import VirtualDrone

START_S = 120.0


class Changes:
    """A listener of the control loop, called once the motors have their commands."""

    def __init__(self) -> None:
        self.noted: list[tuple[int, float]] = []
        self._last = (0.0, 0.0)

    def __call__(self, step: ControlStep) -> None:
        """Notes the time [ns of the monotonic clock] and the moment asked for, if the motors' commands are new."""
        if (step.fore, step.aft) != self._last:
            self._last = (step.fore, step.aft)
            self.noted.append((time.monotonic_ns(), step.asked.M_open))


async def serve() -> None:
    """Until standard input ends."""
    changes = Changes()
    drone = VirtualDrone("paper", {"rings": True})
    drone.controller.bus.subscribe(ControlStep, changes)
    async with drone:
        say({"url": await drone.listen("tcpin://127.0.0.1:0")})
        while await asyncio.to_thread(sys.stdin.readline):
            timing = drone.controller.timing
            say({"changes": changes.noted, "missed": timing.missed, "overruns": timing.overruns})
            changes.noted = []


def say(what: dict[str, Any]) -> None:
    """One line of JSON."""
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


class DroneProcess:
    """That process, seen from outside. A context manager."""

    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "bench.stack.drone_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.url: str = self._answer()["url"]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        try:
            self.process.wait(START_S)
        finally:
            self.process.kill()
            self.process.stdout.close()

    def report(self) -> dict[str, Any]:
        """Return the notes of the drone since the last call."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"the drone's process ended with status {self.process.wait(START_S)}")
        answer: dict[str, Any] = json.loads(line)
        return answer


if __name__ == "__main__":
    asyncio.run(serve())
