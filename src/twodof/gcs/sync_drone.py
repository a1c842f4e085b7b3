"""What the synchronous drone does in its own way: connecting, leaving, waiting for first values."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar, Self
from weakref import WeakSet, finalize

from twodof.errors import Rejected, TwodofError
from twodof.gcs.async_drone import DEFAULT_URL, AsyncDrone
from twodof.gcs.discovery import FoundDrone, discover
from twodof.gcs.loop_thread import LoopThread
from twodof.gcs.stoppable_drone import LEAVING_S
from twodof.gcs.sync_face import SyncFace
from twodof.gcs.sync_parts import DroneParameters, DroneSignal
from twodof.link.signing.key import Key


class SyncDrone(SyncFace):
    """A drone that a thread of its own flies for a script."""

    there: AsyncDrone
    _open: ClassVar[WeakSet[SyncDrone]] = WeakSet()

    def __init__(self, there: AsyncDrone, runner: LoopThread) -> None:
        super().__init__(there, runner)
        self.parameters = DroneParameters(there.parameters, runner)

    @classmethod
    def connect(
        cls,
        url: str = DEFAULT_URL,
        timeout: float = 10.0,
        system: int | None = None,
        key: Key | str | Path | None = None,
        take_lease: bool = True,
        drone: int | None = None,
    ) -> Self:
        """Find the drone at `url` and, with `take_lease`, become the one who commands it. As AsyncDrone.connect."""
        runner = LoopThread(url)
        try:
            there = runner.run(AsyncDrone.connect(url, timeout, system, key, take_lease, drone))
        except Rejected as refusal:
            runner.close()
            if any(other.has_lease(refusal) for other in cls._open):
                remedy = "this program has it: close() the Drone that it has, or go on with that"
                raise Rejected(refusal.what, refusal.where, remedy) from refusal
            raise
        except BaseException:
            runner.close()
            raise
        made = cls(there, runner)
        runner.at_exit(made.close)
        # One that nobody has any more, by a notebook's cell that was run again, is to fly no more either.
        finalize(made, runner.leave_behind, there.close).atexit = False
        cls._open.add(made)
        return made

    def has_lease(self, refusal: Rejected) -> bool:
        """Whether it is this one that has the lease which a refusal is about."""
        holder = self.there.lease.holder
        return self.there.lease.ours and holder is not None and f"{holder[0]}/{holder[1]} holds" in refusal.what

    @staticmethod
    def discover(timeout: float = 3.0, hosts: Iterable[str] = ()) -> list[FoundDrone]:
        """The drones that are heard at the usual ports of this machine, and answer at those of `hosts`.

        Listens for `timeout` [s]; each has the `url` to connect to. Raises LinkError for a host that is unknown.
        """
        runner = LoopThread("discovery")
        try:
            return runner.run(discover(timeout, hosts))
        finally:
            runner.close()

    def __repr__(self) -> str:
        return repr(self.there)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.close()
        except TwodofError:
            if kind is None:
                raise

    def close(self, timeout: float = LEAVING_S) -> None:
        """Disarm it if we commanded, give the lease up, close the link. Raises if it cannot be seen to be disarmed."""
        try:
            if self._runner.alive:
                self._runner.run(self.there.close(timeout), finish=True)  # Ctrl-C keeps nobody from disarming
        finally:
            self._open.discard(self)
            self._runner.close()

    @property
    def theta(self) -> float:
        """The latest estimate of the pitch [rad]; the first one is waited for. Raises LinkLost, Timeout."""
        return self._scalar("estimate.theta")

    @property
    def q(self) -> float:
        """The latest estimate of the pitch rate [rad/s], as `theta`."""
        return self._scalar("estimate.q")

    @property
    def x(self) -> float:
        """The latest estimate of the position along the rail [m], as `theta`."""
        return self._scalar("estimate.x")

    @property
    def v(self) -> float:
        """The latest estimate of the velocity along the rail [m/s], as `theta`."""
        return self._scalar("estimate.v")

    def _scalar(self, name: str) -> float:
        value = self.telemetry(name).value
        return value[0] if isinstance(value, tuple) else value

    def telemetry(self, name: str) -> DroneSignal:
        """A signal by its name (`estimate.q`) or .mat channel (`q`). Raises LogError if there is none."""
        return DroneSignal(self.there.telemetry(name), self._runner)
