"""The assembled thing on virtual time: rig, flight controller, companion, links that fail, and clients.

The flight controller runs as in real time: nothing is granted. But its pace is the event loop's clock, which jumps. So
minutes pass in seconds, and a loaded machine changes nothing.
"""

import asyncio
import gc
import sys
from collections.abc import Callable, Coroutine, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from typing import Any, Self
from unittest.mock import patch

from tests.faults.transport import Faults, FaultyTransport
from tests.faults.virtual_time import run_virtual
from twodof.companion.companion import Companion
from twodof.companion.links import Serve
from twodof.errors import TwodofError
from twodof.fcu import server
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.real_time import Watchdog
from twodof.fcu.mavlink.background import BackgroundWorker
from twodof.flight.failsafe.causes_and_actions import ACTIONS
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.signing import Signing
from twodof.link.transport import open_transport
from twodof.link.transport.base import Transport
from twodof.sim.virtual_drone import VirtualDrone

PERIOD_S = 0.004
NONE, LEVEL, BRAKE, DESCEND, OFF = (ACTIONS.index(name) for name in ("none", "level", "brake", "descend", "off"))
GROUND = 190
# A loop on virtual time gives no sign of life while the test itself works: only minutes of it are a hang.
HANGS_S = 60.0
_numbers = count()


class LoopPacer:
    """A pacer of the control loop on the event loop's clock; never late."""

    def __init__(self, period_ns: int) -> None:
        self.missed = self.late_ns = 0
        self._period = period_ns * 1e-9
        self._begin, self._done = asyncio.get_running_loop().time(), 0

    async def wait(self) -> int:
        """Waits for the next period."""
        self._done += 1
        await asyncio.sleep(max(0.0, self._begin + self._done * self._period - asyncio.get_running_loop().time()))
        return 1

    def close(self) -> None:
        """Do nothing."""


@contextmanager
def paced_by_the_loop() -> Iterator[None]:
    """A virtual drone that is begun within runs on the event loop's clock, which may jump."""
    with ExitStack() as stack:
        stack.enter_context(patch.object(server, "Pacer", LoopPacer))
        stack.enter_context(patch.object(server, "Watchdog", lambda stop, patient: Watchdog(stop, HANGS_S)))
        # Another thread's work would take virtual time by chance.
        stack.enter_context(patch.object(BackgroundWorker, "submit", _at_once))
        yield


@dataclass
class Seen:
    """A step, and the rig's true pitch [rad] and place [m] after it."""

    step: ControlStep
    theta: float
    x: float


class Whole:
    """A drone and its companion, for `async with`; `options` are VirtualDrone's.

    `wifi` are the faults between clients and companion, `line` those between companion and flight controller, both
    ways. `steps` is every control period so far. `signing` is the flight controller's, `companion_signing` the
    companion's.
    """

    def __init__(
        self,
        wifi: Faults | None = None,
        line: Faults | None = None,
        seed: int = 1,
        signing: Signing | None = None,
        companion_signing: Signing | None = None,
        **options: Any,
    ) -> None:
        number = next(_numbers)
        self.fcu, self.clients = f"mem://fcu-{number}", f"mem://clients-{number}"
        self.wifi, self.line = wifi or Faults(), line or Faults()
        self.steps: list[Seen] = []
        self.drone = VirtualDrone(**{"conditions": {"rings": True, "seed": seed}, "signing": signing, **options})
        self.drone.controller.bus.subscribe(ControlStep, self._seen)
        self.companion = Companion(self.fcu, [Serve(self.clients.replace("mem:", "memin:"))], 1, companion_signing)
        self.faulty: list[FaultyTransport] = []
        self._seeds = count(1000 * seed)
        self._stack = ExitStack()

    async def __aenter__(self) -> Self:
        stack = self._stack
        stack.enter_context(paced_by_the_loop())
        stack.enter_context(patch.object(server, "open_transport", self._open))
        stack.enter_context(patch("twodof.companion.links.open_transport", self._open))
        await self.drone.__aenter__()
        await self.drone.listen(self.fcu.replace("mem:", "memin:"))
        await self.companion.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        try:
            await self.companion.close()
            await self.drone.close()
        finally:
            self._stack.close()
            for one in self.faulty:
                await one.close()
            gc.unfreeze()

    @property
    def tick(self) -> int:
        """The next control period."""
        return self.drone.controller.tick

    async def open(self, faults: Faults | None = None) -> FaultyTransport:
        """A client's end of a link to the companion."""
        made = FaultyTransport(await open_transport(self.clients), faults or self.wifi, next(self._seeds))
        self.faulty.append(made)
        return made

    async def client(self, system: int = 250, timeout: float = 30.0, **options: Any) -> AsyncDrone:
        """A client behind the companion."""
        return await self.client_over(await self.open(), timeout=timeout, system=system, **options)

    async def client_over(self, link: Transport, **options: Any) -> AsyncDrone:
        """A client on a link of ours."""
        return await AsyncDrone.over(link, **options)

    async def airborne(self, theta: float | None = 0.1, **options: Any) -> AsyncDrone:
        """A client that has armed, and streams this pitch [rad] (None: its position); a second later it flies there."""
        drone = await self.client(**options)
        await drone.run(0.5)
        await drone.arm(timeout=30.0)
        if theta is None:
            await drone.set_position(0.0, timeout=30.0)
        else:
            await drone.set_pitch(theta, thrust=0.4, timeout=30.0)
        await drone.run(1.5)
        assert self.steps[-1].step.armed
        assert self.steps[-1].step.action == NONE
        assert self.steps[-1].step.fore > 0.0
        return drone

    async def passes(self, seconds: float) -> None:
        """Time passes, also where the clients hear nothing of it."""
        await asyncio.sleep(seconds)

    def ms(self, first: int, true: Callable[[Seen], bool]) -> float:
        """How long after the tick `first` began the first period ended in which something is true [ms]."""
        for seen in self.steps:
            if seen.step.tick >= first and true(seen):
                return 4.0 * (seen.step.tick - first + 1)
        raise AssertionError("it never was")

    def since(self, first: int) -> list[ControlStep]:
        """The steps from a tick on."""
        return [seen.step for seen in self.steps if seen.step.tick >= first]

    def _seen(self, step: ControlStep) -> None:
        self.steps.append(Seen(step, self.drone.rig.truth[0], self.drone.rig.truth[2]))

    async def _open(self, url: str, *rest: Any) -> Transport:
        made = await open_transport(url, *rest)
        faults = self.line if self.fcu.partition("://")[2] in url else self.wifi
        if faults == Faults():
            return made
        faulty = FaultyTransport(made, faults, next(self._seeds))
        self.faulty.append(faulty)
        return faulty


def _at_once(background: BackgroundWorker, work: Callable[[], object], done: Callable[[object], None]) -> bool:
    try:
        result: object = work()
    except (OSError, TwodofError) as fault:
        result = fault
    done(result)
    return True


def run(work: Coroutine[Any, Any, Any]) -> Any:
    """Run `work` on virtual time and return its result."""
    return run_virtual(work)


def stands(seen: Seen) -> bool:
    """Return whether both motors stand."""
    return seen.step.fore == 0.0 and seen.step.aft == 0.0


def acts(action: int) -> Callable[[Seen], bool]:
    """Return a test of whether the failsafe takes this action."""
    return lambda seen: seen.step.action == action


def silent(steps: list[ControlStep]) -> bool:
    """Return whether the drone is armed and the failsafe does not act in all steps."""
    return all(step.action == NONE and step.armed for step in steps)


def tell(fault: str, what: str, took_ms: float, within_ms: float) -> None:
    """A measured time and its bound, in the report of a test that is run with -rA."""
    sys.stdout.write(f"{fault}: {what} after {took_ms:.0f} ms (within {within_ms:.0f} ms)\n")
    assert took_ms <= within_ms
